"""The mirror image that refused ranges speak for.

Ranges to two peers fit on both sides of the line through them. A vehicle that came to the wrong side far from that line, after a
time without enough ranges, finds the ranges to these two as good there, and refuses those to all others, which fit on the other
side alone. So refused ranges are held against the mirror image of the state.
"""

from __future__ import annotations

import math

import numpy as np

from gcs_coloc.core.measurements import RangeMeasurement
from gcs_coloc.estimators.fleet.cluster import Cluster
from gcs_coloc.estimators.fleet.corrections import UpdateResult
from gcs_coloc.estimators.fleet.mirror import Mirror, upright_through
from gcs_coloc.estimators.fleet.motion import POSITION
from gcs_coloc.estimators.fleet.vehicle import IN_USE_S, OtherSide

_ENOUGH = 2


def hold_against(
    before: OtherSide | None, cluster: Cluster, denied_vehicle: int, other: int, verdict: UpdateResult, m: RangeMeasurement
) -> OtherSide | None:
    """Return what speaks for the mirror image of a denied vehicle after one more range with another vehicle."""
    if not verdict.used and _fits_image(cluster, denied_vehicle, other, verdict, m):
        return OtherSide(other, 1 if before is None else before.ranges + 1)
    return None if before is not None and before.neighbour == other else before


def find_other_side(told: OtherSide | None, cluster: Cluster, denied_vehicle: int, at_s: float) -> Mirror | None:
    """Return the plane on whose other side a denied vehicle is by what refused ranges have told; None where too few have."""
    if told is None or told.ranges < _ENOUGH:
        return None
    return _plane(cluster, denied_vehicle, told.neighbour, at_s)


def _plane(cluster: Cluster, denied_vehicle: int, without: int, at_s: float) -> Mirror | None:
    """Return the upright plane through the two peers in use beside one; None where they are not two."""
    neighbours = cluster.records[denied_vehicle].neighbours
    peers = [v for v, n in neighbours.items() if v != without and at_s - n.at_s <= IN_USE_S and v in cluster.joint.where]
    return upright_through(cluster, denied_vehicle, peers, at_s) if len(peers) == 2 else None


def _fits_image(cluster: Cluster, denied_vehicle: int, other: int, verdict: UpdateResult, m: RangeMeasurement) -> bool:
    mirror = _plane(cluster, denied_vehicle, other, m.measured_at_s)
    if mirror is None:
        return False
    place, n = np.array(cluster.place(denied_vehicle)), mirror.normal
    image = place - 2.0 * float((place - mirror.at_m) @ n) * n
    miss_m = m.range_m - math.dist(image, cluster.place(other))
    variance_m2 = verdict.sigma_m**2 + float(np.trace(cluster.joint.covariance(denied_vehicle)[POSITION, POSITION]))
    return miss_m * miss_m <= cluster.settings.gate_sigma**2 * variance_m2
