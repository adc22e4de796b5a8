"""A pitot tube that fails: its readings are refused before a gap of the ranges, and used again once they are right."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import AttitudeMeasurement, Estimate, NoEstimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.ekf.air_data import AIR_UNSUSPECTED, AirCheck, Place
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.settings import FleetSettings

DENIED, AIRSPEED_MPS, WIND_MPS = 9, 20.0, np.array([3.0, 5.0])
PEERS = {1: (0.0, 2000.0), 2: (4000.0, 1000.0), 3: (2000.0, -2500.0), 4: (-1500.0, -500.0)}
LOST_S, FAILS_S, GAP_S, REPAIRED_S, END_S = 5.0, 30.0, (40.0, 52.0), 55.0, 85.0
TURN_RADPS = 0.1


def flown(
    reads_mps: float | None, estimator: FleetFilter | None = None, end_s: float = END_S
) -> dict[int, tuple[Estimate | NoEstimate, float]]:
    """Fly circles in wind, the pitot tube wrong from 30 to 55 s; by second the estimate and its error (m)."""
    rng, step_s, estimator = np.random.default_rng(5), 0.1, estimator or FleetFilter()
    place, seen = np.zeros(2), {}
    for k in range(round(end_s / step_s) + 1):
        t = k * step_s
        if k == round(LOST_S / step_s):
            estimator.set_denied({DENIED}, t)
        heading = TURN_RADPS * t
        velocity = AIRSPEED_MPS * np.array([math.sin(heading), math.cos(heading)]) + WIND_MPS
        place = place + step_s * velocity
        for p, (east, north) in PEERS.items() if k % 2 == 0 else ():
            estimator.add(PositionMeasurement(p, t, t, (east, north, 100.0), 1.0, 1.0, (0.0, 0.0, 0.0), 0.3))
            if not GAP_S[0] <= t < GAP_S[1]:
                range_m = math.dist(place, (east, north)) + rng.normal()
                estimator.add(RangeMeasurement(DENIED, p, t, t, range_m, 1.0))
        if t < LOST_S:
            estimator.add(PositionMeasurement(DENIED, t, t, (*place, 100.0), 1.0, 1.0, (*velocity, 0.0), 0.3))
        is_wrong = reads_mps is not None and FAILS_S <= t < REPAIRED_S
        airspeed_mps = (reads_mps if is_wrong else AIRSPEED_MPS) + 0.3 * rng.normal()
        roll = math.atan(TURN_RADPS * AIRSPEED_MPS / 9.80665)
        estimator.add(AttitudeMeasurement(DENIED, t, t, roll, 0.0, heading, airspeed_mps))
        if k % 10 == 0:
            where = estimator.estimate(DENIED, t)
            off_m = float(np.linalg.norm(where.position_enu_m[:2] - place)) if isinstance(where, Estimate) else math.nan
            seen[round(t)] = where, off_m
    return seen


def refuses(where: Estimate | NoEstimate) -> bool:
    return isinstance(where, Estimate) and where.refuses_air_data


@pytest.mark.parametrize("reads_mps", [7.0, 14.5, 25.5, 40.0, 300.0])
def test_a_wrong_airspeed_is_refused_before_the_ranges_cease(reads_mps):
    seen = flown(reads_mps)
    assert not any(refuses(where) for t, (where, _) in seen.items() if t < FAILS_S)
    assert refuses(seen[round(GAP_S[0])][0])
    for t in range(round(GAP_S[0]), round(GAP_S[1]) + 1):
        where, off_m = seen[t]
        assert isinstance(where, NoEstimate) or off_m < 1.5 * horizontal_bound_95_m(where.covariance), t


def test_an_airspeed_that_has_been_right_for_a_turn_is_used_again():
    last, off_m = flown(300.0)[round(END_S)]
    assert isinstance(last, Estimate)
    assert not last.refuses_air_data
    assert off_m < horizontal_bound_95_m(last.covariance)


def test_with_its_own_gps_back_nothing_is_held_against_its_air_data():
    estimator = FleetFilter()
    assert refuses(flown(7.0, estimator, REPAIRED_S)[round(REPAIRED_S)][0])
    for k in range(40):
        t = REPAIRED_S + 0.1 * (k + 1)
        if k == 0:
            estimator.set_denied(set(), t)
        estimator.add(PositionMeasurement(DENIED, t, t, (20.0 * t, 0.0, 100.0), 1.0, 1.0, (20.0, 0.0, 0.0), 0.3))
        estimator.add(AttitudeMeasurement(DENIED, t, t, 0.0, 0.0, 0.5 * math.pi, 20.0))
    estimator.set_denied({DENIED}, t)
    lost = estimator.estimate(DENIED, t)
    assert isinstance(lost, Estimate)
    assert not lost.refuses_air_data


def test_a_right_one_is_never_refused_and_carries_the_vehicle_through_the_gap():
    seen = flown(None)
    assert not any(refuses(where) for where, _ in seen.values())
    where, off_m = seen[round(GAP_S[1])]
    assert isinstance(where, Estimate)
    assert off_m < horizontal_bound_95_m(where.covariance) < 15.0


def flown_into_a_turn(reads_mps: float) -> tuple[float, float, bool]:
    """Fly circles, then straight on, then turn at 2 g; the most of the error (m) and of error over bound in that turn."""
    rng, step_s, estimator = np.random.default_rng(3), 0.1, FleetFilter()
    place, heading, turns_s, most_m, most_ratio, refused = np.zeros(2), 0.0, 52.0, 0.0, 0.0, True
    for k in range(round(56.0 / step_s)):
        t = k * step_s
        if k == round(LOST_S / step_s):
            estimator.set_denied({DENIED}, t)
        turn_radps = TURN_RADPS if t < 45.0 else 2.0 * 9.80665 / AIRSPEED_MPS if t >= turns_s else 0.0
        velocity = AIRSPEED_MPS * np.array([math.sin(heading), math.cos(heading)]) + WIND_MPS
        place = place + step_s * velocity
        for p, (east, north) in PEERS.items() if k % 2 == 0 else ():
            estimator.add(PositionMeasurement(p, t, t, (east, north, 100.0), 1.0, 1.0, (0.0, 0.0, 0.0), 0.3))
            range_m = math.dist(place, (east, north)) + rng.normal()
            estimator.add(RangeMeasurement(DENIED, p, t, t, range_m, 1.0))
        if t < LOST_S:
            estimator.add(PositionMeasurement(DENIED, t, t, (*place, 100.0), 1.0, 1.0, (*velocity, 0.0), 0.3))
        airspeed_mps = (reads_mps if t >= FAILS_S else AIRSPEED_MPS) + 0.3 * rng.normal()
        roll = math.atan(turn_radps * AIRSPEED_MPS / 9.80665)
        estimator.add(AttitudeMeasurement(DENIED, t, t, roll, 0.0, heading, airspeed_mps))
        if t >= turns_s:
            where = estimator.estimate(DENIED, t)
            assert isinstance(where, Estimate)
            off_m = float(np.linalg.norm(where.position_enu_m[:2] - place))
            most_m = max(most_m, off_m)
            most_ratio = max(most_ratio, off_m / horizontal_bound_95_m(where.covariance))
            refused = refused and where.refuses_air_data
        heading += turn_radps * step_s
    return most_m, most_ratio, refused


def test_a_hard_turn_is_followed_by_its_bank_while_the_airspeed_is_refused():
    """Without its bank it is 10 m off, 3.4 times the bound."""
    most_m, most_ratio, refused = flown_into_a_turn(7.0)
    assert refused
    assert most_m < 4.0
    assert most_ratio < 1.0


def checked(
    check: AirCheck, from_s: float, seconds: float, reads_mps: float, sigma_m: float, turn_radps: float = TURN_RADPS
) -> AirCheck:
    """Fly on, in circles or straight, without wind, with places of a 1-sigma and air data at 10 Hz."""
    for k in range(round(seconds * 10.0) + 1):
        at_s = from_s + 0.1 * k
        heading = turn_radps * at_s
        radius_m = AIRSPEED_MPS / TURN_RADPS
        east_m, north_m = (
            (-radius_m * math.cos(heading), radius_m * math.sin(heading)) if turn_radps else (0.0, AIRSPEED_MPS * at_s)
        )
        check = check.updated(at_s, Place(east_m, north_m, sigma_m), reads_mps, heading, None, FleetSettings())
    return check


def test_two_windows_of_five_metres_a_second_refuse_and_a_turn_takes_back():
    sound = checked(AIR_UNSUSPECTED, 0.0, 20.0, AIRSPEED_MPS, 1.0)
    assert not sound.is_refused
    assert not checked(sound, 20.0, 7.9, 25.0, 1.0).is_refused
    refused = checked(sound, 20.0, 8.0, 25.0, 1.0)
    assert refused.is_refused
    assert checked(refused, 28.0, 12.0, AIRSPEED_MPS, 1.0).is_refused
    assert not checked(refused, 28.0, 40.0, AIRSPEED_MPS, 1.0).is_refused


@pytest.mark.parametrize(("reads_mps", "turn_radps"), [(12.0, 0.0), (AIRSPEED_MPS, 0.0), (12.0, TURN_RADPS), (28.0, TURN_RADPS)])
def test_what_passes_for_wind_on_one_course_takes_nothing_back_and_a_turn_shows_the_error(reads_mps, turn_radps):
    refused = checked(checked(AIR_UNSUSPECTED, 0.0, 20.0, AIRSPEED_MPS, 1.0), 20.0, 4.0, 60.0, 1.0)
    assert checked(refused, 24.0, 100.0, reads_mps, 1.0, turn_radps).is_refused


def test_windows_between_places_that_are_hardly_known_neither_refuse_nor_take_back():
    sound = checked(AIR_UNSUSPECTED, 0.0, 20.0, AIRSPEED_MPS, 1.0)
    assert not checked(sound, 20.0, 20.0, 25.0, 100.0).is_refused
    refused = checked(sound, 20.0, 4.0, 60.0, 1.0)
    assert checked(refused, 24.0, 40.0, AIRSPEED_MPS, 50.0).is_refused


def test_while_the_gusts_are_not_known_a_difference_is_learned_and_no_suspicion():
    young = checked(AIR_UNSUSPECTED, 0.0, 12.0, AIRSPEED_MPS, 1.0)
    assert not checked(checked(young, 12.0, 4.0, 25.9, 1.0), 16.1, 4.0, 25.9, 1.0).is_refused
    old = checked(young, 12.1, 12.0, AIRSPEED_MPS, 1.0)
    assert checked(checked(old, 24.2, 4.0, 25.9, 1.0), 28.3, 4.0, 25.9, 1.0).is_refused


def test_a_suspicion_outlasts_windows_that_tell_nothing():
    sound = checked(AIR_UNSUSPECTED, 0.0, 20.0, AIRSPEED_MPS, 1.0)
    suspected = checked(sound, 20.0, 4.0, 25.0, 1.0)
    in_gap = checked(suspected, 24.1, 6.0, 25.0, 100.0)
    assert not in_gap.is_refused
    assert checked(in_gap, 30.2, 8.0, 25.0, 1.0).is_refused
    assert not checked(in_gap, 30.2, 8.0, AIRSPEED_MPS, 1.0).is_refused


@pytest.mark.parametrize(("reads_mps", "is_refused"), [(13.9, True), (14.1, False), (25.9, False), (26.1, True)])
def test_an_airspeed_that_leaps_is_refused_at_once_where_nothing_else_tells(reads_mps, is_refused):
    sound = checked(AIR_UNSUSPECTED, 0.0, 20.0, AIRSPEED_MPS, 1.0)
    assert checked(sound, 20.0, 0.1, reads_mps, 1000.0).is_refused is is_refused


def test_a_reflected_vehicle_has_made_no_way_yet_and_what_was_refused_stays_refused():
    refused = checked(checked(AIR_UNSUSPECTED, 0.0, 20.0, AIRSPEED_MPS, 1.0), 20.0, 4.0, 60.0, 1.0)
    sound = checked(AIR_UNSUSPECTED, 0.0, 22.0, AIRSPEED_MPS, 1.0)
    assert refused.reflected().is_refused
    elsewhere = Place(500.0, 500.0, 1.0)
    moved = (each.updated(22.1, elsewhere, AIRSPEED_MPS, 2.2, None, FleetSettings()) for each in (sound.reflected(), sound))
    assert [each.window is not None and each.window.place == elsewhere for each in moved] == [True, False]


@pytest.mark.parametrize(("step_s", "is_refused"), [(0.6, False), (0.4, True)])
def test_air_data_that_come_too_seldom_show_no_way(step_s, is_refused):
    check = AIR_UNSUSPECTED
    for k in range(30):
        check = check.updated(k * step_s, Place(0.0, AIRSPEED_MPS * k * step_s, 1.0), 100.0, 0.0, None, FleetSettings())
    assert check.is_refused is is_refused
