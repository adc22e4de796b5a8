"""How a vehicle gets its states in a filter: from its recent reports, or a vehicle without a position from its ranges alone."""

from __future__ import annotations

import numpy as np

from gcs_coloc.core.measurements import AltitudeMeasurement, PositionMeasurement
from gcs_coloc.estimators.fleet.blocks import initial_block, start_block
from gcs_coloc.estimators.fleet.clusters import Clusters
from gcs_coloc.estimators.fleet.corrections import split_report, stamp_sigma_s, take_own
from gcs_coloc.estimators.fleet.settings import FleetSettings
from gcs_coloc.estimators.fleet.start import StartProblem, solve_start
from gcs_coloc.estimators.fleet.vehicle import Records

_START_EVERY_S = 0.5


def begin_from_reports(clusters: Clusters, records: Records, vehicle: int, at_s: float, s: FleetSettings) -> bool:
    """Begin a vehicle's states from its recent reports; False if these are not fresh."""
    record = records.writable(vehicle)
    last = record.last_position
    if last is None or (at_s - last.measured_at_s > s.start_age_s and not record.fixed):
        return False
    if record.fixed:
        variances = [last.sigma_h_m**2, last.sigma_h_m**2, last.sigma_v_m**2]
        clusters.begin(vehicle, np.array(last.position_enu_m), np.diag(variances), last.measured_at_s)
        return True
    reports = [m for m in record.recent if isinstance(m, PositionMeasurement)]
    first = reports[0] if reports else last
    white, slow = split_report(record, first, s)
    record.stamp_s = stamp_sigma_s(first, s)
    (record.slow_report_h_m, record.slow_report_v_m), record.slow_baro_m = slow, 0.0
    record.attitude = None
    record.informed_at_s = record.velocity_used_at_s = first.measured_at_s
    mean, covariance = initial_block(first, white, slow, record.stamp_s, s)
    cluster = clusters.begin(vehicle, mean, covariance, first.measured_at_s)
    for m in record.recent:
        if m is not first and m.measured_at_s >= first.measured_at_s:
            take_own(cluster, m)
    return True


def begin_from_ranges(clusters: Clusters, records: Records, vehicle: int, at_s: float, s: FleetSettings) -> bool:
    """Try to find a denied vehicle without a position from its recent ranges alone; why it was not found stands in its record."""
    record = records.writable(vehicle)
    if at_s - record.start_tried_at_s < _START_EVERY_S:
        return False
    record.start_tried_at_s = at_s
    outcome = solve_start(_start_problem(records, vehicle, at_s, s), s.limit_sigma_m)
    if isinstance(outcome, str):
        record.reason = outcome
        return False
    record.slow_baro_m = record.slow_report_h_m = record.slow_report_v_m = 0.0
    record.stamp_s = s.stamp_sigma_s
    record.attitude = None
    record.informed_at_s = at_s
    record.ranged = ()
    clusters.begin(vehicle, *start_block(*outcome, s), at_s)
    return True


def _start_problem(records: Records, vehicle: int, at_s: float, s: FleetSettings) -> StartProblem:
    problem = StartProblem(at_s)
    for m in records[vehicle].ranges:
        peer = m.to_vehicle if m.from_vehicle == vehicle else m.from_vehicle
        report = records[peer].last_position
        if report is None or records[peer].denied_vehicle:
            continue
        past = [r for r in records[peer].recent if isinstance(r, PositionMeasurement)]
        near = min(past, key=lambda r: abs(r.measured_at_s - m.measured_at_s), default=report)
        if abs(near.measured_at_s - m.measured_at_s) > s.start_age_s and not near.static:
            continue
        problem.add_range(peer, near, past, m)
    for own in records[vehicle].recent:
        if isinstance(own, AltitudeMeasurement):
            problem.add_altitude(own)
    return problem
