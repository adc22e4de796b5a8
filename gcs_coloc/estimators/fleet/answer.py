"""What is stated of a vehicle from the states of its cluster, or why nothing is."""

from __future__ import annotations

import numpy as np

from gcs_coloc.core.error_bound import horizontal_sigma_m
from gcs_coloc.core.measurements import Estimate, NoEstimate
from gcs_coloc.estimators.fleet.ekf._kernels import POSITION, SIZE, STAMP_ERROR, VELOCITY
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.records import IN_USE_S
from gcs_coloc.estimators.fleet.outliers import unresolved_outlier_variance_m2
from gcs_coloc.estimators.qu_zhang.dop import horizontal_dilution_of

_STEP_BACK_MOST_S = 2.0
_STATED = np.eye(6, SIZE)


def answer(cluster: Cluster, vehicle: int, at_s: float) -> Estimate | NoEstimate:
    """Return where a vehicle of a cluster is at a time near that of its states."""
    if cluster.records[vehicle].static:
        return _anchor(cluster, vehicle, at_s)
    step_s = at_s - cluster.joint.time_s[vehicle]
    if step_s < -_STEP_BACK_MOST_S:
        return NoEstimate(vehicle, at_s, f"asked for a time {-step_s:.1f} s before its newest measurement")
    x, P = cluster.predict(vehicle, at_s)
    # By the service's clock: its states go by its own.
    late_s = x.item(STAMP_ERROR)
    G = _STATED.copy()
    G[0, 3] = G[1, 4] = G[2, 5] = -late_s
    G[POSITION, STAMP_ERROR] = -x[VELOCITY]
    position, spread = x[POSITION] - late_s * x[VELOCITY], G @ P @ G.T
    covariance = spread + spread.T
    covariance *= 0.5
    unchecked_m2 = unresolved_outlier_variance_m2(cluster.records[vehicle])
    covariance[0, 0] += unchecked_m2
    covariance[1, 1] += unchecked_m2
    worst_m = horizontal_sigma_m(covariance)
    if not worst_m <= cluster.settings.limit_sigma_m:
        return NoEstimate(
            vehicle, at_s, f"too uncertain: {worst_m:.0f} m (1-sigma) horizontally; more or better placed ranges are needed"
        )
    units = [n.unit for n in cluster.records[vehicle].neighbours.values() if abs(at_s - n.at_s) <= IN_USE_S]
    hdop = horizontal_dilution_of(units) if len(units) >= 2 else None
    return Estimate(vehicle, at_s, position, x[VELOCITY].copy(), covariance, hdop, len(units))


def _anchor(cluster: Cluster, vehicle: int, at_s: float) -> Estimate:
    covariance = np.diag([0.0, 0.0, 0.0, 1e-6, 1e-6, 1e-6])
    covariance[:3, :3] = cluster.joint.covariance(vehicle)
    return Estimate(vehicle, at_s, cluster.joint.mean(vehicle).copy(), np.zeros(3), covariance, None, 0)
