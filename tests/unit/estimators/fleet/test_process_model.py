from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.measurements import AttitudeMeasurement, VehicleClass
from gcs_coloc.estimators.fleet.ekf._kernels import Transition
from gcs_coloc.estimators.fleet.ekf.possible_motion import PROFILES
from gcs_coloc.estimators.fleet.ekf.process_model import set_transition, turn_rate_radps
from gcs_coloc.estimators.fleet.ekf.records import VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import SIZE, TURN
from gcs_coloc.estimators.fleet.settings import FleetSettings


@pytest.mark.parametrize("turn_radps", [0.4, -0.25, 1e-6, 0.0])
def test_the_turn_is_that_of_small_steps_with_the_wind_carrying_along(turn_radps):
    airspeed, heading, wind = 24.0, 0.7, np.array([-5.0, 3.0])
    x = np.zeros(SIZE)
    x[3:5] = airspeed * np.array([math.sin(heading), math.cos(heading)]) + wind
    x[6:8] = wind
    step = Transition()
    mean = step.set_motion(x.tolist(), 1.7, turn_radps, in_wind=True)
    moved = step.F @ x
    np.testing.assert_allclose(mean, moved[:5], rtol=1e-12)
    place, steps = np.zeros(2), 20_000
    for k in range(steps):
        psi = heading + turn_radps * 1.7 * (k + 0.5) / steps
        place += (airspeed * np.array([math.sin(psi), math.cos(psi)]) + wind) * 1.7 / steps
    end = heading + turn_radps * 1.7
    np.testing.assert_allclose(moved[:2], place, atol=1e-4)
    np.testing.assert_allclose(moved[3:5], airspeed * np.array([math.sin(end), math.cos(end)]) + wind, atol=1e-9)


def test_the_turn_rate_is_that_of_textbooks():
    # 30 degrees of bank at 50 m/s: 6.49 degrees a second.
    assert math.degrees(turn_rate_radps(math.radians(30.0), 50.0)) == pytest.approx(6.488, abs=1e-3)


@pytest.mark.parametrize("airspeed_mps", [24.0, None])
def test_a_bank_turns_the_way_with_the_airspeed_and_without(airspeed_mps):
    """Eq. (3) and (44): a level turn of 24 m/s in wind, 40 degrees of bank, heading known at the middle of a step."""
    speed, heading, wind, step_s = 24.0, 0.7, np.array([-5.0, 3.0]), 0.1
    roll = math.radians(40.0)
    turn = turn_rate_radps(roll, speed)
    x, P = np.zeros(SIZE), np.zeros((SIZE, SIZE))
    x[3:5] = speed * np.array([math.sin(heading), math.cos(heading)]) + wind
    x[6:8] = wind
    yaw = heading + 0.5 * turn * step_s
    record = VehicleRecord(attitude=AttitudeMeasurement(1, 9.9, 9.9, roll, 0.0, yaw, airspeed_mps))
    mean = set_transition(Transition(), record, FleetSettings(), (x.tolist(), P), step_s, 10.0)
    end = heading + turn * step_s
    radius_m = speed / turn
    way_m = radius_m * np.array([math.cos(heading) - math.cos(end), math.sin(end) - math.sin(heading)]) + step_s * wind
    np.testing.assert_allclose(mean[:2], way_m, atol=2e-3)
    np.testing.assert_allclose(mean[3:5], speed * np.array([math.sin(end), math.cos(end)]) + wind, atol=2e-3)


def test_acceleration_noise_of_two_steps_is_that_of_one():
    first, second, both = Transition(), Transition(), Transition()
    for step, step_s in ((first, 0.4), (second, 0.6), (both, 1.0)):
        step.set_motion([0.0] * SIZE, step_s, 0.0, in_wind=False)
        step.set_acceleration_noise(step_s, 2.0, 0.5)
    np.testing.assert_allclose(both.Q, second.F @ first.Q @ second.F.T + second.Q, atol=1e-12)


