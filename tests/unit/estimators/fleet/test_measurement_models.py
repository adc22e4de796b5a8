"""Each measurement model is the linearised h of its equation, and its correction that of the textbook."""

import math

import numpy as np
import pytest

from gcs_coloc.core.measurements import AltitudeMeasurement, AttitudeMeasurement, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.ekf._kernels import RangeEnd
from gcs_coloc.estimators.fleet.ekf.measurement_models import air_velocity, altitude, position_report, slant_range
from gcs_coloc.estimators.fleet.ekf.state import JointState, pair_key, whiten
from gcs_coloc.estimators.fleet.settings import FleetSettings
from tests.unit.estimators.fleet import reference

MEAN = np.array([100.0, -50.0, 80.0, 18.0, 9.0, -1.0, 3.0, -2.0, 0.5, 0.02, 2.0, 1.0, -1.0, 2.0, 0.02, 0.1])


def joint_state() -> JointState:
    """Vehicles 1 and 2 and their pair, all correlated."""
    rng = np.random.default_rng(5)
    joint = JointState()
    other = MEAN + np.array([300.0, 200.0, 40.0, *rng.normal(size=13) * 0.1])
    for key, mean in ((1, MEAN), (2, other), (pair_key(1, 2, 0), np.array([0.2, -0.1]))):
        joint.augment(key, mean, np.eye(len(mean)), 0.0)
    root = rng.normal(size=(34, 34)) * 0.1
    joint.A[1:, 1:] = root @ root.T + 1e-4 * np.eye(34)
    return joint


def parts(joint: JointState) -> tuple[np.ndarray, np.ndarray]:
    return joint.A[0, 1:].copy(), joint.A[1:, 1:].copy()


def test_a_position_report_measures_position_with_its_error_and_velocity():
    joint = joint_state()
    x, P = parts(joint)
    m = PositionMeasurement(1, 0.0, 0.0, (101.0, -51.0, 79.0), 2.0, 3.0, (17.0, 9.5, 0.0), 0.4)
    linear = position_report(joint, m, (0.5, 0.8), 0.25)
    H = np.zeros((6, 34))
    H[:3, 0:3] = H[:3, 11:14] = H[3:, 3:6] = np.eye(3)
    # Four reports a second of a velocity error that is correlated over one: a quarter of the information each.
    R = np.diag([0.25, 0.25, 0.64, *[0.16 * 4.0] * 3])
    innovation = np.array([*m.position_enu_m, 17.0, 9.5, 0.0]) - H @ x
    np.testing.assert_allclose(linear.HA, np.column_stack([-innovation, H @ P]))
    joint.correct(whiten(linear.HA, linear.innovation_covariance(linear.R)).W)
    corrected = reference.correct(x, P, innovation, H, R)
    np.testing.assert_allclose(joint.A[0, 1:], corrected[0])
    np.testing.assert_allclose(joint.A[1:, 1:], corrected[1], atol=1e-9)


def test_an_altitude_measures_height_with_its_error():
    joint = joint_state()
    x, P = parts(joint)
    HA, innovation, variance = altitude(joint, AltitudeMeasurement(1, 0.0, 0.0, 83.0, 1.0), 0.3)
    H = np.zeros(34)
    H[2] = H[10] = 1.0
    assert innovation == pytest.approx(83.0 - H @ x)
    assert variance == pytest.approx(H @ P @ H + 0.09)
    np.testing.assert_allclose(HA[1:], H @ P)
    joint.correct_scalar(HA, variance)
    corrected = reference.correct(x, P, np.array([innovation]), H[np.newaxis], np.array([[0.09]]))
    np.testing.assert_allclose(joint.A[0, 1:], corrected[0])
    np.testing.assert_allclose(joint.A[1:, 1:], corrected[1], atol=1e-9)


