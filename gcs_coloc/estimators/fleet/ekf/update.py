"""The measurement update: propagate to the time of a measurement, linearise, gate, correct."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    FloatArray,
    OdometryMeasurement,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.estimators.fleet.ekf.adaptive_noise import without_time_error
from gcs_coloc.estimators.fleet.ekf.air_data import Place
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.measurement_models import air_velocity, altitude, odometry, position_report, slant_range
from gcs_coloc.estimators.fleet.ekf.outcomes import Outcome, UpdateResult
from gcs_coloc.estimators.fleet.ekf.possible_motion import CORRELATION
from gcs_coloc.estimators.fleet.ekf.process_model import ATTITUDE_HELD_S, usable_airspeed_mps
from gcs_coloc.estimators.fleet.ekf.records import OwnMeasurement, VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import BARO_ERROR, REPORT_ERROR, TIME_STAMP_OFFSET, JointState, Key, UnknownKey, whiten
from gcs_coloc.estimators.fleet.ekf.tilt import missed_motion, tilt_after
from gcs_coloc.estimators.fleet.settings import FleetSettings

_HARDEST_MPS2 = 20.0  # chosen: 2 g, the hardest manoeuvre that a position report outside the gate is explained by
_REPORT_ERROR_H = slice(REPORT_ERROR.start, REPORT_ERROR.start + 2)
_REPORT_ERROR_V = slice(REPORT_ERROR.start + 2, REPORT_ERROR.stop)
_MISSED_CLIMB_S = 1.2
"""Chosen: a climb that begins hard leaves the gate within so long; heights further apart show no steps. 1 Hz with jitter."""
_CLIMB_ERROR_MPS = 15.0  # chosen: the climb of an agile copter that was sinking a moment ago; a height that departs faster jumps
_BARO = slice(BARO_ERROR, BARO_ERROR + 1)
_UP_AND_CLIMB = np.ix_((2, 5), (2, 5))
_HORIZONTAL = np.array([0, 1, 3, 4])
_PLACE_AND_MOTION = np.ix_(_HORIZONTAL, _HORIZONTAL)
_PLACE_BY_MOTION = ([0, 1, 3, 4], [3, 4, 0, 1])
_OFFSET = slice(TIME_STAMP_OFFSET, TIME_STAMP_OFFSET + 1)

NOTHING_CONSIDERED: Mapping[Key, float] = MappingProxyType({})

Sigmas = tuple[float, float]
"""Horizontal and vertical, m."""


def update_own(cluster: Cluster, m: OwnMeasurement) -> UpdateResult:
    """Correct with a vehicle's own measurement; the noise is split as its stream has shown, eq. (16)."""
    record, s = cluster.records[m.vehicle], cluster.settings
    if isinstance(m, PositionMeasurement):
        return update_position_report(cluster, m, *split_report_noise(record, m, s), time_stamp_offset_sigma_s(m, s))
    if isinstance(m, AltitudeMeasurement):
        return update_altitude(cluster, m, *record.altitude_noise.split(0, m.sigma_m, s.least_coloured_share))
    return update_odometry(cluster, m) if isinstance(m, OdometryMeasurement) else update_air_velocity(cluster, m)


