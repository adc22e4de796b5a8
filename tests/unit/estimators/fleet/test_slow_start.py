"""A vehicle whose ranges are too slow for a multilateration is located from them all the same, every side open."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import (
    AMBIGUOUS,
    AltitudeMeasurement,
    Estimate,
    NoEstimateReason,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.settings import FleetSettings

DENIED, EVERY_S, SIGMA_M = 9, 2.0, 1.0
BEACONS = {1: (0.0, 0.0, 0.0), 2: (400.0, 20.0, 0.0), 3: (380.0, 300.0, 0.0), 4: (-30.0, 350.0, 0.0)}


def sailed(seed: int, beacons: tuple[int, ...]) -> list[tuple[float, Estimate | NoEstimateReason]]:
    """The error, m, and the answer after each range of a boat that ranges its beacons in turn, one every two seconds."""
    rng, estimator = np.random.default_rng(seed), FleetFilter(FleetSettings(vehicle_class="boat"))
    estimator.set_denied({DENIED}, 0.0)
    course_rad, here = rng.uniform(-math.pi, math.pi), rng.uniform(100.0, 280.0, 2)
    found: list[tuple[float, Estimate | NoEstimateReason]] = []
    for k in range(60):
        t = EVERY_S * k
        here = here + 1.5 * EVERY_S * np.array((math.cos(course_rad), math.sin(course_rad)))
        for beacon in beacons:
            estimator.add(PositionMeasurement(beacon, t, t, BEACONS[beacon], 0.5, 0.5, (0.0, 0.0, 0.0), 0.01))
        estimator.add(AltitudeMeasurement(DENIED, t, t, 0.0, 0.5))
        beacon = beacons[k % len(beacons)]
        range_m = math.dist((*here, 0.0), BEACONS[beacon]) + SIGMA_M * rng.normal()
        estimator.add(RangeMeasurement(DENIED, beacon, t, t, range_m, SIGMA_M))
        where = estimator.estimate(DENIED, t)
        if isinstance(where, Estimate):
            found.append((float(np.linalg.norm(where.position_enu_m[:2] - here)), where))
        else:
            found.append((math.nan, where.reason.reason))
    return found


@pytest.mark.parametrize("seed", range(6))
def test_it_is_located_from_ranges_that_come_every_two_seconds(seed: int):
    """Six ranges never came within the four seconds of a multilateration, so it waited for ever."""
    found = sailed(seed, (1, 2, 3, 4))
    known = [(error_m, where) for error_m, where in found if isinstance(where, Estimate)]
    assert len(known) > 40
    assert all(error_m < 4.0 * horizontal_sigma_m(where.covariance) for error_m, where in known)
    assert known[-1][0] < 10.0


@pytest.mark.parametrize("seed", range(6))
def test_beside_two_beacons_both_sides_stay_open(seed: int):
    found = sailed(seed, (1, 2))
    assert {where for _, where in found if not isinstance(where, Estimate)} & AMBIGUOUS
    for error_m, where in found:
        assert not isinstance(where, Estimate) or error_m < 4.0 * horizontal_sigma_m(where.covariance)
