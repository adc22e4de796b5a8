"""A plane that loses its GPS and turns, with ranges and attitude once a second, as telemetry radios send them."""

import math

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import AttitudeMeasurement, Estimate, PositionMeasurement, RangeMeasurement, VehicleClass
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.settings import FleetSettings

DENIED, SPEED_MPS, LOST_S, STEP_S = 9, 22.0, 10.0, 0.05
PEERS_M = {1: (-300.0, 500.0), 2: (900.0, 600.0), 3: (400.0, -500.0), 4: (1100.0, -300.0), 5: (200.0, 900.0)}
TURNS_S = ((30.3, 36.0), (50.6, 55.0))


def flown(bank_rad):
    """Return times, places (n, 2), headings and banks of a plane that flies east and makes two turns, into and out in 1 s."""
    place, heading, ways = np.zeros(2), math.pi / 2.0, []
    for k in range(round(70.0 / STEP_S)):
        t = k * STEP_S
        bank = max(max(0.0, min(t - start, end - t, 1.0)) for start, end in TURNS_S) * bank_rad
        ways.append((t, place.copy(), heading, bank))
        heading += 9.80665 * math.tan(bank) / SPEED_MPS * STEP_S
        place += SPEED_MPS * STEP_S * np.array([math.sin(heading), math.cos(heading)])
    return ways


def errors_and_bounds_m(bank_rad, *, has_attitude, seed):
    """Fly it; return the error of the estimate and its 95 % bound since the loss, m, five times a second."""
    rng, found = np.random.default_rng(seed), []
    estimator = FleetFilter(FleetSettings(vehicle_class=VehicleClass.PLANE))
    for k, (t, place, heading, bank) in enumerate(flown(bank_rad)):
        if k == round(LOST_S / STEP_S):
            estimator.set_denied({DENIED}, t)
        velocity = (SPEED_MPS * math.sin(heading), SPEED_MPS * math.cos(heading), 0.0)
        if k % 4 == 0:
            for peer, at_m in PEERS_M.items():
                estimator.add(PositionMeasurement(peer, t, t, (*at_m, 100.0), 1.0, 1.5, (0.0, 0.0, 0.0), 0.3))
            if t < LOST_S:
                estimator.add(PositionMeasurement(DENIED, t, t, (*place.tolist(), 100.0), 1.0, 1.5, velocity, 0.3))
        if has_attitude and k % 20 == 0:
            estimator.add(AttitudeMeasurement(DENIED, t, t, bank, 0.0, heading, SPEED_MPS))
        for peer, at_m in PEERS_M.items():
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
    off_m, bound_m = errors_and_bounds_m(math.radians(62.0), has_attitude=True, seed=seed)
    assert len(off_m) > 280
    assert off_m.max() < 8.0
    assert (off_m < 3.0 * bound_m).all()


@pytest.mark.parametrize("seed", range(3))
def test_ranges_once_a_second_show_a_turn_without_attitude(seed):
    """With the process noise of ranges at 5 Hz nine of eleven were outside the gate, up to 50 m off."""
    off_m, bound_m = errors_and_bounds_m(math.radians(40.0), has_attitude=False, seed=seed)
    assert off_m.max() < 16.0
    assert (off_m < 3.0 * bound_m).mean() > 0.98
