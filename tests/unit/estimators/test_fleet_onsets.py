from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from gcs_coloc.core.measurements import AltitudeMeasurement, Estimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet_filter import FleetFilter
from gcs_coloc.estimators.fleet_onsets import OnsetsOf
from gcs_coloc.estimators.fleet_settings import FleetSettings

SUBJECT, SPEED_MPS, TURN_RADPS, RANGE_SIGMA_M = 9, 50.0, 0.19, 20.0
TURN_S, STRAIGHT_S, END_S = 40.0, 48.0, 52.0
PEERS_M = {1: (0.0, 2500.0), 2: (3500.0, 2600.0), 3: (2000.0, -2500.0)}
NEVER = FleetSettings(onset_rate_per_s=1e-12)


def begun(settings: FleetSettings, speed_mps: float = SPEED_MPS) -> FleetFilter:
    """A filter of a subject that flies east from the origin and three anchors."""
    estimator = FleetFilter(settings)
    for vehicle, (e, n) in PEERS_M.items():
        estimator.add(PositionMeasurement(vehicle, 0.0, 0.0, (e, n, 0.0), 5.0, 1.0, static=True))
    estimator.add(PositionMeasurement(SUBJECT, 0.0, 0.0, (0.0, 0.0, 0.0), 5.0, 1.0, (speed_mps, 0.0, 0.0), 1.0))
    estimator.set_subjects({SUBJECT}, 0.0)
    return estimator


def measure(estimator: FleetFilter, t: float, place: tuple[float, float], noise_m: np.ndarray | float) -> None:
    """Tell the subject's height and its ranges to all anchors."""
    estimator.add(AltitudeMeasurement(SUBJECT, t, t, 0.0, 1.0))
    for (p, (e, n)), off_m in zip(PEERS_M.items(), np.broadcast_to(noise_m, 3), strict=True):
        range_m = math.hypot(place[0] - e, place[1] - n) + float(off_m)
        estimator.add(RangeMeasurement(SUBJECT, p, t, t, range_m, RANGE_SIGMA_M))


def turning(t: float) -> tuple[float, float]:
    """Straight to the east, a turn to the left at 1 g by a right angle, then straight on."""
    if t < TURN_S:
        return SPEED_MPS * t, 0.0
    a = TURN_RADPS * (min(t, STRAIGHT_S) - TURN_S)
    radius_m, on_m = SPEED_MPS / TURN_RADPS, SPEED_MPS * max(t - STRAIGHT_S, 0.0)
    east_m, north_m = SPEED_MPS * TURN_S + radius_m * math.sin(a), radius_m * (1.0 - math.cos(a))
    return east_m + on_m * math.cos(a), north_m + on_m * math.sin(a)


def nees_from_the_turn_on(seed: int, settings: FleetSettings) -> list[float]:
    rng, estimator, squares = np.random.default_rng(seed), begun(settings), []
    for k in range(1, round(END_S * 5.0)):
        t = 0.2 * k
        measure(estimator, t, turning(t), RANGE_SIGMA_M * rng.normal(size=3))
        where = estimator.estimate(SUBJECT, t)
        if t > TURN_S:
            assert isinstance(where, Estimate)
            off = where.position_enu_m[:2] - turning(t)
            squares.append(float(off @ np.linalg.solve(where.covariance[:2, :2], off)))
    return squares


def test_a_hard_turn_that_nobody_tells_of_is_in_what_is_stated_before_the_ranges_show_it():
    # Twelve flights, 59 epochs of each from the onset on. With steady flight taken for certain 8 % of them are outside the region
    # that holds 99 %; here 2 % are, of 1 %. Half is far from both: these are as many errors as a dozen turns can tell apart.
    steady, may_begin = (np.array([nees_from_the_turn_on(seed, s) for seed in range(12)]) for s in (NEVER, FleetSettings()))
    limit = float(chi2.ppf(0.99, 2))
    assert np.mean(steady > limit) > 0.05
    assert np.mean(may_begin > limit) < 0.5 * np.mean(steady > limit)
    assert may_begin.max() < 36.0


def test_steady_flight_is_hardly_known_worse_for_manoeuvres_that_might_have_begun():
    sigmas_m = []
    for settings in (NEVER, FleetSettings()):
        rng, estimator = np.random.default_rng(1), begun(settings)
        for k in range(1, 150):
            measure(estimator, 0.2 * k, (SPEED_MPS * 0.2 * k, 0.0), RANGE_SIGMA_M * rng.normal(size=3))
        where = estimator.estimate(SUBJECT, 30.0)
        assert isinstance(where, Estimate)
        sigmas_m.append(math.sqrt(np.trace(where.covariance[:2, :2])))
    assert sigmas_m[0] < sigmas_m[1] < 1.2 * sigmas_m[0]


def test_by_how_much_the_mean_lags_behind_an_acceleration_is_known():
    estimator, onset_s, acceleration_mps2 = begun(NEVER), math.inf, 2.0
    for k in range(1, 120):
        t = 0.2 * k
        place = (SPEED_MPS * t, 0.5 * acceleration_mps2 * max(t - onset_s, 0.0) ** 2)
        measure(estimator, t, place, 0.0)
        model = estimator._timeline.catch_up().main
        newest_s = max((at_s for at_s in model.records[SUBJECT].onsets if at_s < math.inf), default=0.0)
        if onset_s == math.inf and newest_s > 15.0:
            onset_s = newest_s
        if t - onset_s > 4.0:
            break
    joint, slot = model.clusters[SUBJECT].joint, model.records[SUBJECT].onsets.index(onset_s)
    north, on = joint.where[SUBJECT].start + 1, joint.where[OnsetsOf(SUBJECT)].start + 2 * slot + 1
    lag_m = place[1] - joint.A[0, north]
    assert lag_m > 3.0
    assert acceleration_mps2 * joint.A[north, on] == pytest.approx(lag_m, rel=0.15)
