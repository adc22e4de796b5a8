"""Estimates of the fleet filter as they are stated, from a vehicle's states or from its search."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_dilution_of, horizontal_sigma_m
from gcs_coloc.core.measurements import Estimate, NoEstimate, NoEstimateReason, Unlocated
from gcs_coloc.estimators.fleet.ambiguity.curved_ranges import FAR_SIGMAS, curvature_covariances
from gcs_coloc.estimators.fleet.ambiguity.range_evidence import unresolved_outlier_variance_m2
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.possible_motion import BOUND_95_SIGMAS, HORIZONTAL, add_motion
from gcs_coloc.estimators.fleet.ekf.process_model import gap_covariance
from gcs_coloc.estimators.fleet.ekf.records import VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import POSITION, SIZE, TIME_STAMP_OFFSET, VELOCITY
from gcs_coloc.estimators.fleet.gaps import untold_motion
from gcs_coloc.estimators.fleet.observed_biases import unknown_bias_covariance
from gcs_coloc.estimators.fleet.search.position_search import PositionSearch
from gcs_coloc.estimators.fleet.searched_vehicles import predicted_search
from gcs_coloc.estimators.fleet.settings import FleetSettings

_STEP_BACK_MOST_S = 2.0  # chosen: further back the prediction with negative steps does not hold
_LIMIT_SHARE = (BOUND_95_SIGMAS / FAR_SIGMAS) ** 2
"""What a vehicle can do is a limit: its 95 % bound is that of the protection level as well."""
_STATED = np.eye(6, SIZE)  # position and velocity of a vehicle's block


def estimate_of_cluster(cluster: Cluster, vehicle: int, at_s: float) -> Estimate | NoEstimate:
    """Estimate a vehicle of a cluster on the service's clock, eq. (10): p - tau v with its covariance."""
    record = cluster.records[vehicle]
    if record.static:
        covariance = np.diag([0.0, 0.0, 0.0, 1e-6, 1e-6, 1e-6])
        covariance[:3, :3] = cluster.joint.covariance(vehicle)
        return Estimate(vehicle, at_s, cluster.joint.mean(vehicle).copy(), np.zeros(3), covariance, None, 0)
    step_s = at_s - cluster.joint.time_s[vehicle]
    if step_s < -_STEP_BACK_MOST_S:
        return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.BEFORE_MEASUREMENTS, -step_s))
    x, P = cluster.predict(vehicle, at_s)
    offset_s = x.item(TIME_STAMP_OFFSET)
    G = _STATED.copy()
    G[0, 3] = G[1, 4] = G[2, 5] = -offset_s
    G[POSITION, TIME_STAMP_OFFSET] = -x[VELOCITY]
    position, spread = x[POSITION] - offset_s * x[VELOCITY], G @ P @ G.T
    covariance = spread + spread.T
    covariance *= 0.5
    curved = curvature_covariances(cluster, vehicle, covariance, at_s) if record.denied_vehicle else None
    far = None
    if curved is not None:
        near_m2, far_m2 = curved
        far = covariance[:2, :2] + far_m2
        covariance[:2, :2] += near_m2
    if record.unknown_bias is not None:
        unknown = unknown_bias_covariance(cluster, vehicle, step_s - offset_s)
        covariance += unknown
        if far is not None:
            far += unknown[:2, :2]
    gap_m2, gap_m2ps2, gap_both = gap_covariance(record, cluster.settings, at_s)
    added_m2 = gap_m2 + unresolved_outlier_variance_m2(record)
    add_motion(covariance, (added_m2, gap_m2ps2, gap_both))
    if far is not None:
        far += added_m2 * np.eye(2)
    units = list(cluster.peers_in_use(vehicle, at_s).values())
    hdop = horizontal_dilution_of(units) if len(units) >= 2 else None
    refuses_air_data = record.air_check.is_refused
    air_s = record.attitude.measured_at_s if record.attitude is not None else -math.inf
    velocity = x[VELOCITY].copy()
    where = Estimate(vehicle, at_s, position, velocity, covariance, hdop, len(units), None, far, refuses_air_data, air_s)
    return _if_known_well(where, cluster.settings)


def estimate_of_search(
    vehicle: int, record: VehicleRecord, search: PositionSearch, at_s: float, settings: FleetSettings
) -> Estimate | NoEstimate:
    """Estimate a denied vehicle that is searched, where all places that fit are one."""
    place = None if search.is_open else predicted_search(search, record.profile, at_s, settings).place()
    if place is None:
        return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.SEVERAL_PLACES, len(search.mean)))
    mean, covariance = place
    return _if_known_well(Estimate(vehicle, at_s, mean[:3], mean[3:], covariance, None, len(record.neighbours)), settings)


def with_possible_motion(where: Estimate, record: VehicleRecord, settings: FleetSettings) -> Estimate | NoEstimate:
    """Return an estimate with the motion added that no range has ruled out, eq. (29) and (37).

    This includes motion of which no range could tell. Where it makes the estimate too uncertain, a `NoEstimate` is returned.
    """
    at_s = where.at_s
    motion = untold_motion(record, settings, at_s) if record.unshown is None else record.unshown.covariance(at_s)
    if motion is None:
        return where
    covariance = where.covariance.copy()
    covariance[HORIZONTAL] += motion
    far = where.protected_covariance[:2, :2] + _LIMIT_SHARE * motion[:2, :2]
    return _if_known_well(replace(where, covariance=covariance, far_covariance=far), settings)


def _if_known_well(where: Estimate, settings: FleetSettings) -> Estimate | NoEstimate:
    worst_m = horizontal_sigma_m(where.covariance)
    if worst_m <= settings.limit_sigma_m:
        return where
    return NoEstimate(where.vehicle, where.at_s, Unlocated(NoEstimateReason.TOO_UNCERTAIN, worst_m))
