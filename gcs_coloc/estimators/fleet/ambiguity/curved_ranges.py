"""Uncertainty that a denied vehicle's covariance leaves out where its ranges are curved, eq. (35).

It matters beside peers that are nearly on one line. A range across its own direction changes with the square of the offset from
the line of the peers. The filter takes the slope of that parabola where it believes the vehicle to be, and further out the slope
is steeper. So a vehicle that is believed too far out is believed too exactly: the true place fits the ranges much better than the
slope there tells.

Denied vehicles that range each other are too far out together. So those whose positions move with the vehicle's, by their
covariance, are moved with it, and their ranges count as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Integral
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.error_ellipse import error_ellipse
from gcs_coloc.core.measurements import FloatArray, Vector3
from gcs_coloc.estimators.fleet.ekf._kernels import RangeEnd
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.state import POSITION, pair_key

_STRAIGHT_SHARE = 0.1  # chosen: a slope that changes by less than this share within a sigma is as good as straight
_NEAR_SIGMAS = 2.0  # chosen: of the 95 % of one direction, which is what the ranges leave open
FAR_SIGMAS = 6.0
"""Chosen: a little more than the 5.7 of the nominal protection level."""
_MOST_SIGMAS = 20.0
"""Chosen: bounds the search; what is so much further out than stated, hypotheses or the limit of the estimate tell."""
_STEPS = 81  # chosen: steps of a quarter of a sigma
_MOVES_ALONG = 0.25  # chosen: another denied vehicle that moves by less of an offset is as any peer, with its uncertainty
_LEAST_DISTANCE_M = 1.0  # bounds the curvature of a range to a peer that is close
_STEP_SIGMAS = np.linspace(0.0, _MOST_SIGMAS, _STEPS)
_OFFSET_SIGMAS = np.concatenate([_STEP_SIGMAS, -_STEP_SIGMAS])

Horizontal = tuple[float, float]
"""East and north."""


class _Pair(NamedTuple):
    """A range in use between a vehicle that is moved, `own`, and its neighbour, `end`.

    The neighbour may stand still or be moved too. Its states are `behind_s` seconds older.
    """

    own: RangeEnd
    end: RangeEnd
    behind_s: float


def curvature_covariances(
    cluster: Cluster, vehicle: int, covariance: FloatArray, at_s: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return what curved ranges add to the horizontal covariance of a denied vehicle.

    These are two matrices (2, 2) in m^2. None means that the ranges add nothing. The first is for the 95 % bound, the second for
    the protection level, which looks further out. Along the worst direction an offset d costs d^2 / sigma^2 by the filter. What
    the ranges have in it, at the slopes of the estimate, is replaced by what they really come to at d, eq. (35).
    """
    peers = cluster.peers_in_use(vehicle, at_s)
    sigma_m, _, angle_rad = error_ellipse(covariance.item(0, 0), covariance.item(0, 1), covariance.item(1, 1))
    east, north = math.cos(angle_rad), math.sin(angle_rad)
    if not _are_curved(cluster, vehicle, peers, (east, north), sigma_m):
        return None
    near, far = _reach_sigmas(cluster, _moves(cluster, vehicle, (east, north)), at_s, sigma_m)
    near_m2, far_m2 = ((max(reach, 1.0) ** 2 - 1.0) * sigma_m * sigma_m for reach in (near / _NEAR_SIGMAS, far / FAR_SIGMAS))
    along = np.array([[east * east, east * north], [east * north, north * north]])
    return (near_m2 * along, far_m2 * along) if max(near_m2, far_m2) > 0.0 else None


def variance_across_m2(cluster: Cluster, vehicle: int, normal: FloatArray, at_s: float) -> float:
    """Return the variance along a unit normal (3,), m^2, with what curved ranges add for the 95 % bound."""
    covariance = cluster.joint.covariance(vehicle)[POSITION, POSITION]
    curved = curvature_covariances(cluster, vehicle, covariance, at_s)
    variance_m2 = float(normal @ covariance @ normal)
    return variance_m2 if curved is None else variance_m2 + float(normal[:2] @ curved[0] @ normal[:2])


def _moves(cluster: Cluster, vehicle: int, direction: Horizontal) -> dict[int, Horizontal]:
    """Return how far each denied vehicle moves per metre that one vehicle moves in a direction.

    The values are east and north, by the regression on the vehicle's position. Others that move by less than `_MOVES_ALONG` are
    left out.
    """
    joint = cluster.joint
    own = joint.where[vehicle].start
    P = joint.covariance(vehicle)[:2, :2]
    pull = np.linalg.solve(P, np.array(direction))
    moves = {vehicle: direction}
    for other, where in joint.where.items():
        if not isinstance(other, Integral) or other == vehicle or not cluster.records[other].denied_vehicle:
            continue
        e, n = (joint.A[where.start : where.start + 2, own : own + 2] @ pull).tolist()
        if math.hypot(e, n) >= _MOVES_ALONG:
            moves[other] = e, n
    return moves


def _are_curved(cluster: Cluster, vehicle: int, units: Mapping[int, Vector3], direction: Horizontal, sigma_m: float) -> bool:
    """Return whether the slopes of the ranges along a direction change within one sigma.

    They seldom do, so this cheap test comes first.
    """
    A, where = cluster.joint.A, cluster.joint.where
    own = where[vehicle].start
    e, n = A.item(0, own), A.item(0, own + 1)
    slopes2 = curvatures2 = 0.0
    for peer, (unit_e, unit_n, _) in units.items():
        at = where[peer].start
        slope = unit_e * direction[0] + unit_n * direction[1]
        distance_m = max(math.hypot(e - A.item(0, at), n - A.item(0, at + 1)), _LEAST_DISTANCE_M)
        slopes2 += slope * slope
        curvatures2 += ((1.0 - slope * slope) / distance_m) ** 2
    return sigma_m * sigma_m * curvatures2 > _STRAIGHT_SHARE * _STRAIGHT_SHARE * slopes2


