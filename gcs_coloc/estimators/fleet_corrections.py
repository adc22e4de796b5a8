"""The measurement models of the fleet filter: how each kind of measurement corrects the joint state of a cluster of vehicles.

Each takes a measurement at its own time and brings the vehicles concerned to that time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    FloatArray,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.estimators.fleet_blocks import pair_key
from gcs_coloc.estimators.fleet_cluster import Cluster
from gcs_coloc.estimators.fleet_joint import whiten
from gcs_coloc.estimators.fleet_motion import (
    AIRSPEED_ERROR,
    BARO_ERROR,
    HEADING_ERROR,
    REPORT_ERROR,
    STAMP_ERROR,
    STEEPEST_BANK_RAD,
)

_LEAST_AIRSPEED_MPS = 5.0  # below it an airspeed sensor and a coordinated turn mean nothing
_REPORT_VELOCITY_TIME_S = 1.0
_LEAST_DISTANCE_M = 1e-3
_HARDEST_MPS2 = 20.0
_WELL_KNOWN_SHARE = 0.25
_REPORT_ERROR_H = slice(REPORT_ERROR.start, REPORT_ERROR.start + 2)
_REPORT_ERROR_V = slice(REPORT_ERROR.start + 2, REPORT_ERROR.stop)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of a measurement: `used` or not and why, with the innovation where there was one to judge."""

    outcome: str
    innovation_m: float = 0.0
    sigma_m: float = 0.0
    nis: float = 0.0
    degrees_of_freedom: int = 0

    @property
    def used(self) -> bool:
        """Whether the state was corrected."""
        return self.outcome == USED


USED = "used"


def restate_clock(cluster: Cluster, vehicle: int, sigma_s: float) -> None:
    """Take a new sigma of the error of a vehicle's time stamps."""
    record = cluster.records[vehicle]
    if not record.fixed:
        record.stamp_s = cluster.restate(vehicle, slice(STAMP_ERROR, STAMP_ERROR + 1), record.stamp_s, sigma_s)


def take_position(
    cluster: Cluster, m: PositionMeasurement, white: tuple[float, float], slow: tuple[float, float], stamp_s: float
) -> Verdict:
    """Correct with a report of position, and velocity where given; sigmas in m are (horizontal, vertical)."""
    record, joint, at_s = cluster.records[m.vehicle], cluster.joint, m.measured_at_s
    since_s = at_s - record.informed_at_s
    cluster.bring(m.vehicle, at_s)
    start = joint.start[m.vehicle]
    record.slow_report_h_m = cluster.restate(m.vehicle, _REPORT_ERROR_H, record.slow_report_h_m, slow[0])
    record.slow_report_v_m = cluster.restate(m.vehicle, _REPORT_ERROR_V, record.slow_report_v_m, slow[1])
    restate_clock(cluster, m.vehicle, stamp_s)
    P, x = joint.P, joint.x
    p, e = slice(start, start + 3), slice(start + 11, start + 14)
    reported, sigma_mps = m.velocity_enu_mps, m.sigma_velocity_mps
    k = 3 if reported is None or sigma_mps is None else 6
    PHt = np.empty((len(x), k))
    v = slice(start + 3, start + 6)
    PHt[:, :3] = P[:, p] + P[:, e]
    innovation = np.empty(k)
    innovation[:3] = m.position_enu_m - x[p] - x[e]
    noise = [white[0] ** 2, white[0] ** 2, white[1] ** 2]
    if reported is not None and sigma_mps is not None:
        PHt[:, 3:] = P[:, v]
        innovation[3:] = reported - x[v]
        # A navigation filter's velocity error is correlated too: more reports a second do not tell more.
        thin = max(1.0, _REPORT_VELOCITY_TIME_S / max(at_s - record.velocity_used_at_s, 1e-3))
        noise += [sigma_mps**2 * thin] * 3
        record.velocity_used_at_s = at_s
    whitened = whiten(_report_covariance(cluster, PHt, m.vehicle, noise), innovation)
    # Twice the degrees of freedom widen the gate as the chi-square distribution widens.
    limit = cluster.settings.gate_sigma**2 + 2.0 * k
    if whitened.nis > limit:
        # Noise that was not seen before to be white: as large as the report itself says.
        noise[:3] = [m.sigma_h_m**2, m.sigma_h_m**2, m.sigma_v_m**2]
        whitened = whiten(_report_covariance(cluster, PHt, m.vehicle, noise), innovation)
    if whitened.nis > limit:
        # A hard manoeuvre since the last report explains much: one that began then, at any acceleration a vehicle stands.
        jolt = _jolt(since_s)
        trial = PHt.copy()
        trial[start : start + 6] += jolt[:, :k]
        whitened = whiten(_report_covariance(cluster, trial, m.vehicle, noise), innovation)
        if whitened.nis > limit:
            return Verdict("refused: position report outside the gate", 0.0, 0.0, whitened.nis, k)
        joint.P[start : start + 6, start : start + 6] += jolt
        PHt = trial
    W = joint.update(PHt, whitened)
    cluster.watch(m.vehicle, W, whitened.e.tolist(), at_s)
    record.informed_at_s = at_s
    return Verdict(USED, 0.0, 0.0, whitened.nis, k)


