"""Trilateration: a position from three ranges in the plane, with its covariance.

Source: Qu & Zhang, Eq. 16-26.

With peers at (x_i, y_i), ranges rho_i and A = X^2 + Y^2, the three circles are linear in (X, Y, A):

    [-2 x_i, -2 y_i, 1] [X, Y, A]' = M_i = rho_i^2 - x_i^2 - y_i^2,   i = 1, 2, 3.

The inverse of that matrix H is written with the barycentric coordinates lambda_i of the peers' triangle, which gives the same
numbers without an inversion: the rows of H^-1 for X and Y are -1/2 times the gradients of lambda_i.

All functions take stacks of geometries in their leading dimensions. Collinear peers give infinite or NaN results, never an error:
ask `flatness` first. Their arguments:

- `centres` (..., 3, 2): the peers, m; `centre_covariances` (..., 3, 2, 2): of these, m^2, independent of each other.
- `squared_ranges` (..., 3), m^2: horizontal. Squares, because a slant range less a height difference is one directly.
- `squared_range_covariance` (..., 3, 3): of these, m^4; for plane, independent ranges diag(4 rho_i^2 sigma_i^2).
- `position` (..., 2): where to linearise, m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import FloatArray, RangeMeasurement, Residual
from gcs_coloc.estimators.qu_zhang.track import UNKNOWN_SPEED_SIGMA_MPS, PeerTrack


def barycentric_gradients(points: FloatArray) -> FloatArray:
    """Return d lambda_i / dx and d lambda_i / dy, (..., 2, 3), of a triangle's corners (..., 3, 2)."""
    x, y = points[..., 0], points[..., 1]
    following, preceding = [1, 2, 0], [2, 0, 1]
    edge_x = x[..., preceding] - x[..., following]
    edge_y = y[..., following] - y[..., preceding]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.asarray(np.stack([edge_y, edge_x], axis=-2) / _doubled_area(points)[..., np.newaxis, np.newaxis])


def gains(centres: FloatArray) -> FloatArray:
    """Return the fix's move per m^2 in each squared range, 1/m: two rows of H^-1, (..., 2, 3)."""
    return np.asarray(-0.5 * barycentric_gradients(centres))


def trilaterate(centres: FloatArray, squared_ranges: FloatArray) -> FloatArray:
    """Return the position (..., 2), m, from three squared horizontal ranges (Eq. 16-22)."""
    # The origin is free; the peers' centroid keeps the squares small.
    origin = centres.mean(axis=-2)
    relative = centres - origin[..., np.newaxis, :]
    right_side = squared_ranges - (relative**2).sum(axis=-1)
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(origin + (gains(centres) @ right_side[..., np.newaxis])[..., 0])


def flatness(centres: FloatArray) -> FloatArray:
    """Return the height of the peers' triangle over its longest side.

    It is 0 for collinear peers and 0.87 for an equilateral triangle. It is the conditioning of H made independent of units and of
    the origin.
    """
    longest_squared = (_sides(centres) ** 2).sum(axis=-1).max(axis=-1)
    return np.asarray(np.abs(_doubled_area(centres)) / np.maximum(longest_squared, np.finfo(np.float64).tiny))


def triangle_height_m(centres: FloatArray) -> FloatArray:
    """Return the shortest height of the peers' triangle, m: shape (...) from (..., 3, 2)."""
    return np.asarray(flatness(centres) * np.sqrt((_sides(centres) ** 2).sum(axis=-1).max(axis=-1)))


def misclosure_covariance(
    centres: FloatArray, position: FloatArray, squared_range_covariance: FloatArray, centre_covariances: FloatArray
) -> FloatArray:
    """Return the first-order covariance (..., 3, 3) of the three circle equations' misclosures, m^4.

    A peer that is off by delta shifts its equation by 2 (X - x_i)' delta.
    """
    offsets = position[..., np.newaxis, :] - centres
    from_peers = 4.0 * np.einsum("...ij,...ijk,...ik->...i", offsets, centre_covariances, offsets)
    return np.asarray(squared_range_covariance + from_peers[..., np.newaxis] * np.eye(3))


def corrected_covariance(
    centres: FloatArray, position: FloatArray, squared_range_covariance: FloatArray, centre_covariances: FloatArray
) -> FloatArray:
    """Return the first-order covariance (..., 2, 2) of `trilaterate`, m^2, range noise included.

    For plane ranges it is the east-north block of H^-1 diag(4 rho_i^2 (sigma_i^2 + u_i' P_i u_i)) H^-T. It is singular where
    the trilateration is: for collinear peers.
    """
    misclosures = misclosure_covariance(centres, position, squared_range_covariance, centre_covariances)
    solution = gains(centres)
    with np.errstate(invalid="ignore", over="ignore"):
        covariance = solution @ misclosures @ np.swapaxes(solution, -1, -2)
        return np.asarray(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))


