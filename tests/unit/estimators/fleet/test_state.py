from __future__ import annotations

import numpy as np

from gcs_coloc.estimators.fleet.ekf.state import JointState, whiten


def walk(step_s: float) -> tuple[np.ndarray, np.ndarray]:
    F = np.array([[1.0, step_s], [0.0, 1.0]])
    Q = 0.7 * np.array([[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]])
    return F, Q


def step(joint: JointState, key: str, at_s: float) -> None:
    F, Q = walk(at_s - joint.time_s[key])
    joint.propagate(key, tuple((F @ joint.mean(key)).tolist()), F, Q, at_s)


def whole(joint: JointState) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of all states, the mean the same in row and column."""
    np.testing.assert_array_equal(joint.A[0, 1:], joint.A[1:, 0])
    return joint.A[0, 1:].copy(), joint.A[1:, 1:].copy()


def measured(joint: JointState, H: np.ndarray, z: np.ndarray) -> np.ndarray:
    """What `whiten` takes of values z that measure H x."""
    x, P = whole(joint)
    return np.column_stack([H @ x - z, H @ P])


def two_walkers() -> tuple[JointState, np.random.Generator]:
    rng = np.random.default_rng(4)
    joint = JointState()
    for key in ("a", "b"):
        root = rng.normal(size=(2, 2))
        joint.augment(key, rng.normal(size=2), root @ root.T + np.eye(2), 0.0)
    return joint, rng


def textbook(x: np.ndarray, P: np.ndarray, H: np.ndarray, R: float, z: float) -> tuple[np.ndarray, np.ndarray]:
    S = H @ P @ H.T + R
    K = P @ H.T / S
    A = np.eye(len(x)) - K @ H
    return x + K[:, 0] * (z - float((H @ x)[0])), A @ P @ A.T + R * K @ K.T


def test_blocks_at_their_own_times_give_what_the_synchronous_filter_gives():
    joint, rng = two_walkers()
    x, P = whole(joint)
    H_range = np.array([[1.0, 0.0, -1.0, 0.0]])
    H_a = np.array([[1.0, 0.0, 0.0, 0.0]])
    now_s = 0.0
    for k in range(1, 40):
        step_s = float(rng.uniform(0.05, 0.5))
        now_s += step_s
        F1, Q1 = walk(step_s)
        F, Q = np.kron(np.eye(2), F1), np.kron(np.eye(2), Q1)
        x, P = F @ x, F @ P @ F.T + Q
        z = float(rng.normal())
        only_a = k % 4 != 0
        H = H_a if only_a else H_range
        x, P = textbook(x, P, H, 0.3, z)
        for key in ("a",) if only_a else ("a", "b"):
            step(joint, key, now_s)
        HA = measured(joint, H, np.array([z]))
        joint.correct(whiten(HA, HA[:, 1:] @ H.T + 0.3).W)
        if not only_a:
            np.testing.assert_allclose(whole(joint)[0], x, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(whole(joint)[1], P, rtol=1e-8, atol=1e-9)


def test_scalar_update_equals_block_update():
    joint, _ = two_walkers()
    other = joint.copy()
    H = np.array([[1.0, 0.2, -1.0, 0.1]])
    HA = measured(joint, H, np.array([0.8]))
    S = HA[:, 1:] @ H.T + 0.5
    np.testing.assert_allclose(joint.correct_scalar(HA[0], float(S[0, 0])), whiten(HA, S).W, rtol=1e-12)
    other.correct(whiten(HA, S).W)
    np.testing.assert_allclose(whole(joint)[0], whole(other)[0], rtol=1e-12)
    np.testing.assert_allclose(whole(joint)[1], whole(other)[1], rtol=1e-12, atol=1e-14)


def test_what_is_expected_of_a_block_is_the_mean_and_the_covariance_with_all():
    joint, rng = two_walkers()
    x, P = whole(joint)
    H = rng.normal(size=(3, 2))
    np.testing.assert_allclose(joint.predict_block_measurement("b", H), np.column_stack([H @ x[2:], H @ P[2:]]))


def test_a_whitened_measurement_has_innovations_of_unit_variance():
    joint, rng = two_walkers()
    H, z = rng.normal(size=(2, 4)), np.array([0.5, -1.2])
    HA = measured(joint, H, z)
    S = HA[:, 1:] @ H.T + np.eye(2)
    white = whiten(HA, S)
    np.testing.assert_allclose(white.nis, HA[:, 0] @ np.linalg.inv(S) @ HA[:, 0])
    np.testing.assert_allclose(white.nis, np.square(white.innovations()).sum())
    np.testing.assert_allclose(white.W @ white.W.T, HA.T @ np.linalg.inv(S) @ HA)


def test_a_part_is_the_marginal_and_a_copy_is_independent():
    joint, _ = two_walkers()
    part = joint.marginalise(["b"])
    copy = joint.copy()
    step(copy, "b", 1.0)
    np.testing.assert_array_equal(part.covariance("b"), joint.covariance("b"))
    np.testing.assert_array_equal(part.mean("b"), joint.mean("b"))
    assert len(part.A) == 3
    assert joint.time_s == {"a": 0.0, "b": 0.0}
    assert not np.allclose(copy.A, joint.A)


def test_joined_densities_are_independent():
    first, _ = two_walkers()
    second = first.marginalise(["b"])
    first = first.marginalise(["a"])
    first.augment_with(second)
    assert first.where["b"] == slice(3, 5)
    assert not first.A[1:3, 3:].any()
    np.testing.assert_array_equal(first.mean("b"), second.mean("b"))


def test_scaled_states_are_scaled_in_mean_and_covariances():
    joint, _ = two_walkers()
    x, P = whole(joint)
    joint.scale(2, 4, 0.5)
    D = np.diag([1.0, 0.5, 0.5, 1.0])
    np.testing.assert_allclose(whole(joint)[0], D @ x)
    np.testing.assert_allclose(whole(joint)[1], D @ P @ D)


def test_two_fading_states_keep_their_spread_and_lose_their_correlations():
    joint, _ = two_walkers()
    x, P = whole(joint)
    joint.decay("b", (0.9, 0.4), (2.0, 3.0))
    D = np.diag([1.0, 1.0, 0.9, 0.4])
    np.testing.assert_allclose(whole(joint)[0], D @ x)
    fresh = np.diag([0.0, 0.0, 4.0 * (1.0 - 0.81), 9.0 * (1.0 - 0.16)])
    np.testing.assert_allclose(whole(joint)[1], D @ P @ D + fresh)
    np.testing.assert_array_equal(joint.A, joint.A.T)
