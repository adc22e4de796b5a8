"""Short gaps between bursts of ranges: what a vehicle may have done in them, by what it has shown before."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m, horizontal_sigma_m
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    OdometryMeasurement,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet.ekf.outcomes import Outcome, UpdateResult
from gcs_coloc.estimators.fleet.ekf.possible_motion import PROFILES, unshown_motion
from gcs_coloc.estimators.fleet.ekf.process_model import GAP_S, gap_covariance
from gcs_coloc.estimators.fleet.ekf.records import VehicleRecord
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.fleet_model import FleetModel
from gcs_coloc.estimators.fleet.gaps import add_gap, decide_unshown_motion
from gcs_coloc.estimators.fleet.searched_vehicles import search_of
from gcs_coloc.estimators.fleet.settings import FleetSettings

DENIED = 9
BEACONS = {1: (-46.0, 11.0), 2: (11.0, -7.0), 3: (22.0, 24.0), 4: (-18.0, 59.0)}
SIGMA_M = 0.5
LOST_S = 5.0
BURST_S, PERIOD_S = 1.6, 3.8
"""Eight ranges, two to each beacon, then silence."""

Path = Callable[[float], tuple[float, float]]


def flown(
    vehicle_class: VehicleClass, path: Path, end_s: float, seed: int, height_sigma_m: float | None = None
) -> list[tuple[float, float, float]]:
    """Return times (s), errors and 95 % bounds (m) every 0.2 s, also within the gaps, where there is an estimate."""
    rng, estimator, told = np.random.default_rng(seed), FleetFilter(), []
    estimator.add(VehicleClassReport(DENIED, 0.0, 0.0, vehicle_class))
    for number, place in BEACONS.items():
        estimator.add(PositionMeasurement(number, 0.0, 0.0, (*place, 0.0), 0.01, 0.01, static=True))
    estimator.add(PositionMeasurement(DENIED, 0.0, 0.0, (*path(0.0), 0.0), 0.7, 0.7))
    estimator.set_denied({DENIED}, 0.01)
    for k in range(1, round(end_s / 0.2)):
        t = 0.2 * k
        within_s = t % PERIOD_S
        if height_sigma_m is not None:
            estimator.add(AltitudeMeasurement(DENIED, t, t, 0.0, height_sigma_m))
        if within_s < BURST_S:
            beacon = 1 + int(within_s / 0.4) % 4
            range_m = math.dist(path(t), BEACONS[beacon]) + SIGMA_M * rng.normal()
            estimator.add(RangeMeasurement(DENIED, beacon, t, t, range_m, SIGMA_M))
        where = estimator.estimate(DENIED, t)
        if isinstance(where, Estimate):
            told.append((t, math.dist(where.position_enu_m[:2], path(t)), horizontal_bound_95_m(where.covariance)))
    return told


def in_loops(t: float) -> tuple[float, float]:
    """Drive at 1 m/s and less, in turns of more than 10 m of radius."""
    return 15.0 * math.sin(t / 15.0), 5.0 + 12.0 * math.sin(t / 22.0)


@pytest.mark.parametrize("seed", range(2))
def test_a_gap_adds_no_more_than_the_vehicle_has_shown(seed: int):
    """Each gap of 2 s added all that its class can do, so that the ranges after it moved the estimate by metres: 5.4 m."""
    told = [(error, bound) for t, error, bound in flown(VehicleClass.GROUND, in_loops, 240.0, seed) if t > 40.0]
    assert len(told) > 0.95 * 1000
    assert math.sqrt(np.mean([error**2 for error, _ in told])) < 3.0
    assert np.mean([error < bound for error, bound in told]) > 0.95


def test_a_manoeuvre_that_it_never_showed_is_in_the_bound_until_ranges_rule_it_out():
    """A hovering multirotor leaves at 6 m/s^2 in a gap, to one side after the other."""
    begin_s, covered = 40 * PERIOD_S + BURST_S, []
    for seed in range(4):
        side = 0.5 * math.pi * seed

        def path(t: float, side: float = side) -> tuple[float, float]:
            since_s = max(t - begin_s, 0.0)
            way_m = 3.0 * min(since_s, 1.5) ** 2 + 9.0 * max(since_s - 1.5, 0.0)
            return way_m * math.cos(side), 10.0 + way_m * math.sin(side)

        after = [(e, b) for t, e, b in flown(VehicleClass.MULTIROTOR, path, begin_s + 11.0, seed) if t > begin_s]
        assert len(after) > 30
        assert all(error < 2.0 * bound for error, bound in after)
        covered += [error < bound for error, bound in after]
    assert np.mean(covered) > 0.9


@pytest.mark.parametrize("seed", range(4))
def test_beacons_that_are_ranged_in_turns_leave_no_side_open(seed: int):
    """Between the bursts only the last two beacons had been ranged within two seconds: the side of their line seemed open."""

    def path(t: float) -> tuple[float, float]:
        course = 0.05 * t + seed
        return -6.0 + 22.0 * math.cos(course), 25.0 + 22.0 * math.sin(course)

    end_s, begin_s = 160.0, 20.0
    told = [(e, b) for t, e, b in flown(VehicleClass.GROUND, path, end_s, seed, height_sigma_m=0.1) if t > begin_s]
    assert len(told) >= (end_s - begin_s) / 0.2 - 2
    assert all(error < bound < 16.0 for error, bound in told)


def leaving(t: float, leaves_s: float) -> float:
    """Return how far east a multirotor is that leaves at 6 m/s^2, up to 9 m/s."""
    since_s = max(t - leaves_s, 0.0)
    return 3.0 * min(since_s, 1.5) ** 2 + 9.0 * max(since_s - 1.5, 0.0)


@pytest.mark.parametrize("seed", range(4))
def test_a_gap_of_the_ranges_along_one_direction_is_a_gap(seed: int):
    """A hovering multirotor leaves along it, with the ranges across going on: its error came to 2.5 times its bound."""
    beacons, sigma_m, ceased_s, leaves_s, again_s = {1: (0.0, 150.0), 2: (150.0, 0.0)}, 1.0, 40.0, 41.0, 46.0
    rng, estimator, told = np.random.default_rng(seed), FleetFilter(), []
    estimator.add(VehicleClassReport(DENIED, 0.0, 0.0, VehicleClass.MULTIROTOR))
    for number, place in beacons.items():
        estimator.add(PositionMeasurement(number, 0.0, 0.0, (*place, 0.0), 0.5, 0.5, static=True))
    estimator.add(PositionMeasurement(DENIED, 0.0, 0.0, (0.0, 0.0, 0.0), 0.7, 0.7, (0.0, 0.0, 0.0), 0.3))
    estimator.set_denied({DENIED}, 0.01)
    for k in range(1, 250):
        t = 0.2 * k
        here = leaving(t, leaves_s), 0.0
        estimator.add(AltitudeMeasurement(DENIED, t, t, 0.0, 0.3))
        for number, place in beacons.items():
            if number == 1 or not ceased_s < t < again_s:
                range_m = math.dist(here, place) + sigma_m * rng.normal()
                estimator.add(RangeMeasurement(DENIED, number, t, t, range_m, sigma_m))
        where = estimator.estimate(DENIED, t)
        if isinstance(where, Estimate):
            level_m = 6.0 * horizontal_sigma_m(where.protected_covariance)
            told.append((t, math.dist(where.position_enu_m[:2], here), horizontal_bound_95_m(where.covariance), level_m))
    assert all(bound < 4.0 for t, _, bound, _ in told if 10.0 < t < ceased_s + GAP_S)
    assert all(error < bound for t, error, bound, _ in told if ceased_s < t < again_s)
    assert all(error < 2.0 * bound for t, error, bound, _ in told if t >= again_s)
    assert all(error < level for _, error, _, level in told)
    # An acceleration of 1 g for four seconds is a limit, not a sigma.
    assert 78.0 < next(level for t, _, _, level in told if t > ceased_s + 4.0) < 100.0


PEERS = {1: (-150.0, 600.0), 2: (0.0, 600.0), 3: (-600.0, -200.0)}
LOST_SIDE_BY_SIDE = {8: (-150.0, 0.0), 9: (0.0, 0.0)}
ACROSS = ((8, 1), (9, 2), (9, 8))


def side_by_side(
    seed: int, leaves_s: float, pairs: Sequence[tuple[int, int]], with_odometry: Sequence[int] = ()
) -> Iterator[tuple[float, int, float, float]]:
    """Yield time (s), vehicle, error and 95 % bound (m) of two multirotors that lose their GPS after 5 s, and leave east."""
    rng, estimator, sigma_m = np.random.default_rng(seed), FleetFilter(), 0.5
    for number, place in PEERS.items():
        estimator.add(PositionMeasurement(number, 0.0, 0.0, (*place, 0.0), 0.5, 0.5, static=True))
    for number in LOST_SIDE_BY_SIDE:
        estimator.add(VehicleClassReport(number, 0.0, 0.0, VehicleClass.MULTIROTOR))
    for k in range(1, 60):
        t = round(0.2 * k, 3)
        here = {number: (e + leaving(t, leaves_s), n) for number, (e, n) in LOST_SIDE_BY_SIDE.items()} | PEERS
        for number in with_odometry:
            estimator.add(OdometryMeasurement(number, t, t, 0.0, 0.0, 0.0, 0.05, 0.01))
        if t < LOST_S:
            for number in LOST_SIDE_BY_SIDE:
                estimator.add(PositionMeasurement(number, t, t, (*here[number], 0.0), 0.7, 0.7, (0.0, 0.0, 0.0), 0.3))
            continue
        estimator.set_denied(set(LOST_SIDE_BY_SIDE), t)
        for number in LOST_SIDE_BY_SIDE:
            estimator.add(AltitudeMeasurement(number, t, t, 0.0, 0.3))
        for a, b in pairs:
            estimator.add(RangeMeasurement(a, b, t, t, math.dist(here[a], here[b]) + sigma_m * rng.normal(), sigma_m))
        for number in LOST_SIDE_BY_SIDE:
            where = estimator.estimate(number, t)
            assert isinstance(where, Estimate)
            error_m = math.dist(where.position_enu_m[:2], here[number])
            yield t, number, error_m, horizontal_bound_95_m(where.covariance)


@pytest.mark.parametrize("seed", range(3))
def test_two_lost_vehicles_do_not_vouch_for_each_other(seed: int):
    """They leave across the ranges to their peers, and were off by 2.5 times their bounds."""
    for t, _, error_m, bound_m in side_by_side(seed, LOST_S + 2.0, ACROSS):
        assert error_m < bound_m
        assert bound_m < 4.0 or t > LOST_S + 1.0


@pytest.mark.parametrize(
    ("pairs", "with_odometry"), [(ACROSS, [8]), ([(8, 3), *ACROSS], [])], ids=["by odometry", "by two peers"]
)
def test_a_lost_vehicle_whose_motion_is_known_vouches_for_another(pairs, with_odometry):
    told = list(side_by_side(0, math.inf, pairs, with_odometry))
    assert max(bound_m for _, number, _, bound_m in told if number == 9) < 6.0


def hovering() -> FleetModel:
    """Return a model of a multirotor at rest for 30 s, ranged until then."""
    model, here = FleetModel(FleetSettings()), (0.0, 6.0)
    model.apply(VehicleClassReport(DENIED, 0.0, 0.0, VehicleClass.MULTIROTOR))
    for number, place in BEACONS.items():
        model.apply(PositionMeasurement(number, 0.0, 0.0, (*place, 0.0), 0.01, 0.01, static=True))
    model.apply(PositionMeasurement(DENIED, 0.0, 0.0, (*here, 0.0), 0.7, 0.7, (0.0, 0.0, 0.0), 0.3))
    model.set_denied(frozenset({DENIED}), 0.01)
    for k in range(1, 300):
        model.apply(RangeMeasurement(DENIED, 1 + k % 4, 0.1 * k, 0.1 * k, math.dist(here, BEACONS[1 + k % 4]), 0.3))
    return model


def test_a_search_that_begins_in_a_gap_keeps_one_in_twenty_for_a_new_manoeuvre():
    model = hovering()
    add_gap(model.clusters[DENIED], DENIED, 34.0)
    search = search_of(model.clusters, DENIED, 34.0)
    assert search is not None
    (shown_m2, all_m2), log_weight = search.covariance[:, 0, 0], search.log_weight
    assert all_m2 > 25.0 * shown_m2
    assert math.exp(log_weight[1] - log_weight[0]) == pytest.approx(0.05, abs=0.001)


@pytest.mark.parametrize(("range_m", "is_along_the_arc_only"), [(50_000.0, True), (50.0, False)])
def test_what_was_ruled_out_along_a_line_is_not_on_a_wide_arc(range_m, is_along_the_arc_only):
    model = hovering()
    cluster, record = model.clusters[DENIED], model.records[DENIED]
    add_gap(cluster, DENIED, 36.0)
    assert record.unshown is not None
    record.unshown = record.unshown.after_range((0.0, 1.0, 0.0), 0.3)
    e_m2, n_m2 = np.diag(cluster.joint.covariance(DENIED))[:2].tolist()
    m = RangeMeasurement(DENIED, 1, 36.0, 36.0, range_m, 0.3)
    decide_unshown_motion(cluster, DENIED, UpdateResult(Outcome.USED, 5.0, 1.0, 25.0, 1, (1.0, 0.0, 0.0)), m)
    more_e_m2, more_n_m2 = np.diag(cluster.joint.covariance(DENIED))[:2] - (e_m2, n_m2)
    assert more_e_m2 > 1000.0
    assert more_n_m2 == pytest.approx(0.3**2 if is_along_the_arc_only else more_e_m2, rel=0.01)
    assert record.unshown is None


def test_in_a_long_gap_a_vehicle_that_turns_is_not_predicted_straight_on():
    """It went on at its last velocity of 1 m/s: 18.4 m in 20 s, from a loop of 12 m."""
    gone_m = []
    for seed in range(3):
        rng, estimator = np.random.default_rng(seed), FleetFilter()
        estimator.add(VehicleClassReport(DENIED, 0.0, 0.0, VehicleClass.GROUND))
        for number, place in BEACONS.items():
            estimator.add(PositionMeasurement(number, 0.0, 0.0, (*place, 0.0), 0.01, 0.01, static=True))
        estimator.add(PositionMeasurement(DENIED, 0.0, 0.0, (0.0, 6.0, 0.0), 0.7, 0.7))
        estimator.set_denied({DENIED}, 0.01)
        for k in range(1, 1000):
            t, beacon = 0.1 * k, 1 + k % 4
            range_m = math.dist((6.0 * math.sin(t / 6.0), 6.0 * math.cos(t / 6.0)), BEACONS[beacon]) + 0.3 * rng.normal()
            estimator.add(RangeMeasurement(DENIED, beacon, t, t, range_m, 0.3))
        before, after = estimator.estimate(DENIED, 100.0), estimator.estimate(DENIED, 120.0)
        assert isinstance(before, Estimate)
        assert isinstance(after, Estimate)
        gone_m.append(math.dist(before.position_enu_m, after.position_enu_m))
    assert np.mean(gone_m) < 16.0


def test_what_was_left_open_in_a_gap_ends_with_the_loss_of_gps():
    """It stayed, and its velocity made the bound of a healthy vehicle grow for ever."""
    estimator = FleetFilter()
    estimator.add(VehicleClassReport(DENIED, 0.0, 0.0, VehicleClass.MULTIROTOR))
    for number, place in BEACONS.items():
        estimator.add(PositionMeasurement(number, 0.0, 0.0, (*place, 0.0), 0.01, 0.01, static=True))
    estimator.add(PositionMeasurement(DENIED, 0.0, 0.0, (0.0, 6.0, 0.0), 0.7, 0.7))
    estimator.set_denied({DENIED}, 0.01)
    for k in range(1, 300):
        estimator.add(RangeMeasurement(DENIED, 1 + k % 4, 0.1 * k, 0.1 * k, math.dist((0.0, 6.0), BEACONS[1 + k % 4]), 0.3))
    # One range after a gap, along which alone it is ruled out.
    estimator.add(RangeMeasurement(DENIED, 1, 33.0, 33.0, math.dist((0.0, 6.0), BEACONS[1]), 0.3))
    denied = estimator.estimate(DENIED, 33.1)
    assert isinstance(denied, Estimate)
    assert horizontal_bound_95_m(denied.covariance) > 5.0
    estimator.set_denied(set(), 33.2)
    for k in range(200):
        t = 33.3 + 0.2 * k
        estimator.add(PositionMeasurement(DENIED, t, t, (0.0, 6.0, 0.0), 0.7, 0.7, (0.0, 0.0, 0.0), 0.3))
    healthy = estimator.estimate(DENIED, t)
    assert isinstance(healthy, Estimate)
    assert horizontal_bound_95_m(healthy.covariance) < 3.0


@given(
    st.sampled_from(VehicleClass),
    st.floats(1.6, 600.0),
    st.floats(0.0, 20.0),
    st.floats(0.0, 100.0),
    st.floats(0.0, 2.0 * math.pi),
)
def test_what_it_has_not_shown_is_a_covariance_after_a_gap_of_any_length(vehicle_class, gap_s, shown_mps2, later_s, course_rad):
    """After 16 s of a robot it was none: both motions are limited by its speed, and the velocity has little left to be shown."""
    record = VehicleRecord(denied_vehicle=True, updated_at_s=0.0, profile=PROFILES[vehicle_class])
    possible, shown = (gap_covariance(record, FleetSettings(), gap_s, most_mps2) for most_mps2 in (math.inf, shown_mps2))
    motion = unshown_motion(gap_s, possible, shown)
    if motion is None:
        return
    for looked in (motion, motion.after_range((math.sin(course_rad), math.cos(course_rad), 0.0), SIGMA_M)):
        covariance = looked.covariance(gap_s + later_s)
        assert np.linalg.eigvalsh(covariance)[0] >= -1e-9 * np.trace(covariance)


@pytest.mark.parametrize("silent_s", [1.6, 3.0])
def test_a_vehicle_with_gps_that_turns_as_it_falls_silent_is_within_its_bound(silent_s):
    """Its reports cease as it rolls to 45 degrees at 22 m/s. No air data is newer."""
    estimator = FleetFilter()
    estimator.add(VehicleClassReport(1, 0.0, 0.0, VehicleClass.PLANE))
    for k in range(100):
        t = 0.1 * k
        estimator.add(PositionMeasurement(1, t, t, (22.0 * t, 0.0, 50.0), 0.6, 1.0, (22.0, 0.0, 0.0), 0.3))
    where = estimator.estimate(1, t + silent_s)
    assert isinstance(where, Estimate)
    radius_m = 22.0**2 / 9.8
    angle_rad = 22.0 * silent_s / radius_m
    true_m = (22.0 * t + radius_m * math.sin(angle_rad), radius_m * (1.0 - math.cos(angle_rad)))
    error_m = math.dist(where.position_enu_m[:2], true_m)
    assert 0.9 * 0.5 * 9.8 * silent_s**2 < error_m < horizontal_bound_95_m(where.covariance)


def test_a_vehicle_that_started_from_ranges_alone_vouches_for_another_at_once():
    """Its ranges counted as of one that nothing is known of, until others told of both directions."""
    model, here = FleetModel(FleetSettings()), (0.0, 6.0)
    model.set_denied(frozenset({DENIED}), 0.0)
    for number, place in BEACONS.items():
        model.apply(PositionMeasurement(number, 0.0, 0.0, (*place, 0.0), 0.01, 0.01, static=True))
    for k in range(1, 100):
        t, beacon = 0.1 * k, 1 + k % 4
        m = RangeMeasurement(DENIED, beacon, t, t, math.dist(here, BEACONS[beacon]), 0.3)
        if model.apply(m).outcome is Outcome.INITIALISED:
            break
    record = model.records[DENIED]
    assert record.gaps_added_until_s == record.told_at_s == record.updated_at_s == t < 9.0
