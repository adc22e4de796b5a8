"""The mirror image of a denied vehicle that ranges peers in one plane: when the filter may have taken it, and what it is.

Ranges with peers in one plane are the same on both sides of it: to the right and left of peers on one line, above and below peers
at one height. Near the plane they hardly tell the motion across it either, so a turn there leads to either side unseen.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import AltitudeMeasurement, FloatArray, Vector3
from gcs_coloc.estimators.fleet.ekf._kernels import POSITION, SIZE, STAMP_ERROR, TURN, VELOCITY
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster, RangeEnd
from gcs_coloc.estimators.fleet.ekf.records import IN_USE_S

_NEAR_SIGMAS = 4.0
_SPEED_SIGMAS = 2.0
_HARDEST_TURN_MPS2 = 5.0
_HARDEST_BESIDE_A_LINE_MPS2 = 9.8
_TOLD_APART = 2.0
_LEAST_SPREAD_SIGMAS = 3.0
_SAME_PLACE = 1.0
_COVERED_SIGMAS = 3.0
_LEVEL = 0.7
_LEAST_DISTANCE_M = 1.0
_LEAST_BLUR_M = 1e-3


@dataclass(frozen=True, slots=True)
class ReflectionPlane:
    """The plane that reflects: a point `point_m` (3,), unit normal (3,), and its speed along the normal at the vehicle, m/s."""

    point_m: FloatArray
    normal: FloatArray
    speed_mps: float


def find_reflection_plane(cluster: Cluster, denied_vehicle: int, at_s: float) -> ReflectionPlane | None:
    """Return the plane that a vehicle's peers are in if it is not told on which side of it the vehicle is going to leave it.

    That is the vertical plane through peers on one line, or the level one through three and more where no height is heard. None
    where the peers are not in one plane, where the denied vehicle is too far from it to have changed the side, where it crosses
    so fast that it cannot have turned back within the stretch in which the ranges are blind across the plane, or where its
    mirror image is as yet the same as the state.
    """
    neighbours = cluster.records[denied_vehicle].neighbours
    peers = [v for v, n in neighbours.items() if at_s - n.at_s <= IN_USE_S and v in cluster.joint.where]
    if len(peers) < 2:
        return None
    view = _PeerGeometry(cluster, denied_vehicle, peers, at_s)
    (e, n), longest_m2 = view.line()
    if view.may_be_ambiguous((-n, e, 0.0)):
        plane = _across(view, np.array([-n, e, 0.0]), np.array([[e], [n], [0.0]]), longest_m2)
        if plane is not None:
            return plane
    if len(peers) < 3 or any(
        view.altitude_separation(_LEVEL, view.blind_m(least)) > _TOLD_APART for least in view.least_blurs_m()
    ):
        return None
    offsets = np.array(view.offsets)
    spreads, axes = np.linalg.eigh(offsets.T @ offsets)
    normal = axes[:, 0]
    if abs(float(normal[2])) < _LEVEL or not view.may_be_ambiguous(normal.tolist()):
        return None
    return _across(view, normal, axes[:, 1:], float(spreads[1]))


def has_air_data(cluster: Cluster, denied_vehicle: int, at_s: float) -> bool:
    """Whether a denied vehicle tells its attitude and airspeed."""
    attitude = cluster.records[denied_vehicle].attitude
    return attitude is not None and at_s - attitude.measured_at_s <= cluster.settings.attitude_fresh_s


def vertical_plane_through_line(cluster: Cluster, denied_vehicle: int, at_s: float) -> ReflectionPlane | None:
    """Return the upright plane through the peers of a denied vehicle where these are on one line, None if they are not.

    They are as long as the ranges to them do not tell the sides of the plane apart at the denied vehicle's distance from it.
    """
    peers = _heard(cluster, denied_vehicle, at_s)
    return vertical_plane_through(cluster, denied_vehicle, peers, at_s) if len(peers) >= 2 else None


def vertical_plane_through(cluster: Cluster, denied_vehicle: int, peers: list[int], at_s: float) -> ReflectionPlane | None:
    """Return the upright plane that two and more peers of a vehicle are in; None where they are in none, or all at one place."""
    view = _PeerGeometry(cluster, denied_vehicle, peers, at_s)
    (e, n), longest_m2 = view.line()
    if longest_m2 < _LEAST_DISTANCE_M**2:
        return None
    normal, along = np.array([-n, e, 0.0]), np.array([[e], [n], [0.0]])
    if len(peers) > 2:
        blur2_m2 = np.array([max(float(view.apart_m2(i)[0, 0]), _LEAST_BLUR_M**2) for i in range(len(peers))])
        reach_m = max(abs(float(np.array(view.offset) @ normal)), view.blind_m(math.sqrt(float(blur2_m2.max()))))
        if view.range_separation(normal, reach_m, blur2_m2) > _TOLD_APART:
            return None
    speed_mps = _plane_speed(view, np.array(view.offsets) @ along, np.array(view.offset) @ along, normal)
    return ReflectionPlane(np.array(view.centre), normal, speed_mps)


def only_motion_discriminates(cluster: Cluster, denied_vehicle: int, at_s: float, line: ReflectionPlane | None) -> bool:
    """Whether only how steadily a vehicle would fly tells the sides apart: its peers are on a `line` or two, no attitude."""
    return (line is not None or len(_heard(cluster, denied_vehicle, at_s)) <= 2) and not has_air_data(
        cluster, denied_vehicle, at_s
    )


def _heard(cluster: Cluster, denied_vehicle: int, at_s: float) -> list[int]:
    """Return the peers with which ranges were heard lately, used or not: one that is refused tells the sides apart best."""
    return [
        v for v, t in cluster.records[denied_vehicle].last_range_s.items() if at_s - t <= IN_USE_S and v in cluster.joint.where
    ]


def offset_sigmas(cluster: Cluster, denied_vehicle: int, plane: ReflectionPlane) -> float:
    """Return how far a denied vehicle is off a plane, in its own sigmas, signed."""
    n = plane.normal
    sigma_m = math.sqrt(float(n @ cluster.joint.covariance(denied_vehicle)[POSITION, POSITION] @ n))
    return float((np.array(cluster.position(denied_vehicle)) - plane.point_m) @ n) / sigma_m


class _PeerGeometry:
    """A denied vehicle and its peers at a time: where they are and how well that is known, as far as it costs little.

    `offset` is the vehicle's place about the mean `centre` of its peers, `offsets` theirs, `distance_m` how far it is from each.
    `most_m` is at least as large as the sigma of any way between the denied vehicle and a peer in any direction.
    """

    def __init__(self, cluster: Cluster, denied_vehicle: int, peers: list[int], at_s: float) -> None:
        self.cluster = cluster
        self.own = cluster.range_end(denied_vehicle)
        self.peers = [cluster.range_end(v) for v in peers]
        places = [peer.position for peer in self.peers]
        ce, cn, cu = self.centre = [math.fsum(axis) / len(peers) for axis in zip(*places, strict=True)]
        self.offsets: list[Vector3] = [(e - ce, n - cn, u - cu) for e, n, u in places]
        e, n, u = self.own.position
        self.offset = (e - ce, n - cn, u - cu)
        self.distance_m = [max(math.dist(self.own.position, place), _LEAST_DISTANCE_M) for place in places]
        self.nearest_m = min(self.distance_m)
        most_m = _most_m(cluster, self.own) + max(_most_m(cluster, peer) for peer in self.peers)
        self.most_m = max(most_m, _LEAST_BLUR_M)
        record = cluster.records[denied_vehicle]
        self.aided = has_air_data(cluster, denied_vehicle, at_s)
        self._height_sigma_m = math.inf
        for m in reversed(record.own_measurements):
            if at_s - m.measured_at_s > IN_USE_S:
                break
            if isinstance(m, AltitudeMeasurement):
                self._height_sigma_m = m.sigma_m

    def least_blurs_m(self) -> Iterator[float]:
        """What the largest sigma of a distance to a peer is at least: first without looking, then that to one of them."""
        yield _LEAST_BLUR_M
        yield math.sqrt(max(float(self.apart_m2(0)[0, 0]), 0.0))

    def apart_m2(self, i: int) -> FloatArray:
        """Return the covariance (4, 4) of the way from peer i to the vehicle: along the line between them, east, north, up."""
        (e, n, u), (pe, pn, pu), distance_m = self.offset, self.offsets[i], self.distance_m[i]
        unit = ((e - pe) / distance_m, (n - pn) / distance_m, (u - pu) / distance_m)
        return self.cluster.joint.predict_measurement(self.cluster.range_jacobian(self.own, self.peers[i], unit))[1]

    def blind_m(self, blur_m: float) -> float:
        """Within this distance of a plane the ranges change by less than they are uncertain."""
        return math.sqrt(2.0 * blur_m * self.nearest_m)

    def line(self) -> tuple[tuple[float, float], float]:
        """Return the direction (east, north) in which the peers lie, a unit vector, and the sum of squares along it, m^2."""
        ee = en = nn = 0.0
        for e, n, _ in self.offsets:
            ee += e * e
            en += e * n
            nn += n * n
        course = 0.5 * math.atan2(2.0 * en, ee - nn)
        return (math.cos(course), math.sin(course)), 0.5 * (ee + nn) + math.hypot(0.5 * (ee - nn), en)

    def range_separation(self, normal: FloatArray, reach_m: float, blurs_m2: FloatArray) -> float:
        """How clearly the ranges tell the two sides of a plane apart at this distance from it, its unit normal (3,).

        `blurs_m2` (k,) is how uncertain the distance to each peer is.
        """
        told = 2.0 * reach_m * (np.array(self.offsets) @ normal) / np.array(self.distance_m)
        return float(np.sum(told * told / blurs_m2))

    def altitude_separation(self, upwards: float, reach_m: float) -> float:
        """How clearly the vehicle's own height tells the two sides of a plane apart, whose unit normal has this part upwards."""
        return (2.0 * reach_m * upwards / self._height_sigma_m) ** 2

    def may_be_ambiguous(self, normal: Sequence[float]) -> bool:
        """Whether it may be open on which side of a plane through the centre the denied vehicle is, whatever the covariances are.

        It is not too far from the plane, and the peers are not too far off it to tell the sides apart.
        """
        ne, nn, nu = normal
        away_m = self.offset[0] * ne + self.offset[1] * nn + self.offset[2] * nu
        blind_m = self.blind_m(self.most_m)
        if abs(away_m) > max(_NEAR_SIGMAS * self.most_m, blind_m):
            return False
        slopes = ((e * ne + n * nn + u * nu) / d for (e, n, u), d in zip(self.offsets, self.distance_m, strict=True))
        # The ratio of the blind stretch to the blur only falls as the blur grows.
        told = 2.0 * blind_m / self.most_m
        return told * told * sum(slope * slope for slope in slopes) <= _TOLD_APART