@pytest.mark.parametrize("known", [True, False])
def test_air_data_measure_speed_and_course_of_the_air_velocity(known):
    joint = joint_state()
    if not known:
        joint.covariance(1)[3:6, 3:6] += 400.0 * np.eye(3)
    x, P = parts(joint)
    heading = math.atan2(15.0, 11.0)
    m = AttitudeMeasurement(1, 0.0, 0.0, 0.1, 0.05, heading + (0.05 if known else 0.0), 19.0)
    linear = air_velocity(joint, m, 19.0, 0.5, FleetSettings(), noise_level=2.0)
    V = 19.0 * math.cos(0.05)

    def h(x: np.ndarray) -> np.ndarray:
        e, n = x[3:5] - x[6:8]
        # The course is scaled by a speed that is held at the point of linearisation.
        return np.array([math.hypot(e, n) + x[8], scale * (math.atan2(e, n) + x[9])])

    speed = math.hypot(15.0, 11.0)
    scale = speed if known else V
    innovation = np.array([V, scale * m.yaw_rad]) - h(x)
    np.testing.assert_allclose(linear.HA[:, 0], -innovation, atol=1e-9)
    s = FleetSettings()
    np.testing.assert_allclose(linear.R, [2.0 * s.air_noise_mps**2 * s.air_noise_time_s / 0.5] * 2)
    H = reference.numerical_jacobian(h, x)
    if not known:
        # Linearised at the measured airspeed, not at the speed of the state.
        H[1, [3, 4, 6, 7]] *= speed / V
    np.testing.assert_allclose(linear.HA[:, 1:], H @ P, atol=1e-6)


@pytest.mark.parametrize("lever_arms", [(0.0, 0.0, 0.0), (20.0, -30.0, 5.0)])
@pytest.mark.parametrize("clock_of", [None, 1, 2])
def test_a_range_is_the_distance_with_its_errors_of_second_order(clock_of, lever_arms):
    joint = joint_state()
    x, P = parts(joint)
    ends = [
        RangeEnd(v, joint.where[v], tuple(reference.position(b)), tuple(b[3:6]), float(b[14]))
        for v, b in ((1, x[:16]), (2, x[16:32]))
    ]
    m = RangeMeasurement(1, 2, 0.0, 0.0, 365.0, 1.0, clock_of=clock_of, offset_enu_m=lever_arms)
    linear = slant_range(joint, (ends[0], ends[1]), joint.where[pair_key(1, 2, 0)].start, m, 0.49, 0.01)
    assert linear is not None
    d = reference.position(x[:16]) - reference.position(x[16:32]) - lever_arms
    distance = float(np.linalg.norm(d))
    closing = float((d / distance) @ (x[3:6] - x[19:22]))

    def h(x: np.ndarray) -> np.ndarray:
        d = reference.position(x[:16]) - reference.position(x[16:32]) - lever_arms
        late_s = {None: 0.0, 1: x[14], 2: x[30]}[clock_of]
        return np.array([np.linalg.norm(d) + x[32] + x[33] + closing * late_s])

    H = reference.numerical_jacobian(h, x)
    D = reference.numerical_jacobian(lambda x: reference.position(x[:16]) - reference.position(x[16:32]), x)
    longer, spread = reference.second_order(d / distance, distance, D @ P @ D.T)
    assert linear.unit == pytest.approx(d / distance)
    assert linear.innovation_m == pytest.approx(365.0 - h(x)[0] - longer)
    assert linear.variance_m2 == pytest.approx((H @ P @ H.T)[0, 0] + spread + 0.49 + (closing * 0.01) ** 2)
    np.testing.assert_allclose(linear.HA[1:], (H @ P)[0], atol=1e-6)


def test_a_range_between_two_vehicles_at_one_place_has_no_direction():
    joint = joint_state()
    end = RangeEnd(1, joint.where[1], (1.0, 2.0, 3.0))
    assert (
        slant_range(
            joint, (end, end), joint.where[pair_key(1, 2, 0)].start, RangeMeasurement(1, 2, 0.0, 0.0, 1.0, 1.0), 1.0, 0.01
        )
        is None
    )
