import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from gcs_coloc.estimators.qu_zhang.trilateration import (
    barycentric_gradients,
    corrected_covariance,
    flatness,
    gains,
    misclosure,
    misclosure_covariance,
    published_covariance,
    triangle_height_m,
    trilaterate,
)

PEERS = np.array([[0.0, 0.0], [4000.0, 500.0], [1000.0, 3000.0]])
AT = np.array([2500.0, 1800.0])
coordinate = st.floats(-5000, 5000)
triangles = st.lists(st.tuples(coordinate, coordinate), min_size=3, max_size=3).map(np.array)


def squared_ranges(peers: np.ndarray, at: np.ndarray) -> np.ndarray:
    return ((peers - at) ** 2).sum(axis=-1)


def squared_range_covariance(peers: np.ndarray, at: np.ndarray, sigma: float) -> np.ndarray:
    return np.diag(4 * squared_ranges(peers, at) * sigma**2)


def matrix_of_equation_16(peers: np.ndarray) -> np.ndarray:
    return np.column_stack([-2 * peers, np.ones(3)])


def test_worked_by_hand() -> None:
    # Peers (0,0), (4,0), (0,4), vehicle (1,2): squared ranges 5, 13, 5. A = 5, -8X + A = -3, -8Y + A = -11.
    assert trilaterate(np.array([[0.0, 0], [4, 0], [0, 4]]), np.array([5.0, 13.0, 5.0])) == pytest.approx([1.0, 2.0])


def test_the_gains_are_the_inverse_of_the_papers_matrix() -> None:
    assert gains(PEERS) == pytest.approx(np.linalg.inv(matrix_of_equation_16(PEERS))[:2], rel=1e-9)


@given(triangles, st.tuples(coordinate, coordinate))
def test_exact_ranges_give_the_position_back(peers: np.ndarray, at: tuple[float, float]) -> None:
    assume(flatness(peers) > 1e-3 and triangle_height_m(peers) > 1.0)

    assert trilaterate(peers, squared_ranges(peers, np.array(at))) == pytest.approx(at, abs=1e-3)


def test_stacks_agree_with_one_by_one() -> None:
    peers = np.stack([PEERS, PEERS[::-1] + 70.0])
    ranges = np.stack([squared_ranges(one, AT) + 100.0 for one in peers])

    assert trilaterate(peers, ranges) == pytest.approx(np.stack([trilaterate(a, b) for a, b in zip(peers, ranges, strict=True)]))


def test_flatness_is_height_over_longest_side() -> None:
    assert flatness(np.array([[0.0, 0], [1, 0], [0.5, math.sqrt(0.75)]])) == pytest.approx(math.sqrt(0.75))
    assert flatness(np.array([[0.0, 0], [1000, 0], [400, 20]])) == pytest.approx(0.02)
    assert triangle_height_m(np.array([[0.0, 0], [1000, 0], [400, 20]])) == pytest.approx(20.0)
    assert flatness(np.array([[0.0, 0], [1000, 0], [400, 0]])) == 0.0
    assert flatness(np.zeros((3, 2))) == 0.0


@given(triangles, st.floats(0.01, 100))
def test_flatness_does_not_depend_on_units(peers: np.ndarray, scale: float) -> None:
    assume(triangle_height_m(peers) > 1e-3)

    assert flatness(peers * scale) == pytest.approx(flatness(peers), rel=1e-6)


def test_collinear_peers_do_not_raise() -> None:
    line = np.array([[0.0, 0], [1000, 0], [400, 0]])

    assert not np.isfinite(trilaterate(line, squared_ranges(line, AT))).all()


def test_the_covariance_is_the_formula_of_the_inverse() -> None:
    P = np.array([[[9.0, 2.0], [2.0, 4.0]], [[1.0, 0.0], [0.0, 25.0]], [[16.0, -3.0], [-3.0, 16.0]]])
    ours = corrected_covariance(PEERS, AT, squared_range_covariance(PEERS, AT, 20.0), P)
    rho = np.sqrt(squared_ranges(PEERS, AT))
    u = (AT - PEERS) / rho[:, np.newaxis]
    inverse = np.linalg.inv(matrix_of_equation_16(PEERS))
    middle = np.diag([4 * rho[i] ** 2 * (20.0**2 + u[i] @ P[i] @ u[i]) for i in range(3)])

    assert ours == pytest.approx((inverse @ middle @ inverse.T)[:2, :2], rel=1e-9)


