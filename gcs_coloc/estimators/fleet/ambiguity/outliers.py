"""What refused ranges say of a denied vehicle's state: CUSUM test, covariance inflation, unresolved outliers.

A gate that locks itself out is the worst failure of a filter: confident and lost. So the refused ranges of a denied vehicle are
evidence that its state is wrong, the used ones that it is right, eq. (21).
"""

from __future__ import annotations

from gcs_coloc.core.measurements import RangeMeasurement
from gcs_coloc.estimators.fleet.ambiguity.reflection_evidence import update_reflection_evidence
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.outcomes import UpdateResult
from gcs_coloc.estimators.fleet.ekf.records import IN_USE_S, Neighbour, UnresolvedOutlier, VehicleRecord
from gcs_coloc.estimators.fleet.settings import FleetSettings

_CUSUM_REFUSED = 0.88
"""Log-likelihood ratio of a refused range: ln(0.8 / 0.33), four of five are refused in a wrong state, one of three at most
in a right one."""
_CUSUM_USED = -1.2
"""Log-likelihood ratio of a used range: ln(0.2 / 0.67)."""
_CUSUM_LIMIT = 7.0
"""Chosen: eight refused ranges in a row; fewer inflate on multipath, more let a wrong state stand longer."""
_REFUSED_MEMORY = 0.7
"""Chosen: share of the mean squared innovation that the next refused range keeps: the mean of the last three."""
_INFLATION_KEPT = 0.8
"""Chosen: each used range takes a fifth of the noise inflation away: half is gone after three ranges that agree."""
_LEAST_INFORMATION = 1e-6
"""Keeps the determinant of the direction matrix positive with one neighbour."""
_COVERED_SIGMAS = 3.0
"""Chosen: the state that an unresolved outlier speaks for is within three sigmas of the estimate."""


def monitor_range(cluster: Cluster, vehicle: int, other: int, result: UpdateResult, m: RangeMeasurement) -> None:
    """Record the result of a denied vehicle's range with another vehicle; inflate its covariance when the CUSUM test fails."""
    record = cluster.records[vehicle]
    if result.degrees_of_freedom > 0:
        record.reflection_evidence = update_reflection_evidence(record.reflection_evidence, cluster, vehicle, other, result, m)
    if result.used:
        record.neighbours[other] = Neighbour(m.measured_at_s, result.unit)
        record.updated_at_s = m.measured_at_s
        outlier = record.unresolved_outlier
        if outlier is None or outlier.neighbour == other or _is_resolved(record, outlier, m.measured_at_s, cluster.settings):
            record.cusum = max(record.cusum + _CUSUM_USED, 0.0)
            record.unresolved_outlier = None
        record.range_noise_inflation_m2 *= _INFLATION_KEPT
        return
    if result.degrees_of_freedom == 0:
        return
    square, kept = result.innovation_m**2, _REFUSED_MEMORY if record.cusum > 0.0 else 0.0
    record.refused_innovation_m2 = kept * record.refused_innovation_m2 + (1.0 - kept) * square
    record.cusum += _CUSUM_REFUSED
    refused = UnresolvedOutlier(other, result.unit, result.nis)
    record.unresolved_outlier = None if _is_resolved(record, refused, m.measured_at_s, cluster.settings) else refused
    if record.cusum > _CUSUM_LIMIT:
        # The first ranges after the inflation may be the wrong ones: their noise is inflated too, until some have agreed.
        cluster.inflate_covariance(vehicle, record.refused_innovation_m2)
        record.range_noise_inflation_m2 = record.refused_innovation_m2
        record.cusum = 0.0
        record.unresolved_outlier = None


def unresolved_outlier_variance_m2(record: VehicleRecord) -> float:
    """Return the variance (m^2) to add to an estimate while it is unresolved whether the state or a refused range is wrong.

    It counts from the second refused range in a row on: a single one is an outlier.
    """
    if record.unresolved_outlier is None or record.cusum < 2.0 * _CUSUM_REFUSED:
        return 0.0
    return record.refused_innovation_m2 / _COVERED_SIGMAS**2


def _is_resolved(record: VehicleRecord, refused: UnresolvedOutlier, at_s: float, s: FleetSettings) -> bool:
    """Whether the ranges in use would show the displacement that a refused range suggests, eq. (22).

    Of all horizontal displacements that explain the refused range, the least visible one moves the other ranges by the
    innovation times the root of 1 / (u' N^-1 u); N is the sum of their u u', u a unit vector along the range. With one other
    peer that is nothing.
    """
    ee = nn = _LEAST_INFORMATION
    en = 0.0
    for vehicle, neighbour in record.neighbours.items():
        if vehicle != refused.neighbour and at_s - neighbour.at_s <= IN_USE_S:
            e, n, _ = neighbour.unit
            ee, en, nn = ee + e * e, en + e * n, nn + n * n
    e, n, _ = refused.unit
    least = e * e * nn - 2.0 * e * n * en + n * n * ee
    return refused.nis * (ee * nn - en * en) > s.gate_sigma**2 * least
