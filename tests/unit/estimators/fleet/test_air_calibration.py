"""What a plane's air data are calibrated with while it has GPS: the wind, their errors, and how gusty it is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import AttitudeMeasurement, Estimate, PositionMeasurement
from gcs_coloc.estimators.fleet.ekf.air_data import EVERY_S, AirCalibration, GroundVelocity
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.settings import FleetSettings

PLANE, AIRSPEED_MPS, VELOCITY_SIGMA_MPS = 7, 20.0, 0.3
SETTINGS = FleetSettings()


def report(at_s: float, velocity_mps: np.ndarray, place_m=(0.0, 0.0)) -> PositionMeasurement:
    sigma_mps = VELOCITY_SIGMA_MPS
    return PositionMeasurement(PLANE, at_s, at_s, (*place_m, 100.0), 1.0, 1.0, (*velocity_mps, 0.0), sigma_mps)


def calibrated(rng: np.random.Generator, truth: np.ndarray, noise_mps: float, samples: int) -> AirCalibration:
    """Fly circles of two minutes: each sample with its own error of the air data, `noise_mps` on each axis."""
    calibration = AirCalibration.initial(0.0, SETTINGS)
    for k in range(samples):
        at_s = EVERY_S * (k + 1)
        heading = math.tau * at_s / 120.0
        through_air = AIRSPEED_MPS * np.array([math.sin(heading), math.cos(heading)])
        velocity = through_air + truth[:2] + VELOCITY_SIGMA_MPS * rng.normal(size=2)
        airspeed = AIRSPEED_MPS + truth[2] + noise_mps * rng.normal()
        yaw = heading + truth[3] + noise_mps * rng.normal() / AIRSPEED_MPS
        calibration = calibration.updated(at_s, GroundVelocity(*velocity, VELOCITY_SIGMA_MPS), airspeed, yaw, SETTINGS)
    return calibration


def drawn_truth(rng: np.random.Generator) -> np.ndarray:
    s = SETTINGS
    sigmas = (s.wind_sigma_mps, s.wind_sigma_mps, s.airspeed_sigma_mps, s.heading_sigma_rad)
    return np.array(sigmas) * np.clip(rng.normal(size=4), -1.5, 1.5)


@pytest.mark.parametrize("noise_mps", [0.8, 3.0])
def test_its_errors_are_those_that_it_states(noise_mps):
    """60 flights: the mean normalised squared error of four components is 4, with a standard error of 0.37; three are allowed.

    The learned level settles above the noise (eq. 30), and the drawn errors keep within 1.5 sigmas: a third of 4 at least.
    """
    errors = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        truth = drawn_truth(rng)
        found = calibrated(rng, truth, noise_mps, 45)
        off = found.mean - truth
        errors.append(float(off @ np.linalg.solve(found.covariance, off)))
    assert 1.3 < np.mean(errors) < 5.1


def test_wind_and_the_error_of_the_airspeed_are_told_apart_in_circles():
    truth = np.array([6.0, -4.0, 1.5, 0.04])
    found = calibrated(np.random.default_rng(1), truth, 0.3, 60)
    assert np.abs(found.mean - truth)[:3].max() < 0.4
    assert abs(found.mean[3] - truth[3]) < 0.02


@pytest.mark.parametrize(("noise_mps", "least", "most"), [(0.0, 0.0, 0.3), (0.8, 0.5, 3.5), (3.0, 7.0, 40.0)])
def test_the_level_of_gusts_follows_the_scatter_of_the_air_data(noise_mps, least, most):
    found = calibrated(np.random.default_rng(2), np.array([5.0, 0.0, 0.0, 0.0]), noise_mps, 60)
    assert least < math.exp(found.log_level) < most


def test_one_wrong_attitude_doubles_the_level_at_most():
    before = calibrated(np.random.default_rng(3), np.zeros(4), 0.8, 30)
    north = GroundVelocity(0.0, AIRSPEED_MPS, VELOCITY_SIGMA_MPS)
    after = before.updated(before.at_s + EVERY_S, north, AIRSPEED_MPS, 2.0, SETTINGS)
    assert math.exp(after.log_level - before.log_level) < 2.0


def lost_in_gusts(seed: int, gps_s: float, then_s: float) -> tuple[float, float]:
    """Fly circles in wind with gusts of 3 m/s, lose GPS, and fly on by air data alone: the error and the 95 % bound, m."""
    rng, step_s = np.random.default_rng(seed), 0.2
    keep = math.exp(-step_s / 4.0)
    gust, place, wind = 3.0 * rng.normal(size=2), np.zeros(2), np.array([8.0, -6.0])
    estimator = FleetFilter()
    roll = math.atan(AIRSPEED_MPS * math.tau / 60.0 / 9.80665)
    for k in range(round((gps_s + then_s) / step_s)):
        t = k * step_s
        gust = keep * gust + 3.0 * math.sqrt(1.0 - keep * keep) * rng.normal(size=2)
        heading = math.tau * t / 60.0
        velocity = AIRSPEED_MPS * np.array([math.sin(heading), math.cos(heading)]) + wind + gust
        place = place + step_s * velocity
        if t < gps_s:
            estimator.add(report(t, velocity, place))
        elif k == round(gps_s / step_s):
            estimator.set_denied({PLANE}, t)
        estimator.add(AttitudeMeasurement(PLANE, t, t, roll, 0.0, heading, AIRSPEED_MPS))
    where = estimator.estimate(PLANE, t)
    assert isinstance(where, Estimate)
    return float(np.linalg.norm(where.position_enu_m[:2] - place)), horizontal_bound_95_m(where.covariance)


def test_a_plane_lost_in_gusts_after_two_minutes_is_where_its_bound_says():
    """Of 40 flights 38 are within a bound of 95 %; 33 or more in 999 of 1,000 such draws. Started from three seconds 9 are."""
    flights = [lost_in_gusts(seed, 120.0, 8.0) for seed in range(40)]
    assert sum(error_m <= bound_m for error_m, bound_m in flights) >= 33
    assert np.median([error_m for error_m, _ in flights]) < 20.0


def test_what_was_learned_before_a_loss_is_forgotten_when_its_gps_is_trusted_again():
    estimator = FleetFilter()

    def fly(begin_s: float, end_s: float, wind_mps: float) -> None:
        for k in range(round(begin_s / 0.2), round(end_s / 0.2)):
            t = 0.2 * k
            estimator.add(report(t, np.array([AIRSPEED_MPS + wind_mps, 0.0]), ((AIRSPEED_MPS + wind_mps) * t, 0.0)))
            estimator.add(AttitudeMeasurement(PLANE, t, t, 0.0, 0.0, math.pi / 2.0, AIRSPEED_MPS))

    fly(0.0, 60.0, 10.0)
    estimator.set_denied({PLANE}, 60.0)
    estimator.set_denied((), 61.0)
    fly(61.0, 65.0, -10.0)
    estimator.set_denied({PLANE}, 65.0)
    for k in range(1, 26):
        t = 65.0 + 0.2 * k
        estimator.add(AttitudeMeasurement(PLANE, t, t, 0.0, 0.0, math.pi / 2.0, AIRSPEED_MPS))
    where = estimator.estimate(PLANE, 70.0)
    assert isinstance(where, Estimate)
    assert where.velocity_enu_mps is not None
    assert abs(float(where.velocity_enu_mps[0]) - 10.0) < 2.0


@pytest.mark.parametrize("sigma_mps", [None, 0.3])
@pytest.mark.parametrize("velocity_mps", [None, (AIRSPEED_MPS, 0.0, 0.0)])
def test_a_report_without_a_velocity_or_its_sigma_calibrates_nothing_and_raises_nothing(velocity_mps, sigma_mps):
    estimator = FleetFilter()
    for k in range(100):
        t = 0.2 * k
        estimator.add(AttitudeMeasurement(PLANE, t, t, 0.0, 0.0, math.pi / 2.0, AIRSPEED_MPS))
        estimator.add(PositionMeasurement(PLANE, t, t, (AIRSPEED_MPS * t, 0.0, 100.0), 1.0, 1.0, velocity_mps, sigma_mps))
    estimator.set_denied({PLANE}, 20.0)
    assert isinstance(estimator.estimate(PLANE, 20.0), Estimate)
