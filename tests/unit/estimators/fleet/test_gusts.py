"""A plane's gusts: their level is learned, so that flight in still air is accurate and flight in gusts honest."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import AttitudeMeasurement, Estimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.settings import FleetSettings

DENIED, AIRSPEED_MPS, RANGE_M = 9, 20.0, 5.0
PEERS = {1: (0.0, 2000.0), 2: (4000.0, 1000.0), 3: (2000.0, -2500.0), 4: (-1500.0, -500.0)}
LOST_S, LEARNED_S, END_S = 5.0, 65.0, 185.0


def flown(gust_mps: float, learns: bool, seed: int) -> tuple[float, float, float]:
    """Fly east in wind with gusts of 4 s; return RMSE (m), the share within the bound and its mean (m), after the learning."""
    rng, t_step = np.random.default_rng(seed), 0.2
    settings = FleetSettings() if learns else FleetSettings(least_noise_level=1.0, most_noise_level=1.0)
    estimator, keep = FleetFilter(settings), math.exp(-t_step / 4.0)
    gust, place, errors, bounds = np.zeros(2), np.zeros(2), [], []
    for k in range(round(END_S / t_step)):
        t = k * t_step
        if k == round(LOST_S / t_step):
            estimator.set_denied({DENIED}, t)
        gust = keep * gust + gust_mps * math.sqrt(1.0 - keep * keep) * rng.normal(size=2)
        velocity = np.array([AIRSPEED_MPS, 5.0]) + gust
        place = place + t_step * velocity
        for p, (east, north) in PEERS.items():
            estimator.add(PositionMeasurement(p, t, t, (east, north, 100.0), 1.0, 1.0, (0.0, 0.0, 0.0), 0.3))
            range_m = math.dist(place, (east, north)) + RANGE_M * rng.normal()
            estimator.add(RangeMeasurement(DENIED, p, t, t, range_m, RANGE_M))
        if t < LOST_S:
            report = PositionMeasurement(DENIED, t, t, (*place, 100.0), 1.0, 1.0, (*velocity, 0.0), 0.3)
            estimator.add(report)
        off_course_mps, off_speed_mps = 0.3 * rng.normal(size=2)
        heading = math.pi / 2.0 + off_course_mps / AIRSPEED_MPS
        estimator.add(AttitudeMeasurement(DENIED, t, t, 0.0, 0.0, heading, AIRSPEED_MPS - gust[0] + off_speed_mps))
        if t > LEARNED_S and k % 5 == 0:
            where = estimator.estimate(DENIED, t)
            assert isinstance(where, Estimate)
            errors.append(float(np.linalg.norm(where.position_enu_m[:2] - place)))
            bounds.append(horizontal_bound_95_m(where.covariance))
    covered = np.mean(np.less_equal(errors, bounds))
    return math.sqrt(np.mean(np.square(errors))), float(covered), float(np.mean(bounds))


@cache
def mean_of(gust_mps: float, learns: bool) -> np.ndarray:
    return np.mean([flown(gust_mps, learns, seed) for seed in (1, 2, 3)], axis=0)


def test_in_still_air_the_position_becomes_more_accurate_and_is_stated_so():
    (rmse_m, covered, bound_m), (fixed_rmse_m, _, fixed_bound_m) = mean_of(0.0, True), mean_of(0.0, False)
    assert rmse_m < fixed_rmse_m
    assert bound_m < 0.9 * fixed_bound_m
    assert covered >= 0.9


def test_strong_gusts_are_learned_and_are_in_the_bound():
    (_, covered, bound_m), (_, _, still_bound_m) = mean_of(4.0, True), mean_of(0.0, True)
    assert covered >= 0.9
    assert bound_m > 1.5 * still_bound_m


def test_gusts_that_are_not_learned_pass_for_a_sensor_that_fails():
    """So the air data are refused, and the bound of a filter that takes gusts for light holds nevertheless."""
    rmse_m, covered, _ = mean_of(4.0, False)
    assert rmse_m < 5.0
    assert covered >= 0.85
