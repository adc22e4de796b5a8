from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    OdometryMeasurement,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet.ekf.measurement_models import odometry
from gcs_coloc.estimators.fleet.ekf.state import SIZE, TURN, JointState
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.qu_zhang.filter import QuZhangFilter

ROBOT = 9
ANCHORS = {1: (0.0, 0.0, 0.0), 2: (12.0, 0.0, 0.0), 3: (0.0, 12.0, 0.0), 4: (12.0, 12.0, 0.0)}
SPEED_MPS, TURN_RADPS = 1.0, 0.25
GAP_S = (20.0, 30.0)


def robot_at(t: float) -> np.ndarray:
    """Where the robot is: clockwise on a circle of 4 m, at rest from 35 s on."""
    angle = TURN_RADPS * min(t, 35.0)
    return np.array([6.0 + 4.0 * math.sin(angle), 6.0 + 4.0 * math.cos(angle), 0.0])


def driven(*, with_odometry: bool, seed: int = 3) -> dict[float, tuple[float, float]]:
    """Error and larger sigma (m) by time of a robot whose ranges pause for ten seconds."""
    rng = np.random.default_rng(seed)
    estimator = FleetFilter()
    estimator.add(VehicleClassReport(ROBOT, 0.0, 0.0, VehicleClass.INDOOR))
    for anchor, place in ANCHORS.items():
        estimator.add(PositionMeasurement(anchor, 0.0, 0.0, place, 0.01, 0.01, static=True))
    estimator.add(PositionMeasurement(ROBOT, 0.0, 0.0, tuple(robot_at(0.0).tolist()), 0.1, 0.1, (1.0, 0.0, 0.0), 0.1))
    estimator.set_denied({ROBOT}, 0.01)
    found = {}
    for n in range(1, 450):
        t = 0.1 * n
        moving = t < 35.0
        if n % 5 == 0:
            estimator.add(AltitudeMeasurement(ROBOT, t, t, 0.0, 0.1))
        if with_odometry:
            forward, turn = (SPEED_MPS, TURN_RADPS) if moving else (0.0, 0.0)
            noisy = forward + 0.02 * rng.normal(), 0.0, turn + 0.01 * rng.normal()
            estimator.add(OdometryMeasurement(ROBOT, t, t, *noisy, 0.05, 0.02))
        if not GAP_S[0] < t < GAP_S[1]:
            for anchor, place in ANCHORS.items():
                range_m = float(np.linalg.norm(robot_at(t) - place)) + 0.1 * rng.normal()
                estimator.add(RangeMeasurement(ROBOT, anchor, t, t, range_m, 0.1))
        where = estimator.estimate(ROBOT, t)
        if isinstance(where, Estimate):
            error_m = float(np.linalg.norm((where.position_enu_m - robot_at(t))[:2]))
            found[round(t, 1)] = error_m, math.sqrt(float(np.linalg.eigvalsh(where.covariance[:2, :2])[-1]))
    return found


@pytest.mark.parametrize("seed", [3, 4])
def test_odometry_carries_a_robot_through_a_gap_in_its_ranges_and_its_bound_holds(seed):
    found = driven(with_odometry=True, seed=seed)
    for t in (24.0, 27.0, 29.9):
        error_m, sigma_m = found[t]
        assert error_m < 2.45 * sigma_m
        assert error_m < 1.5
        assert sigma_m < 4.0
    without = driven(with_odometry=False, seed=seed)
    assert 29.9 not in without or without[29.9][1] > 4.0 * found[29.9][1]


def test_wheels_at_rest_hold_a_robot_still():
    found = driven(with_odometry=True)
    assert max(found[round(0.1 * n, 1)][0] for n in range(400, 450)) < 0.15


def joint_with(velocity: tuple[float, float], sigma_mps: float) -> JointState:
    x = np.zeros(SIZE)
    x[3], x[4], x[TURN] = *velocity, 0.1
    joint = JointState()
    P = np.diag([1.0] * 3 + [sigma_mps**2] * 3 + [1.0] * (SIZE - 6))
    joint.augment(ROBOT, x, P, 0.0)
    return joint


def test_the_model_is_speed_and_turn_rate_whatever_the_heading():
    linear = odometry(joint_with((3.0, 4.0), 0.1), OdometryMeasurement(ROBOT, 0.0, 0.0, 0.0, -5.5, 0.3, 0.2, 0.1), 1.0)
    assert linear.H[0, 3:5] == pytest.approx([0.6, 0.8])
    assert linear.H[1, TURN] == 1.0
    assert -linear.HA[:, 0] == pytest.approx([0.5, 0.2])
    assert pytest.approx([0.04, 0.01]) == linear.R


def test_without_a_course_a_speed_is_no_component_of_the_velocity():
    linear = odometry(joint_with((0.3, 0.0), 1.0), OdometryMeasurement(ROBOT, 0.0, 0.0, 2.0, 0.0, 0.3, 0.1, 0.1), 1.0)
    assert len(linear.H) == 1
    assert linear.H[0, TURN] == 1.0


def test_at_a_stop_both_components_of_the_velocity_are_zero_within_what_was_measured():
    linear = odometry(joint_with((0.3, -0.2), 1.0), OdometryMeasurement(ROBOT, 0.0, 0.0, 0.03, 0.04, 0.0, 0.1, 0.1), 0.1)
    assert -linear.HA[:, 0] == pytest.approx([-0.3, 0.2, -0.1])
    assert pytest.approx([0.125, 0.125, 0.1]) == linear.R


def test_the_paper_s_estimator_counts_odometry_and_leaves_it():
    estimator = QuZhangFilter()
    estimator.add(OdometryMeasurement(ROBOT, 1.0, 1.0, 1.0, 0.0, 0.0, 0.1, 0.1))
    assert estimator.counts()["odometry not used by this estimator"] == 1
