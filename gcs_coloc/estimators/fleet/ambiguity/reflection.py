"""Reflection of a denied vehicle's state in a plane through its peers: when it is possible, and the reflected state.

Ranges with peers in one plane are the same on both sides of it: right and left of peers on one line, above and below peers at
one height. Near the plane the ranges hardly observe the motion across it either, so an unobserved turn may lead to either side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.estimators.fleet.ambiguity.peer_geometry import LEAST_SIGMA_M, NEAR_SIGMAS, SEPARATED, PeerGeometry
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.process_model import fresh_attitude
from gcs_coloc.estimators.fleet.ekf.records import IN_USE_S
from gcs_coloc.estimators.fleet.ekf.state import POSITION, SIZE, TURN, VELOCITY

_SPEED_SIGMAS = 2.0
"""Chosen: a closing speed beyond two sigmas is known by its sign."""
_HARDEST_TURN_MPS2 = 5.0
"""Chosen: half a g, the unobserved acceleration to be reckoned with above and below peers."""
_HARDEST_BESIDE_A_LINE_MPS2 = 9.8
"""Chosen: 1 g; beside peers on one line only the motion separates the sides, and a hard turn is as hard to observe."""
_LEAST_SPREAD_SIGMAS = 3.0
"""Chosen: peers closer together than three range sigmas do not define a plane."""
_SAME_PLACE_NIS = 1.0
"""Chosen: a reflected state within one sigma of the state is the same."""
_COVERED_SIGMAS = 3.0
"""Chosen: the less likely state is within three sigmas of a mixture."""
_LEVEL = 0.7
"""Chosen: a plane whose normal is within 45 degrees of the vertical is level."""
_LEAST_SPREAD_M = 1.0
"""Chosen: peers at one place define no line."""


@dataclass(frozen=True, slots=True)
class ReflectionPlane:
    """The plane that reflects: a point `point_m` (3,), unit normal (3,), and its speed along the normal at the vehicle, m/s.

    `ranges_separate`: the peers are so far off it that the ranges will decide between its sides.
    """

    point_m: FloatArray
    normal: FloatArray
    speed_mps: float
    ranges_separate: bool


def find_reflection_plane(cluster: Cluster, denied_vehicle: int, at_s: float) -> ReflectionPlane | None:
    """Return the plane of a vehicle's peers if the measurements leave open on which side the vehicle will be.

    It is the vertical plane through peers on one line, or the level plane through three or more where no height is measured.
    None where the ranges separate its sides and fit no second place, the vehicle is too far from it to have changed sides, it
    crosses so fast that it cannot have turned back within the stretch in which the ranges are blind across the plane, or where
    the reflected state is still the same as the state.
    """
    peers = list(cluster.peers_in_use(denied_vehicle, at_s))
    if len(peers) < 2:
        return None
    view = PeerGeometry(cluster, denied_vehicle, peers, at_s)
    (e, n), longest_m2 = view.line()
    normal, along = np.array([-n, e, 0.0]), np.array([[e], [n], [0.0]])
    if view.may_be_ambiguous(normal, along):
        plane = _test_plane(view, normal, along, longest_m2)
        if plane is not None:
            return plane
    if len(peers) < 3 or any(
        view.altitude_separation(_LEVEL, view.blind_m(least_m)) > SEPARATED for least_m in view.least_range_sigmas_m()
    ):
        return None
    offsets = np.array(view.offsets)
    spreads, axes = np.linalg.eigh(offsets.T @ offsets)
    normal = axes[:, 0]
    if abs(float(normal[2])) < _LEVEL or not view.may_be_ambiguous(normal, axes[:, 1:]):
        return None
    return _test_plane(view, normal, axes[:, 1:], float(spreads[1]))


def vertical_plane_through_line(cluster: Cluster, denied_vehicle: int, at_s: float) -> ReflectionPlane | None:
    """Return the vertical plane through the ranged peers of a denied vehicle where they are on one line, else None.

    They are as long as the ranges to them do not separate the sides of the plane at the vehicle's distance from it, or nearly
    fit a second place.
    """
    peers = _ranged_peers(cluster, denied_vehicle, at_s)
    return vertical_plane_through(cluster, denied_vehicle, peers, at_s) if len(peers) >= 2 else None


def vertical_plane_through(cluster: Cluster, denied_vehicle: int, peers: list[int], at_s: float) -> ReflectionPlane | None:
    """Return the vertical plane that two or more peers are in; None where they are in none, or all at one place."""
    view = PeerGeometry(cluster, denied_vehicle, peers, at_s)
    (e, n), longest_m2 = view.line()
    if longest_m2 < _LEAST_SPREAD_M**2:
        return None
    normal, along = np.array([-n, e, 0.0]), np.array([[e], [n], [0.0]])
    ranges_separate = False
    if len(peers) > 2:
        covariances = [view.difference_covariance(i) for i in range(len(peers))]
        variances_m2 = np.array([max(float(covariance[0, 0]), LEAST_SIGMA_M**2) for covariance in covariances])
        reach_m = max(abs(float(np.array(view.offset) @ normal)), view.blind_m(math.sqrt(float(variances_m2.max()))))
        ranges_separate = view.range_separation(normal, reach_m, variances_m2) > SEPARATED
        across_m2 = max(float(normal @ covariance[1:, 1:] @ normal) for covariance in covariances)
        if ranges_separate and not view.has_second_place(normal, along, across_m2):
            return None
    speed_mps = _plane_speed(view, np.array(view.offsets) @ along, np.array(view.offset) @ along, normal)
    return ReflectionPlane(np.array(view.centre), normal, speed_mps, ranges_separate)


def only_motion_separates(cluster: Cluster, denied_vehicle: int, at_s: float, line: ReflectionPlane | None) -> bool:
    """Whether only the process model separates the sides: peers are two or on one straight `line`, and there is no air data."""
    few = (line is not None and not line.ranges_separate) or len(_ranged_peers(cluster, denied_vehicle, at_s)) <= 2
    return few and fresh_attitude(cluster.records[denied_vehicle], cluster.settings, at_s) is None


def offset_sigmas(cluster: Cluster, denied_vehicle: int, plane: ReflectionPlane) -> float:
    """Return the signed distance of a denied vehicle from a plane, in sigmas of its position."""
    n = plane.normal
    sigma_m = math.sqrt(float(n @ cluster.joint.covariance(denied_vehicle)[POSITION, POSITION] @ n))
    return float((np.array(cluster.position(denied_vehicle)) - plane.point_m) @ n) / sigma_m


def reflect(cluster: Cluster, denied_vehicle: int, plane: ReflectionPlane) -> None:
    """Replace a denied vehicle's state by its reflection, with all covariances: x -> M x + c, eq. (23)."""
    joint, n = cluster.joint, plane.normal
    M = np.eye(SIZE)
    M[0:3, 0:3] -= 2.0 * np.outer(n, n)
    M[3:6, 3:6] = M[0:3, 0:3]
    # A rate about the vertical changes its sign in a vertical plane and keeps it in a level one.
    M[TURN, TURN] = 2.0 * float(n[2]) ** 2 - 1.0
    c = np.zeros(SIZE)
    c[0:3] = 2.0 * float(plane.point_m @ n) * n
    c[3:6] = 2.0 * plane.speed_mps * n
    mean = M @ joint.mean(denied_vehicle) + c
    joint.propagate(denied_vehicle, tuple(mean.tolist()), M, np.zeros((SIZE, SIZE)), joint.time_s[denied_vehicle])


