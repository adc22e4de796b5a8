from __future__ import annotations

import numpy as np

from gcs_coloc.estimators.fleet_joint import Joint, whiten


def walk(step_s: float) -> tuple[np.ndarray, np.ndarray]:
    F = np.array([[1.0, step_s], [0.0, 1.0]])
    Q = 0.7 * np.array([[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]])
    return F, Q


def step(joint: Joint, key: str, at_s: float) -> None:
    F, Q = walk(at_s - joint.time_s[key])
    joint.transform(key, F @ joint.x[joint.slice(key)], F, Q, at_s)


def two_walkers() -> tuple[Joint, np.random.Generator]:
    rng = np.random.default_rng(4)
    joint = Joint()
    for key in ("a", "b"):
        root = rng.normal(size=(2, 2))
        joint.append(key, rng.normal(size=2), root @ root.T + np.eye(2), 0.0)
    return joint, rng


def textbook(x: np.ndarray, P: np.ndarray, H: np.ndarray, R: float, z: float) -> tuple[np.ndarray, np.ndarray]:
    S = H @ P @ H.T + R
    K = P @ H.T / S
    A = np.eye(len(x)) - K @ H
    return x + K[:, 0] * (z - float((H @ x)[0])), A @ P @ A.T + R * K @ K.T


def test_blocks_at_their_own_times_give_what_the_synchronous_filter_gives():
    joint, rng = two_walkers()
    x, P = joint.x.copy(), joint.P.copy()
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
        PHt = joint.P @ H.T
        joint.update(PHt, whiten(H @ PHt + 0.3, np.array([z - float((H @ joint.x)[0])])))
        if not only_a:
            np.testing.assert_allclose(joint.x, x, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(joint.P, P, rtol=1e-8, atol=1e-9)


def test_scalar_update_equals_block_update():
    joint, _ = two_walkers()
    other = joint.copy()
    H = np.array([1.0, 0.2, -1.0, 0.1])
    PHt = joint.P @ H
    variance = float(H @ PHt) + 0.5
    joint.update_scalar(PHt, variance, 0.8)
    other.update(PHt[:, np.newaxis], whiten(np.array([[variance]]), np.array([0.8])))
    np.testing.assert_allclose(joint.x, other.x, rtol=1e-12)
    np.testing.assert_allclose(joint.P, other.P, rtol=1e-12, atol=1e-14)


def test_a_whitened_innovation_is_of_unit_variance():
    S, innovation = np.array([[2.0, 0.3], [0.3, 1.0]]), np.array([0.5, -1.2])
    white = whiten(S, innovation)
    np.testing.assert_allclose(white.inverse_root @ S @ white.inverse_root.T, np.eye(2), atol=1e-14)
    np.testing.assert_allclose(white.nis, innovation @ np.linalg.inv(S) @ innovation)


def test_a_part_is_the_marginal_and_a_copy_is_independent():
    joint, _ = two_walkers()
    part = joint.part(["b"])
    copy = joint.copy()
    step(copy, "b", 1.0)
    np.testing.assert_array_equal(part.P, joint.P[2:, 2:])
    np.testing.assert_array_equal(part.x, joint.x[2:])
    assert joint.time_s == {"a": 0.0, "b": 0.0}
    assert not np.allclose(copy.P, joint.P)


def test_joined_densities_are_independent():
    first, _ = two_walkers()
    second = first.part(["b"])
    first = first.part(["a"])
    first.join(second)
    assert first.slice("b") == slice(2, 4)
    assert not first.P[:2, 2:].any()
