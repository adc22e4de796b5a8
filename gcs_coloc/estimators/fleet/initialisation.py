"""How a vehicle gets its states in a filter: from its recent reports, or a vehicle without a position from its ranges alone."""

from __future__ import annotations

import numpy as np

from gcs_coloc.core.measurements import AltitudeMeasurement, PositionMeasurement
from gcs_coloc.estimators.fleet.cluster_set import ClusterSet
from gcs_coloc.estimators.fleet.ekf.blocks import block_from_estimate, block_from_report
from gcs_coloc.estimators.fleet.ekf.records import Records
from gcs_coloc.estimators.fleet.ekf.update import split_report_noise, time_stamp_offset_sigma_s, update_own
from gcs_coloc.estimators.fleet.multilateration import MultilaterationProblem, solve_multilateration
from gcs_coloc.estimators.fleet.settings import FleetSettings

_START_EVERY_S = 0.5


def initialise_from_reports(clusters: ClusterSet, records: Records, vehicle: int, at_s: float, s: FleetSettings) -> bool:
    """Begin a vehicle's states from its recent reports; False if these are not fresh."""
    record = records.writable(vehicle)
    last = record.last_position
    if last is None or (at_s - last.measured_at_s > s.start_age_s and not record.static):
        return False
    if record.static:
        variances = [last.sigma_h_m**2, last.sigma_h_m**2, last.sigma_v_m**2]
        clusters.initialise(vehicle, np.array(last.position_enu_m), np.diag(variances), last.measured_at_s)
        return True
    reports = [m for m in record.recent_own if isinstance(m, PositionMeasurement)]
    first = reports[0] if reports else last
    white, slow = split_report_noise(record, first, s)
    record.time_stamp_offset_sigma_s = time_stamp_offset_sigma_s(first, s)
    (record.report_error_sigma_h_m, record.report_error_sigma_v_m), record.baro_error_sigma_m = slow, 0.0
    record.attitude = None
    record.updated_at_s = record.velocity_used_at_s = first.measured_at_s
    mean, covariance = block_from_report(first, white, slow, record.time_stamp_offset_sigma_s, s)
    cluster = clusters.initialise(vehicle, mean, covariance, first.measured_at_s)
    for m in record.recent_own:
        if m is not first and m.measured_at_s >= first.measured_at_s:
            update_own(cluster, m)
    return True


def initialise_from_ranges(clusters: ClusterSet, records: Records, vehicle: int, at_s: float, s: FleetSettings) -> bool:
    """Try to find a denied vehicle without a position from its recent ranges alone; why it was not found stands in its record."""
    record = records.writable(vehicle)
    if at_s - record.initialisation_tried_at_s < _START_EVERY_S:
        return False
    record.initialisation_tried_at_s = at_s
    outcome = solve_multilateration(_multilateration_problem(records, vehicle, at_s, s), s.limit_sigma_m)
    if isinstance(outcome, str):
        record.no_estimate_reason = outcome
        return False
    record.baro_error_sigma_m = record.report_error_sigma_h_m = record.report_error_sigma_v_m = 0.0
    record.time_stamp_offset_sigma_s = s.stamp_sigma_s
    record.attitude = None
    record.updated_at_s = at_s
    record.range_measurements = ()
    clusters.initialise(vehicle, *block_from_estimate(*outcome, s), at_s)
    return True


def _multilateration_problem(records: Records, vehicle: int, at_s: float, s: FleetSettings) -> MultilaterationProblem:
    problem = MultilaterationProblem(at_s)
    for m in records[vehicle].recent_ranges:
        peer = m.to_vehicle if m.from_vehicle == vehicle else m.from_vehicle
        report = records[peer].last_position
        if report is None or records[peer].denied_vehicle:
            continue
        past = [r for r in records[peer].recent_own if isinstance(r, PositionMeasurement)]
        near = min(past, key=lambda r: abs(r.measured_at_s - m.measured_at_s), default=report)
        if abs(near.measured_at_s - m.measured_at_s) > s.start_age_s and not near.static:
            continue
        problem.add_range(peer, near, past, m)
    for own in records[vehicle].recent_own:
        if isinstance(own, AltitudeMeasurement):
            problem.add_altitude(own)
    return problem
