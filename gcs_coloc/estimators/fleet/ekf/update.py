"""How the measurements that a vehicle makes of itself correct the joint state of its cluster: reports, heights, attitude.

Each is taken at its own time, to which the vehicle is brought.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    FloatArray,
    PositionMeasurement,
    RangeMeasurement,
    Vector3,
)
from gcs_coloc.core.telemetry.air_data import LEAST_AIRSPEED_MPS
from gcs_coloc.estimators.fleet.ekf._kernels import (
    AIRSPEED_ERROR,
    BARO_ERROR,
    HEADING_ERROR,
    REPORT_ERROR,
    SIZE,
    STAMP_ERROR,
    STEEPEST_BANK_RAD,
    VELOCITY,
    WIND,
)
from gcs_coloc.estimators.fleet.ekf.adaptive_noise import without_time_error
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.records import OwnMeasurement, VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import whiten
from gcs_coloc.estimators.fleet.settings import FleetSettings

_REPORT_VELOCITY_TIME_S = 1.0
_HARDEST_MPS2 = 20.0
_WELL_KNOWN_SHARE = 0.25
_REPORT_ERROR_H = slice(REPORT_ERROR.start, REPORT_ERROR.start + 2)
_REPORT_ERROR_V = slice(REPORT_ERROR.start + 2, REPORT_ERROR.stop)
_BARO = slice(BARO_ERROR, BARO_ERROR + 1)
_STAMP = slice(STAMP_ERROR, STAMP_ERROR + 1)
_AIR = ((3, 6), (4, 7))
"""Velocity over ground and wind, east and north."""
# What a report tells: position with its error in the first three rows, velocity in the rest.
_REPORTED = np.eye(6, SIZE)
_REPORTED[range(3), range(REPORT_ERROR.start, REPORT_ERROR.stop)] = 1.0


class UpdateResult(NamedTuple):
    """What became of a measurement: `used` or not and why, with the innovation where there was one to judge.

    `unit`: of a range that was used or refused by the gate, its direction.
    """

    outcome: str
    innovation_m: float = 0.0
    sigma_m: float = 0.0
    nis: float = 0.0
    degrees_of_freedom: int = 0
    unit: Vector3 = (0.0, 0.0, 0.0)

    @property
    def used(self) -> bool:
        """Whether the state was corrected."""
        return self.outcome == USED


USED = "used"

Sigmas = tuple[float, float]
"""Horizontal and vertical, m."""


def time_stamp_offset_sigma_s(m: PositionMeasurement | RangeMeasurement, s: FleetSettings) -> float:
    """Return the sigma of the error of the stamps that a measurement is of, s."""
    return math.hypot(s.stamp_sigma_s, m.time_sigma_s)


def split_report_noise(record: VehicleRecord, m: PositionMeasurement, s: FleetSettings) -> tuple[Sigmas, Sigmas]:
    """Return the white and the slow part of a report's sigmas, each (horizontal, vertical) in m."""
    sigma_h_m, sigma_v_m = without_time_error(m)
    white_h_m, slow_h_m = record.report_noise.split(0, sigma_h_m, s.least_slow_share)
    white_v_m, slow_v_m = record.report_noise.split(1, sigma_v_m, s.least_slow_share)
    return (white_h_m, white_v_m), (slow_h_m, slow_v_m)


def update_own(cluster: Cluster, m: OwnMeasurement) -> UpdateResult:
    """Correct with what a vehicle of the cluster measured of itself, its error taken apart as its stream has shown."""
    record, s = cluster.records[m.vehicle], cluster.settings
    if isinstance(m, PositionMeasurement):
        return update_position_report(cluster, m, *split_report_noise(record, m, s), time_stamp_offset_sigma_s(m, s))
    if isinstance(m, AltitudeMeasurement):
        return update_altitude(cluster, m, *record.altitude_noise.split(0, m.sigma_m, s.least_slow_share))
    return update_air_velocity(cluster, m)


def update_time_stamp_sigma(cluster: Cluster, vehicle: int, sigma_s: float) -> None:
    """Take a new sigma of the error of a vehicle's time stamps."""
    record = cluster.records[vehicle]
    if not record.static:
        record.time_stamp_offset_sigma_s = cluster.change_sigma(vehicle, _STAMP, record.time_stamp_offset_sigma_s, sigma_s)


