"""The side of a line of peers that a few ranges seem to tell.

A vehicle whose ranges are missing for a while may soon be on either side of the line through two peers. The ranges that make its
place sure again are linearised where it was held to be, so they put it on that side, though the other one fits as well.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from gcs_coloc.core.error_bound import horizontal_sigma_m
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.reflection import ReflectionPlane, offset_sigmas, vertical_plane_through_line

_SURER = 0.9
_EITHER_SIGMAS = 4.0
_CLEARLY_ASIDE = 1.0


class SavedEstimate(NamedTuple):
    """Where a denied vehicle was held to be: east and north in m, their covariance in m^2, and its larger axis in m."""

    east_m: float
    north_m: float
    ee_m2: float
    en_m2: float
    nn_m2: float
    sigma_m: float


def save_estimate(cluster: Cluster, denied_vehicle: int, at_s: float | None = None) -> SavedEstimate:
    """Return where a denied vehicle is held to be at a time, by default that of its states."""
    joint = cluster.joint
    x, P = (
        (joint.mean(denied_vehicle), joint.covariance(denied_vehicle)) if at_s is None else cluster.predict(denied_vehicle, at_s)
    )
    return SavedEstimate(x.item(0), x.item(1), P.item(0, 0), P.item(0, 1), P.item(1, 1), horizontal_sigma_m(P))


def plane_after_gap(before: SavedEstimate, cluster: Cluster, denied_vehicle: int, at_s: float) -> ReflectionPlane | None:
    """Return the plane of a vehicle's peers if only ranges on its line have since told the denied vehicle on which side it is."""
    if horizontal_sigma_m(cluster.joint.covariance(denied_vehicle)) > _SURER * before.sigma_m:
        return None
    plane = vertical_plane_through_line(cluster, denied_vehicle, at_s)
    if plane is None or abs(offset_sigmas(cluster, denied_vehicle, plane)) < _CLEARLY_ASIDE:
        return None
    (e, n, _), (at_e, at_n, _) = plane.normal.tolist(), plane.point_m.tolist()
    away_m = (before.east_m - at_e) * e + (before.north_m - at_n) * n
    variance_m2 = e * e * before.ee_m2 + 2.0 * e * n * before.en_m2 + n * n * before.nn_m2
    return plane if abs(away_m) < _EITHER_SIGMAS * math.sqrt(max(variance_m2, 0.0)) else None
