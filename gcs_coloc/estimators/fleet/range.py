"""How a slant range corrects the joint state of a cluster of vehicles, and the way back where most are refused.

The correction is of second order, with the pair's own slow errors.
"""

from __future__ import annotations

import math

import numpy as np

from gcs_coloc.core.measurements import RangeMeasurement
from gcs_coloc.estimators.fleet.cluster import Cluster
from gcs_coloc.estimators.fleet.corrections import USED, UpdateResult
from gcs_coloc.estimators.fleet.joint import Key
from gcs_coloc.estimators.fleet.motion import STAMP_ERROR
from gcs_coloc.estimators.fleet.other_side import hold_against
from gcs_coloc.estimators.fleet.settings import FleetSettings
from gcs_coloc.estimators.fleet.vehicle import IN_USE_S, Neighbour, RefusedRange, VehicleRecord

_LEAST_DISTANCE_M = 1e-3
# Of a denied vehicle that is not where it is held to be four of five ranges are refused, of one that is at most one of three: the
# logarithms of how much likelier a refused and a used range are for the former, and from which sum on it is taken to be lost.
_REFUSED_TELLS, _USED_TELLS, _LOST = 0.88, -1.2, 7.0
_REFUSED_MEMORY = 0.7
_DISTRUST_KEPT = 0.8
_ALMOST_NOTHING = 1e-6
_COVERED_SIGMAS = 3.0


def take_range(cluster: Cluster, pair: Key, m: RangeMeasurement, sigma_m: float, slow_m: float) -> UpdateResult:
    """Correct with a slant range between two vehicles, whose errors are the block `pair` (`pair_key`).

    `sigma_m` is that of the range itself, `slow_m` of the part of its error that lasts.
    """
    s, joint, at_s = cluster.settings, cluster.joint, m.measured_at_s
    cluster.bring(m.from_vehicle, at_s)
    cluster.bring(m.to_vehicle, at_s)
    bias = _pair(cluster, pair, m.measured_at_s, slow_m)
    a, b = cluster.end(m.from_vehicle), cluster.end(m.to_vehicle)
    (ax, ay, az), (bx, by, bz) = a.place, b.place
    dx, dy, dz = ax - bx, ay - by, az - bz
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if distance < _LEAST_DISTANCE_M:
        return UpdateResult("refused: both ends estimated at one place")
    unit = ux, uy, uz = (dx / distance, dy / distance, dz / distance)
    (ave, avn, avu), (bve, bvn, bvu) = a.velocity, b.velocity
    closing = ux * (ave - bve) + uy * (avn - bvn) + uz * (avu - bvu)
    # In the first row the range itself: the distance and its errors.
    G = cluster.way(a, b, unit)
    G[0, bias] = G[0, bias + 1] = 1.0
    errors = joint.A.item(0, bias) + joint.A.item(0, bias + 1)
    clock = a if m.clock_of == a.vehicle else b if m.clock_of == b.vehicle else None
    if clock is not None and clock.late_s is not None:
        # It is of as much later than it says as the reports of the vehicle that stamped it.
        G[0, clock.where.start + STAMP_ERROR] += closing
        errors += closing * clock.late_s
    HA, S = joint.foresee(G)
    (first_order, *_), (_, xx, xy, xz), (_, yx, yy, yz), (_, zx, zy, zz) = S.tolist()
    mx, my, mz = xx * ux + xy * uy + xz * uz, yx * ux + yy * uy + yz * uz, zx * ux + zy * uy + zz * uz
    along = ux * mx + uy * my + uz * mz
    # Second order: a range to an uncertain place is on average longer than to its mean, and its spread grows.
    across_trace = max(xx + yy + zz - along, 0.0)
    norm2 = xx * xx + yy * yy + zz * zz + xy * xy + yx * yx + xz * xz + zx * zx + yz * yz + zy * zy
    square = norm2 - 2.0 * (mx * mx + my * my + mz * mz) + along * along
    longer = 0.5 * across_trace / distance
    spread = max(0.5 * square / (distance * distance), 0.0)
    noise = sigma_m * sigma_m + _distrust_m2(cluster, m) + (closing * s.stamp_sigma_s) ** 2
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
    cluster.watch(a.vehicle, W, whitened, at_s)
    cluster.watch(b.vehicle, W, whitened, at_s)
    return UpdateResult(USED, innovation, sigma, nis, 1, unit)