def _report_covariance(cluster: Cluster, PHt: FloatArray, vehicle: int, noise: list[float]) -> FloatArray:
    """Return S = H P H' + R (k, k) of a report: position with its errors in the first three rows, velocity in the rest."""
    start, k = cluster.joint.start[vehicle], PHt.shape[1]
    S = np.empty((k, k))
    S[:3] = PHt[start : start + 3] + PHt[start + 11 : start + 14]
    S[3:] = PHt[start + 3 : start + k]
    S.flat[:: k + 1] += noise
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


def take_altitude(cluster: Cluster, m: AltitudeMeasurement, white_m: float, slow_m: float) -> Verdict:
    """Correct with a barometric height whose error is partly white, partly slow."""
    record, joint = cluster.records[m.vehicle], cluster.joint
    start = joint.start[m.vehicle]
    b = start + BARO_ERROR
    record.slow_baro_m = cluster.restate(m.vehicle, slice(BARO_ERROR, BARO_ERROR + 1), record.slow_baro_m, slow_m)
    cluster.bring(m.vehicle, m.measured_at_s)
    PHt = joint.P[:, start + 2] + joint.P[:, b]
    variance = float(PHt[start + 2] + PHt[b]) + white_m * white_m
    innovation = m.up_m - float(joint.x[start + 2] + joint.x[b])
    nis = innovation * innovation / variance
    if nis > cluster.settings.gate_sigma**2:
        # The barometer is the vehicle's own and drifts, it does not jump: believe it less, but do not lose it.
        variance += innovation * innovation
    W = joint.update_scalar(PHt, variance, innovation)
    cluster.watch(m.vehicle, W[:, np.newaxis], (innovation / math.sqrt(variance),), m.measured_at_s)
    return Verdict(USED, innovation, math.sqrt(variance), nis, 1)


def take_attitude(cluster: Cluster, m: AttitudeMeasurement) -> Verdict:
    """Turn with the bank angle from now on, and correct with the air velocity: ground velocity less wind."""
    s, record, joint = cluster.settings, cluster.records[m.vehicle], cluster.joint
    if m.airspeed_mps is None or m.airspeed_mps < _LEAST_AIRSPEED_MPS or abs(m.roll_rad) > STEEPEST_BANK_RAD:
        record.attitude = None
        return Verdict("no airspeed beside the attitude")
    cluster.bring(m.vehicle, m.measured_at_s)
    since_s = m.measured_at_s - record.attitude.measured_at_s if record.attitude is not None else s.air_noise_time_s
    record.attitude = m
    start = joint.start[m.vehicle]
    V = m.airspeed_mps * math.cos(m.pitch_rad)
    P, x = joint.P, joint.x
    v, w = slice(start + 3, start + 5), slice(start + 6, start + 8)
    air = P[:, v] - P[:, w]
    ve, vn = (x[v] - x[w]).tolist()
    speed = math.hypot(ve, vn)
    spread = float(np.trace(air[v]) - np.trace(air[w]))
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
    PHt = np.empty((len(x), 2))
    PHt[:, 0] = se * air[:, 0] + sn * air[:, 1] + P[:, start + AIRSPEED_ERROR]
    PHt[:, 1] = sn * air[:, 0] - se * air[:, 1] + speed * P[:, start + HEADING_ERROR]
    innovation = np.array(misses) - (x[start + AIRSPEED_ERROR], speed * x[start + HEADING_ERROR])
    S = np.empty((2, 2))
    rows = PHt[v] - PHt[w]
    S[0] = se * rows[0] + sn * rows[1] + PHt[start + AIRSPEED_ERROR]
    S[1] = sn * rows[0] - se * rows[1] + speed * PHt[start + HEADING_ERROR]
    noise = s.air_noise_mps**2 * max(1.0, s.air_noise_time_s / max(since_s, 1e-3))
    S[0, 0] += noise
    S[1, 1] += noise
    whitened = whiten(S, innovation)
    nis = whitened.nis
    excess = nis / s.gate_sigma**2
    if excess > 1.0:
        S[0, 0] += (excess - 1.0) * S[0, 0]
        S[1, 1] += (excess - 1.0) * S[1, 1]
        whitened = whiten(S, innovation)
    W = joint.update(PHt, whitened)
    cluster.watch(m.vehicle, W, whitened.e.tolist(), m.measured_at_s)
    return Verdict(USED, 0.0, 0.0, nis, 2)