def _most_m(cluster: Cluster, end: RangeEnd) -> float:
    """Return a bound on the sigma of a vehicle's place in any direction, m: as if all errors in it were one."""
    A, p = cluster.joint.A, end.where.start
    place_m = math.sqrt(A.item(p, p) + A.item(p + 1, p + 1) + A.item(p + 2, p + 2))
    if end.time_stamp_offset_s is None:
        return place_m
    v, s = p + VELOCITY.start, p + STAMP_ERROR
    speed_sigma_mps = math.sqrt(A.item(v, v) + A.item(v + 1, v + 1) + A.item(v + 2, v + 2))
    return place_m + abs(end.time_stamp_offset_s) * speed_sigma_mps + math.hypot(*end.velocity) * math.sqrt(A.item(s, s))


def _across(view: _PeerGeometry, normal: FloatArray, within: FloatArray, least_spread_m2: float) -> ReflectionPlane | None:
    """Test one plane: unit normal (3,), axes within it (3, m), and the least sum of squares of the peers along these."""
    offsets, offset, upwards = np.array(view.offsets), np.array(view.offset), abs(float(normal[2]))
    away_m = float(offset @ normal)
    blur2, across2, blind_m = np.empty(len(view.peers)), 0.0, 0.0
    for i in range(len(view.peers)):
        apart_m2 = view.apart_m2(i)
        blur2[i] = max(float(apart_m2[0, 0]), _LEAST_BLUR_M**2)
        across2 = max(across2, float(normal @ apart_m2[1:, 1:] @ normal))
        blind_m = max(blind_m, view.blind_m(math.sqrt(float(blur2[i]))))
        if view.altitude_separation(upwards, max(abs(away_m), blind_m)) > _TOLD_APART:
            return None
    if math.sqrt(least_spread_m2) < _LEAST_SPREAD_SIGMAS * math.sqrt(float(blur2.max())):
        return None
    if abs(away_m) > max(_NEAR_SIGMAS * math.sqrt(across2), blind_m):
        return None
    reach_m = max(abs(away_m), blind_m)
    if view.range_separation(normal, reach_m, blur2) + view.altitude_separation(upwards, reach_m) > _TOLD_APART:
        return None
    speed_mps = _plane_speed(view, offsets @ within, offset @ within, normal)
    closing = float(np.dot(view.own.velocity, normal)) - speed_mps
    P = view.cluster.joint.covariance(view.own.vehicle)
    spread_v = math.sqrt(float(normal @ P[VELOCITY, VELOCITY] @ normal))
    # Beside peers on one line nothing but the motion will tell, and a hard turn is as hard to see.
    hardest_mps2 = _HARDEST_TURN_MPS2 if upwards > _LEVEL else _HARDEST_BESIDE_A_LINE_MPS2
    turn = 0.0 if view.aided else math.sqrt(hardest_mps2 * blind_m)
    if abs(closing) > _SPEED_SIGMAS * spread_v + turn:
        return None
    if upwards > _LEVEL and abs(closing) < _SPEED_SIGMAS * spread_v:
        # Level flight beside the plane does not come to its other side.
        return None
    both = np.array([away_m, closing])
    G = np.zeros((2, SIZE))
    G[0, POSITION] = G[1, VELOCITY] = normal
    twice = 2.0 * float(both @ np.linalg.solve(G @ P @ G.T, both))
    return ReflectionPlane(np.array(view.centre), normal, speed_mps) if twice > _SAME_PLACE else None


