"""A vehicle that was never located starts from its ranges to another denied one, where that is located itself."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import AltitudeMeasurement, Estimate, NoEstimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.filter import FleetFilter

NAMED, LOST, LOST_AT_S, BEGINS_S, END_S = 9, 4, 2.0, 4.0, 12.0
"""The vehicle whose own positions are never trusted; the one that loses its GPS, and when; when the first is ranged."""
VELOCITY_MPS = np.array([0.0, 20.0, 0.0])
PLACES = {1: (0.0, 0.0, 100.0), 2: (0.0, 900.0, 120.0), LOST: (500.0, 300.0, 110.0), NAMED: (800.0, 600.0, 90.0)}
"""Of a formation; the two peers are on a line, so that a vehicle may be on either side of it."""


def flown(seed: int, lost_had_gps: bool) -> list[tuple[float, Estimate | NoEstimate]]:
    """The error, m, and the answer for the named vehicle, ranges and reports at 2 Hz."""
    rng, estimator = np.random.default_rng(seed), FleetFilter()
    estimator.set_denied({NAMED} if lost_had_gps else {NAMED, LOST}, 0.0)
    found = []
    for k in range(round(2.0 * END_S)):
        t = 0.5 * k
        if t == LOST_AT_S:
            estimator.set_denied({NAMED, LOST}, t)
        there = {vehicle: np.array(place) + VELOCITY_MPS * t for vehicle, place in PLACES.items()}
        for vehicle, place in there.items():
            if vehicle in (1, 2) or (vehicle == LOST and lost_had_gps and t < LOST_AT_S):
                measured = (place + rng.normal(size=3)).tolist()
                estimator.add(PositionMeasurement(vehicle, t, t, tuple(measured), 1.0, 1.5, tuple(VELOCITY_MPS.tolist()), 0.3))
            else:
                estimator.add(AltitudeMeasurement(vehicle, t, t, float(place[2]) + rng.normal(), 2.0))
        pairs = [(LOST, 1), (LOST, 2), *([(NAMED, 1), (NAMED, 2), (NAMED, LOST)] if t >= BEGINS_S else [])]
        for one, other in pairs:
            range_m = float(np.linalg.norm(there[one] - there[other])) + rng.normal()
            estimator.add(RangeMeasurement(one, other, t, t, range_m, 1.0))
        where = estimator.estimate(NAMED, t)
        off = where.position_enu_m[:2] - there[NAMED][:2] if isinstance(where, Estimate) else np.full(2, math.nan)
        found.append((float(np.linalg.norm(off)), where))
    return found


@pytest.mark.parametrize("seed", range(5))
def test_it_starts_on_its_own_side_of_two_peers(seed):
    """It waited for a third peer with GPS for ever."""
    found = flown(seed, lost_had_gps=True)
    assert all(isinstance(where, Estimate) for _, where in found[-12:])
    assert all(off_m < 4.0 * horizontal_sigma_m(where.covariance) for off_m, where in found if isinstance(where, Estimate))
    assert found[-1][0] < 10.0


@pytest.mark.parametrize("seed", range(5))
def test_it_does_not_start_where_both_may_be_on_either_side(seed):
    assert not any(isinstance(where, Estimate) for _, where in flown(seed, lost_had_gps=False))