def update_position_report(
    cluster: Cluster, m: PositionMeasurement, white: Sigmas, coloured: Sigmas, offset_sigma_s: float
) -> UpdateResult:
    """Correct with a position report, and its velocity where given, eq. (11).

    A report outside the gate is tried again with the noise that it states, then with a hard manoeuvre since the last one that was
    used: ranges since then tell little of it. Air data that told of no such manoeuvre are in another wind than was learned. The
    NIS is that of the first try, so that models can be compared by it.
    """
    record, joint, at_s = cluster.records[m.vehicle], cluster.joint, m.measured_at_s
    since_s = at_s - record.report_used_at_s
    cluster.propagate(m.vehicle, at_s)
    record.report_error_sigma_h_m = cluster.change_sigma(m.vehicle, _REPORT_ERROR_H, record.report_error_sigma_h_m, coloured[0])
    record.report_error_sigma_v_m = cluster.change_sigma(m.vehicle, _REPORT_ERROR_V, record.report_error_sigma_v_m, coloured[1])
    change_time_stamp_offset_sigma(cluster, m.vehicle, offset_sigma_s)
    HA, H, where, R = linear = position_report(joint, m, white, at_s - record.velocity_used_at_s)
    k = len(H)
    if k > len(m.position_enu_m):
        record.velocity_used_at_s = at_s
    whitened, told_otherwise = whiten(HA, linear.innovation_covariance(R)), False
    nis = whitened.nis
    # The gate widens as the standard deviation of the chi-square distribution does.
    limit = cluster.settings.gate_sigma**2 + 2.0 * k
    if whitened.nis > limit:
        R[:3] = [m.sigma_h_m**2, m.sigma_h_m**2, m.sigma_v_m**2]
        whitened = whiten(HA, linear.innovation_covariance(R))
    if whitened.nis > limit:
        manoeuvre = _manoeuvre_covariance(since_s)
        HA[:, where.start : where.start + 6] += manoeuvre[:k]
        whitened = whiten(HA, linear.innovation_covariance(R))
        if whitened.nis > limit:
            return UpdateResult(Outcome.REFUSED_POSITION_GATE, 0.0, 0.0, nis, k)
        joint.covariance(m.vehicle)[:6, :6] += manoeuvre
        told_otherwise = record.attitude is not None and at_s - record.attitude.measured_at_s <= ATTITUDE_HELD_S
    joint.correct(whitened.W)
    cluster.add_corrections(m.vehicle, whitened.W, whitened.innovations(), at_s, of_position=True)
    if told_otherwise:
        cluster.forget_air_errors(m.vehicle)
    record.updated_at_s = record.report_used_at_s = at_s
    return UpdateResult(Outcome.USED, 0.0, 0.0, nis, k)


def update_altitude(cluster: Cluster, m: AltitudeMeasurement, white_m: float, coloured_m: float) -> UpdateResult:
    """Correct with a barometric height, eq. (12).

    Heights that leave the gate step by step tell of a climb: they are tried again with a hard manoeuvre since the last one
    within it, eq. (20). One that leaves it at once has jumped, eq. (43). Those that leave it by more than a climb, or after a
    pause, are used with inflated noise.
    """
    record, joint, limit = cluster.records[m.vehicle], cluster.joint, cluster.settings.gate_sigma**2
    record.baro_error_sigma_m = cluster.change_sigma(m.vehicle, _BARO, record.baro_error_sigma_m, coloured_m)
    cluster.propagate(m.vehicle, m.measured_at_s)
    hA, innovation, variance = altitude(joint, m, white_m)
    nis = innovation * innovation / variance
    step_m = innovation - record.height_innovation_m
    gap_s = m.measured_at_s - record.height_at_s
    if nis > limit and gap_s <= _MISSED_CLIMB_S and abs(step_m) > _CLIMB_ERROR_MPS * gap_s + 2.0 * white_m:
        record.height_jumps_m += step_m
        m = replace(m, up_m=m.up_m - step_m)
        b = joint.where[m.vehicle].start + BARO_ERROR
        # By how much exactly it has jumped nothing tells: the error is free to be another one.
        joint.A[b, b] += step_m * step_m
        hA, innovation, variance = altitude(joint, m, white_m)
    record.height_at_s, record.height_innovation_m = m.measured_at_s, innovation
    if innovation * innovation > limit * variance:
        if gap_s > _MISSED_CLIMB_S:
            record.height_used_at_s = math.inf
        since_s = min(max(m.measured_at_s - record.height_used_at_s, 0.0), _MISSED_CLIMB_S)
        manoeuvre = _manoeuvre_covariance(since_s)[_UP_AND_CLIMB]
        if innovation * innovation <= limit * (variance + manoeuvre[0, 0]):
            joint.covariance(m.vehicle)[_UP_AND_CLIMB] += manoeuvre
            hA, innovation, variance = altitude(joint, m, white_m)
    if innovation * innovation <= limit * variance:
        record.height_used_at_s = m.measured_at_s
    else:
        variance += innovation * innovation
    W = joint.correct_scalar(hA, variance)
    sigma_m = math.sqrt(variance)
    cluster.add_corrections(m.vehicle, W, (innovation / sigma_m,), m.measured_at_s)
    return UpdateResult(Outcome.USED, innovation, sigma_m, nis, 1)