def mixture(
    x: FloatArray, P: FloatArray, other_x: FloatArray, other_P: FloatArray, log_odds: float
) -> tuple[FloatArray, FloatArray]:
    """Return mean (6,) and covariance (6, 6) of a mixture of two states, eq. (25); `log_odds` is that of the other state.

    The covariance is at least such that the less likely state is within three sigmas.
    """
    share = 0.5 + 0.5 * math.tanh(0.5 * log_odds)
    d = other_x - x
    less = min(share, 1.0 - share)
    spread = max(less * (1.0 - less), ((1.0 - less) / _COVERED_SIGMAS) ** 2)
    return x + share * d, (1.0 - share) * P + share * other_P + spread * np.outer(d, d)


def _ranged_peers(cluster: Cluster, denied_vehicle: int, at_s: float) -> list[int]:
    """Return the peers with recent ranges, used or refused: a refused one separates the sides best."""
    last_range_s = cluster.records[denied_vehicle].last_range_s
    return [v for v, t in last_range_s.items() if at_s - t <= IN_USE_S and v in cluster.joint.where]


def _test_plane(view: PeerGeometry, normal: FloatArray, within: FloatArray, least_spread_m2: float) -> ReflectionPlane | None:
    """Test one plane: unit normal (3,), axes within it (3, m), and the least sum of squares of the peers along these."""
    offsets, offset, upwards = np.array(view.offsets), np.array(view.offset), abs(float(normal[2]))
    away_m = float(offset @ normal)
    variances_m2, across_m2, blind_m = np.empty(len(view.peers)), 0.0, 0.0
    for i in range(len(view.peers)):
        covariance = view.difference_covariance(i)
        variances_m2[i] = max(float(covariance[0, 0]), LEAST_SIGMA_M**2)
        across_m2 = max(across_m2, float(normal @ covariance[1:, 1:] @ normal))
        blind_m = max(blind_m, view.blind_m(math.sqrt(float(variances_m2[i]))))
        if view.altitude_separation(upwards, max(abs(away_m), blind_m)) > SEPARATED:
            return None
    if math.sqrt(least_spread_m2) < _LEAST_SPREAD_SIGMAS * math.sqrt(float(variances_m2.max())):
        return None
    if abs(away_m) > max(NEAR_SIGMAS * math.sqrt(across_m2), blind_m):
        return None
    reach_m = max(abs(away_m), blind_m)
    by_ranges, by_altitude = view.range_separation(normal, reach_m, variances_m2), view.altitude_separation(upwards, reach_m)
    if by_altitude + (0.0 if view.has_second_place(normal, within, across_m2) else by_ranges) > SEPARATED:
        return None
    speed_mps = _plane_speed(view, offsets @ within, offset @ within, normal)
    closing = float(np.dot(view.own.velocity, normal)) - speed_mps
    P = view.cluster.joint.covariance(view.own.vehicle)
    sigma_mps = math.sqrt(float(normal @ P[VELOCITY, VELOCITY] @ normal))
    hardest_mps2 = _HARDEST_TURN_MPS2 if upwards > _LEVEL else _HARDEST_BESIDE_A_LINE_MPS2
    turn_mps = 0.0 if view.has_air_data else math.sqrt(hardest_mps2 * blind_m)
    if abs(closing) > _SPEED_SIGMAS * sigma_mps + turn_mps:
        return None
    if upwards > _LEVEL and abs(closing) < _SPEED_SIGMAS * sigma_mps:
        # Level flight beside the plane does not come to its other side.
        return None
    both = np.array([away_m, closing])
    G = np.zeros((2, SIZE))
    G[0, POSITION] = G[1, VELOCITY] = normal
    twice = 2.0 * float(both @ np.linalg.solve(G @ P @ G.T, both))
    if twice <= _SAME_PLACE_NIS:
        return None
    return ReflectionPlane(np.array(view.centre), normal, speed_mps, by_ranges > SEPARATED)


def _plane_speed(view: PeerGeometry, within_m: FloatArray, at_m: FloatArray, normal: FloatArray) -> float:
    """Return the speed along its normal, m/s, of the plane through the peers, at a point `at_m` (m,) in it.

    `within_m` (k, m) holds the coordinates of the peers in the plane about their mean.
    """
    speeds = np.array([peer.velocity for peer in view.peers]) @ normal
    slopes = np.linalg.solve(within_m.T @ within_m, within_m.T @ speeds)
    return float(speeds.mean() + slopes @ at_m)