def published_covariance(centres: FloatArray, position: FloatArray, variances: FloatArray) -> FloatArray:
    """Return the paper's covariance (..., 2, 2) of the fix: diag(A11, A22), m^2 (Eq. 23-26, 32).

    The error equation there has the rows [u_i, 1] with a clock bias that ranges between vehicles do not have, so that it is
    singular where two peers are seen in one direction and not where the trilateration is: it can be far from the real error.
    Kept for comparison with the paper. `variances` (..., 3) are s_i^2, m^2: in the paper those of the peers' filters alone,
    without the range noise.
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
    it is not tells of a wrong range even when nothing else is known of the vehicle. Returned are A - X^2 - Y^2 (...), m^2, and
    its first-order variance (...), m^4; its square over that is a NIS with one degree of freedom. `fix` is what `trilaterate`
    made of the ranges.
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


@dataclass(frozen=True, slots=True)
class Circle:
    """One range, brought to the epoch and to the horizontal plane.

    `centre_m` (2,) is the peer, shifted by what the vehicle moves between the range and the epoch; `centre_covariance` (2, 2),
    m^2, is that of the centre. `height_m` is the vehicle's height above the peer, `height_variance_m2` the peer's part of its
    variance. `lasting_covariance` (3, 3), m^2, is the part of the peer's error that stays from epoch to epoch.
    """

    peer: int
    centre_m: FloatArray
    centre_covariance: FloatArray
    range_m: float
    range_sigma_m: float
    height_m: float
    height_variance_m2: float
    lasting_covariance: FloatArray

    @property
    def squared_m2(self) -> float:
        """The squared horizontal range, m^2; noise can make that of a peer overhead negative."""
        return self.range_m**2 - self.height_m**2

    @property
    def squared_variance_m4(self) -> float:
        """Variance of the squared horizontal range, m^4, from the range and the peer's height.

        It includes the second order, which matters for a peer overhead.
        """
        return (
            4.0 * self.range_m**2 * self.range_sigma_m**2
            + 2.0 * self.range_sigma_m**4
            + 4.0 * self.height_m**2 * self.height_variance_m2
            + 2.0 * self.height_variance_m2**2
        )


def make_circle(
    peer: int, measurement: RangeMeasurement, peer_track: PeerTrack, own_track: PeerTrack, at_s: float, lasting: bool
) -> Circle:
    """Return the circle that one range puts the vehicle on at the time `at_s` of its epoch.

    The peer is taken where it was when the range was measured; the circle's centre then moves along with the vehicle's own
    predicted displacement until `at_s`, and the velocity's uncertainty over that time widens the centre's. Both tracks must have
    a vertical filter, the peer's a horizontal one too; ValueError otherwise. `lasting` is whether the peer's
    position error lasts from epoch to epoch.
    """
    if peer_track.horizontal is None or peer_track.vertical is None or own_track.vertical is None:
        raise ValueError("a circle needs the peer's position and the vehicle's height")
    then_s = measurement.measured_at_s
    peer_state, peer_covariance = peer_track.horizontal.predicted(then_s)
    peer_height, peer_height_covariance = peer_track.vertical.predicted(then_s)
    own_height, _ = own_track.vertical.predicted(then_s)
    velocity, velocity_covariance = np.zeros(2), UNKNOWN_SPEED_SIGMA_MPS**2 * np.eye(2)
    if own_track.horizontal is not None:
        own_state, own_covariance = own_track.horizontal.predicted(at_s)
        velocity, velocity_covariance = own_state[[1, 3]], own_covariance[np.ix_([1, 3], [1, 3])]
    elapsed_s = at_s - then_s
    e, n, u = measurement.virtual_end(peer, (peer_state.item(0), peer_state.item(2), peer_height.item(0)))
    variances = np.array([peer_track.sigma_h_m, peer_track.sigma_h_m, peer_track.sigma_v_m]) ** 2
    return Circle(
        peer=peer,
        centre_m=np.array([e, n]) + velocity * elapsed_s,
        centre_covariance=peer_covariance[np.ix_([0, 2], [0, 2])] + velocity_covariance * elapsed_s**2,
        range_m=measurement.range_m,
        range_sigma_m=measurement.sigma_m,
        height_m=own_height.item(0) - u,
        height_variance_m2=float(peer_height_covariance[0, 0]) + (peer_track.sigma_v_m**2 if lasting else 0.0),
        lasting_covariance=np.diag(variances) if lasting else np.zeros((3, 3)),
    )


def range_residual(
    vehicle: int,
    circle: Circle,
    predicted: tuple[FloatArray, FloatArray],
    height_variance_m2: float,
    measured_at_s: float,
    refused: str | None,
) -> Residual:
    """Return the residual of one range against the vehicle's predicted state at the epoch.

    `predicted` is the state (4,) and its covariance (4, 4), `height_variance_m2` that of the vehicle's own height.
    """
    state, covariance = predicted
    offset = np.array([*(state[[0, 2]] - circle.centre_m), circle.height_m])
    distance_m = float(np.linalg.norm(offset))
    unit = offset / max(distance_m, 1e-9)
    spread = covariance[np.ix_([0, 2], [0, 2])] + circle.centre_covariance + circle.lasting_covariance[:2, :2]
    up_m2 = circle.height_variance_m2 + height_variance_m2
    variance = float(unit[:2] @ spread @ unit[:2]) + unit[2] ** 2 * up_m2 + circle.range_sigma_m**2
    innovation_m = circle.range_m - distance_m
    return Residual(
        from_vehicle=vehicle,
        to_vehicle=circle.peer,
        measured_at_s=measured_at_s,
        innovation_m=innovation_m,
        sigma_m=math.sqrt(variance),
        nis=innovation_m**2 / variance,
        degrees_of_freedom=1,
        refused=refused,
    )
