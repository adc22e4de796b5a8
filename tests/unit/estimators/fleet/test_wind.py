from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.measurements import AttitudeMeasurement, Estimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.filter import FleetFilter

DENIED, SPEED_MPS = 9, 50.0
PEERS = {1: (0.0, 2000.0), 2: (8000.0, 4000.0), 3: (7000.0, 11000.0)}
LOST_S, END_S = 5.0, 60.0


def denied_at(t: float) -> np.ndarray:
    return np.array([2000.0 + SPEED_MPS * t, -4000.0, 100.0])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_wind_learned_from_a_false_velocity_does_not_outlast_the_ranges_that_contradict_it(seed):
    """Until its loss the denied vehicle reports twice its speed, which beside its airspeed makes a wind of 50 m/s.

    In the end it is known to be where it is: within four sigmas, and these no more than what 30 m ranges give in a minute.
    """
    rng = np.random.default_rng(seed)
    estimator = FleetFilter()
    for k in range(round(END_S * 10.0)):
        t = 0.1 * k
        if k == round(LOST_S * 10.0):
            estimator.set_denied({DENIED}, t)
        for p, (east, north) in PEERS.items():
            at = np.array([east, north, 100.0]) + 0.5 * rng.normal(size=3)
            estimator.add(PositionMeasurement(p, t, t, tuple(at.tolist()), 2.0, 3.0, (0.0, 0.0, 0.0), 0.5))
        if t < LOST_S:
            reported_m = denied_at(0.0) + np.array([2.0 * SPEED_MPS * t, 0.0, 0.0]) + 0.5 * rng.normal(size=3)
            estimator.add(
                PositionMeasurement(DENIED, t, t, tuple(reported_m.tolist()), 2.0, 3.0, (2.0 * SPEED_MPS, 0.0, 0.0), 0.5)
            )
        estimator.add(AttitudeMeasurement(DENIED, t, t, 0.0, 0.0, math.pi / 2.0, SPEED_MPS))
        for p, (east, north) in PEERS.items() if k % 5 == 0 else ():
            range_m = float(np.linalg.norm(denied_at(t) - (east, north, 100.0))) + 30.0 * rng.normal()
            estimator.add(RangeMeasurement(DENIED, p, t, t, range_m, 30.0))
    where = estimator.estimate(DENIED, END_S)
    assert isinstance(where, Estimate)
    off = (where.position_enu_m - denied_at(END_S))[:2]
    assert off @ np.linalg.solve(where.covariance[:2, :2], off) < 4.0**2
    assert math.sqrt(np.linalg.eigvalsh(where.covariance[:2, :2])[1]) < 100.0