def update_air_velocity(cluster: Cluster, m: AttitudeMeasurement) -> UpdateResult:
    """Turn with the bank angle from now on, and correct with airspeed and heading, eq. (13).

    A multirotor's attitude without airspeed accelerates it, eq. (47).
    Outside the gate, where they came too late to show a turn, they are tried again with a hard manoeuvre since the last ones,
    eq. (20); outside it again they are refused. As long as those of a denied vehicle contradict its way over ground the bank
    angle alone is used, eq. (44).
    """
    s, record, joint = cluster.settings, cluster.records[m.vehicle], cluster.joint
    airspeed_mps = usable_airspeed_mps(m)
    if airspeed_mps is None:
        record.attitude = None
        return _update_tilt(cluster, m) if record.profile.tilts and not record.static else UpdateResult(Outcome.KEPT_NO_AIRSPEED)
    cluster.propagate(m.vehicle, m.measured_at_s)
    before = record.attitude
    since_s = s.air_noise_time_s
    if before is not None and before.airspeed_mps is not None:
        since_s = m.measured_at_s - before.measured_at_s
    if record.denied_vehicle and _contradicts_its_way(cluster, m, airspeed_mps):
        record.attitude = replace(m, airspeed_mps=None)
        return UpdateResult(Outcome.REFUSED_AIR_DATA)
    limit, level = s.gate_sigma**2, record.gust_noise.level
    linear = air_velocity(joint, m, airspeed_mps, since_s, s, level)
    whitened = whiten(linear.HA, linear.innovation_covariance(linear.R))
    nis = whitened.nis
    if nis > limit and s.attitude_fresh_s < since_s <= ATTITUDE_HELD_S:
        missed = missed_turn_covariance(since_s, _HARDEST_MPS2)
        joint.covariance(m.vehicle)[:6, :6] += missed
        linear = air_velocity(joint, m, airspeed_mps, since_s, s, level)
        whitened = whiten(linear.HA, linear.innovation_covariance(linear.R))
        if whitened.nis > limit:
            joint.covariance(m.vehicle)[:6, :6] -= missed
    if whitened.nis > limit:
        return UpdateResult(Outcome.REFUSED_AIR_GATE, 0.0, 0.0, nis, 2)
    record.attitude = m
    joint.correct(whitened.W)
    cluster.add_corrections(m.vehicle, whitened.W, whitened.innovations(), m.measured_at_s)
    return UpdateResult(Outcome.USED, 0.0, 0.0, nis, 2)


def _update_tilt(cluster: Cluster, m: AttitudeMeasurement) -> UpdateResult:
    """Accelerate with the tilt from now on, and add what the one before has missed since, eq. (48)."""
    record, joint, before = cluster.records[m.vehicle], cluster.joint, cluster.records[m.vehicle].tilt
    if before is not None and before.is_enough(m.measured_at_s):
        return UpdateResult(Outcome.KEPT_NO_AIRSPEED)
    cluster.propagate(m.vehicle, m.measured_at_s)
    record.tilt = tilt_after(before, m)
    if before is not None and before.is_joined(m.measured_at_s):
        missed, covariance = missed_motion(before, record.tilt, record.velocity_used_at_s)
        where = joint.where[m.vehicle].start + _HORIZONTAL
        joint.A[0, where] += missed
        joint.A[where, 0] += missed
        joint.A[np.ix_(where, where)] += covariance
    return UpdateResult(Outcome.USED_TILT)


