"""Initialisation of a vehicle's states from its recent reports, or from ranges alone.

Ranges alone need a multilateration.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import pairwise

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    FloatArray,
    NoEstimateReason,
    PositionMeasurement,
    Unlocated,
)
from gcs_coloc.core.reasons import StatedReason
from gcs_coloc.estimators.fleet.ekf.air_data import EVERY_S, AirCalibration, GroundVelocity, steady_air_m2
from gcs_coloc.estimators.fleet.ekf.cluster import ClusterSet
from gcs_coloc.estimators.fleet.ekf.possible_motion import BOUND_95_SIGMAS
from gcs_coloc.estimators.fleet.ekf.process_model import GAP_S, acceleration_density_m2ps3, turn_rate_radps, usable_airspeed_mps
from gcs_coloc.estimators.fleet.ekf.records import RANGES_S, LeftOut, VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import (
    HEADING_ERROR,
    POSITION,
    REPORT_ERROR,
    SIZE,
    TIME_STAMP_OFFSET,
    TURN,
    VELOCITY,
    WIND,
)
from gcs_coloc.estimators.fleet.ekf.tilt import GRAVITY_MPS2, tilted_velocity_mps
from gcs_coloc.estimators.fleet.ekf.update import split_report_noise, time_stamp_offset_sigma_s, update_own
from gcs_coloc.estimators.fleet.search.multilateration import FlownThroughAir, MultilaterationProblem, solve_multilateration
from gcs_coloc.estimators.fleet.settings import FleetSettings

_AIR = slice(WIND.start, HEADING_ERROR + 1)
_UNSHOWN_MPS2 = 1.5  # chosen: 1-sigma of the acceleration in gusts and changes of speed
_HEADING_ERROR_RAD = 0.35
"""Chosen: 20 degrees, a compass beside currents; it turns the velocity through the air, and so each acceleration."""
_TRY_EVERY_S = 0.5
"""Chosen: one multilateration costs some ten milliseconds."""
_TRY_CONTRADICTORY_EVERY_S = 2.0
"""The same after ranges that contradicted each other. Chosen: to look for a faulty device costs 0.2 s with eight peers."""


def initialise_from_reports(clusters: ClusterSet, vehicle: int, at_s: float) -> bool:
    """Initialise a vehicle's states from its recent reports; False if these are not fresh."""
    record, s = clusters.records.writable(vehicle), clusters.settings
    last = record.last_position
    if last is None or (at_s - last.measured_at_s > s.initialisation_age_s and not record.static):
        return False
    if record.static:
        variances = [last.sigma_h_m**2, last.sigma_h_m**2, last.sigma_v_m**2]
        clusters.initialise(vehicle, np.array(last.position_enu_m), np.diag(variances), last.measured_at_s)
        return True
    reports = [m for m in record.recent_own if isinstance(m, PositionMeasurement)]
    first = reports[0] if reports else last
    white, coloured = split_report_noise(record, first, s)
    record.time_stamp_offset_sigma_s = time_stamp_offset_sigma_s(first, s)
    (record.report_error_sigma_h_m, record.report_error_sigma_v_m), record.baro_error_sigma_m = coloured, 0.0
    record.attitude, record.tilt, record.began_on_either_side = _attitude_before(record, first.measured_at_s), None, False
    record.updated_at_s = record.report_used_at_s = record.velocity_used_at_s = first.measured_at_s
    # Speeds all over the disc of those that the vehicle reaches.
    speed_sigmas_mps = 0.5 * record.profile.max_speed_mps, record.profile.max_climb_mps
    mean, covariance = block_from_report(first, white, coloured, record.time_stamp_offset_sigma_s, speed_sigmas_mps, s)
    known = next((each for each in reversed(record.air_calibrations) if each.at_s < first.measured_at_s), None)
    if known is not None:
        known = known.predicted(first.measured_at_s, s)
        mean[_AIR], covariance[_AIR, _AIR], record.gust_noise.log_level = known.mean, known.covariance, known.log_level
    cluster = clusters.initialise(vehicle, mean, covariance, first.measured_at_s)
    for m in record.recent_own:
        if m is not first and m.measured_at_s >= first.measured_at_s:
            update_own(cluster, m)
    return True


