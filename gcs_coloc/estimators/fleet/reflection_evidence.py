"""The mirror image that refused ranges speak for.

Ranges to two peers fit on both sides of the line through them. A vehicle that came to the wrong side far from that line, after a
time without enough ranges, finds the ranges to these two as good there, and refuses those to all others, which fit on the other
side alone. So refused ranges are held against the mirror image of the state.
"""

from __future__ import annotations

import math

import numpy as np

from gcs_coloc.core.measurements import RangeMeasurement
from gcs_coloc.estimators.fleet.ekf._kernels import POSITION
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.records import IN_USE_S, ReflectionEvidence
from gcs_coloc.estimators.fleet.ekf.update import UpdateResult
from gcs_coloc.estimators.fleet.reflection import ReflectionPlane, vertical_plane_through

_ENOUGH = 2


def update_reflection_evidence(
    before: ReflectionEvidence | None,
    cluster: Cluster,
    denied_vehicle: int,
    other: int,
    result: UpdateResult,
    m: RangeMeasurement,
) -> ReflectionEvidence | None:
    """Return what speaks for the mirror image of a denied vehicle after one more range with another vehicle."""
    if not result.used and _fits_image(cluster, denied_vehicle, other, result, m):
        return ReflectionEvidence(other, 1 if before is None else before.ranges + 1)
    return None if before is not None and before.neighbour == other else before


def plane_of_refused_ranges(
    told: ReflectionEvidence | None, cluster: Cluster, denied_vehicle: int, at_s: float
) -> ReflectionPlane | None:
    """Return the plane on whose other side a denied vehicle is by what refused ranges have told; None where too few have."""
    if told is None or told.ranges < _ENOUGH:
        return None
    return _plane(cluster, denied_vehicle, told.neighbour, at_s)


def _plane(cluster: Cluster, denied_vehicle: int, without: int, at_s: float) -> ReflectionPlane | None:
    """Return the upright plane through the two peers in use beside one; None where they are not two."""
    neighbours = cluster.records[denied_vehicle].neighbours
    peers = [v for v, n in neighbours.items() if v != without and at_s - n.at_s <= IN_USE_S and v in cluster.joint.where]
    return vertical_plane_through(cluster, denied_vehicle, peers, at_s) if len(peers) == 2 else None


def _fits_image(cluster: Cluster, denied_vehicle: int, other: int, result: UpdateResult, m: RangeMeasurement) -> bool:
    plane = _plane(cluster, denied_vehicle, other, m.measured_at_s)
    if plane is None:
        return False
    place, n = np.array(cluster.position(denied_vehicle)), plane.normal
    image = place - 2.0 * float((place - plane.point_m) @ n) * n
    miss_m = m.range_m - math.dist(image, cluster.position(other))
    variance_m2 = result.sigma_m**2 + float(np.trace(cluster.joint.covariance(denied_vehicle)[POSITION, POSITION]))
    return miss_m * miss_m <= cluster.settings.gate_sigma**2 * variance_m2