def _contradicts_its_way(cluster: Cluster, m: AttitudeMeasurement, airspeed_mps: float) -> bool:
    """Check the air data of a denied vehicle against its way; return whether they are refused.

    What air data have shown is forgotten when the refusal begins.
    """
    record, x, P = cluster.records[m.vehicle], cluster.joint.mean(m.vehicle), cluster.joint.covariance(m.vehicle)
    place = Place(x.item(0), x.item(1), horizontal_sigma_m(P))
    known = record.air_calibrations[-1] if record.air_calibrations else None
    was_refused = record.air_check.is_refused
    record.air_check = record.air_check.updated(
        m.measured_at_s, place, airspeed_mps * math.cos(m.pitch_rad), m.yaw_rad, known, cluster.settings
    )
    if record.air_check.is_refused and not was_refused:
        cluster.forget_air_errors(m.vehicle)
    return record.air_check.is_refused


def update_odometry(cluster: Cluster, m: OdometryMeasurement) -> UpdateResult:
    """Correct with speed and turn rate, eq. (34); outside the gate with inflated noise, as wheels slip."""
    s, record, joint = cluster.settings, cluster.records[m.vehicle], cluster.joint
    cluster.propagate(m.vehicle, m.measured_at_s)
    since_s = m.measured_at_s - record.odometry.measured_at_s if record.odometry is not None else math.inf
    record.odometry = m
    linear = odometry(joint, m, since_s)
    S = linear.innovation_covariance(linear.R)
    nis = whiten(linear.HA, S).nis
    if nis > s.gate_sigma**2:
        S *= nis / s.gate_sigma**2
    whitened = whiten(linear.HA, S)
    joint.correct(whitened.W)
    cluster.add_corrections(m.vehicle, whitened.W, whitened.innovations(), m.measured_at_s)
    return UpdateResult(Outcome.USED, 0.0, 0.0, nis, len(linear.H))


def update_range(
    cluster: Cluster,
    pair: Key,
    m: RangeMeasurement,
    white_m: float,
    coloured_m: float,
    considered_m: Mapping[Key, float] = NOTHING_CONSIDERED,
    unknown: Sequence[tuple[UnknownKey, float]] = (),
) -> UpdateResult:
    """Correct with a slant range between two vehicles of the cluster, eq. (14) and (15).

    `pair` is the `pair_key` of its bias and coloured error, whose steady-state sigma is `coloured_m`; `white_m` is the sigma of
    the range itself. Since an inflation of the covariance of one end its noise is inflated too. `considered_m` holds the sigmas
    of the biases that a range does not correct, eq. (33); `unknown` the errors, with their shares in the range, to which the
    sensitivity of all states is kept, eq. (38).
    """
    s, joint, at_s = cluster.settings, cluster.joint, m.measured_at_s
    cluster.propagate(m.from_vehicle, at_s)
    cluster.propagate(m.to_vehicle, at_s)
    augment_by_unknown(joint, unknown, at_s)
    index = propagate_pair(cluster, pair, at_s, (considered_m.get(pair, s.range_bias_sigma_m), coloured_m))
    ends = cluster.range_end(m.from_vehicle), cluster.range_end(m.to_vehicle)
    records = cluster.records
    inflation_m2 = max(records[m.from_vehicle].range_noise_inflation_m2, records[m.to_vehicle].range_noise_inflation_m2)
    stamp_sigma_s = s.time_stamp_offset_sigma_s / math.sqrt(m.samples)
    linear = slant_range(joint, ends, index, m, white_m * white_m + inflation_m2, stamp_sigma_s)
    if linear is None:
        return UpdateResult(Outcome.REFUSED_SAME_PLACE)
    hA, innovation, variance, unit = linear
    nis = innovation * innovation / variance
    sigma = math.sqrt(variance)
    if nis > s.gate_sigma**2:
        return UpdateResult(Outcome.REFUSED_RANGE_GATE, innovation, sigma, nis, 1, unit)
    if nis > s.huber_sigma**2:
        variance *= math.sqrt(nis) / s.huber_sigma
    # A device that was wrong until now may be so within the gate too.
    variance += max(records[m.from_vehicle].suspicion_m2(m.to_vehicle), records[m.to_vehicle].suspicion_m2(m.from_vehicle))
    W = joint.correct_scalar(hA, variance)
    joint.add_sensitivity(unknown, W, math.sqrt(variance))
    if considered_m:
        joint.restore([joint.where[key].start for key in considered_m if key in joint.where], W)
    whitened = (innovation / math.sqrt(variance),)
    cluster.add_corrections(m.from_vehicle, W, whitened, at_s, of_position=True)
    cluster.add_corrections(m.to_vehicle, W, whitened, at_s, of_position=True)
    return UpdateResult(Outcome.USED, innovation, sigma, nis, 1, unit)


