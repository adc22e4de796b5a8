"""Trilateration: a position from three ranges in the plane, with its covariance (Qu & Zhang, Eq. 16-26).

With peers at (x_i, y_i), ranges rho_i and A = X^2 + Y^2, the three circles are linear in (X, Y, A):

    [-2 x_i, -2 y_i, 1] [X, Y, A]' = M_i = rho_i^2 - x_i^2 - y_i^2,   i = 1, 2, 3.

The inverse of that matrix H is written with the barycentric coordinates lambda_i of the peers' triangle, which gives the same
numbers without an inversion: the rows of H^-1 for X and Y are -1/2 times the gradients of lambda_i. All functions take stacks of
geometries in their leading dimensions. Collinear peers give infinite or NaN results, never an error: ask `flatness` first.
"""

from __future__ import annotations

import numpy as np

from gcs_coloc.core.measurements import FloatArray


def barycentric_gradients(points: FloatArray) -> FloatArray:
    """Return how the barycentric coordinates of a triangle change with position.

    Args:
        points: shape (..., 3, 2), the corners.

    Returns:
        shape (..., 2, 3): d lambda_i / dx in the first row, d lambda_i / dy in the second; not finite
        for a triangle without area.

    """
    x, y = points[..., 0], points[..., 1]
    following, preceding = [1, 2, 0], [2, 0, 1]
    edge_x = x[..., preceding] - x[..., following]
    edge_y = y[..., following] - y[..., preceding]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.asarray(np.stack([edge_y, edge_x], axis=-2) / _doubled_area(points)[..., np.newaxis, np.newaxis])


def gains(centres: FloatArray) -> FloatArray:
    """Return the first two rows of H^-1, shape (..., 2, 3), 1/m: the move of the fix per m^2 in each squared range."""
    return np.asarray(-0.5 * barycentric_gradients(centres))


def trilaterate(centres: FloatArray, squared_ranges: FloatArray) -> FloatArray:
    """Return the position from three squared horizontal ranges (Eq. 16-22).

    Args:
        centres: shape (..., 3, 2), the peers, m.
        squared_ranges: shape (..., 3), m^2. Squares, because a slant range less a height difference is one directly.

    Returns:
        shape (..., 2), m.

    """
    # The origin is free; the peers' centroid keeps the squares small.
    origin = centres.mean(axis=-2)
    relative = centres - origin[..., np.newaxis, :]
    right_side = squared_ranges - (relative**2).sum(axis=-1)
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(origin + (gains(centres) @ right_side[..., np.newaxis])[..., 0])


def flatness(centres: FloatArray) -> FloatArray:
    """Return the height of the peers' triangle over its longest side: 0 for collinear peers, 0.87 for an equilateral triangle.

    It is the conditioning of H made independent of units and of the origin.

    Args:
        centres: shape (..., 3, 2), m.

    Returns:
        shape (...).

    """
    longest_squared = (_sides(centres) ** 2).sum(axis=-1).max(axis=-1)
    return np.asarray(np.abs(_doubled_area(centres)) / np.maximum(longest_squared, np.finfo(np.float64).tiny))


def triangle_height_m(centres: FloatArray) -> FloatArray:
    """Return the shortest height of the peers' triangle, m: shape (...) from (..., 3, 2)."""
    return np.asarray(flatness(centres) * np.sqrt((_sides(centres) ** 2).sum(axis=-1).max(axis=-1)))


def misclosure_covariance(
    centres: FloatArray, position: FloatArray, squared_range_covariance: FloatArray, centre_covariances: FloatArray
) -> FloatArray:
    """Return the first-order covariance of the three circle equations' misclosures, m^4.

    A peer that is off by delta shifts its equation by 2 (X - x_i)' delta.

    Args:
        centres: shape (..., 3, 2), the peers, m.
        position: shape (..., 2), where to linearise, m.
        squared_range_covariance: shape (..., 3, 3), of the squared horizontal ranges, m^4. For plane, independent ranges it is
            diag(4 rho_i^2 sigma_i^2).
        centre_covariances: shape (..., 3, 2, 2), of the peers' positions, m^2, independent of each other.

    Returns:
        shape (..., 3, 3).

    """
    offsets = position[..., np.newaxis, :] - centres
    from_peers = 4.0 * np.einsum("...ij,...ijk,...ik->...i", offsets, centre_covariances, offsets)
    return np.asarray(squared_range_covariance + from_peers[..., np.newaxis] * np.eye(3))