def update_position_report(cluster: Cluster, m: PositionMeasurement, white: Sigmas, slow: Sigmas, stamp_s: float) -> UpdateResult:
    """Correct with a report of position, and velocity where given; sigmas in m are (horizontal, vertical)."""
    record, joint, at_s = cluster.records[m.vehicle], cluster.joint, m.measured_at_s
    since_s = at_s - record.updated_at_s
    cluster.propagate(m.vehicle, at_s)
    record.report_error_sigma_h_m = cluster.change_sigma(m.vehicle, _REPORT_ERROR_H, record.report_error_sigma_h_m, slow[0])
    record.report_error_sigma_v_m = cluster.change_sigma(m.vehicle, _REPORT_ERROR_V, record.report_error_sigma_v_m, slow[1])
    update_time_stamp_sigma(cluster, m.vehicle, stamp_s)
    reported: tuple[float, ...] = m.position_enu_m
    white_h_m2, white_v_m2 = white[0] ** 2, white[1] ** 2
    noise = [white_h_m2, white_h_m2, white_v_m2]
    if m.velocity_enu_mps is not None and m.sigma_velocity_mps is not None:
        reported += m.velocity_enu_mps
        # A navigation filter's velocity error is correlated too: more reports a second do not tell more.
        thin = max(1.0, _REPORT_VELOCITY_TIME_S / max(at_s - record.velocity_used_at_s, 1e-3))
        noise += [m.sigma_velocity_mps**2 * thin] * 3
        record.velocity_used_at_s = at_s
    k, where = len(reported), joint.where[m.vehicle]
    H = _REPORTED[:k]
    HA = joint.predict_block_measurement(m.vehicle, H)
    HA[:, 0] -= reported
    whitened = whiten(HA, _with_noise(HA[:, where] @ H.T, noise))
    # Twice the degrees of freedom widen the gate as the chi-square distribution widens.
    limit = cluster.settings.gate_sigma**2 + 2.0 * k
    if whitened.nis > limit:
        # Noise that was not seen before to be white: as large as the report itself says.
        noise[:3] = [m.sigma_h_m**2, m.sigma_h_m**2, m.sigma_v_m**2]
        whitened = whiten(HA, _with_noise(HA[:, where] @ H.T, noise))
    if whitened.nis > limit:
        # A hard manoeuvre since the last report explains much: one that began then, at any acceleration a vehicle stands.
        jolt = _jolt(since_s)
        HA[:, where.start : where.start + 6] += jolt[:k]
        whitened = whiten(HA, _with_noise(HA[:, where] @ H.T, noise))
        if whitened.nis > limit:
            return UpdateResult("refused: position report outside the gate", 0.0, 0.0, whitened.nis, k)
        joint.covariance(m.vehicle)[:6, :6] += jolt
    joint.correct(whitened.W)
    cluster.update_manoeuvre_detector(m.vehicle, whitened.W, whitened.innovations(), at_s)
    record.updated_at_s = at_s
    return UpdateResult(USED, 0.0, 0.0, whitened.nis, k)


def _with_noise(S: FloatArray, noise: list[float]) -> FloatArray:
    """Add the variances (k,) of noise to the diagonal of S (k, k), in place."""
    diagonal = S.reshape(-1)[:: len(noise) + 1]
    diagonal += noise
    return S


def _jolt(since_s: float) -> FloatArray:
    """Return what an unknown constant acceleration since a time ago adds to position and velocity, (6, 6)."""
    speed = _HARDEST_MPS2 * since_s
    way = 0.5 * speed * since_s
    jolt = np.zeros((6, 6))
    for axis in range(3):
        jolt[axis, axis] = way * way
        jolt[axis, axis + 3] = jolt[axis + 3, axis] = way * speed
        jolt[axis + 3, axis + 3] = speed * speed
    return jolt


