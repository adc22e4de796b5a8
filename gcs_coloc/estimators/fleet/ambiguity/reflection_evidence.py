"""Evidence that a denied vehicle's state may be on the wrong side of its peers: refused ranges, and gaps without ranges.

Ranges to two peers fit on both sides of the line through them. A vehicle that came to the wrong side finds the ranges to these
two fitting and refuses all others, which fit on the other side alone. After a gap in the ranges a vehicle may be on either
side; the next ranges are linearised at the predicted position, so they confirm the side of the prediction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import RangeMeasurement
from gcs_coloc.estimators.fleet.ambiguity.reflection import (
    ReflectionPlane,
    offset_sigmas,
    vertical_plane_through,
    vertical_plane_through_line,
)
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.outcomes import UpdateResult
from gcs_coloc.estimators.fleet.ekf.records import IN_USE_S, ReflectionEvidence
from gcs_coloc.estimators.fleet.ekf.state import POSITION

_ENOUGH_RANGES = 2
"""Chosen: two refused ranges in a row that fit the reflected position open a hypothesis; one may be multipath."""
_SMALLER_SHARE = 0.9
"""Chosen: the ranges after a gap count as informative where they reduced the sigma by a tenth."""
_EITHER_SIDE_SIGMAS = 4.0
"""Chosen: as the gate; a plane within so many sigmas of the saved estimate leaves both sides possible."""
_CLEARLY_ASIDE_SIGMAS = 1.0
"""Chosen: nearer to the plane both hypotheses would be one."""


class SavedEstimate(NamedTuple):
    """The horizontal estimate of a denied vehicle before a range: mean in m, covariance in m^2, larger sigma in m."""

    east_m: float
    north_m: float
    ee_m2: float
    en_m2: float
    nn_m2: float
    sigma_m: float


def save_estimate(cluster: Cluster, denied_vehicle: int, at_s: float | None = None) -> SavedEstimate:
    """Return the horizontal estimate of a denied vehicle at a time, by default that of its states."""
    joint = cluster.joint
    x, P = (
        (joint.mean(denied_vehicle), joint.covariance(denied_vehicle)) if at_s is None else cluster.predict(denied_vehicle, at_s)
    )
    return SavedEstimate(x.item(0), x.item(1), P.item(0, 0), P.item(0, 1), P.item(1, 1), horizontal_sigma_m(P))


def plane_after_gap(before: SavedEstimate, cluster: Cluster, denied_vehicle: int, at_s: float) -> ReflectionPlane | None:
    """Return the plane through the peers where only ranges after a gap decided the side; None where they did not."""
    if horizontal_sigma_m(cluster.joint.covariance(denied_vehicle)) > _SMALLER_SHARE * before.sigma_m:
        return None
    plane = vertical_plane_through_line(cluster, denied_vehicle, at_s)
    if plane is None or abs(offset_sigmas(cluster, denied_vehicle, plane)) < _CLEARLY_ASIDE_SIGMAS:
        return None
    (e, n, _), (at_e, at_n, _) = plane.normal.tolist(), plane.point_m.tolist()
    offset_m = (before.east_m - at_e) * e + (before.north_m - at_n) * n
    variance_m2 = e * e * before.ee_m2 + 2.0 * e * n * before.en_m2 + n * n * before.nn_m2
    return plane if abs(offset_m) < _EITHER_SIDE_SIGMAS * math.sqrt(max(variance_m2, 0.0)) else None


def update_reflection_evidence(
    before: ReflectionEvidence | None,
    cluster: Cluster,
    denied_vehicle: int,
    other: int,
    result: UpdateResult,
    m: RangeMeasurement,
) -> ReflectionEvidence | None:
    """Return the evidence for the reflected state of a denied vehicle after one more range with another vehicle."""
    if not result.used and _fits_reflection(cluster, denied_vehicle, other, result, m):
        return ReflectionEvidence(other, 1 if before is None else before.ranges + 1)
    return None if before is not None and before.neighbour == other else before


def plane_of_refused_ranges(
    evidence: ReflectionEvidence | None, cluster: Cluster, denied_vehicle: int, at_s: float
) -> ReflectionPlane | None:
    """Return the plane on whose other side the refused ranges place a denied vehicle; None where they are too few."""
    if evidence is None or evidence.ranges < _ENOUGH_RANGES:
        return None
    return _plane_without(cluster, denied_vehicle, evidence.neighbour, at_s)


def _plane_without(cluster: Cluster, denied_vehicle: int, neighbour: int, at_s: float) -> ReflectionPlane | None:
    """Return the vertical plane through the two peers in use beside one neighbour; None where they are not two."""
    neighbours = cluster.records[denied_vehicle].neighbours
    peers = [v for v, n in neighbours.items() if v != neighbour and at_s - n.at_s <= IN_USE_S and v in cluster.joint.where]
    return vertical_plane_through(cluster, denied_vehicle, peers, at_s) if len(peers) == 2 else None


def _fits_reflection(cluster: Cluster, denied_vehicle: int, other: int, result: UpdateResult, m: RangeMeasurement) -> bool:
    plane = _plane_without(cluster, denied_vehicle, other, m.measured_at_s)
    if plane is None:
        return False
    position, n = np.array(cluster.position(denied_vehicle)), plane.normal
    reflected = position - 2.0 * float((position - plane.point_m) @ n) * n
    residual_m = m.range_m - math.dist(reflected, cluster.position(other))
    variance_m2 = result.sigma_m**2 + float(np.trace(cluster.joint.covariance(denied_vehicle)[POSITION, POSITION]))
    return residual_m * residual_m <= cluster.settings.gate_sigma**2 * variance_m2
