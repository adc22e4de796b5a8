"""The mirror image of a subject that ranges peers in one plane: when the filter may have taken it, and what it is.

Ranges with peers in one plane are the same on both sides of it: to the right and left of peers on one line, above and below peers
at one height. Near the plane they hardly tell the motion across it either, so a turn there leads to either side unseen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import AltitudeMeasurement, FloatArray
from gcs_coloc.estimators.fleet_cluster import Cluster
from gcs_coloc.estimators.fleet_motion import SIZE, TURN

_IN_USE_S = 2.0
_NEAR_SIGMAS = 4.0
_SPEED_SIGMAS = 2.0
_HARDEST_TURN_MPS2 = 5.0
_TOLD_APART = 2.0
_LEAST_SPREAD_SIGMAS = 3.0
_SAME_PLACE = 1.0
_COVERED_SIGMAS = 3.0
_LEVEL = 0.7


@dataclass(frozen=True, slots=True)
class Mirror:
    """A plane through `at_m` (3,) with the unit normal `normal` (3,); at the subject it moves along it at `speed_mps`."""

    at_m: FloatArray
    normal: FloatArray
    speed_mps: float


def find_mirror(cluster: Cluster, subject: int, at_s: float) -> Mirror | None:
    """Return the plane that a subject's peers are in if it is not told on which side of it the subject is going to leave it.

    That is the vertical plane through peers on one line, or the level one through three and more where no height is heard. None
    where the peers are not in one plane, where the subject is too far from it to have changed the side, where it crosses
    so fast that it cannot have turned back within the stretch in which the ranges are blind across the plane, or where its
    mirror image is as yet the same as the state.
    """
    neighbours = cluster.records[subject].neighbours
    peers = [v for v, n in neighbours.items() if at_s - n.at_s <= _IN_USE_S and v in cluster.joint.start]
    if len(peers) < 2:
        return None
    there = np.array([cluster.place(v) for v in peers])
    offsets = there - there.mean(axis=0)
    spreads, axes = np.linalg.eigh(offsets[:, :2].T @ offsets[:, :2])
    normal, along = np.append(axes[:, 0], 0.0), np.append(axes[:, 1], 0.0)
    mirror = _across(cluster, subject, at_s, peers, there, normal, along[:, np.newaxis], float(spreads[1]))
    if mirror is not None or len(peers) < 3:
        return mirror
    spreads, axes = np.linalg.eigh(offsets.T @ offsets)
    if abs(float(axes[2, 0])) < _LEVEL:
        return None
    return _across(cluster, subject, at_s, peers, there, axes[:, 0], axes[:, 1:], float(spreads[1]))


def _across(
    cluster: Cluster,
    subject: int,
    at_s: float,
    peers: list[int],
    there: FloatArray,
    normal: FloatArray,
    within: FloatArray,
    least_spread_m2: float,
) -> Mirror | None:
    """Test one plane: unit normal (3,), axes within it (3, m), and the least sum of squares of the peers (k, 3) along these."""
    joint, record = cluster.joint, cluster.records[subject]
    start = joint.start[subject]
    here, velocity = np.array(cluster.place(subject)), joint.A[0, start + 3 : start + 6]
    centre = there.mean(axis=0)
    offsets = there - centre
    away_m = float((here - centre) @ normal)
    to_peers = here - there
    distance_m = np.maximum(np.linalg.norm(to_peers, axis=1), 1.0)
    units = to_peers / distance_m[:, np.newaxis]
    blur2 = np.empty(len(peers))
    across2 = 0.0
    for i, v in enumerate(peers):
        relative = cluster.relative(subject, v)[1]
        blur2[i] = max(float(units[i] @ relative @ units[i]), 1e-6)
        across2 = max(across2, float(normal @ relative @ normal))
    blur_m = math.sqrt(float(blur2.max()))
    if math.sqrt(least_spread_m2) < _LEAST_SPREAD_SIGMAS * blur_m:
        return None
    # Within this distance of the plane the ranges change by less than they are uncertain.
    blind_m = math.sqrt(2.0 * blur_m * float(distance_m.min()))
    if abs(away_m) > max(_NEAR_SIGMAS * math.sqrt(across2), blind_m):
        return None
    reach_m = max(abs(away_m), blind_m)
    told = 2.0 * reach_m * (offsets @ normal) / distance_m
    told2 = float(np.sum(told * told / blur2))
    for m in record.recent:
        if isinstance(m, AltitudeMeasurement) and at_s - m.measured_at_s <= _IN_USE_S:
            told2 += (2.0 * reach_m * float(normal[2]) / m.sigma_m) ** 2
            break
    if told2 > _TOLD_APART:
        return None
    speed_mps = _plane_speed(cluster, peers, offsets @ within, (here - centre) @ within, normal)
    closing = float(velocity @ normal) - speed_mps
    spread_v = math.sqrt(float(normal @ joint.A[start + 3 : start + 6, start + 3 : start + 6] @ normal))
    attitude = record.attitude
    aided = attitude is not None and at_s - attitude.measured_at_s <= cluster.settings.attitude_fresh_s
    turn = 0.0 if aided else math.sqrt(_HARDEST_TURN_MPS2 * blind_m)
    if abs(closing) > _SPEED_SIGMAS * spread_v + turn:
        return None
    if abs(float(normal[2])) > _LEVEL and abs(closing) < _SPEED_SIGMAS * spread_v:
        # Level flight beside the plane does not come to its other side.
        return None
    both = np.array([away_m, closing])
    G = np.zeros((2, SIZE))
    G[0, 0:3] = G[1, 3:6] = normal
    apart = 2.0 * float(both @ np.linalg.solve(G @ joint.covariance(subject) @ G.T, both))
    return Mirror(centre, normal, speed_mps) if apart > _SAME_PLACE else None


def _plane_speed(cluster: Cluster, peers: list[int], within_m: FloatArray, at_m: FloatArray, normal: FloatArray) -> float:
    """Return the speed along its normal, m/s, of the plane through the peers, at a place `at_m` (m,) in it.

    `within_m` (k, m) is where the peers are in it, about their mean.
    """
    joint = cluster.joint
    speeds = np.zeros(len(peers))
    for i, v in enumerate(peers):
        if not cluster.records[v].fixed:
            p = joint.start[v]
            speeds[i] = joint.A[0, p + 3 : p + 6] @ normal
    slopes = np.linalg.solve(within_m.T @ within_m, within_m.T @ speeds)
    return float(speeds.mean() + slopes @ at_m)


def reflect(cluster: Cluster, subject: int, mirror: Mirror) -> None:
    """Turn a subject's state into its mirror image, with all its covariances."""
    joint, n = cluster.joint, mirror.normal
    M = np.eye(SIZE)
    M[0:3, 0:3] -= 2.0 * np.outer(n, n)
    M[3:6, 3:6] = M[0:3, 0:3]
    # A rate about the vertical turns round in an upright mirror and stays what it is in a level one.
    M[TURN, TURN] = 2.0 * float(n[2]) ** 2 - 1.0
    offset = np.zeros(SIZE)
    offset[0:3] = 2.0 * float(mirror.at_m @ n) * n
    offset[3:6] = 2.0 * mirror.speed_mps * n
    mean = M @ joint.mean(subject) + offset
    joint.transform(subject, tuple(mean.tolist()), M, np.zeros((SIZE, SIZE)), joint.time_s[subject])


def blend(
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