def _attitude_before(record: VehicleRecord, at_s: float) -> AttitudeMeasurement | None:
    """Return a vehicle's newest attitude until a time; None where it has no airspeed that shows a turn."""
    attitudes = (m for m in reversed(record.own_measurements) if isinstance(m, AttitudeMeasurement) and m.measured_at_s <= at_s)
    newest = next(attitudes, None)
    return newest if newest is not None and usable_airspeed_mps(newest) is not None else None


def calibrate_air_data(record: VehicleRecord, report: PositionMeasurement, s: FleetSettings) -> None:
    """Calibrate a vehicle's air data by the velocity of a position report.

    Nothing is done without such a velocity, without fresh air data, or too soon after the last calibration.
    """
    at_s, last = report.measured_at_s, record.air_calibrations[-1:]
    if report.velocity_enu_mps is None or report.sigma_velocity_mps is None or (last and at_s < last[0].at_s + EVERY_S):
        return
    attitude = next((m for m in reversed(record.own_measurements) if isinstance(m, AttitudeMeasurement)), None)
    airspeed_mps = usable_airspeed_mps(attitude) if attitude is not None else None
    if attitude is None or airspeed_mps is None or at_s - attitude.measured_at_s > s.attitude_fresh_s:
        return
    yaw_rad = attitude.yaw_rad + turn_rate_radps(attitude.roll_rad, airspeed_mps) * (at_s - attitude.measured_at_s)
    before = last[0] if last else AirCalibration.initial(at_s, s)
    ground = GroundVelocity(*report.velocity_enu_mps[:2], report.sigma_velocity_mps)
    record.air_calibrations = (*last, before.updated(at_s, ground, airspeed_mps * math.cos(attitude.pitch_rad), yaw_rad, s))


def learn_manoeuvres(record: VehicleRecord, report: PositionMeasurement, s: FleetSettings) -> None:
    """Learn from the report of a vehicle without states how hard its manoeuvres are, eq. (41)."""
    if report.velocity_enu_mps is not None:
        _, density_m2ps3 = acceleration_density_m2ps3(*report.velocity_enu_mps[:2], s)
        most = record.profile.noise_levels[1]
        record.manoeuvre_noise.learn_from_report(
            report, density_m2ps3, s.noise_level_time_s, most, partial(_told_by_tilt, record)
        )


def _told_by_tilt(record: VehicleRecord, from_s: float, to_s: float) -> tuple[float, float] | None:
    """Return by how much a vehicle's velocity changed between two times by its tilt, east and north, m/s."""
    attitudes = [m for m in record.own_measurements if isinstance(m, AttitudeMeasurement)] if record.profile.tilts else []
    return tilted_velocity_mps(attitudes, from_s, to_s) if attitudes else None


def initialise_from_ranges(clusters: ClusterSet, vehicle: int, at_s: float, open_sides: frozenset[int]) -> bool:
    """Initialise a denied vehicle from its recent ranges alone; return whether it succeeded.

    Ranges to other denied vehicles count where these are located, but for `open_sides`, which may be elsewhere. A failure leaves
    its reason in the vehicle's record. The next try is made no sooner than after `_TRY_EVERY_S`.
    """
    record, s = clusters.records.writable(vehicle), clusters.settings
    contradicts = record.left_out is None and record.no_estimate_reason.reason is NoEstimateReason.CONTRADICTORY
    if at_s - record.initialisation_tried_at_s < (_TRY_CONTRADICTORY_EVERY_S if contradicts else _TRY_EVERY_S):
        return False
    record.initialisation_tried_at_s = at_s
    problem = _multilateration_problem(clusters, vehicle, at_s, open_sides)
    solution = solve_multilateration(problem, s.limit_sigma_m)
    if isinstance(solution, StatedReason):
        record.no_estimate_reason, record.left_out = solution, None
        return False
    if solution.left_out and not _is_confirmed(record, solution.left_out, at_s):
        record.no_estimate_reason = Unlocated(NoEstimateReason.CONTRADICTORY)
        return False
    record.left_out = None
    begin_without_reports(record, at_s, s)
    record.began_on_either_side = float(solution.covariance[2, 2]) > problem.straight_m2()
    clusters.initialise(vehicle, *block_from_estimate(solution.mean, solution.covariance, s), at_s)
    return True


