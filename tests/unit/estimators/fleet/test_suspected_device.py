"""A device that was wrong until now is not believed at once where its next range is within the gate."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.measurements import AltitudeMeasurement, Estimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.filter import FleetFilter

DENIED = 9
ANCHORS_M = {1: (0.0, 0.0, 0.0), 2: (28.7, 0.0, 0.0), 3: (28.7, 25.7, 0.0), 4: (0.0, 25.7, 0.0)}
WRONG_FROM_S, HALF_WRONG_FROM_S, END_S = 6.0, 14.0, 18.0


def walked(t: float) -> np.ndarray:
    return np.array([11.0 + 0.1 * t, 16.0 - 0.4 * t, 0.0])


def largest_error_m(seed: int) -> float:
    """Return the largest error once a device that was 9 m off is so by 3 to 6 m, now within the gate and now beyond."""
    rng, estimator = np.random.default_rng(seed), FleetFilter()
    for anchor, place in ANCHORS_M.items():
        estimator.add(PositionMeasurement(anchor, 0.0, 0.0, place, 0.1, 0.1, static=True))
    estimator.set_denied({DENIED}, 0.0)
    most_m = 0.0
    for k in range(round(10.0 * END_S)):
        t = 0.1 * k
        estimator.add(AltitudeMeasurement(DENIED, t, t, 0.0, 0.1))
        for anchor, place in ANCHORS_M.items():
            range_m = math.dist(walked(t), place) + 0.2 * rng.normal()
            if anchor == 2 and t >= WRONG_FROM_S:
                range_m += 9.0 if t < HALF_WRONG_FROM_S else rng.uniform(3.0, 6.0)
            estimator.add(RangeMeasurement(DENIED, anchor, t, t, range_m, 1.0))
        where = estimator.estimate(DENIED, t)
        if isinstance(where, Estimate) and t >= HALF_WRONG_FROM_S:
            most_m = max(most_m, math.dist(where.position_enu_m[:2], walked(t)[:2]))
    return most_m


def test_a_device_that_has_been_refused_pulls_little_within_the_gate():
    """Believed at once, it drew the place 2.9 to 3.4 m to itself."""
    assert max(largest_error_m(seed) for seed in range(4)) < 1.5


@pytest.mark.parametrize("wrong_m", [9.0, 338_210.0])
def test_a_device_that_is_right_again_is_believed_again(wrong_m):
    """Its ranges count as before, once enough of them have fitted, however wrong they were: a counter less one is 338 km."""
    rng, estimator = np.random.default_rng(3), FleetFilter()
    for anchor, place in ANCHORS_M.items():
        estimator.add(PositionMeasurement(anchor, 0.0, 0.0, place, 0.1, 0.1, static=True))
    estimator.set_denied({DENIED}, 0.0)
    sigmas = {}
    for k in range(160):
        t = 0.1 * k
        estimator.add(AltitudeMeasurement(DENIED, t, t, 0.0, 0.1))
        for anchor, place in ANCHORS_M.items():
            range_m = math.dist(walked(t), place) + 0.2 * rng.normal()
            range_m += wrong_m if anchor == 2 and 6.0 <= t < 8.0 else 0.0
            estimator.add(RangeMeasurement(DENIED, anchor, t, t, range_m, 1.0))
        where = estimator.estimate(DENIED, t)
        if isinstance(where, Estimate):
            sigmas[k] = math.sqrt(np.trace(where.covariance[:2, :2]))
    assert sigmas[78] > 1.05 * sigmas[58]
    assert sigmas[87] < 1.02 * sigmas[58]