def time_stamp_offset_sigma_s(m: PositionMeasurement | RangeMeasurement, s: FleetSettings) -> float:
    """Return the sigma of the time-stamp offset that a measurement states, s."""
    return math.hypot(s.time_stamp_offset_sigma_s, m.time_sigma_s)


def split_report_noise(record: VehicleRecord, m: PositionMeasurement, s: FleetSettings) -> tuple[Sigmas, Sigmas]:
    """Return the white and the coloured sigmas, (horizontal, vertical) in m, of a report, eq. (16)."""
    sigma_h_m, sigma_v_m = without_time_error(m)
    white_h_m, coloured_h_m = record.report_noise.split(0, sigma_h_m, s.least_coloured_share)
    white_v_m, coloured_v_m = record.report_noise.split(1, sigma_v_m, s.least_coloured_share)
    return (white_h_m, white_v_m), (coloured_h_m, coloured_v_m)


def change_time_stamp_offset_sigma(cluster: Cluster, vehicle: int, sigma_s: float) -> None:
    """Change the sigma of a vehicle's time-stamp offset."""
    record = cluster.records[vehicle]
    if not record.static:
        record.time_stamp_offset_sigma_s = cluster.change_sigma(vehicle, _OFFSET, record.time_stamp_offset_sigma_s, sigma_s)


def missed_turn_covariance(since_s: float, most_mps2: float) -> FloatArray:
    """Return the covariance (6, 6) that an unseen turn of up to `most_mps2` adds, eq. (20)."""
    missed = np.zeros((6, 6))
    missed[_PLACE_AND_MOTION] = _manoeuvre_covariance(since_s, most_mps2)[_PLACE_AND_MOTION]
    missed[_PLACE_BY_MOTION] *= CORRELATION
    return missed


def _manoeuvre_covariance(since_s: float, most_mps2: float = _HARDEST_MPS2) -> FloatArray:
    """Return the covariance (6, 6) that an unknown constant acceleration adds, eq. (20).

    It is that of position and velocity. The acceleration began `since_s` ago.
    """
    speed = most_mps2 * since_s
    distance = 0.5 * speed * since_s
    covariance = np.zeros((6, 6))
    for axis in range(3):
        covariance[axis, axis] = distance * distance
        covariance[axis, axis + 3] = covariance[axis + 3, axis] = distance * speed
        covariance[axis + 3, axis + 3] = speed * speed
    return covariance


def augment_by_unknown(joint: JointState, unknown: Sequence[tuple[UnknownKey, float]], at_s: float) -> None:
    """Augment a joint state by the sensitivities to unknown errors that it has not kept so far."""
    for key, _ in unknown:
        if key not in joint.where:
            joint.augment(key, np.zeros(1), np.zeros((1, 1)), at_s)


def propagate_pair(cluster: Cluster, pair: Key, at_s: float, sigmas: tuple[float, float]) -> int:
    """Propagate a pair's range errors to the time of a range, eq. (7), and return their index.

    The errors are the bias and, after it, the coloured error. A new pair gets them with their steady-state `sigmas`.
    """
    s, joint = cluster.settings, cluster.joint
    if pair not in joint.where:
        joint.augment(pair, np.zeros(2), np.diag(np.square(sigmas)), at_s)
        return len(joint.A) - len(sigmas)
    index: int = joint.where[pair].start
    step_s = at_s - joint.time_s[pair]
    if step_s > 0.0:
        decays = (math.exp(-step_s / s.range_bias_time_s), math.exp(-step_s / s.range_coloured_time_s))
        joint.decay(pair, decays, sigmas)
        joint.time_s[pair] = at_s
    return index