def _reach_sigmas(cluster: Cluster, moves: Mapping[int, Horizontal], at_s: float, sigma_m: float) -> tuple[float, float]:
    """Return the offsets, in sigmas, whose costs are those of `_NEAR_SIGMAS` and `FAR_SIGMAS`.

    Each is the larger one of both sides. `moves` holds how far each vehicle moves per metre of the offset.
    """
    pairs = _pairs(cluster, moves, at_s)
    vectors_m = np.array([_vector_m(*pair) for pair in pairs])
    distances_m = np.maximum(np.sqrt((vectors_m * vectors_m).sum(axis=1)), _LEAST_DISTANCE_M)
    units = vectors_m / distances_m[:, np.newaxis]
    information = np.linalg.inv(_distance_covariance(cluster, pairs, units, moves))
    # The place of each along the other horizontal direction is what it has to be.
    for vehicle, (east, north) in moves.items():
        length = math.hypot(east, north)
        along = (units[:, 0] * -north + units[:, 1] * east) / length * _signs(pairs, vehicle)
        weighted = information @ along
        determined = float(along @ weighted)
        if determined > 0.0:
            information -= np.outer(weighted, weighted) / determined
    relative = np.array([np.subtract(moves[own.vehicle], moves.get(end.vehicle, (0.0, 0.0))) for own, end, _ in pairs])
    slopes = units[:, 0] * relative[:, 0] + units[:, 1] * relative[:, 1]
    by_slopes = float(slopes @ information @ slopes) * sigma_m * sigma_m
    share = min(1.0, 1.0 / by_slopes) if by_slopes > 0.0 else 0.0
    offsets_m = sigma_m * _OFFSET_SIGMAS[:, np.newaxis]
    lengths2 = (relative * relative).sum(axis=1)
    changes_m = np.sqrt(distances_m**2 + (2.0 * slopes * distances_m + lengths2 * offsets_m) * offsets_m) - distances_m
    by_ranges = ((changes_m @ information) * changes_m).sum(axis=1)
    costs = (1.0 - share * by_slopes) * _OFFSET_SIGMAS**2 + share * by_ranges
    sides = costs[: len(_STEP_SIGMAS)], costs[len(_STEP_SIGMAS) :]
    return max(_first_beyond(side, _NEAR_SIGMAS) for side in sides), max(_first_beyond(side, FAR_SIGMAS) for side in sides)


def _pairs(cluster: Cluster, moves: Mapping[int, Horizontal], at_s: float) -> list[_Pair]:
    """Return the ranges in use of the vehicles that move, each pair once."""
    time_s, pairs, done = cluster.joint.time_s, [], set[int]()
    for vehicle in moves:
        own = cluster.range_end(vehicle)
        others = [peer for peer in cluster.peers_in_use(vehicle, at_s) if peer not in done]
        pairs += [_Pair(own, cluster.range_end(peer), time_s[vehicle] - time_s[peer]) for peer in others]
        done.add(vehicle)
    return pairs


def _signs(pairs: list[_Pair], vehicle: int) -> FloatArray:
    """Return 1 where a vehicle is the pair's own, -1 where it is its other end, else 0."""
    return np.array([float(own.vehicle == vehicle) - float(end.vehicle == vehicle) for own, end, _ in pairs])


def _first_beyond(cost: FloatArray, sigmas: float) -> float:
    beyond = np.flatnonzero(cost > sigmas * sigmas)
    return float(_STEP_SIGMAS[beyond[0] if len(beyond) else -1])


def _distance_covariance(cluster: Cluster, pairs: list[_Pair], units: FloatArray, moves: Mapping[int, Horizontal]) -> FloatArray:
    """Return the covariance (k, k) of the distances of k pairs, m^2.

    It counts the errors of the vehicles that are not moved, and those of the pairs.
    """
    joint = cluster.joint
    H = np.vstack([
        cluster.range_jacobian(own, end, (unit[0], unit[1], unit[2]))[0]
        for (own, end, _), unit in zip(pairs, units.tolist(), strict=True)
    ])  # fmt: skip
    for vehicle in moves:
        H[:, joint.where[vehicle]] = 0.0
    errors: dict[tuple[int, int], list[slice]] = {}
    for key, place in joint.where.items():
        if isinstance(key, tuple):
            errors.setdefault((key[0], key[1]), []).append(place)
    for row, (own, end, _) in zip(H, pairs, strict=True):
        for place in errors.get(pair_key(own.vehicle, end.vehicle, 0)[:2], ()):
            row[place] = 1.0
    return joint.predict_measurement(H)[1]


def _vector_m(own: RangeEnd, end: RangeEnd, behind_s: float) -> tuple[float, float, float]:
    """Return the vector from a peer to the vehicle, m, with the peer moved on to the vehicle's time."""
    (e, n, u), (pe, pn, pu), (ve, vn, vu) = own.position, end.position, end.velocity
    return e - pe - behind_s * ve, n - pn - behind_s * vn, u - pu - behind_s * vu
