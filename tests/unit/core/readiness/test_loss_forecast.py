"""The forecast of a loss: what integrity would add to the estimator's bound is in what is told of half a minute later."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, PositionPrior, RangeResidual
from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel
from gcs_coloc.core.integrity.fault_monitor import expected_separation_m2
from gcs_coloc.core.integrity.protection_level import Exposure, ProtectionSettings
from gcs_coloc.core.integrity.solution_separation import SolutionSeparation
from gcs_coloc.core.measurements import Estimate, PositionMeasurement
from gcs_coloc.core.readiness.loss_forecast import EarlierPrediction, LossSituation, forecast
from gcs_coloc.core.readiness.vehicle_readiness import HORIZON_S, VehicleReadiness

RANGED = 1
PLACES = {RANGED: (0.0, 0.0, 100.0), 2: (800.0, 100.0, 110.0), 3: (-500.0, 700.0, 90.0), 4: (-300.0, -800.0, 120.0)}
COVARIANCE = np.diag([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])


def epoch(peers: int) -> Epoch:
    """Return the ranges of the vehicle to some peers: 0.5 m of noise, receivers of 1 m."""
    nodes = {node: place for node, place in PLACES.items() if node <= peers + 1}
    priors = {node: PositionPrior(place, 1.0, 1.5, no_prior=False) for node, place in nodes.items()}
    priors[RANGED] = priors[RANGED]._replace(no_prior=True)
    return Epoch(0.0, priors, tuple(RangeResidual(RANGED, node, 0.0, 0.5, 0.3) for node in nodes if node != RANGED))


def told(
    peers: int,
    noise: NoiseModel,
    hdops: tuple[float | None, ...] = (1.2, 1.2),
    recent_hdops: tuple[float, ...] = (1.2,),
    variance_m2: float = 1.0,
    recent_share: float = 1.0,
    ranges_hz: float = 5.0,
) -> VehicleReadiness:
    """Return the forecast for an estimator that predicts the same covariance all along, and some HDOP.

    Earlier forecasts told `recent_share` of the bound without faults.
    """
    stated = epoch(peers)
    reported = {
        node: PositionMeasurement(node, 0.0, 0.0, prior.position_enu_m, 1.0, 1.5, (0.0, 0.0, 0.0), 0.3)
        for node, prior in stated.priors.items()
        if node != RANGED
    }
    where = np.array(PLACES[RANGED])
    answers = [
        Estimate(RANGED, at_s, where, np.zeros(3), variance_m2 * COVARIANCE, hdop, peers)
        for at_s, hdop in zip((0.0, 0.5 * HORIZON_S, HORIZON_S), (None, *hdops), strict=True)
    ]
    exposure = Exposure(True, inf)
    recent_m = recent_share * horizontal_bound_95_m(variance_m2 * COVARIANCE)
    recent = [EarlierPrediction(hdop, recent_m) for hdop in recent_hdops]
    situation = LossSituation(
        RANGED, (0.0, 0.0, 0.0), reported, noise.apply(stated), stated, {}, 0.2, ranges_hz, exposure, recent
    )
    return forecast(situation, answers, AidingSettings(), ProtectionSettings())


def test_possible_faults_are_in_the_bound_of_later_and_not_yet_in_that_of_now() -> None:
    found, separation_m2 = told(3, NoiseModel()), expected_separation_m2(epoch(3), RANGED)
    assert separation_m2 is not None
    later_m2 = COVARIANCE.copy()
    later_m2[:2, :2] += separation_m2
    assert found.bound_95_now_m == pytest.approx(horizontal_bound_95_m(COVARIANCE))
    assert found.bound_95_m == pytest.approx(horizontal_bound_95_m(later_m2), rel=1e-3)


def test_without_redundancy_the_bound_is_the_estimators() -> None:
    assert told(2, NoiseModel()).bound_95_m == pytest.approx(horizontal_bound_95_m(COVARIANCE))


def test_noise_beyond_the_stated_one_is_in_the_bound() -> None:
    noise = NoiseModel(range_bias_m=3.0)
    as_stated, as_found = SolutionSeparation(epoch(3)), SolutionSeparation(noise.apply(epoch(3)))
    excess_m2 = as_found.covariance_m2(RANGED) - as_stated.covariance_m2(RANGED)
    separation_m2 = expected_separation_m2(epoch(3), RANGED)
    assert separation_m2 is not None
    later_m2 = COVARIANCE.copy()
    later_m2[:2, :2] += separation_m2 + excess_m2
    assert told(3, noise).bound_95_m == pytest.approx(horizontal_bound_95_m(later_m2), rel=1e-3)
    assert float(np.trace(excess_m2)) > 5.0


@pytest.mark.parametrize(
    ("recent_hdops", "hdops", "is_told"),
    [
        ((1.2, 1.2), (1.2, 1.2), True),
        ((1.2, 1.3), (1.2, 1.5), True),
        ((1.2, 1.2), (1.2, 1.6), False),
        ((1.2, 1.2), (1.6, 1.2), False),
        ((1.6, 1.2), (1.2, 1.2), False),  # it turned of late, and will again
        ((5.1, 5.1), (5.2, 5.1), False),
        ((1.2, 1.2), (1.2, None), False),
        ((), (1.2, 1.2), False),  # not followed for a minute
    ],
)
def test_a_bound_is_told_where_the_geometry_hardly_changes(
    recent_hdops: tuple[float, ...], hdops: tuple[float | None, ...], is_told: bool
) -> None:
    assert told(2, NoiseModel(), hdops, recent_hdops).is_told is is_told


@pytest.mark.parametrize(("recent_share", "is_told"), [(0.8, False), (0.9, True), (1.1, True), (1.2, False)])
def test_a_bound_is_told_where_the_forecasts_of_the_last_minute_told_it_too(recent_share: float, is_told: bool) -> None:
    assert told(2, NoiseModel(), recent_hdops=(1.2, 1.2), recent_share=recent_share).is_told is is_told


@pytest.mark.parametrize(("ranges_hz", "is_told"), [(4.9, False), (5.0, True)])
def test_a_bound_is_not_told_of_a_vehicle_with_few_ranges(ranges_hz: float, is_told: bool) -> None:
    assert told(2, NoiseModel(), recent_hdops=(1.2, 1.2), ranges_hz=ranges_hz).is_told is is_told


@pytest.mark.parametrize(("range_bias_m", "is_told"), [(0.0, True), (3.0, False)])
def test_a_bound_that_is_mostly_what_the_tests_have_found_is_not_told(range_bias_m: float, is_told: bool) -> None:
    """The filter's own bound is 5 m; devices off by 3 m make it larger, and the tests go on to find by how much."""
    assert told(3, NoiseModel(range_bias_m=range_bias_m), variance_m2=4.0).is_told is is_told
