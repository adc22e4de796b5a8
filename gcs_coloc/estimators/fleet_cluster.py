"""The measurement models of the fleet filter: how each kind of measurement corrects the joint state of a cluster of vehicles.

A cluster is a set of vehicles whose states are correlated: the subjects that range each other or share neighbours, and these
neighbours. Each takes a measurement at its own time, brings the vehicles concerned to that time and corrects the joint density.
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
from gcs_coloc.estimators.fleet_joint import Joint
from gcs_coloc.estimators.fleet_motion import (
    AIRSPEED_ERROR,
    BARO_ERROR,
    GRAVITY_MPS2,
    HEADING_ERROR,
    POSITION,
    REPORT_ERROR,
    SIZE,
    STAMP_ERROR,
    TURN,
    VELOCITY,
    add_acceleration_noise,
    set_turn_column,
    transition,
    turn_rate_radps,
)
from gcs_coloc.estimators.fleet_settings import FleetSettings
from gcs_coloc.estimators.fleet_vehicle import VehicleRecord

LEAST_AIRSPEED_MPS = 5.0
"""Below this an airspeed sensor and a coordinated turn mean nothing."""
_STEEPEST_BANK_RAD = 1.2
_COAST_TIME_S = 2.0
_COAST_GAIN = 5.0
_NOTICED_M = 10.0
_UNNOTICED_GAIN = 20.0
_TURN_GAIN = 6.0
_LONGEST_STEP_S = 0.5
_MOST_STEPS = 40
_TURN_TIME_S = 1.0
_UNKNOWN_VELOCITY_MPS = 30.0
_REPORT_VELOCITY_TIME_S = 1.0
_LEAST_DISTANCE_M = 1e-3
_HARDEST_MPS2 = 20.0
_WELL_KNOWN_SHARE = 0.25


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


def pair_key(a: int, b: int, device: int) -> tuple[int, int, int]:
    """Return the key of the bias block of a ranging pair: the bias belongs to both ends together."""
    return (a, b, device) if a < b else (b, a, device)


def initial_block(
    report: PositionMeasurement, white: tuple[float, float], slow: tuple[float, float], s: FleetSettings
) -> tuple[FloatArray, FloatArray]:
    """Return mean (16,) and covariance (16, 16) of a vehicle from one report; sigmas in m are (horizontal, vertical)."""
    x = np.zeros(SIZE)
    P = np.zeros((SIZE, SIZE))
    x[POSITION] = report.position_enu_m
    for axis in range(3):
        w, c = white[axis // 2], slow[axis // 2]
        P[axis, axis] = w * w + c * c
        e = REPORT_ERROR.start + axis
        P[e, e] = c * c
        P[axis, e] = P[e, axis] = -c * c
    sigma = _UNKNOWN_VELOCITY_MPS
    if report.velocity_enu_mps is not None and report.sigma_velocity_mps is not None:
        x[VELOCITY] = report.velocity_enu_mps
        sigma = report.sigma_velocity_mps
    for axis in (3, 4, 5):
        P[axis, axis] = sigma * sigma
    _own_slow_states(P, s)
    return x, P


def start_block(mean: FloatArray, covariance: FloatArray, s: FleetSettings) -> tuple[FloatArray, FloatArray]:
    """Return mean (16,) and covariance (16, 16) of a vehicle from its position and velocity, (6,) and (6, 6)."""
    x = np.zeros(SIZE)
    P = np.zeros((SIZE, SIZE))
    x[:6] = mean
    P[:6, :6] = covariance
    _own_slow_states(P, s)
    return x, P


def _own_slow_states(P: FloatArray, s: FleetSettings) -> None:
    for axis in (6, 7):
        P[axis, axis] = s.wind_sigma_mps**2
    P[AIRSPEED_ERROR, AIRSPEED_ERROR] = s.airspeed_sigma_mps**2
    P[HEADING_ERROR, HEADING_ERROR] = s.heading_sigma_rad**2
    P[STAMP_ERROR, STAMP_ERROR] = s.stamp_sigma_s**2
    P[TURN, TURN] = s.turn_sigma_radps**2


def _steps(from_s: float, to_s: float) -> list[float]:
    """Return the ends of the steps to a later time: short, for a turn bends the way, but not many. Empty if it is not later."""
    span_s = to_s - from_s
    if span_s <= 0.0:
        return []
    count = min(math.ceil(span_s / _LONGEST_STEP_S), _MOST_STEPS)
    return [from_s + span_s * i / count for i in range(1, count)] + [to_s]


class Cluster:
    """The joint state of some vehicles (`records` is shared with the model: this changes the records of its own vehicles)."""

    __slots__ = ("joint", "records", "settings")

    def __init__(self, settings: FleetSettings, records: dict[int, VehicleRecord], joint: Joint | None = None) -> None:
        self.settings = settings
        self.records = records
        self.joint = Joint() if joint is None else joint

    def motion(
        self, vehicle: int, x: FloatArray, P: FloatArray, step_s: float, at_s: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the mean (16,), its Jacobian F and the noise Q (16, 16) of a vehicle after a step (negative: back) to `at_s`.

        `x` (16,) and `P` (16, 16) are its state before the step.
        """
        s, record = self.settings, self.records[vehicle]
        attitude = record.attitude
        aided = attitude is not None and at_s - attitude.measured_at_s <= s.attitude_fresh_s
        length = abs(step_s)
        # A slow vehicle turns on the spot, which a turn rate does not describe.
        slowness = 1.0 / (1.0 + float(x[3] * x[3] + x[4] * x[4]) / (s.slow_speed_mps * s.slow_speed_mps))
        density = s.acceleration_density_m2ps3 + slowness * (s.slow_density_m2ps3 - s.acceleration_density_m2ps3)
        climb = s.climb_density_m2ps3
        ratio, ratio_v = record.manoeuvre.ratio(), record.manoeuvre.vertical_ratio()
        gain = max(ratio * ratio, 1.0)
        gain_v = max(ratio_v * ratio_v / 3.0, 1.0)
        if aided:
            assert attitude is not None
            assert attitude.airspeed_mps is not None
            roll = min(max(attitude.roll_rad, -_STEEPEST_BANK_RAD), _STEEPEST_BANK_RAD)
            turn = turn_rate_radps(roll, attitude.airspeed_mps)
            # A steep turn is never quite level: the lift that is over or wanting acts to the side and upwards.
            uneven = 2.0 * _TURN_TIME_S * (s.turn_share * GRAVITY_MPS2 * math.tan(roll)) ** 2
            density = s.aided_density_m2ps3 + uneven
            climb += uneven
        elif at_s - record.informed_at_s > _COAST_TIME_S:
            # Nobody has seen steady flight lately: a manoeuvre may have begun since.
            gain = max(gain, min(((at_s - record.informed_at_s) / _COAST_TIME_S) ** 2, _COAST_GAIN))
        if record.subject and not aided:
            # Where a place is known badly a manoeuvre is noticed late: one may have been under way for long.
            half, skew = 0.5 * float(P[0, 0] + P[1, 1]), 0.5 * float(P[0, 0] - P[1, 1])
            worst_m2 = half + math.sqrt(skew * skew + float(P[0, 1]) ** 2)
            gain = max(gain, min(worst_m2 / (_NOTICED_M * _NOTICED_M), _UNNOTICED_GAIN))
        density *= min(gain, s.manoeuvre_gain)
        climb *= min(gain_v, s.manoeuvre_gain)
        # How long the turn of now lasts, within the step.
        lasting_s = math.copysign(s.turn_time_s * -math.expm1(-length / s.turn_time_s), step_s)
        if not aided:
            turn = float(x[TURN]) * lasting_s / step_s
        F = transition(step_s, turn, in_wind=aided)
        mean = F @ x
        if not aided:
            set_turn_column(F, step_s, lasting_s, float(mean[3]), float(mean[4]))
        Q = np.zeros((SIZE, SIZE))
        add_acceleration_noise(Q, length, density, climb)
        for index, time_s, sigma in (
            (6, s.wind_time_s, s.wind_sigma_mps),
            (7, s.wind_time_s, s.wind_sigma_mps),
            (8, s.air_error_time_s, s.airspeed_sigma_mps),
            (9, s.air_error_time_s, s.heading_sigma_rad),
            (10, s.baro_error_time_s, record.slow_baro_m),
            (11, s.report_error_time_s, record.slow_report_h_m),
            (12, s.report_error_time_s, record.slow_report_h_m),
            (13, s.report_error_time_s, record.slow_report_v_m),
            (14, s.stamp_error_time_s, s.stamp_sigma_s),
            (15, s.turn_time_s, s.turn_sigma_radps * min(math.sqrt(gain), _TURN_GAIN)),
        ):
            decay = math.exp(-length / time_s)
            F[index, index] = decay
            mean[index] *= decay
            Q[index, index] += sigma * sigma * (1.0 - decay * decay)
        return mean, F, Q

    def bring(self, vehicle: int, at_s: float) -> None:
        """Propagate one vehicle to a time; a vehicle that is there already, or fixed, is left."""
        record = self.records[vehicle]
        if record.fixed:
            return
        joint = self.joint
        where = joint.slice(vehicle)
        for to_s in _steps(joint.time_s[vehicle], at_s):
            mean, F, Q = self.motion(vehicle, joint.x[where], joint.P[where, where], to_s - joint.time_s[vehicle], to_s)
            joint.transform(vehicle, mean, F, Q, to_s)

    def predicted(self, vehicle: int, at_s: float) -> tuple[FloatArray, FloatArray]:
        """Return mean (16,) and covariance (16, 16) of a vehicle at a time after, or shortly before, that of its states."""
        where = self.joint.slice(vehicle)
        x, P, from_s = self.joint.x[where], self.joint.P[where, where], self.joint.time_s[vehicle]
        for to_s in _steps(from_s, at_s) if at_s >= from_s else [at_s]:
            x, F, Q = self.motion(vehicle, x, P, to_s - from_s, to_s)
            P = F @ P @ F.T + Q
            from_s = to_s
        return x, P

    def rescale(self, vehicle: int, where: slice | int, factor: float) -> None:
        """Scale a slow state and all its covariances: its spread turned out to be other than assumed."""
        start = self.joint.start[vehicle]
        index = (
            slice(start + where.start, start + where.stop)
            if isinstance(where, slice)
            else slice(start + where, start + where + 1)
        )
        self.joint.x[index] *= factor
        self.joint.P[index] *= factor
        self.joint.P[:, index] *= factor

    def _watch(self, vehicle: int, W: FloatArray, e: FloatArray | tuple[float, ...], at_s: float) -> None:
        if self.records[vehicle].fixed:
            return
        monitor = self.records[vehicle].manoeuvre
        monitor.fade(at_s, self.settings.manoeuvre_memory_s)
        start = self.joint.start[vehicle] + VELOCITY.start
        east, north, up = W[start : start + 3].tolist()
        for we, wn, wu, whitened in zip(east, north, up, e, strict=True):
            monitor.add(we, wn, wu, whitened)

    def take_position(self, m: PositionMeasurement, white: tuple[float, float], slow: tuple[float, float]) -> Verdict:
        """Correct with a report of position, and velocity where given; sigmas in m are (horizontal, vertical)."""
        record, joint, at_s = self.records[m.vehicle], self.joint, m.measured_at_s
        since_s = at_s - record.informed_at_s
        self.bring(m.vehicle, at_s)
        start = joint.start[m.vehicle]
        if slow[0] < 0.9 * record.slow_report_h_m:
            self.rescale(m.vehicle, slice(11, 13), slow[0] / record.slow_report_h_m)
        if slow[1] < 0.9 * record.slow_report_v_m:
            self.rescale(m.vehicle, 13, slow[1] / record.slow_report_v_m)
        record.slow_report_h_m, record.slow_report_v_m = slow
        P, x = joint.P, joint.x
        p, e = slice(start, start + 3), slice(start + 11, start + 14)
        reported, sigma_mps = m.velocity_enu_mps, m.sigma_velocity_mps
        k = 3 if reported is None or sigma_mps is None else 6
        PHt = np.empty((len(x), k))
        v, late = slice(start + 3, start + 6), start + STAMP_ERROR
        velocity = x[v].copy()
        PHt[:, :3] = P[:, p] + P[:, e] + P[:, late, np.newaxis] * velocity
        innovation = np.empty(k)
        innovation[:3] = m.position_enu_m - x[p] - x[e] - x[late] * velocity
        noise = [white[0] ** 2, white[0] ** 2, white[1] ** 2]
        if reported is not None and sigma_mps is not None:
            PHt[:, 3:] = P[:, v]
            innovation[3:] = reported - x[v]
            # A navigation filter's velocity error is correlated too: more reports a second do not tell more.
            thin = max(1.0, _REPORT_VELOCITY_TIME_S / max(at_s - record.velocity_used_at_s, 1e-3))
            noise += [sigma_mps**2 * thin] * 3
            record.velocity_used_at_s = at_s
        S = self._report_covariance(PHt, m.vehicle, velocity, noise)
        nis = float(innovation @ np.linalg.solve(S, innovation))
        # Twice the degrees of freedom widen the gate as the chi-square distribution widens.
        limit = self.settings.gate_sigma**2 + 2.0 * k
        if nis > limit:
            # Noise that was not seen before to be white: as large as the report itself says.
            noise[:3] = [m.sigma_h_m**2, m.sigma_h_m**2, m.sigma_v_m**2]
            S = self._report_covariance(PHt, m.vehicle, velocity, noise)
            nis = float(innovation @ np.linalg.solve(S, innovation))
        if nis > limit:
            # A hard manoeuvre since the last report explains much: one that began then, at any acceleration a vehicle stands.
            jolt = self._jolt(since_s)
            trial = PHt.copy()
            trial[start : start + 6] += jolt[:, :k]
            S = self._report_covariance(trial, m.vehicle, velocity, noise)
            nis = float(innovation @ np.linalg.solve(S, innovation))
            if nis > limit:
                return Verdict("refused: position report outside the gate", 0.0, 0.0, nis, k)
            joint.P[start : start + 6, start : start + 6] += jolt
            PHt = trial
        W, whitened = joint.update(PHt, S, innovation)
        self._watch(m.vehicle, W, whitened.tolist(), at_s)
        record.informed_at_s = at_s
        return Verdict(USED, 0.0, 0.0, nis, k)

    def _report_covariance(self, PHt: FloatArray, vehicle: int, velocity: FloatArray, noise: list[float]) -> FloatArray:
        """Return S = H P H' + R (k, k) of a report: position with its errors in the first three rows, velocity in the rest."""
        start, k = self.joint.start[vehicle], PHt.shape[1]
        S = np.empty((k, k))
        S[:3] = PHt[start : start + 3] + PHt[start + 11 : start + 14] + velocity[:, np.newaxis] * PHt[start + STAMP_ERROR]
        S[3:] = PHt[start + 3 : start + k]
        S.flat[:: k + 1] += noise
        return S

    @staticmethod
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

    def take_altitude(self, m: AltitudeMeasurement, white_m: float, slow_m: float) -> Verdict:
        """Correct with a barometric height whose error is partly white, partly slow."""
        record, joint = self.records[m.vehicle], self.joint
        start = joint.start[m.vehicle]
        b = start + BARO_ERROR
        if record.slow_baro_m == 0.0:
            joint.P[b, b] += slow_m * slow_m
        elif slow_m < 0.9 * record.slow_baro_m:
            self.rescale(m.vehicle, BARO_ERROR, slow_m / record.slow_baro_m)
        record.slow_baro_m = slow_m
        self.bring(m.vehicle, m.measured_at_s)
        PHt = joint.P[:, start + 2] + joint.P[:, b]
        variance = float(PHt[start + 2] + PHt[b]) + white_m * white_m
        innovation = m.up_m - float(joint.x[start + 2] + joint.x[b])
        nis = innovation * innovation / variance
        if nis > self.settings.gate_sigma**2:
            # The barometer is the vehicle's own and drifts, it does not jump: believe it less, but do not lose it.
            variance += innovation * innovation
        W = joint.update_scalar(PHt, variance, innovation)
        self._watch(m.vehicle, W[:, np.newaxis], (innovation / math.sqrt(variance),), m.measured_at_s)
        return Verdict(USED, innovation, math.sqrt(variance), nis, 1)

    def take_attitude(self, m: AttitudeMeasurement) -> Verdict:
        """Turn with the bank angle from now on, and correct with the air velocity: ground velocity less wind."""
        s, record, joint = self.settings, self.records[m.vehicle], self.joint
        if m.airspeed_mps is None or m.airspeed_mps < LEAST_AIRSPEED_MPS or abs(m.roll_rad) > _STEEPEST_BANK_RAD:
            record.attitude = None
            return Verdict("no airspeed beside the attitude")
        self.bring(m.vehicle, m.measured_at_s)
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
        nis = float(innovation @ np.linalg.solve(S, innovation))
        excess = nis / s.gate_sigma**2
        if excess > 1.0:
            S[0, 0] += (excess - 1.0) * S[0, 0]
            S[1, 1] += (excess - 1.0) * S[1, 1]
        W, whitened = joint.update(PHt, S, innovation)
        self._watch(m.vehicle, W, whitened.tolist(), m.measured_at_s)
        return Verdict(USED, 0.0, 0.0, nis, 2)

    def take_range(self, m: RangeMeasurement, slow_m: float) -> Verdict:
        """Correct with a slant range between two vehicles; `slow_m` is the sigma of the part of its error that lasts."""
        s, joint, at_s = self.settings, self.joint, m.measured_at_s
        a, b = m.from_vehicle, m.to_vehicle
        self.bring(a, at_s)
        self.bring(b, at_s)
        bias = self._pair(m, slow_m)
        ia, ib = joint.start[a], joint.start[b]
        P, x = joint.P, joint.x
        dx, dy, dz = (x[ia : ia + 3] - x[ib : ib + 3]).tolist()
        distance = math.sqrt(dx * dx + dy * dy + dz * dz)
        if distance < _LEAST_DISTANCE_M:
            return Verdict("refused: both ends estimated at one place")
        u = np.array([dx, dy, dz]) / distance
        relative = P[:, ia : ia + 3] - P[:, ib : ib + 3]
        M = relative[ia : ia + 3] - relative[ib : ib + 3]
        PHt = relative @ u
        Mu = M @ u
        along = float(u @ Mu)
        # Second order: a range to an uncertain place is on average longer than to its mean, and its spread grows.
        across_trace = max(float(M[0, 0] + M[1, 1] + M[2, 2]) - along, 0.0)
        square = float(np.vdot(M, M)) - 2.0 * float(Mu @ Mu) + along * along
        longer = 0.5 * across_trace / distance
        spread = max(0.5 * square / (distance * distance), 0.0)
        noise = m.sigma_m * m.sigma_m
        if s.stamp_sigma_s > 0.0:
            closing = self._closing_mps(a, b, u)
            noise += (closing * s.stamp_sigma_s) ** 2
        # The expansion fails where the uncertainty is as large as the distance: there it may not outgrow the first order.
        spread = min(spread, along + noise)
        longer = min(longer, math.sqrt(along + noise))
        expected = distance + longer
        PHt = PHt + P[:, bias] + P[:, bias + 1]
        expected += float(x[bias] + x[bias + 1])
        variance = float(u @ (PHt[ia : ia + 3] - PHt[ib : ib + 3]) + PHt[bias] + PHt[bias + 1]) + spread + noise
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
        self._watch(a, column, whitened, at_s)
        self._watch(b, column, whitened, at_s)
        return Verdict(USED, innovation, sigma, nis, 1)

    def _closing_mps(self, a: int, b: int, u: FloatArray) -> float:
        closing = 0.0
        for vehicle, sign in ((a, 1.0), (b, -1.0)):
            if not self.records[vehicle].fixed:
                v = self.joint.start[vehicle] + 3
                closing += sign * float(u @ self.joint.x[v : v + 3])
        return closing

    def _pair(self, m: RangeMeasurement, slow_m: float) -> int:
        """Bring the pair's two range errors (bias and slow part) to the time of a range; return the index of the first."""
        s, joint = self.settings, self.joint
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

    def widen(self, vehicle: int, position_m2: float) -> None:
        """Add uncertainty to a vehicle that the ranges contradict: position variance in m^2 per axis, velocity to match."""
        start = self.joint.start[vehicle]
        time2_s2 = 4.0
        for axis in range(3):
            self.joint.P[start + axis, start + axis] += position_m2
            self.joint.P[start + 3 + axis, start + 3 + axis] += position_m2 / time2_s2
