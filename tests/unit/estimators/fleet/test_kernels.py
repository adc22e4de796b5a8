"""The unrolled code gives what the plain matrices of `reference` give."""

import numpy as np
import pytest

from gcs_coloc.estimators.fleet.ekf._kernels import RangeEnd, Transition, range_jacobian
from gcs_coloc.estimators.fleet.ekf.state import JointState
from tests.unit.estimators.fleet import reference


@pytest.mark.parametrize("in_wind", [True, False])
@pytest.mark.parametrize(("step_s", "omega"), [(0.5, 0.3), (0.02, -0.7), (1.3, 1e-3), (-0.4, 0.2), (0.5, 1e-5)])
def test_the_transition_is_that_of_the_plain_matrices(step_s, omega, in_wind):
    x = np.random.default_rng(1).normal(size=16) * 10.0
    kernel, F = Transition(), reference.transition(step_s, omega, in_wind=in_wind)
    mean = kernel.set_motion(x.tolist(), step_s, omega, in_wind=in_wind)
    # An angle below 1e-4 is expanded to first order.
    np.testing.assert_allclose(kernel.F, F, atol=1e-9)
    np.testing.assert_allclose(mean, (F @ x)[:5], atol=1e-7)


def test_the_process_noise_is_that_of_the_plain_matrices():
    kernel, rng = Transition(), np.random.default_rng(2)
    times_s, sigmas = rng.uniform(0.5, 100.0, 6), rng.uniform(0.01, 5.0, 8)
    kernel.set_acceleration_noise(0.7, 0.4, 0.03)
    kernel.set_gauss_markov(0.7, times_s.tolist(), sigmas.tolist())
    decay, variances = reference.gauss_markov(0.7, times_s, sigmas)
    np.testing.assert_allclose(kernel.Q, reference.acceleration_noise(0.7, 0.4, 0.03) + np.diag([*[0.0] * 6, *variances]))
    np.testing.assert_allclose(np.diag(kernel.F)[6:], decay)


@pytest.mark.parametrize("anchor", [True, False])
def test_the_range_jacobian_is_the_derivative_of_the_vector_between_both_ends(anchor):
    rng = np.random.default_rng(3)
    x = rng.normal(size=16 + (3 if anchor else 16)) * 5.0
    x[14], unit = 0.03, np.array([0.6, 0.0, -0.8])

    def difference(x: np.ndarray) -> np.ndarray:
        d = reference.position(x[:16]) - reference.position(x[16:])
        return np.array([unit @ d, *d])

    blocks = x[:16], x[16:]
    ends = [
        RangeEnd(
            k,
            slice(1 + 16 * k, 1 + 16 * k + len(block)),
            tuple(reference.position(block)),
            tuple(block[3:6]) if len(block) == 16 else (0.0, 0.0, 0.0),
            float(block[14]) if len(block) == 16 else None,
        )
        for k, block in enumerate(blocks)
    ]
    jacobian = range_jacobian(1 + len(x), ends[0], ends[1], tuple(unit))
    np.testing.assert_array_equal(jacobian[:, 0], 0.0)
    np.testing.assert_allclose(jacobian[:, 1:], reference.numerical_jacobian(difference, x), atol=1e-8)


def test_the_decay_of_a_pair_is_that_of_the_plain_matrices():
    rng = np.random.default_rng(4)
    root = rng.normal(size=(5, 5))
    x, P = rng.normal(size=5), root @ root.T
    joint = JointState()
    for key, where in (("vehicle", slice(0, 3)), ("pair", slice(3, 5))):
        joint.augment(key, x[where], P[where, where], 0.0)
    joint.A[1:, 1:] = P
    joint.decay("pair", (0.9, 0.5), (0.1, 2.0))
    F = np.diag([1.0, 1.0, 1.0, 0.9, 0.5])
    Q = np.diag([0.0, 0.0, 0.0, 0.1**2 * (1.0 - 0.9**2), 2.0**2 * (1.0 - 0.5**2)])
    np.testing.assert_allclose(joint.A[1:, 1:], F @ P @ F.T + Q)
    np.testing.assert_allclose(joint.A[0, 1:], F @ x)
