"""Reflection of a denied vehicle's state in a plane through its peers, and when it is possible.

Ranges with peers in one plane are the same on both sides of it: right and left of peers on one line, above and below peers at
one height. Near the plane the ranges hardly observe the motion across it either, so an unobserved turn may lead to either side.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.estimators.fleet.ambiguity.curved_ranges import variance_across_m2
from gcs_coloc.estimators.fleet.ambiguity.peer_geometry import NEAR_SIGMAS, SEPARATED, PeerGeometry
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.process_model import fresh_air_data, shows_its_motion
from gcs_coloc.estimators.fleet.ekf.state import POSITION, SIZE, TURN, VELOCITY

_SPEED_SIGMAS = 2.0  # chosen: a closing speed beyond two sigmas is known by its sign
_HARDEST_TURN_MPS2 = 5.0  # chosen: half a g, the unobserved acceleration to be reckoned with above and below peers
_HARDEST_BESIDE_A_LINE_MPS2 = 9.8
"""Chosen: 1 g; beside peers on one line only the motion separates the sides, and a hard turn is as hard to observe."""
_LEAST_SPREAD_SIGMAS = 3.0  # chosen: peers closer together than three range sigmas do not define a plane
_SAME_PLACE_NIS = 1.0  # chosen: a reflected state within one sigma of the state is the same
COVERED_SIGMAS = 3.0
"""Chosen: each state is within three sigmas of a mixture, or of an estimate that includes it."""
_LEVEL = 0.7  # chosen: a plane whose normal is within 45 degrees of the vertical is level
_LEAST_SPREAD_M = 1.0  # chosen: peers at one place define no line
CLEARLY_ASIDE_SIGMAS = 1.0
"""Chosen: within one sigma of the plane a state is on neither side, and both hypotheses would be one."""


@dataclass(frozen=True, slots=True)
class ReflectionPlane:
    """The plane through its peers in which a vehicle's state is reflected.

    `point_m` (3,) is a point in it and `normal` (3,) its unit normal. `speed_mps` is its speed along the normal at the vehicle.
    `ranges_separate`: the peers are so far off it that the ranges will decide between its sides.
    """

    point_m: FloatArray
    normal: FloatArray
    speed_mps: float
    ranges_separate: bool


def find_reflection_plane(cluster: Cluster, denied_vehicle: int, at_s: float) -> ReflectionPlane | None:
    """Return the plane of a vehicle's peers if it is open on which side the vehicle will be.

    It is the vertical plane through peers on one line, or the level plane through three or more where no height is measured.
    None where the ranges separate its sides and fit no second place, the vehicle is too far from it to have changed sides, it
    crosses so fast that it cannot have turned back within the stretch in which the ranges are blind across the plane, or where
    the reflected state is still the same as the state.
    """
    peers = list(cluster.peers_in_use(denied_vehicle, at_s))
    if len(peers) < 2:
        return None
    view = PeerGeometry(cluster, denied_vehicle, peers, at_s)
    normal, along, longest_m2 = _axes_of_line(view)
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


def find_reflected_start(cluster: Cluster, denied_vehicle: int, at_s: float) -> ReflectionPlane | None:
    """Return the level plane of peers on whose other side a vehicle with an open height may have begun.

    None with fewer than three peers, where it is not clearly aside yet, or the ranges separate the sides. Neither its distance
    nor its climb counts: from a height as uncertain as that, a filter comes to one of the sides by chance. Nor does a height of
    its own: which of both states fits it is decided by their odds.
    """
    peers = list(cluster.peers_in_use(denied_vehicle, at_s))
    if len(peers) < 3:
        return None
    view = PeerGeometry(cluster, denied_vehicle, peers, at_s)
    offsets, offset = np.array(view.offsets), np.array(view.offset)
    spreads, axes = np.linalg.eigh(offsets.T @ offsets)
    normal, within = axes[:, 0], axes[:, 1:]
    variances_m2, across_m2, _ = view.seen_from(normal)
    away_m = abs(float(offset @ normal))
    if abs(float(normal[2])) < _LEVEL or away_m < CLEARLY_ASIDE_SIGMAS * math.sqrt(across_m2):
        return None
    if math.sqrt(float(spreads[1])) < _LEAST_SPREAD_SIGMAS * math.sqrt(float(variances_m2.max())):
        return None
    is_separated = view.range_separation(normal, away_m, variances_m2) > SEPARATED
    if is_separated and not view.has_second_place(normal, within, across_m2):
        return None
    return ReflectionPlane(
        np.array(view.centre), normal, _plane_speed(view, offsets @ within, offset @ within, normal), is_separated
    )


def find_joint_reflection(cluster: Cluster, denied_vehicle: int, at_s: float) -> dict[int, ReflectionPlane] | None:
    """Return the plane at each of several denied vehicles that may have changed sides together, or None.

    They are the vehicle and those that it ranges, directly or over others of them, which are near the plane as well: ranges
    among them are the same on both sides. One that is clearly aside is as any peer. The plane is vertical, through the peers
    of them all.
    """
    group = _denied_in_reach(cluster, denied_vehicle, at_s)
    if len(group) < 2:
        return None
    while True:
        peers = _peers_of(cluster, group, at_s)
        if len(peers) < 2:
            return None
        views = {vehicle: PeerGeometry(cluster, vehicle, peers, at_s) for vehicle in group}
        normal, along, longest_m2 = _axes_of_line(views[denied_vehicle])
        if not views[denied_vehicle].may_be_ambiguous(normal, along):
            return None
        near = [vehicle for vehicle in group if _is_near_line(views[vehicle])]
        if denied_vehicle not in near or len(near) < 2:
            return None
        if len(near) == len(group):
            break
        group = near
    if _test_plane(views[denied_vehicle], normal, along, longest_m2) is None:
        return None
    return {vehicle: _plane_of_line(view) for vehicle, view in views.items()}


def vertical_plane_through_line(
    cluster: Cluster, denied_vehicle: int, at_s: float, group: frozenset[int] = frozenset()
) -> ReflectionPlane | None:
    """Return the vertical plane through the ranged peers of a denied vehicle if they are on one line.

    None if they are not. They count as on one line as long as the ranges to them do not separate the sides of the plane at the
    vehicle's distance from it, or nearly fit a second place. The peers of a `group` that is reflected together are those of all
    its vehicles outside of it.
    """
    peers = _ranged_peers(cluster, group or {denied_vehicle}, at_s)
    return vertical_plane_through(cluster, denied_vehicle, peers, at_s) if len(peers) >= 2 else None


def vertical_plane_through(cluster: Cluster, denied_vehicle: int, peers: list[int], at_s: float) -> ReflectionPlane | None:
    """Return the vertical plane of two or more peers; None where these are on no line, or at one place."""
    view = PeerGeometry(cluster, denied_vehicle, peers, at_s)
    normal, along, longest_m2 = _axes_of_line(view)
    if longest_m2 < _LEAST_SPREAD_M**2:
        return None
    ranges_separate = False
    if len(peers) > 2:
        variances_m2, across_m2, blind_m = view.seen_from(normal)
        reach_m = max(abs(float(np.array(view.offset) @ normal)), blind_m)
        ranges_separate = view.range_separation(normal, reach_m, variances_m2) > SEPARATED
        if ranges_separate and not view.has_second_place(normal, along, across_m2):
            return None
    return _plane_of_line(view, ranges_separate=ranges_separate)


def only_motion_separates(cluster: Cluster, group: frozenset[int], at_s: float, line: ReflectionPlane | None) -> bool:
    """Return whether only the process model separates the sides for denied vehicles of a group.

    The group is reflected together. Its peers are two or on one straight `line`, or three where no height is measured, and at
    least one of its vehicles has no air data.
    """
    most = 2 if all(cluster.records[vehicle].has_height for vehicle in group) else 3
    few = (line is not None and not line.ranges_separate) or len(_ranged_peers(cluster, group, at_s)) <= most
    return few and any(fresh_air_data(cluster.records[vehicle], cluster.settings, at_s) is None for vehicle in group)


def may_peers_have_moved(cluster: Cluster, group: Collection[int], at_s: float) -> bool:
    """Return whether a peer of a group is denied itself and does not show its own motion.

    What separates the sides by motion alone may then be that peer's motion.
    """
    records = (cluster.records[peer] for peer in _ranged_peers(cluster, group, at_s))
    return any(record.denied_vehicle and not shows_its_motion(record, cluster.settings, at_s) for record in records)


def offset_sigmas(cluster: Cluster, denied_vehicle: int, plane: ReflectionPlane, at_s: float) -> float:
    """Return the signed distance of a denied vehicle from a plane, in sigmas of its position."""
    sigma_m = math.sqrt(variance_across_m2(cluster, denied_vehicle, plane.normal, at_s))
    return float((np.array(cluster.position(denied_vehicle)) - plane.point_m) @ plane.normal) / sigma_m


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
    means: Sequence[FloatArray], covariances: Sequence[FloatArray], log_odds: Sequence[float]
) -> tuple[FloatArray, FloatArray]:
    """Return mean (m,) and covariance (m, m) of a mixture of states, eq. (25).

    `log_odds` are against any one of the states. The covariance is at least such that each state is within three sigmas.
    """
    odds = np.exp(np.array(log_odds) - max(log_odds))
    shares = odds / odds.sum()
    mean = shares @ np.array(means)
    squares = [np.outer(each - mean, each - mean) for each in means]
    within, spread = np.zeros_like(squares[0]), np.zeros_like(squares[0])
    for share, square, covariance in zip(shares, squares, covariances, strict=True):
        within, spread = within + share * covariance, spread + share * square
    for square, each in zip(squares, means, strict=True):
        nis = float((each - mean) @ np.linalg.lstsq(spread, each - mean)[0])
        if nis > COVERED_SIGMAS**2:
            spread += (1.0 / COVERED_SIGMAS**2 - 1.0 / nis) * square
    return mean, within + spread


def _ranged_peers(cluster: Cluster, group: Collection[int], at_s: float) -> list[int]:
    """Return the peers with recent ranges, used or refused: a refused one separates the sides best."""
    records = [cluster.records[vehicle] for vehicle in group]
    ranged = {v: t for record in records for v, t in record.last_range_s.items() if at_s - t <= record.in_use_s(v)}
    return [v for v in ranged if v in cluster.joint.where and v not in group]


def _denied_in_reach(cluster: Cluster, denied_vehicle: int, at_s: float) -> list[int]:
    """Return a denied vehicle and those that it ranges, directly or over others of them."""
    found = [denied_vehicle]
    for vehicle in found:
        peers = cluster.peers_in_use(vehicle, at_s)
        found += [peer for peer in peers if cluster.records[peer].denied_vehicle and peer not in found]
    return found


def _peers_of(cluster: Cluster, group: Collection[int], at_s: float) -> list[int]:
    """Return the peers in use of several denied vehicles, without themselves."""
    return [peer for peer in dict.fromkeys(p for v in group for p in cluster.peers_in_use(v, at_s)) if peer not in group]


def _is_near_line(view: PeerGeometry) -> bool:
    """Whether a vehicle is so near to the line of its peers that it may be on either side of it."""
    normal, _, _ = _axes_of_line(view)
    _, across_m2, blind_m = view.seen_from(normal)
    return abs(float(np.array(view.offset) @ normal)) <= max(NEAR_SIGMAS * math.sqrt(across_m2), blind_m)


def _axes_of_line(view: PeerGeometry) -> tuple[FloatArray, FloatArray, float]:
    """Return the horizontal unit normal (3,) and the axis (3, 1) of the line of the peers.

    The third value is the sum of squares of the peers along the line, m^2.
    """
    (e, n), longest_m2 = view.line()
    return np.array([-n, e, 0.0]), np.array([[e], [n], [0.0]]), longest_m2


def _plane_of_line(view: PeerGeometry, *, ranges_separate: bool = False) -> ReflectionPlane:
    """Return the vertical plane through the peers' line, at the vehicle."""
    normal, along, _ = _axes_of_line(view)
    speed_mps = _plane_speed(view, np.array(view.offsets) @ along, np.array(view.offset) @ along, normal)
    return ReflectionPlane(np.array(view.centre), normal, speed_mps, ranges_separate)


def _test_plane(view: PeerGeometry, normal: FloatArray, within: FloatArray, least_spread_m2: float) -> ReflectionPlane | None:
    """Return the plane with a given normal if the vehicle may be on either side of it, else None.

    `normal` (3,) is a unit vector, and `within` (3, m) are the axes in the plane. `least_spread_m2` is the least sum of squares
    of the peers along these axes.
    """
    offsets, offset, upwards = np.array(view.offsets), np.array(view.offset), abs(float(normal[2]))
    away_m = float(offset @ normal)
    variances_m2, across_m2, blind_m = view.seen_from(normal)
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
    """Return the speed along its normal, m/s, of the plane through the peers, at a point in it.

    `at_m` (m,) holds the coordinates of the point and `within_m` (k, m) those of the peers, in the plane about the mean of the
    peers.
    """
    speeds = np.array([peer.velocity for peer in view.peers]) @ normal
    slopes = np.linalg.solve(within_m.T @ within_m, within_m.T @ speeds)
    return float(speeds.mean() + slopes @ at_m)
