"""How a slant range corrects the joint state of a cluster of vehicles, and the way back where most are refused.

The correction is of second order, with the pair's own slow errors.
"""

from __future__ import annotations

import math

import numpy as np

from gcs_coloc.core.measurements import RangeMeasurement
from gcs_coloc.estimators.fleet.ekf._kernels import STAMP_ERROR
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.state import Key
from gcs_coloc.estimators.fleet.ekf.update import USED, UpdateResult

_LEAST_DISTANCE_M = 1e-3


def update_range(cluster: Cluster, pair: Key, m: RangeMeasurement, sigma_m: float, slow_m: float) -> UpdateResult:
    """Correct with a slant range between two vehicles, whose errors are the block `pair` (`pair_key`).

    `sigma_m` is that of the range itself, `slow_m` of the part of its error that lasts.
    """
    s, joint, at_s = cluster.settings, cluster.joint, m.measured_at_s
    cluster.propagate(m.from_vehicle, at_s)
    cluster.propagate(m.to_vehicle, at_s)
    bias = _pair(cluster, pair, m.measured_at_s, slow_m)
    a, b = cluster.range_end(m.from_vehicle), cluster.range_end(m.to_vehicle)
    (ax, ay, az), (bx, by, bz) = a.position, b.position
    dx, dy, dz = ax - bx, ay - by, az - bz
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if distance < _LEAST_DISTANCE_M:
        return UpdateResult("refused: both ends estimated at one place")
    unit = ux, uy, uz = (dx / distance, dy / distance, dz / distance)
    (ave, avn, avu), (bve, bvn, bvu) = a.velocity, b.velocity
    closing = ux * (ave - bve) + uy * (avn - bvn) + uz * (avu - bvu)
    # In the first row the range itself: the distance and its errors.
    G = cluster.range_jacobian(a, b, unit)
    G[0, bias] = G[0, bias + 1] = 1.0
    errors = joint.A.item(0, bias) + joint.A.item(0, bias + 1)
    clock = a if m.clock_of == a.vehicle else b if m.clock_of == b.vehicle else None
    if clock is not None and clock.time_stamp_offset_s is not None:
        # It is of as much later than it says as the reports of the vehicle that stamped it.
        G[0, clock.where.start + STAMP_ERROR] += closing
        errors += closing * clock.time_stamp_offset_s
    HA, S = joint.predict_measurement(G)
    (first_order, *_), (_, xx, xy, xz), (_, yx, yy, yz), (_, zx, zy, zz) = S.tolist()
    mx, my, mz = xx * ux + xy * uy + xz * uz, yx * ux + yy * uy + yz * uz, zx * ux + zy * uy + zz * uz
    along = ux * mx + uy * my + uz * mz
    # Second order: a range to an uncertain place is on average longer than to its mean, and its spread grows.
    across_trace = max(xx + yy + zz - along, 0.0)
    norm2 = xx * xx + yy * yy + zz * zz + xy * xy + yx * yx + xz * xz + zx * zx + yz * yz + zy * zy
    square = norm2 - 2.0 * (mx * mx + my * my + mz * mz) + along * along
    longer = 0.5 * across_trace / distance
    spread = max(0.5 * square / (distance * distance), 0.0)
    noise = sigma_m * sigma_m + _range_noise_inflation_m2(cluster, m) + (closing * s.stamp_sigma_s) ** 2
    # The expansion fails where the uncertainty is as large as the distance: there it may not outgrow the first order.
    spread = min(spread, along + noise)
    longer = min(longer, math.sqrt(along + noise))
    variance = first_order + spread + noise
    innovation = m.range_m - (distance + longer + errors)
    hA = HA[0]
    hA[0] = -innovation
    nis = innovation * innovation / variance
    sigma = math.sqrt(variance)
    if nis > s.gate_sigma**2:
        return UpdateResult("refused: range outside the gate", innovation, sigma, nis, 1, (ux, uy, uz))
    if nis > s.doubt_sigma**2:
        # Huber's weight: beyond the doubt the pull of an innovation grows no more.
        variance *= math.sqrt(nis) / s.doubt_sigma
    W = joint.correct_scalar(hA, variance)
    whitened = (innovation / math.sqrt(variance),)
    cluster.update_manoeuvre_detector(a.vehicle, W, whitened, at_s)
    cluster.update_manoeuvre_detector(b.vehicle, W, whitened, at_s)
    return UpdateResult(USED, innovation, sigma, nis, 1, unit)


def _pair(cluster: Cluster, pair: Key, at_s: float, slow_m: float) -> int:
    """Bring the pair's two range errors (bias and slow part) to the time of a range; return the index of the first."""
    s, joint = cluster.settings, cluster.joint
    sigmas = (s.range_bias_sigma_m, slow_m)
    if pair not in joint.where:
        joint.augment(pair, np.zeros(2), np.diag(np.square(sigmas)), at_s)
        return len(joint.A) - len(sigmas)
    index: int = joint.where[pair].start
    step_s = at_s - joint.time_s[pair]
    if step_s > 0.0:
        decays = (math.exp(-step_s / s.range_bias_time_s), math.exp(-step_s / s.range_slow_time_s))
        joint.decay(pair, decays, sigmas)
        joint.time_s[pair] = at_s
    return index


def _range_noise_inflation_m2(cluster: Cluster, m: RangeMeasurement) -> float:
    """Return the variance that a range is given beyond its own, m^2, since its vehicle was found to be lost."""
    return max(cluster.records[m.from_vehicle].range_noise_inflation_m2, cluster.records[m.to_vehicle].range_noise_inflation_m2)
