"""Barometric heights outside the gate: a climb that begins hard is followed, a barometer that jumps is not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet.filter import FleetFilter

DENIED, STEP_S, END_S = 9, 0.2, 60.0
ANCHORS_M = {1: (-70.0, -60.0, 20.0), 2: (80.0, -50.0, 60.0), 3: (60.0, 75.0, 30.0), 4: (-75.0, 65.0, 50.0)}
CLIMB_MPS, ACCELERATION_MPS2, HOLDS_S = 8.0, 8.0, 6.0


def flown(climb_mps: float, jump_m: float, seed: int) -> tuple[float, float]:
    """Climb and sink in turns among four anchors; the barometer jumps at 30 s.

    Return the largest error upwards, m, and the largest horizontal error over its 95 % bound.
    """
    rng, estimator = np.random.default_rng(seed), FleetFilter()
    for vehicle, place in ANCHORS_M.items():
        estimator.add(PositionMeasurement(vehicle, 0.0, 0.0, place, 0.3, 0.3, static=True))
    estimator.add(VehicleClassReport(DENIED, 0.0, 0.0, VehicleClass.MULTIROTOR))
    up_m, rate_mps, off_m, ratios = 60.0, 0.0, [], []
    for k in range(round(END_S / STEP_S)):
        t = k * STEP_S
        wanted_mps = climb_mps if math.floor(t / HOLDS_S) % 2 == 0 else -climb_mps
        rate_mps += min(max(wanted_mps - rate_mps, -ACCELERATION_MPS2 * STEP_S), ACCELERATION_MPS2 * STEP_S)
        up_m += rate_mps * STEP_S
        if t < 5.0:
            estimator.add(PositionMeasurement(DENIED, t, t, (0.0, 0.0, up_m), 0.5, 0.5, (0.0, 0.0, rate_mps), 0.3))
        elif k == round(5.0 / STEP_S):
            estimator.set_denied({DENIED}, t)
        jumped_m = jump_m if t > 30.0 else 0.0
        estimator.add(AltitudeMeasurement(DENIED, t, t, up_m + jumped_m + 0.3 * rng.normal(), 2.0))
        for p, place in ANCHORS_M.items():
            range_m = math.dist((0.0, 0.0, up_m), place) + rng.normal()
            estimator.add(RangeMeasurement(DENIED, p, t, t, range_m, 1.0))
        where = estimator.estimate(DENIED, t)
        if t > 8.0:
            assert isinstance(where, Estimate)
            off_m.append(abs(float(where.position_enu_m[2]) - up_m))
            ratios.append(math.hypot(*where.position_enu_m[:2].tolist()) / horizontal_bound_95_m(where.covariance))
    return max(off_m), max(ratios)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_copter_that_climbs_and_sinks_in_turns_keeps_its_height_and_its_place(seed):
    """With the white acceleration of altitude hold it was 7.4 m too high or low."""
    off_m, ratio = flown(CLIMB_MPS, 0.0, seed)
    assert off_m < 5.0
    assert ratio < 1.5


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("jump_m", [-80.0, -25.0, -10.0, 10.0, 25.0, 80.0])
def test_a_barometer_that_jumps_moves_it_neither_aside_nor_upwards(jump_m, seed):
    """With inflated noise a jump of 80 m moved it upwards by 65 m within half a minute, one of 10 m by 6 m."""
    off_m, ratio = flown(0.0, jump_m, seed)
    assert ratio < 1.5
    assert off_m < 2.5


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_barometer_that_jumps_in_a_climb_moves_it_little(seed):
    """With inflated noise it was given up."""
    off_m, ratio = flown(CLIMB_MPS, 40.0, seed)
    assert off_m < 7.0
    assert ratio < 1.5


def test_a_jump_is_forgotten_with_the_vehicles_own_gps():
    """Its heights are learnt anew then: at its next loss they are right."""
    rng, estimator = np.random.default_rng(1), FleetFilter()
    for vehicle, place in ANCHORS_M.items():
        estimator.add(PositionMeasurement(vehicle, 0.0, 0.0, place, 0.3, 0.3, static=True))
    estimator.add(VehicleClassReport(DENIED, 0.0, 0.0, VehicleClass.MULTIROTOR))
    off_m = []
    for k in range(round(60.0 / STEP_S)):
        t = k * STEP_S
        is_lost = 5.0 <= t < 25.0 or t >= 35.0
        estimator.set_denied({DENIED} if is_lost else set(), t)
        if not is_lost:
            estimator.add(PositionMeasurement(DENIED, t, t, (0.0, 0.0, 60.0), 0.5, 0.5, (0.0, 0.0, 0.0), 0.3))
            continue
        jumped_m = 80.0 if 15.0 < t < 25.0 else 0.0
        estimator.add(AltitudeMeasurement(DENIED, t, t, 60.0 + jumped_m + 0.3 * rng.normal(), 2.0))
        for p, place in ANCHORS_M.items():
            estimator.add(RangeMeasurement(DENIED, p, t, t, math.dist((0.0, 0.0, 60.0), place) + rng.normal(), 1.0))
        where = estimator.estimate(DENIED, t)
        assert isinstance(where, Estimate)
        off_m.append(abs(float(where.position_enu_m[2]) - 60.0))
    assert max(off_m) < 3.0


@pytest.mark.parametrize("seed", range(5))
def test_the_stated_height_is_as_uncertain_as_many_jumps_make_it(seed):
    """By ranges that tell nothing of the height. The band: 26 jumps, 4.6 sigmas at most; 8 to 15 if a jump counted as known."""
    rng, estimator, ratios = np.random.default_rng(seed), FleetFilter(), []
    for vehicle, (e, n, _) in ANCHORS_M.items():
        estimator.add(PositionMeasurement(vehicle, 0.0, 0.0, (5.0 * e, 5.0 * n, 60.0), 0.3, 0.3, static=True))
    estimator.add(VehicleClassReport(DENIED, 0.0, 0.0, VehicleClass.MULTIROTOR))
    for k in range(round(END_S / STEP_S)):
        t = k * STEP_S
        if t < 5.0:
            estimator.add(PositionMeasurement(DENIED, t, t, (0.0, 0.0, 60.0), 0.5, 0.5, (0.0, 0.0, 0.0), 0.3))
        estimator.set_denied(set() if t < 5.0 else {DENIED}, t)
        estimator.add(AltitudeMeasurement(DENIED, t, t, 60.0 + 40.0 * (math.floor(t / 2.0) % 2) + 2.0 * rng.normal(), 2.0))
        for p, (e, n, _) in ANCHORS_M.items():
            estimator.add(RangeMeasurement(DENIED, p, t, t, math.hypot(5.0 * e, 5.0 * n) + rng.normal(), 1.0))
        where = estimator.estimate(DENIED, t)
        if t > 8.0:
            assert isinstance(where, Estimate)
            ratios.append(abs(float(where.position_enu_m[2]) - 60.0) / math.sqrt(float(where.covariance[2, 2])))
    assert max(ratios) < 6.0