def _pair(cluster: Cluster, pair: Key, at_s: float, slow_m: float) -> int:
    """Bring the pair's two range errors (bias and slow part) to the time of a range; return the index of the first."""
    s, joint = cluster.settings, cluster.joint
    sigmas = (s.range_bias_sigma_m, slow_m)
    if pair not in joint.where:
        joint.append(pair, np.zeros(2), np.diag(np.square(sigmas)), at_s)
        return len(joint.A) - len(sigmas)
    index: int = joint.where[pair].start
    step_s = at_s - joint.time_s[pair]
    if step_s > 0.0:
        decays = (math.exp(-step_s / s.range_bias_time_s), math.exp(-step_s / s.range_slow_time_s))
        joint.fade(pair, decays, sigmas)
        joint.time_s[pair] = at_s
    return index


def _distrust_m2(cluster: Cluster, m: RangeMeasurement) -> float:
    """Return the variance that a range is given beyond its own, m^2, since its vehicle was found to be lost."""
    return max(cluster.records[m.from_vehicle].distrust_m2, cluster.records[m.to_vehicle].distrust_m2)


def account(cluster: Cluster, vehicle: int, other: int, verdict: UpdateResult, m: RangeMeasurement) -> None:
    """Note at a denied vehicle what became of its range with another vehicle, and find the way back when most are refused."""
    record = cluster.records[vehicle]
    if verdict.degrees_of_freedom > 0:
        record.other_side = hold_against(record.other_side, cluster, vehicle, other, verdict, m)
    if verdict.used:
        record.neighbours[other] = Neighbour(m.measured_at_s, verdict.unit)
        record.informed_at_s = m.measured_at_s
        doubt = record.unchecked
        if doubt is None or doubt.neighbour == other or _contradicted(record, doubt, m.measured_at_s, cluster.settings):
            record.lost_evidence = max(record.lost_evidence + _USED_TELLS, 0.0)
            record.unchecked = None
        record.distrust_m2 *= _DISTRUST_KEPT
        return
    if verdict.degrees_of_freedom == 0:
        return
    square, kept = verdict.innovation_m**2, _REFUSED_MEMORY if record.lost_evidence > 0.0 else 0.0
    record.refused_m2 = kept * record.refused_m2 + (1.0 - kept) * square
    record.lost_evidence += _REFUSED_TELLS
    refused = RefusedRange(other, verdict.unit, verdict.nis)
    record.unchecked = None if _contradicted(record, refused, m.measured_at_s, cluster.settings) else refused
    if record.lost_evidence > _LOST:
        # Most of what is heard contradicts the state: the state is what is wrong, or nobody can tell. So the next ranges are
        # believed no more than the state is, until some have agreed with each other.
        cluster.widen(vehicle, record.refused_m2)
        record.distrust_m2 = record.refused_m2
        record.lost_evidence = 0.0
        record.unchecked = None


def unchecked_variance_m2(record: VehicleRecord) -> float:
    """Return the variance, m^2, by which a vehicle is known worse while nobody can tell whether it or a refused range is off.

    It has what the refused ranges say within three sigmas, from the second in a row on: a single one is an outlier.
    """
    if record.unchecked is None or record.lost_evidence < 2.0 * _REFUSED_TELLS:
        return 0.0
    return record.refused_m2 / _COVERED_SIGMAS**2


def _contradicted(record: VehicleRecord, refused: RefusedRange, at_s: float, s: FleetSettings) -> bool:
    """Whether the ranges in use would show it if the denied vehicle were off by what a refused one says it is.

    Of all horizontal displacements that explain the refused range, the one that the others notice least moves these by the
    innovation times the root of 1 / (u' N^-1 u): N is the sum of their own u u', u a unit vector along the range. With one other
    peer that is nothing.
    """
    ee = nn = _ALMOST_NOTHING
    en = 0.0
    for vehicle, neighbour in record.neighbours.items():
        if vehicle != refused.neighbour and at_s - neighbour.at_s <= IN_USE_S:
            e, n, _ = neighbour.unit
            ee, en, nn = ee + e * e, en + e * n, nn + n * n
    e, n, _ = refused.unit
    least = e * e * nn - 2.0 * e * n * en + n * n * ee
    return refused.nis * (ee * nn - en * en) > s.gate_sigma**2 * least
