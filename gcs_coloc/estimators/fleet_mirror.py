"""The mirror image of a subject that ranges peers near one line: when the filter may have taken it, and what it is.

Ranges with peers on one line are the same on both sides of it. Near the line they hardly tell the motion across it either, so a
turn there leads to either side unseen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import FloatArray
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


@dataclass(frozen=True, slots=True)
class Mirror:
    """A line through `at_m` (east, north) with the unit normal `normal`; at the subject it moves along it at `speed_mps`."""

    at_m: FloatArray
    normal: FloatArray
    speed_mps: float


def find_mirror(cluster: Cluster, subject: int, at_s: float) -> Mirror | None:
    """Return the line of a subject's peers if the ranges do not tell on which side of it the subject is going to leave it.

    None where the peers are not on one line, where the subject is too far from it to have changed the side, where it crosses
    so fast that it cannot have turned back within the stretch in which the ranges are blind across the line, or where its
    mirror image is as yet the same as the state.
    """
    joint, record = cluster.joint, cluster.records[subject]
    peers = [v for v, n in record.neighbours.items() if at_s - n.at_s <= _IN_USE_S and v in joint.start]
    if len(peers) < 2:
        return None
    start = joint.start[subject]
    there = np.array([cluster.place(v)[:2] for v in peers])
    here, velocity = cluster.place(subject)[:2], joint.x[start + 3 : start + 5]
    centre = there.mean(axis=0)
    offsets = there - centre
    spreads, axes = np.linalg.eigh(offsets.T @ offsets)
    normal, along = axes[:, 0], axes[:, 1]
    away_m = float((here - centre) @ normal)
    to_peers = here - there
    distance_m = np.maximum(np.hypot(to_peers[:, 0], to_peers[:, 1]), 1.0)
    units = to_peers / distance_m[:, np.newaxis]
    blur2 = np.empty(len(peers))
    across2 = 0.0
    for i, v in enumerate(peers):
        relative = cluster.relative(subject, v)[1][:2, :2]
        blur2[i] = max(float(units[i] @ relative @ units[i]), 1e-6)
        across2 = max(across2, float(normal @ relative @ normal))
    blur_m = math.sqrt(float(blur2.max()))
    if math.sqrt(float(spreads[1])) < _LEAST_SPREAD_SIGMAS * blur_m:
        return None
    # Within this distance of the line the ranges change by less than they are uncertain.
    blind_m = math.sqrt(2.0 * blur_m * float(distance_m.min()))
    if abs(away_m) > max(_NEAR_SIGMAS * math.sqrt(across2), blind_m):
        return None
    reach_m = max(abs(away_m), blind_m)
    told = 2.0 * reach_m * (offsets @ normal) / distance_m
    if float(np.sum(told * told / blur2)) > _TOLD_APART:
        return None
    speed_mps = _line_speed(cluster, peers, offsets @ along, float((here - centre) @ along), normal)
    closing = float(velocity @ normal) - speed_mps
    spread_v = math.sqrt(float(normal @ joint.P[start + 3 : start + 5, start + 3 : start + 5] @ normal))
    attitude = record.attitude
    aided = attitude is not None and at_s - attitude.measured_at_s <= cluster.settings.attitude_fresh_s
    turn = 0.0 if aided else math.sqrt(_HARDEST_TURN_MPS2 * blind_m)
    if abs(closing) > _SPEED_SIGMAS * spread_v + turn:
        return None
    both = np.array([away_m, closing])
    G = np.zeros((2, SIZE))
    G[0, 0:2] = G[1, 3:5] = normal
    where = joint.slice(subject)
    apart = 2.0 * float(both @ np.linalg.solve(G @ joint.P[where, where] @ G.T, both))
    return Mirror(centre, normal, speed_mps) if apart > _SAME_PLACE else None


def _line_speed(cluster: Cluster, peers: list[int], abscissae_m: FloatArray, at_m: float, normal: FloatArray) -> float:
    """Return the speed along its normal, in m/s, of the line through the peers, at a place along it."""
    joint = cluster.joint
    speeds = np.zeros(len(peers))
    for i, v in enumerate(peers):
        if not cluster.records[v].fixed:
            p = joint.start[v]
            speeds[i] = joint.x[p + 3 : p + 5] @ normal
    slope = float(abscissae_m @ speeds) / float(abscissae_m @ abscissae_m)
    return float(speeds.mean()) + slope * at_m


def reflect(cluster: Cluster, subject: int, mirror: Mirror) -> None:
    """Turn a subject's state into its mirror image, with all its covariances."""
    joint = cluster.joint
    where = joint.slice(subject)
    n = mirror.normal
    M = np.eye(SIZE)
    M[0:2, 0:2] -= 2.0 * np.outer(n, n)
    M[3:5, 3:5] = M[0:2, 0:2]
    M[TURN, TURN] = -1.0
    offset = np.zeros(SIZE)
    offset[0:2] = 2.0 * float(mirror.at_m @ n) * n
    offset[3:5] = 2.0 * mirror.speed_mps * n
    joint.x[where] = M @ joint.x[where] + offset
    rows = M @ joint.P[where]
    block = rows[:, where] @ M.T
    joint.P[where] = rows
    joint.P[:, where] = rows.T
    joint.P[where, where] = 0.5 * (block + block.T)


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