def take_range(cluster: Cluster, m: RangeMeasurement, sigma_m: float, slow_m: float) -> Verdict:
    """Correct with a slant range between two vehicles.

    `sigma_m` is that of the range itself, `slow_m` of the part of its error that lasts.
    """
    s, joint, at_s = cluster.settings, cluster.joint, m.measured_at_s
    a, b = m.from_vehicle, m.to_vehicle
    cluster.bring(a, at_s)
    cluster.bring(b, at_s)
    bias = _pair(cluster, m, slow_m)
    P, x = joint.P, joint.x
    dx, dy, dz = (cluster.place(a) - cluster.place(b)).tolist()
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if distance < _LEAST_DISTANCE_M:
        return Verdict("refused: both ends estimated at one place")
    u = np.array([dx, dy, dz]) / distance
    relative, M = cluster.relative(a, b)
    PHt = relative @ u
    Mu = M @ u
    along = float(u @ Mu)
    # Second order: a range to an uncertain place is on average longer than to its mean, and its spread grows.
    across_trace = max(float(M[0, 0] + M[1, 1] + M[2, 2]) - along, 0.0)
    square = float(np.vdot(M, M)) - 2.0 * float(Mu @ Mu) + along * along
    longer = 0.5 * across_trace / distance
    spread = max(0.5 * square / (distance * distance), 0.0)
    closing = _closing_mps(cluster, a, b, u)
    noise = sigma_m * sigma_m + (closing * s.stamp_sigma_s) ** 2
    # The expansion fails where the uncertainty is as large as the distance: there it may not outgrow the first order.
    spread = min(spread, along + noise)
    longer = min(longer, math.sqrt(along + noise))
    expected = distance + longer
    PHt = PHt + P[:, bias] + P[:, bias + 1]
    expected += float(x[bias] + x[bias + 1])
    clock = m.clock_of if m.clock_of in (a, b) and not cluster.records[m.clock_of].fixed else None
    if clock is not None:
        # It is of as much later than it says as the reports of the vehicle that stamped it.
        late = joint.start[clock] + STAMP_ERROR
        PHt += closing * P[:, late]
        expected += closing * float(x[late])
    variance = float(u @ (cluster.placed(a, PHt) - cluster.placed(b, PHt)) + PHt[bias] + PHt[bias + 1]) + spread + noise
    if clock is not None:
        variance += closing * float(PHt[late])
    innovation = m.range_m - expected
    nis = innovation * innovation / variance
    sigma = math.sqrt(variance)
    if nis > s.gate_sigma**2:
        return Verdict("refused: range outside the gate", innovation, sigma, nis, 1)
    if nis > s.doubt_sigma**2:
        # Huber's weight: beyond the doubt the pull of an innovation grows no more.
        variance *= math.sqrt(nis) / s.doubt_sigma
    W = joint.update_scalar(PHt, variance, innovation)
    whitened = (innovation / math.sqrt(variance),)
    column = W[:, np.newaxis]
    cluster.watch(a, column, whitened, at_s)
    cluster.watch(b, column, whitened, at_s)
    return Verdict(USED, innovation, sigma, nis, 1)


def _closing_mps(cluster: Cluster, a: int, b: int, u: FloatArray) -> float:
    closing = 0.0
    for vehicle, sign in ((a, 1.0), (b, -1.0)):
        if not cluster.records[vehicle].fixed:
            v = cluster.joint.start[vehicle] + 3
            closing += sign * float(u @ cluster.joint.x[v : v + 3])
    return closing


def _pair(cluster: Cluster, m: RangeMeasurement, slow_m: float) -> int:
    """Bring the pair's two range errors (bias and slow part) to the time of a range; return the index of the first."""
    s, joint = cluster.settings, cluster.joint
    key = pair_key(m.from_vehicle, m.to_vehicle, m.device_id)
    sigmas = (s.range_bias_sigma_m, slow_m)
    if key not in joint.start:
        joint.append(key, np.zeros(2), np.diag(np.square(sigmas)), m.measured_at_s)
        return joint.start[key]
    index = joint.start[key]
    step_s = m.measured_at_s - joint.time_s[key]
    if step_s > 0.0:
        decays = (math.exp(-step_s / s.range_bias_time_s), math.exp(-step_s / s.range_slow_time_s))
        for i, decay, sigma in zip((index, index + 1), decays, sigmas, strict=True):
            joint.x[i] *= decay
            joint.P[i] *= decay
            joint.P[:, i] *= decay
            joint.P[i, i] += sigma * sigma * (1.0 - decay * decay)
        joint.time_s[key] = m.measured_at_s
    return index