def _plane_speed(view: _PeerGeometry, within_m: FloatArray, at_m: FloatArray, normal: FloatArray) -> float:
    """Return the speed along its normal, m/s, of the plane through the peers, at a place `at_m` (m,) in it.

    `within_m` (k, m) is where the peers are in it, about their mean.
    """
    speeds = np.array([peer.velocity for peer in view.peers]) @ normal
    slopes = np.linalg.solve(within_m.T @ within_m, within_m.T @ speeds)
    return float(speeds.mean() + slopes @ at_m)


def reflect(cluster: Cluster, denied_vehicle: int, plane: ReflectionPlane) -> None:
    """Turn a denied vehicle's state into its mirror image, with all its covariances."""
    joint, n = cluster.joint, plane.normal
    M = np.eye(SIZE)
    M[0:3, 0:3] -= 2.0 * np.outer(n, n)
    M[3:6, 3:6] = M[0:3, 0:3]
    # A rate about the vertical turns round in an upright plane and stays what it is in a level one.
    M[TURN, TURN] = 2.0 * float(n[2]) ** 2 - 1.0
    offset = np.zeros(SIZE)
    offset[0:3] = 2.0 * float(plane.point_m @ n) * n
    offset[3:6] = 2.0 * plane.speed_mps * n
    mean = M @ joint.mean(denied_vehicle) + offset
    joint.propagate(denied_vehicle, tuple(mean.tolist()), M, np.zeros((SIZE, SIZE)), joint.time_s[denied_vehicle])


def mixture(
    x: FloatArray, P: FloatArray, other_x: FloatArray, other_P: FloatArray, log_odds: float
) -> tuple[FloatArray, FloatArray]:
    """Return mean (6,) and covariance (6, 6) of two possible states; `log_odds` is that of the other one.

    The covariance is that of the mixture, and at least such that the less likely of the two is within three sigmas.
    """
    share = 0.5 + 0.5 * math.tanh(0.5 * log_odds)
    d = other_x - x
    less = min(share, 1.0 - share)
    spread = max(less * (1.0 - less), ((1.0 - less) / _COVERED_SIGMAS) ** 2)
    return x + share * d, (1.0 - share) * P + share * other_P + spread * np.outer(d, d)