def _is_confirmed(record: VehicleRecord, left_out: frozenset[int], at_s: float) -> bool:
    """Return whether the same devices were left out of a start ever since one by other ranges.

    Two faulty devices may agree with the others for a moment, and seldom while the vehicle moves on.
    """
    if record.left_out is None or record.left_out.peers != left_out:
        record.left_out = LeftOut(left_out, at_s)
    return at_s - record.left_out.since_s > RANGES_S


def begin_without_reports(record: VehicleRecord, at_s: float, s: FleetSettings) -> None:
    """Begin the record of a vehicle that is located from ranges alone."""
    record.baro_error_sigma_m = record.report_error_sigma_h_m = record.report_error_sigma_v_m = 0.0
    record.time_stamp_offset_sigma_s = s.time_stamp_offset_sigma_s
    record.attitude = record.tilt = None
    # Its covariance holds all that the vehicle may have done until now, whatever the number of its neighbours.
    record.updated_at_s = record.told_at_s = record.gaps_added_until_s = at_s
    record.range_measurements = ()
    record.forget_tests()


def _multilateration_problem(
    clusters: ClusterSet, vehicle: int, at_s: float, open_sides: frozenset[int]
) -> MultilaterationProblem:
    """Return the recent ranges of a vehicle to others whose positions are known, and its own heights."""
    records, s = clusters.records, clusters.settings
    # An acceleration of the most in an unknown direction.
    most_mps2 = records[vehicle].profile.max_acceleration_mps2 / math.sqrt(2.0)
    problem = MultilaterationProblem(at_s, most_mps2, _flown_through_air(records[vehicle], at_s, s))
    for m in records[vehicle].recent_ranges:
        peer = m.other_end(vehicle)
        if records[peer].denied_vehicle:
            located = None if peer in open_sides else _located(clusters, peer)
            past = [] if located is None else [located]
        else:
            newest = records[peer].last_position
            past = [r for r in records[peer].recent_own if isinstance(r, PositionMeasurement)] or ([newest] if newest else [])
        near = min(past, key=lambda r: abs(r.measured_at_s - m.measured_at_s), default=None)
        if near is None or (abs(near.measured_at_s - m.measured_at_s) > s.initialisation_age_s and not near.static):
            continue
        error = records[vehicle].lasting_error((peer, m.device_id))
        lasting_m2, profile = 0.0 if error is None else error.sigma_m**2, records[peer].profile
        reach_m = profile.reach_m(abs(m.measured_at_s - near.measured_at_s), profile.max_acceleration_mps2)
        problem.add_range(peer, near, past, m, lasting_m2, 0.0 if near.static else reach_m / BOUND_95_SIGMAS)
    for own in records[vehicle].recent_own:
        if isinstance(own, AltitudeMeasurement):
            problem.add_altitude(own)
    return problem


