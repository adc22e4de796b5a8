from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.estimators.fleet_motion import SIZE, acceleration_noise, fade_slow_states, transition, turn_rate_radps


@pytest.mark.parametrize("turn_radps", [0.4, -0.25, 1e-6, 0.0])
def test_the_turn_is_that_of_small_steps_with_the_wind_carrying_along(turn_radps):
    airspeed, heading, wind = 24.0, 0.7, np.array([-5.0, 3.0])
    x = np.zeros(SIZE)
    x[3:5] = airspeed * np.array([math.sin(heading), math.cos(heading)]) + wind
    x[6:8] = wind
    moved = transition(1.7, turn_radps, in_wind=True) @ x
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


def test_acceleration_noise_of_two_steps_is_that_of_one():
    F = transition(0.6, 0.0, in_wind=False)
    two = F @ acceleration_noise(0.4, 2.0, 0.5) @ F.T + acceleration_noise(0.6, 2.0, 0.5)
    np.testing.assert_allclose(acceleration_noise(1.0, 2.0, 0.5), two, atol=1e-12)


def test_slow_states_keep_their_spread_however_the_step_is_cut():
    times_s, sigmas = tuple(np.arange(1.0, 11.0)), tuple(np.linspace(0.1, 3.0, 10))
    mean, P = np.arange(float(SIZE)), np.diag(np.r_[np.zeros(6), np.square(sigmas)])
    once = mean.copy()
    fade_slow_states(once, np.eye(SIZE), np.zeros((SIZE, SIZE)), 1.0, times_s, sigmas)
    for step_s in (0.3, 0.7):
        F, Q = np.eye(SIZE), np.zeros((SIZE, SIZE))
        fade_slow_states(mean, F, Q, step_s, times_s, sigmas)
        P = F @ P @ F.T + Q
    np.testing.assert_allclose(mean, once)
    np.testing.assert_allclose(np.diag(P)[6:], np.square(sigmas))
    np.testing.assert_array_equal(mean[:6], np.arange(6.0))
