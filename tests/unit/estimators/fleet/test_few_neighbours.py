"""Denied vehicles whose neighbours are too few to tell of all directions: one, or of a vehicle without a height two or three."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m, horizontal_sigma_m
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    FloatArray,
    NoEstimate,
    OdometryMeasurement,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.estimators.fleet.ekf.outcomes import Outcome, UpdateResult
from gcs_coloc.estimators.fleet.ekf.records import VehicleRecord
from gcs_coloc.estimators.fleet.estimates import with_possible_motion
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.fleet_model import FleetModel
from gcs_coloc.estimators.fleet.reflection_hypothesis import log_likelihood_ratio
from gcs_coloc.estimators.fleet.searched_vehicles import search_of, search_with
from gcs_coloc.estimators.fleet.settings import FleetSettings

DENIED = 9
STEP_S, EVERY = 0.05, 4
LOST_S, SETTLED_S = 5.0, 6.0
Told = tuple[float, float, float]
"""Error, 95 % bound and six sigmas of what the protection level is made of, m."""


Step = tuple[FloatArray, FloatArray]
"""Position, m, and velocity, m/s."""


def wandering(rng: np.random.Generator, extent_m: float, speed_mps: float, acceleration_mps2: float) -> Iterator[Step]:
    """Yield position and velocity step by step: accelerations that last some seconds, and a pull to the middle."""
    axes, lasts_s = np.array([0.7, 0.7, 0.1]), 3.0
    place = rng.uniform(-1.0, 1.0, 3) * extent_m * [1.0, 1.0, 0.3]
    velocity = rng.normal(size=3) * speed_mps * [0.7, 0.7, 0.15]
    acceleration = np.zeros(3)
    while True:
        noise = math.sqrt(2.0 * STEP_S / lasts_s) * acceleration_mps2 * axes * rng.normal(size=3)
        acceleration = acceleration * (1.0 - STEP_S / lasts_s) + noise
        velocity = velocity + STEP_S * (acceleration - 0.1 * velocity - 0.1 * speed_mps / extent_m * place)
        place = place + STEP_S * velocity
        yield place, velocity


def flown(
    peers: int, seed: int, extent_m: float, sigma_m: float, *, with_height: bool = False, end_s: float = 60.0
) -> tuple[int, list[Told]]:
    """Return how often an estimate was asked for, and what was told, of a vehicle that wanders among peers at rest."""
    rng, estimator = np.random.default_rng([seed, peers]), FleetFilter()
    places = rng.uniform(-1.0, 1.0, (peers, 3)) * extent_m * [1.0, 1.0, 0.3]
    speed_mps, acceleration_mps2 = (0.7, 0.3) if extent_m < 50.0 else (5.0, 1.5)
    way = wandering(rng, extent_m, speed_mps, acceleration_mps2)
    for number, place in enumerate(places, start=1):
        estimator.add(PositionMeasurement(number, 0.0, 0.0, tuple(place.tolist()), 0.1 * sigma_m, 0.1 * sigma_m, static=True))
    asked, told = 0, []
    for k in range(round(end_s / STEP_S)):
        t, (here, velocity) = k * STEP_S, next(way)
        if k % EVERY:
            continue
        if t < LOST_S:
            reported, moving = here + sigma_m * rng.normal(size=3), tuple(velocity.tolist())
            estimator.add(PositionMeasurement(DENIED, t, t, tuple(reported.tolist()), sigma_m, sigma_m, moving, 0.2))
            continue
        estimator.set_denied({DENIED}, t)
        if with_height:
            estimator.add(AltitudeMeasurement(DENIED, t, t, float(here[2] + 0.3 * rng.normal()), 0.5))
        for number, place in enumerate(places, start=1):
            range_m = float(np.linalg.norm(here - place)) + sigma_m * rng.normal()
            estimator.add(RangeMeasurement(DENIED, number, t, t, max(range_m, 0.0), sigma_m))
        if t < SETTLED_S:
            continue
        asked += 1
        where = estimator.estimate(DENIED, t)
        if isinstance(where, Estimate):
            error_m = math.dist(where.position_enu_m[:2], here[:2])
            level_m = 6.0 * horizontal_sigma_m(where.protected_covariance)
            told.append((error_m, horizontal_bound_95_m(where.covariance), level_m))
    return asked, told


@pytest.mark.parametrize("extent_m", [5.0, 100.0])
@pytest.mark.parametrize(
    ("peers", "with_height"), [(1, False), (2, False), (1, True)], ids=["one, no height", "two, no height", "one"]
)
def test_what_too_few_neighbours_do_not_tell_of_is_in_the_bound(peers: int, with_height: bool, extent_m: float):
    """The filter went on along one of the ways that fit.

    In these six it was outside its 95 % bound for 3 to 56 % of the time, and in three beyond its protection level.
    """
    covered = []
    for seed in range(4):
        sigma_m, end_s = (0.1, 30.0) if extent_m < 50.0 else (1.0, 60.0)
        _, told = flown(peers, seed, extent_m, sigma_m, with_height=with_height, end_s=end_s)
        assert all(error < level for error, _, level in told)
        covered += [error < bound for error, bound, _ in told]
    assert len(covered) > 40
    assert np.mean(covered) > 0.97


def test_three_neighbours_without_a_height_do_not_decide_on_the_side_of_their_plane():
    """The vehicle moved calmly, which counted for the side on which it would have climbed instead of turned: that one won."""
    asked, told = flown(3, 11, 5.0, 0.1)
    assert len(told) > 0.3 * asked
    assert all(error < level for error, _, level in told)


def beside(anchors: Sequence[tuple[float, float, float]], until_s: float, odometry_until_s: float = 0.0) -> FleetModel:
    """Return the model of a vehicle at rest at the origin, with a height, that lost its GPS at 1 s and ranges anchors."""
    model = FleetModel(FleetSettings())
    for number, place in enumerate(anchors, start=1):
        model.apply(PositionMeasurement(number, 0.0, 0.0, place, 0.1, 0.1, static=True))
    for k in range(5, round(5.0 * until_s) + 1):
        t = 0.2 * k
        if k == 5:
            model.apply(PositionMeasurement(DENIED, t, t, (0.0, 0.0, 0.0), 0.5, 0.5, (0.0, 0.0, 0.0), 0.2))
            model.set_denied(frozenset({DENIED}), t)
        model.apply(AltitudeMeasurement(DENIED, t, t, 0.0, 0.5))
        if t <= odometry_until_s:
            model.apply(OdometryMeasurement(DENIED, t, t, 0.0, 0.0, 0.0, 0.05, 0.01))
        for number, place in enumerate(anchors, start=1):
            model.apply(RangeMeasurement(DENIED, number, t, t, math.hypot(*place), 0.5))
    return model


EAST, NORTH = (150.0, 0.0, 0.0), (0.0, 150.0, 0.0)


@pytest.mark.parametrize(("anchors", "told_at_s"), [([EAST], 1.0), ([EAST, NORTH], 3.0)], ids=["one", "two"])
def test_a_search_that_ends_beside_one_neighbour_has_told_of_nothing_more(anchors, told_at_s: float):
    model = beside(anchors, 3.0)
    found = search_of(model.clusters, DENIED, 3.0)
    search_with(model.clusters, DENIED, replace(found, uses={1: 20}))
    assert model.apply(RangeMeasurement(DENIED, 1, 3.0, 3.0, 150.0, 0.5)).outcome is Outcome.INITIALISED
    assert model.records[DENIED].told_at_s == pytest.approx(told_at_s)


def test_what_odometry_has_shown_needs_no_range():
    """Its bound grows from the end of the odometry on, 2 s before, and not from the loss of GPS."""
    where = with_possible_motion(*told_of(beside([EAST], 22.0, odometry_until_s=20.0)))
    assert isinstance(where, Estimate)
    assert 5.0 < horizontal_bound_95_m(where.covariance) < 0.5 * 9.8 * 2.5**2
    assert isinstance(with_possible_motion(*told_of(beside([EAST], 22.0))), NoEstimate)


def told_of(model: FleetModel) -> tuple[Estimate, VehicleRecord, FleetSettings]:
    where = model.estimate(DENIED, 22.0)
    assert isinstance(where, Estimate)
    return where, model.records[DENIED], model.settings


def ranged(innovation_m: float, sigma_m: float) -> UpdateResult:
    return UpdateResult(Outcome.USED, innovation_m, sigma_m, (innovation_m / sigma_m) ** 2, 1)


def test_a_calm_vehicle_is_no_evidence_for_the_side_on_which_it_would_climb_instead_of_turn():
    turning, climbing = ranged(0.1, 2.0), ranged(0.1, 1.0)
    assert log_likelihood_ratio(turning, climbing, may_climb=False) == pytest.approx(math.log(2.0), abs=0.01)
    assert log_likelihood_ratio(turning, climbing, may_climb=True) == pytest.approx(0.0)
    # A range that is far off still tells: by the larger sigma on both sides.
    assert log_likelihood_ratio(turning, ranged(4.0, 1.0), may_climb=True) == pytest.approx(-2.0, abs=0.01)
    assert log_likelihood_ratio(ranged(4.0, 1.0), turning, may_climb=True) == pytest.approx(2.0, abs=0.01)