def _flown_through_air(record: VehicleRecord, at_s: float, s: FleetSettings) -> FlownThroughAir | None:
    """Return how a vehicle flew through the air since its first recent range; None where it is not known."""
    first_s = min(m.measured_at_s for m in record.recent_ranges)
    attitudes = [m for m in record.own_measurements if isinstance(m, AttitudeMeasurement) and m.measured_at_s >= first_s - GAP_S]
    times_s = [first_s, *[m.measured_at_s for m in attitudes], at_s]
    speeds_mps = [usable_airspeed_mps(m) for m in attitudes]
    if not attitudes or None in speeds_mps or max(b - a for a, b in pairwise(sorted(times_s))) > GAP_S:
        return None
    headings = [(math.sin(m.yaw_rad), math.cos(m.yaw_rad)) for m in attitudes]
    level_mps = np.array(speeds_mps, dtype=np.float64) * [math.cos(m.pitch_rad) for m in attitudes]
    turns_mps2 = GRAVITY_MPS2 * math.tan(max(abs(m.roll_rad) for m in attitudes))
    return FlownThroughAir(
        np.array([m.measured_at_s for m in attitudes]) - at_s,
        level_mps[:, np.newaxis] * np.array(headings),
        _UNSHOWN_MPS2 + _HEADING_ERROR_RAD * turns_mps2,
        math.hypot(s.wind_sigma_mps, _HEADING_ERROR_RAD * float(level_mps.max())),
    )


def _located(clusters: ClusterSet, vehicle: int) -> PositionMeasurement | None:
    """Return the position of a denied vehicle by its states, as a report of it; None where it has none."""
    cluster = clusters.get(vehicle)
    if cluster is None:
        return None
    x, P, at_s = cluster.joint.mean(vehicle), cluster.joint.covariance(vehicle), cluster.joint.time_s[vehicle]
    (e, n, u), (ve, vn, vu) = x[POSITION].tolist(), x[VELOCITY].tolist()
    return PositionMeasurement(
        vehicle,
        at_s,
        at_s,
        (e, n, u),
        horizontal_sigma_m(P),
        math.sqrt(P.item(2, 2)),
        (ve, vn, vu),
        horizontal_sigma_m(P[3:, 3:]),
    )


def block_from_report(
    report: PositionMeasurement,
    white: tuple[float, float],
    coloured: tuple[float, float],
    offset_sigma_s: float,
    velocity_sigmas_mps: tuple[float, float],
    s: FleetSettings,
) -> tuple[FloatArray, FloatArray]:
    """Return mean (16,) and covariance (16, 16) of a vehicle from one report: p = z - b_p - noise.

    `white` and `coloured` are sigmas in m (horizontal, vertical), `offset_sigma_s` that of the time-stamp offset,
    `velocity_sigmas_mps` (horizontal, vertical) those of a velocity which the report lacks.
    """
    x = np.zeros(SIZE)
    P = np.zeros((SIZE, SIZE))
    x[POSITION] = report.position_enu_m
    for axis in range(3):
        w, c = white[axis // 2], coloured[axis // 2]
        P[axis, axis] = w * w + c * c
        e = REPORT_ERROR.start + axis
        P[e, e] = c * c
        P[axis, e] = P[e, axis] = -c * c
    sigma_h, sigma_v = velocity_sigmas_mps
    if report.velocity_enu_mps is not None and report.sigma_velocity_mps is not None:
        x[VELOCITY] = report.velocity_enu_mps
        sigma_h = sigma_v = report.sigma_velocity_mps
    P[3, 3] = P[4, 4] = sigma_h * sigma_h
    P[5, 5] = sigma_v * sigma_v
    _set_slow_errors(P, offset_sigma_s, s)
    return x, P


def block_from_estimate(mean: FloatArray, covariance: FloatArray, s: FleetSettings) -> tuple[FloatArray, FloatArray]:
    """Return mean (16,) and covariance (16, 16) from those (6,), (6, 6) of position and velocity."""
    x = np.zeros(SIZE)
    P = np.zeros((SIZE, SIZE))
    x[:6] = mean
    P[:6, :6] = covariance
    _set_slow_errors(P, s.time_stamp_offset_sigma_s, s)
    return x, P


def _set_slow_errors(P: FloatArray, offset_sigma_s: float, s: FleetSettings) -> None:
    """Write the steady-state variances of the Gauss-Markov components but the report error."""
    P[_AIR, _AIR] = np.diag(steady_air_m2(s))
    P[TIME_STAMP_OFFSET, TIME_STAMP_OFFSET] = offset_sigma_s**2
    P[TURN, TURN] = s.turn_sigma_radps**2
