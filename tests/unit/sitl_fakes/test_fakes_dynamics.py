"""The aircraft: published model, stable heading hold, turns as physics has them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from sitl_fakes.dynamics import GRAVITY_MPS2, LateralAircraft, LateralDerivatives, aerosonde, wrap_pi

SPEEDS = [15.0, 22.0, 35.0, 50.0]


def state_matrix(airspeed_mps: float) -> NDArray[np.float64]:
    """System matrix (5, 5) of the linear lateral model, states [beta, p, r, phi, psi] in rad and rad/s (Beard & McLain 5.5.1)."""
    d = aerosonde(airspeed_mps)
    return np.array(
        [
            [d.y_beta, d.y_p, d.y_r, GRAVITY_MPS2 / airspeed_mps, 0.0],
            [d.l_beta, d.l_p, d.l_r, 0.0, 0.0],
            [d.n_beta, d.n_p, d.n_r, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0, 0.0],
        ]
    )


def input_matrix(d: LateralDerivatives) -> NDArray[np.float64]:
    """Input matrix (5, 2) of the linear lateral model, inputs [aileron, rudder] in rad."""
    return np.array([[d.y_da, d.y_dr], [d.l_da, d.l_dr], [d.n_da, d.n_dr], [0.0, 0.0], [0.0, 0.0]])


def test_the_model_reduces_to_the_published_linear_one_about_level_flight():
    aircraft = LateralAircraft(0.0, 0.0, 0.0, 35.0)
    step = 1e-6
    lateral = slice(2, 7)

    def open_loop(x):
        return np.array(aircraft.rates(tuple(x), 0.0, 0.0, 0.0))[lateral]

    jacobian = np.empty((5, 7))
    for column, index in enumerate(range(2, 9)):
        x = np.zeros(9)
        x[index] = step
        jacobian[:, column] = (open_loop(x) - open_loop(-x)) / (2.0 * step)
    assert np.allclose(jacobian, np.hstack([state_matrix(35.0), input_matrix(aerosonde(35.0))]), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("speed", SPEEDS)
def test_the_airframe_has_a_damped_roll_and_dutch_roll_and_a_slow_spiral(speed):
    modes = np.linalg.eigvals(state_matrix(speed))
    oscillating = modes[np.abs(modes.imag) > 1e-9]
    assert len(oscillating) == 2
    assert (oscillating.real < -0.5).all()
    real = np.sort(modes[np.abs(modes.imag) <= 1e-9].real)
    assert real[0] < -10.0
    assert np.abs(real[1:]).max() < 0.1


@pytest.mark.parametrize("speed", SPEEDS)
def test_trimmed_flight_goes_straight(speed):
    aircraft = LateralAircraft(10.0, -20.0, 0.5, speed)
    for _ in range(500):
        aircraft.step(0.5, 0.02)
    s = aircraft.state
    assert (s.east_m, s.north_m) == pytest.approx((10.0 + 10.0 * speed * math.sin(0.5), -20.0 + 10.0 * speed * math.cos(0.5)))
    assert (s.beta_rad, s.p_radps, s.r_radps, s.phi_rad) == pytest.approx((0.0, 0.0, 0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize("turn", [math.radians(30.0), math.radians(-120.0)])
def test_a_heading_step_settles_without_overshoot(speed, turn):
    aircraft = LateralAircraft(0.0, 0.0, 3.0, speed)
    errors = []
    for _ in range(1500):
        aircraft.step(3.0 + turn, 0.02)
        errors.append(wrap_pi(3.0 + turn - aircraft.state.psi_rad) / turn)
    assert min(errors) > -0.03
    assert abs(errors[-1]) < 1e-3


@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize("ahead", [0.1, 0.3, 1.5])
def test_a_steady_turn_has_the_rate_of_its_bank(speed, ahead):
    aircraft = LateralAircraft(0.0, 0.0, 0.0, speed)
    for _ in range(1000):
        aircraft.step(aircraft.state.psi_rad + ahead, 0.02)
    before = aircraft.state
    aircraft.step(before.psi_rad + ahead, 0.02)
    rate = wrap_pi(aircraft.state.psi_rad - before.psi_rad) / 0.02
    # 6 %: the aircraft slips a little in its turn (its yaw damping and sideslip force), as aircraft without a slip controller do.
    assert rate == pytest.approx(GRAVITY_MPS2 * math.tan(before.phi_rad) / speed, rel=0.06)
    assert abs(before.phi_rad) < math.radians(47.0)


def test_wind_carries_the_aircraft_without_turning_it():
    aircraft = LateralAircraft(0.0, 0.0, 0.0, 20.0)
    for _ in range(50):
        aircraft.step(0.0, 0.02, wind_east_mps=5.0, wind_north_mps=-3.0)
    assert (aircraft.state.east_m, aircraft.state.north_m) == pytest.approx((5.0, 17.0))


def test_half_the_time_step_gives_the_same_flight():
    ends = []
    for step in (0.02, 0.01):
        aircraft = LateralAircraft(0.0, 0.0, 0.0, 50.0)
        for k in range(round(20.0 / step)):
            aircraft.step(1.0 if k * step < 8.0 else -1.0, step)
        ends.append((aircraft.state.east_m, aircraft.state.north_m))
    assert math.dist(*ends) < 0.5