def test_the_covariance_is_that_of_the_finite_differences() -> None:
    P = np.stack([np.diag([9.0, 4.0]), np.diag([1.0, 25.0]), np.diag([16.0, 1.0])])
    rho = np.sqrt(squared_ranges(PEERS, AT))
    step, covariance = 1e-3, np.zeros((2, 2))
    for i in range(3):
        moved = rho.copy()
        moved[i] += step
        column = (trilaterate(PEERS, moved**2) - AT) / step
        covariance += 20.0**2 * np.outer(column, column)
        for axis in range(2):
            peers = PEERS.copy()
            peers[i, axis] += step
            column = (trilaterate(peers, rho**2) - AT) / step
            covariance += P[i, axis, axis] * np.outer(column, column)

    assert corrected_covariance(PEERS, AT, squared_range_covariance(PEERS, AT, 20.0), P) == pytest.approx(covariance, rel=1e-4)


def test_the_covariance_is_that_of_many_fixes() -> None:
    # With n = 20,000 draws the sum of the normalised squares is chi-square with 2 n degrees of freedom: mean 2, standard
    # deviation 2 / sqrt(n) = 0.014. The band is 5 of these, the first order's own error at 20 m in kilometres included.
    rng, n = np.random.default_rng(3), 20_000
    P = np.array([[9.0, 2.0], [2.0, 4.0]])
    peers = PEERS + rng.multivariate_normal(np.zeros(2), P, (n, 3))
    ranges = np.sqrt(squared_ranges(PEERS, AT)) + rng.normal(0.0, 20.0, (n, 3))
    errors = trilaterate(peers, ranges**2) - AT
    covariance = corrected_covariance(PEERS, AT, squared_range_covariance(PEERS, AT, 20.0), np.stack([P] * 3))
    mean = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(covariance), errors).mean()

    assert mean == pytest.approx(2.0, abs=5 * 0.0142)


def test_the_misclosure_has_the_variance_it_states_and_is_zero_for_exact_ranges() -> None:
    # n = 20,000 draws: NIS with 1 degree of freedom, mean 1, standard deviation sqrt(2 / n) = 0.01; the band is 5 of these.
    rng, n = np.random.default_rng(4), 20_000
    exact = squared_ranges(PEERS, AT)
    ranges = np.sqrt(exact) + rng.normal(0.0, 20.0, (n, 3))
    peers = np.broadcast_to(PEERS, (n, 3, 2))
    fixes = trilaterate(peers, ranges**2)
    spread = misclosure_covariance(PEERS, AT, squared_range_covariance(PEERS, AT, 20.0), np.zeros((3, 2, 2)))
    value, variance = misclosure(peers, ranges**2, fixes, np.broadcast_to(spread, (n, 3, 3)))

    assert misclosure(PEERS, exact, AT, spread)[0] == pytest.approx(0.0, abs=1e-6)
    assert (value**2 / variance).mean() == pytest.approx(1.0, abs=0.05)


def test_the_misclosure_is_the_third_unknown_of_the_linear_equations() -> None:
    ranges = squared_ranges(PEERS, AT) * np.array([1.01, 0.98, 1.03])
    X, Y, A = np.linalg.solve(matrix_of_equation_16(PEERS), ranges - (PEERS**2).sum(axis=1))
    fix = trilaterate(PEERS, ranges)

    assert misclosure(PEERS, ranges, fix, np.eye(3))[0] == pytest.approx(A - X**2 - Y**2, rel=1e-6)


def test_the_published_covariance_is_the_papers_error_equation() -> None:
    variances = np.array([4.0, 9.0, 16.0])
    offsets = AT - PEERS
    H1 = np.column_stack([offsets / np.linalg.norm(offsets, axis=1, keepdims=True), np.ones(3)])
    A = np.linalg.inv(H1) @ np.diag(variances) @ np.linalg.inv(H1).T

    assert published_covariance(PEERS, AT, variances) == pytest.approx(np.diag([A[0, 0], A[1, 1]]), rel=1e-9)


def test_where_the_published_covariance_is_singular_the_fix_is_not() -> None:
    # Two peers in one direction, seen from the vehicle, and a proper triangle all the same.
    peers, at = np.array([[0.0, 1000.0], [0.0, 3000.0], [2000.0, 0.0]]), np.zeros(2)

    assert not np.isfinite(published_covariance(peers, at, np.ones(3))).all()
    assert np.isfinite(corrected_covariance(peers, at, np.eye(3), np.zeros((3, 2, 2)))).all()


@given(triangles)
def test_barycentric_gradients_sum_to_nothing_and_reproduce_the_plane(points: np.ndarray) -> None:
    assume(flatness(points) > 1e-3 and triangle_height_m(points) > 1.0)
    gradients = barycentric_gradients(points)

    assert gradients.sum(axis=1) == pytest.approx([0.0, 0.0], abs=1e-9)
    assert gradients @ points == pytest.approx(np.eye(2), abs=1e-6)
