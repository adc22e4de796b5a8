"""What refused ranges say of the state: CUSUM test for a wrong state, covariance inflation, unresolved outliers."""

from __future__ import annotations

from gcs_coloc.core.measurements import RangeMeasurement
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.records import IN_USE_S, Neighbour, UnresolvedOutlier, VehicleRecord
from gcs_coloc.estimators.fleet.ekf.update import UpdateResult
from gcs_coloc.estimators.fleet.reflection_evidence import update_reflection_evidence
from gcs_coloc.estimators.fleet.settings import FleetSettings

# Of a denied vehicle that is not where it is held to be four of five ranges are refused, of one that is at most one of three: the
# logarithms of how much likelier a refused and a used range are for the former, and from which sum on it is taken to be lost.
_REFUSED_TELLS, _USED_TELLS, _LOST = 0.88, -1.2, 7.0
_REFUSED_MEMORY = 0.7
_DISTRUST_KEPT = 0.8
_ALMOST_NOTHING = 1e-6
_COVERED_SIGMAS = 3.0


def monitor_range(cluster: Cluster, vehicle: int, other: int, result: UpdateResult, m: RangeMeasurement) -> None:
    """Note at a denied vehicle what became of its range with another vehicle, and find the way back when most are refused."""
    record = cluster.records[vehicle]
    if result.degrees_of_freedom > 0:
        record.reflection_evidence = update_reflection_evidence(record.reflection_evidence, cluster, vehicle, other, result, m)
    if result.used:
        record.neighbours[other] = Neighbour(m.measured_at_s, result.unit)
        record.updated_at_s = m.measured_at_s
        doubt = record.unresolved_outlier
        if doubt is None or doubt.neighbour == other or _is_resolved(record, doubt, m.measured_at_s, cluster.settings):
            record.cusum = max(record.cusum + _USED_TELLS, 0.0)
            record.unresolved_outlier = None
        record.range_noise_inflation_m2 *= _DISTRUST_KEPT
        return
    if result.degrees_of_freedom == 0:
        return
    square, kept = result.innovation_m**2, _REFUSED_MEMORY if record.cusum > 0.0 else 0.0
    record.refused_innovation_m2 = kept * record.refused_innovation_m2 + (1.0 - kept) * square
    record.cusum += _REFUSED_TELLS
    refused = UnresolvedOutlier(other, result.unit, result.nis)
    record.unresolved_outlier = None if _is_resolved(record, refused, m.measured_at_s, cluster.settings) else refused
    if record.cusum > _LOST:
        # Most of what is heard contradicts the state: the state is what is wrong, or nobody can tell. So the next ranges are
        # believed no more than the state is, until some have agreed with each other.
        cluster.inflate_covariance(vehicle, record.refused_innovation_m2)
        record.range_noise_inflation_m2 = record.refused_innovation_m2
        record.cusum = 0.0
        record.unresolved_outlier = None


def unresolved_outlier_variance_m2(record: VehicleRecord) -> float:
    """Return the variance, m^2, by which a vehicle is known worse while nobody can tell whether it or a refused range is off.

    It has what the refused ranges say within three sigmas, from the second in a row on: a single one is an outlier.
    """
    if record.unresolved_outlier is None or record.cusum < 2.0 * _REFUSED_TELLS:
        return 0.0
    return record.refused_innovation_m2 / _COVERED_SIGMAS**2


def _is_resolved(record: VehicleRecord, refused: UnresolvedOutlier, at_s: float, s: FleetSettings) -> bool:
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