def update_altitude(cluster: Cluster, m: AltitudeMeasurement, white_m: float, slow_m: float) -> UpdateResult:
    """Correct with a barometric height whose error is partly white, partly slow."""
    record, joint = cluster.records[m.vehicle], cluster.joint
    start = joint.where[m.vehicle].start
    b = start + BARO_ERROR
    record.baro_error_sigma_m = cluster.change_sigma(m.vehicle, _BARO, record.baro_error_sigma_m, slow_m)
    cluster.propagate(m.vehicle, m.measured_at_s)
    hA = joint.A[start + 2] + joint.A[b]
    variance = hA.item(start + 2) + hA.item(b) + white_m * white_m
    innovation = m.up_m - hA.item(0)
    hA[0] = -innovation
    nis = innovation * innovation / variance
    if nis > cluster.settings.gate_sigma**2:
        # The barometer is the vehicle's own and drifts, it does not jump: believe it less, but do not lose it.
        variance += innovation * innovation
    W = joint.correct_scalar(hA, variance)
    sigma_m = math.sqrt(variance)
    cluster.update_manoeuvre_detector(m.vehicle, W, (innovation / sigma_m,), m.measured_at_s)
    return UpdateResult(USED, innovation, sigma_m, nis, 1)


def update_air_velocity(cluster: Cluster, m: AttitudeMeasurement) -> UpdateResult:
    """Turn with the bank angle from now on, and correct with the air velocity: ground velocity less wind."""
    s, record, joint = cluster.settings, cluster.records[m.vehicle], cluster.joint
    if m.airspeed_mps is None or m.airspeed_mps < LEAST_AIRSPEED_MPS or abs(m.roll_rad) > STEEPEST_BANK_RAD:
        record.attitude = None
        return UpdateResult("no airspeed beside the attitude")
    cluster.propagate(m.vehicle, m.measured_at_s)
    since_s = m.measured_at_s - record.attitude.measured_at_s if record.attitude is not None else s.air_noise_time_s
    record.attitude = m
    where = joint.where[m.vehicle]
    V = m.airspeed_mps * math.cos(m.pitch_rad)
    x, P = joint.mean(m.vehicle).tolist(), joint.covariance(m.vehicle)
    ve, vn = x[3] - x[6], x[4] - x[7]
    speed = math.hypot(ve, vn)
    spread = sum(P.item(v, v) - 2.0 * P.item(v, w) + P.item(w, w) for v, w in _AIR)
    if spread < (_WELL_KNOWN_SHARE * V) ** 2 and speed > 0.5 * V:
        # Linearised where the state is: along a noisy measured heading the gain and the innovation would share their
        # noise, and slowly shift wind against airspeed error.
        se, sn = ve / speed, vn / speed
        off = math.remainder(m.yaw_rad - math.atan2(ve, vn), 2.0 * math.pi)
        misses = (V - speed, speed * off)
    else:
        se, sn, speed = math.sin(m.yaw_rad), math.cos(m.yaw_rad), V
        misses = (V - se * ve - sn * vn, se * vn - sn * ve)
    # Rows: along the nose (airspeed), across it (heading).
    H = np.zeros((2, SIZE))
    H[0, VELOCITY.start : WIND.stop] = (se, sn, 0.0, -se, -sn)
    H[1, VELOCITY.start : WIND.stop] = (sn, -se, 0.0, -sn, se)
    H[0, AIRSPEED_ERROR], H[1, HEADING_ERROR] = 1.0, speed
    HA = joint.predict_block_measurement(m.vehicle, H)
    HA[:, 0] = (x[AIRSPEED_ERROR] - misses[0], speed * x[HEADING_ERROR] - misses[1])
    noise = s.air_noise_mps**2 * max(1.0, s.air_noise_time_s / max(since_s, 1e-3))
    S = _with_noise(HA[:, where] @ H.T, [noise, noise])
    whitened = whiten(HA, S)
    nis = whitened.nis
    excess = nis / s.gate_sigma**2
    if excess > 1.0:
        S[0, 0] += (excess - 1.0) * S[0, 0]
        S[1, 1] += (excess - 1.0) * S[1, 1]
        whitened = whiten(HA, S)
    joint.correct(whitened.W)
    cluster.update_manoeuvre_detector(m.vehicle, whitened.W, whitened.innovations(), m.measured_at_s)
    return UpdateResult(USED, 0.0, 0.0, nis, 2)
