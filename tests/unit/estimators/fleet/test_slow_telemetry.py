"""Vehicles that lose their GPS and manoeuvre, with ranges and attitude once a second, as telemetry radios send them."""

import math

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import (
    AttitudeMeasurement,
    Estimate,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet.filter import FleetFilter

DENIED, SPEED_MPS, LOST_S, END_S, STEP_S = 9, 22.0, 10.0, 70.0, 0.05
PEERS_M = {1: (-300.0, 500.0), 2: (900.0, 600.0), 3: (400.0, -500.0), 4: (1100.0, -300.0), 5: (200.0, 900.0)}
TURNS_S = ((30.3, 36.0), (50.6, 55.0))


def plane(bank_rad):
    """Return place (2,), velocity (2,), heading and bank of a plane in each step: east, and two turns, into and out in 1 s."""
    place, heading, ways = np.zeros(2), math.pi / 2.0, []
    for k in range(round(END_S / STEP_S)):
        t = k * STEP_S
        bank = max(max(0.0, min(t - start, end - t, 1.0)) for start, end in TURNS_S) * bank_rad
        velocity = SPEED_MPS * np.array([math.sin(heading), math.cos(heading)])
        ways.append((place, velocity, heading, bank))
        heading += 9.80665 * math.tan(bank) / SPEED_MPS * STEP_S
        place = place + STEP_S * velocity
    return ways


def multirotor(course_rad):
    """Return the same of a multirotor that hovers, then leaves at 6 m/s² up to 9 m/s, and stops as hard."""
    place, speed, ways = np.array([400.0, 100.0]), 0.0, []
    for k in range(round(END_S / STEP_S)):
        t = k * STEP_S
        velocity = speed * np.array([math.sin(course_rad), math.cos(course_rad)])
        ways.append((place, velocity, 0.0, 0.0))
        speed = min(speed + 6.0 * STEP_S, 9.0) if 40.3 < t < 50.6 else max(speed - 6.0 * STEP_S, 0.0)
        place = place + STEP_S * velocity
    return ways


def errors_and_bounds_m(vehicle, ways, seed, *, has_attitude=False, peers_m=PEERS_M):
    """Fly it; return the error of the estimate and its 95 % bound since the loss, m, five times a second."""
    rng, found, estimator = np.random.default_rng(seed), [], FleetFilter()
    estimator.add(VehicleClassReport(DENIED, 0.0, 0.0, vehicle))
    for k, (place, velocity, heading, bank) in enumerate(ways):
        t = k * STEP_S
        if k == round(LOST_S / STEP_S):
            estimator.set_denied({DENIED}, t)
        if k % 4 == 0:
            for peer, at_m in peers_m.items():
                estimator.add(PositionMeasurement(peer, t, t, (*at_m, 100.0), 1.0, 1.5, (0.0, 0.0, 0.0), 0.3))
            if t < LOST_S:
                own_m, own_mps = (*place.tolist(), 100.0), (*velocity.tolist(), 0.0)
                estimator.add(PositionMeasurement(DENIED, t, t, own_m, 1.0, 1.5, own_mps, 0.3))
        if has_attitude and k % 20 == 0:
            estimator.add(AttitudeMeasurement(DENIED, t, t, bank, 0.0, heading, SPEED_MPS))
        for peer, at_m in peers_m.items():
            if k % 20 == 4 * peer - 1:
                range_m = math.hypot(*(place - at_m)) + rng.normal()
                estimator.add(RangeMeasurement(DENIED, peer, t, t, range_m, 1.0))
        if t > LOST_S + 1.0 and k % 4 == 0:
            where = estimator.estimate(DENIED, t)
            if isinstance(where, Estimate):
                off_m = math.hypot(*(where.position_enu_m[:2] - place))
                found.append((off_m, horizontal_bound_95_m(where.covariance)))
    return np.array(found).T


@pytest.mark.parametrize("seed", range(3))
def test_a_turn_between_two_attitudes_does_not_make_the_later_ones_wrong(seed):
    """Real planes on a radio of 1 Hz: the attitude in the turn was refused, then the ranges, 51 m off at a bound of 19 m."""
    off_m, bound_m = errors_and_bounds_m(VehicleClass.PLANE, plane(math.radians(62.0)), seed, has_attitude=True)
    assert len(off_m) > 280
    assert off_m.max() < 8.0
    assert (off_m < 3.0 * bound_m).all()


@pytest.mark.parametrize("attitude_after_s", [0.2, 0.5, 0.8])
def test_a_healthy_plane_that_nobody_ranges_turns_between_its_reports(attitude_after_s):
    """Without its attitude it was carried straight on: 5.5 m off, 1.9 of its bound."""
    found, estimator = [], FleetFilter()
    estimator.add(VehicleClassReport(DENIED, 0.0, 0.0, VehicleClass.PLANE))
    for k, (place, velocity, heading, bank) in enumerate(plane(math.radians(62.0))):
        t = k * STEP_S
        if k % 20 == 0:
            own_m, own_mps = (*place.tolist(), 100.0), (*velocity.tolist(), 0.0)
            estimator.add(PositionMeasurement(DENIED, t, t, own_m, 1.0, 1.5, own_mps, 0.3))
        if k % 20 == round(attitude_after_s / STEP_S):
            estimator.add(AttitudeMeasurement(DENIED, t, t, bank, 0.0, heading, SPEED_MPS))
        where = estimator.estimate(DENIED, t)
        if k % 4 == 0 and isinstance(where, Estimate):
            found.append((math.hypot(*(where.position_enu_m[:2] - place)), horizontal_bound_95_m(where.covariance)))
    off_m, bound_m = np.array(found).T
    assert off_m.max() < 3.0
    assert (off_m < bound_m).all()


@pytest.mark.parametrize("seed", range(3))
def test_ranges_once_a_second_show_a_turn_without_attitude(seed):
    """With the process noise of ranges at 5 Hz nine of eleven were outside the gate, up to 50 m off."""
    off_m, bound_m = errors_and_bounds_m(VehicleClass.PLANE, plane(math.radians(40.0)), seed)
    assert off_m.max() < 16.0
    assert (off_m < 3.0 * bound_m).mean() > 0.98


@pytest.mark.parametrize("seed", range(3))
def test_ranges_of_two_neighbours_show_a_steep_turn_without_attitude(seed):
    """Every other range was outside the gate: 107 to 151 m off, as long as the turn lasted."""
    three_m = {peer: at_m for peer, at_m in PEERS_M.items() if peer <= 3}
    off_m, bound_m = errors_and_bounds_m(VehicleClass.PLANE, plane(math.radians(62.0)), seed, peers_m=three_m)
    assert off_m.max() < 55.0
    assert (off_m < 3.0 * bound_m).mean() > 0.96


@pytest.mark.parametrize("seed", range(4))
def test_a_multirotor_that_hovered_is_followed_when_it_leaves(seed):
    """It had learned while it hovered that it does not move: 12 m off at a bound of 4 m, with ranges of 15 cm."""
    off_m, bound_m = errors_and_bounds_m(VehicleClass.MULTIROTOR, multirotor(0.5 * math.pi * seed), seed)
    assert off_m.max() < 8.0
    assert (off_m < 2.0 * bound_m).all()
    assert (off_m < bound_m).mean() > 0.93