def test_a_step_leaves_nothing_of_the_step_before():
    x = np.linspace(-3.0, 5.0, SIZE).tolist()
    used, new = Transition(), Transition()
    used.set_motion(x, 0.7, 0.4, in_wind=True)
    used.set_turn_column(0.7, 0.6, 20.0, -3.0)
    for step in (used, new):
        mean = step.set_motion(x, 0.2, 0.1, in_wind=False)
        step.set_turn_column(0.2, 0.19, mean[3], mean[4])
    np.testing.assert_array_equal(used.F, new.F)
    used.set_motion(x, 0.3, 0.1, in_wind=True)
    new.set_motion(x, 0.3, 0.1, in_wind=True)
    np.testing.assert_array_equal(used.F, new.F)
    assert not used.F[:6, TURN].any()


def test_the_column_of_the_turn_rate_is_the_derivative_of_the_way():
    x, lasting_s, d = [0.0] * 3 + [12.0, -20.0] + [0.0] * 11, 0.1, 1e-6
    step = Transition()
    ends = [step.set_motion(x, 0.1, turn, in_wind=False) for turn in (0.2 - d, 0.2, 0.2 + d)]
    step.set_turn_column(0.1, lasting_s, ends[1][3], ends[1][4])
    slope = (np.array(ends[2]) - np.array(ends[0])) / (2.0 * d)
    np.testing.assert_allclose(step.F[[3, 4], TURN], slope[[3, 4]], rtol=1e-6)
    # To first order in the angle.
    np.testing.assert_allclose(step.F[[0, 1], TURN], slope[[0, 1]], rtol=2e-2)


def test_slow_states_keep_their_spread_however_the_step_is_cut():
    times_s, sigmas = tuple(np.arange(1.0, 7.0)), tuple(np.linspace(0.1, 3.0, 8))
    # Wind has two components, a report three, of which the horizontal ones share a sigma.
    spread = np.array(sigmas)[[0, 0, 1, 2, 3, 4, 4, 5, 6, 7]]
    mean, P = np.arange(float(SIZE)), np.diag(np.r_[np.zeros(6), np.square(spread)])
    at_once = Transition()
    at_once.set_gauss_markov(1.0, times_s, sigmas)
    once = at_once.F @ mean
    for step_s in (0.3, 0.7):
        step = Transition()
        step.set_gauss_markov(step_s, times_s, sigmas)
        mean, P = step.F @ mean, step.F @ P @ step.F.T + step.Q
    np.testing.assert_allclose(mean, once)
    np.testing.assert_allclose(np.diag(P)[6:], np.square(spread))
    np.testing.assert_array_equal(mean[:6], np.arange(6.0))
    of_state = np.array(times_s)[[0, 0, 1, 1, 2, 3, 3, 3, 4, 5]]
    np.testing.assert_allclose(once[6:], np.arange(6.0, 16.0) * np.exp(-1.0 / of_state))


@pytest.mark.parametrize(
    ("vehicle_class", "denied", "height_sigma_m", "level"),
    [
        (VehicleClass.MULTIROTOR, False, 0.0, 15.0),
        (VehicleClass.MULTIROTOR, True, 1.0, 15.0),
        (VehicleClass.MULTIROTOR, True, 0.0, 1.0),
        (VehicleClass.PLANE, False, 0.0, 1.0),
        (VehicleClass.PLANE, True, 1.0, 1.0),
    ],
)
def test_climbs_of_a_multirotor_are_followed_where_reports_or_heights_show_them(vehicle_class, denied, height_sigma_m, level):
    record = VehicleRecord(denied_vehicle=denied, baro_error_sigma_m=height_sigma_m, profile=PROFILES[vehicle_class])
    transition, s = Transition(), FleetSettings()
    set_transition(transition, record, s, ([0.0] * SIZE, np.eye(SIZE)), 1.0, 1.0)
    assert transition.Q[5, 5] == pytest.approx(level * s.climb_density_m2ps3)