def corrected_covariance(
    centres: FloatArray, position: FloatArray, squared_range_covariance: FloatArray, centre_covariances: FloatArray
) -> FloatArray:
    """Return the first-order covariance of `trilaterate` itself, with range noise and cross terms.

    For plane ranges it is the east-north block of H^-1 diag(4 rho_i^2 (sigma_i^2 + u_i' P_i u_i)) H^-T. It is singular where
    the trilateration is: for collinear peers.

    Args:
        centres: shape (..., 3, 2), the peers, m.
        position: shape (..., 2), where to linearise, m.
        squared_range_covariance: shape (..., 3, 3), m^4, as for `misclosure_covariance`.
        centre_covariances: shape (..., 3, 2, 2), m^2.

    Returns:
        shape (..., 2, 2), m^2.

    """
    misclosures = misclosure_covariance(centres, position, squared_range_covariance, centre_covariances)
    solution = gains(centres)
    with np.errstate(invalid="ignore", over="ignore"):
        covariance = solution @ misclosures @ np.swapaxes(solution, -1, -2)
        return np.asarray(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))


def published_covariance(centres: FloatArray, position: FloatArray, variances: FloatArray) -> FloatArray:
    """Return the diagonal covariance that the paper gives the fix, to the letter (Eq. 23-26 and 32).

    The error equation there has the rows [u_i, 1] with a clock bias that ranges between vehicles do not have, so that it is
    singular where two peers are seen in one direction and not where the trilateration is: it can be far from the real error.
    Kept for comparison with the paper.

    Args:
        centres: shape (..., 3, 2), the peers, m.
        position: shape (..., 2), the predicted position, m.
        variances: shape (..., 3), s_i^2, m^2: in the paper those of the peers' filters alone, without the range noise.

    Returns:
        shape (..., 2, 2), m^2: diag(A11, A22).

    """
    offsets = position[..., np.newaxis, :] - centres
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        units = offsets / np.linalg.norm(offsets, axis=-1, keepdims=True)
        # The inverse of rows [u_i, 1] is that of the triangle that the three u_i form.
        diagonal = (barycentric_gradients(units) ** 2 * variances[..., np.newaxis, :]).sum(axis=-1)
        return np.asarray(diagonal[..., np.newaxis] * np.eye(2))


def misclosure(
    centres: FloatArray, squared_ranges: FloatArray, fix: FloatArray, misclosure_covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return what three circles leave over when they do not meet in one point, and its variance.

    Three ranges determine two coordinates: the third unknown A of the linear equations ought to be X^2 + Y^2, and by how much
    it is not tells of a wrong range even when nothing else is known of the vehicle.

    Args:
        centres: shape (..., 3, 2), m.
        squared_ranges: shape (..., 3), m^2.
        fix: shape (..., 2), what `trilaterate` made of them, m.
        misclosure_covariance: shape (..., 3, 3), from `misclosure_covariance`, m^4.

    Returns:
        A - X^2 - Y^2, shape (...), m^2, and its first-order variance, shape (...), m^4: their ratio is a NIS with one degree
        of freedom.

    """
    relative = centres - fix[..., np.newaxis, :]
    gradients = barycentric_gradients(centres)
    # lambda_i at the fix: affine in position, one third each at the centroid.
    weights = 1.0 / 3.0 - np.einsum("...ai,...a->...i", gradients, relative.mean(axis=-2))
    left_over = squared_ranges - (relative**2).sum(axis=-1)
    value = (weights * left_over).sum(axis=-1)
    variance = np.einsum("...i,...ij,...j->...", weights, misclosure_covariance, weights)
    return np.asarray(value), np.asarray(variance)


def _sides(centres: FloatArray) -> FloatArray:
    return np.asarray(centres - np.roll(centres, 1, axis=-2))


def _doubled_area(points: FloatArray) -> FloatArray:
    """Return twice the signed area of the triangle, shape (...)."""
    a = points[..., 1, :] - points[..., 0, :]
    b = points[..., 2, :] - points[..., 0, :]
    return np.asarray(a[..., 0] * b[..., 1] - b[..., 0] * a[..., 1])
