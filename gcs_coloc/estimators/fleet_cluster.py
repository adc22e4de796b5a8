"""The joint state of a cluster of vehicles: how it moves on in time, where its vehicles are, and what widens it.

A cluster is a set of vehicles whose states are correlated: the subjects that range each other or share neighbours, and these
neighbours. `fleet_corrections` brings the vehicles of a measurement to its time and corrects the joint density.
"""

from __future__ import annotations

import math

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.estimators.fleet_joint import Joint
from gcs_coloc.estimators.fleet_motion import (
    GRAVITY_MPS2,
    STAMP_ERROR,
    STEEPEST_BANK_RAD,
    TURN,
    VELOCITY,
    WIND,
    acceleration_noise,
    fade_slow_states,
    set_turn_column,
    transition,
    turn_rate_radps,
)
from gcs_coloc.estimators.fleet_settings import FleetSettings
from gcs_coloc.estimators.fleet_vehicle import VehicleRecord

_COAST_TIME_S = 2.0
_COAST_GAIN = 5.0
_NOTICED_M = 10.0
_UNNOTICED_GAIN = 20.0
_TURN_GAIN = 6.0
_LONGEST_STEP_S = 0.5
_MOST_STEPS = 40
_TURN_TIME_S = 1.0
_LEAST_OWN_SHARE = 1e-3
_CLEARLY_LESS = 0.9
_CLEARLY_MORE = 1.1


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
        if record.subject and record.slow_baro_m == 0.0:
            # Nobody tells its height: what flies fast soon climbs fast.
            climb += (1.0 - slowness) * max(s.unseen_climb_density_m2ps3 - climb, 0.0)
        ratio, ratio_v = record.manoeuvre.ratio(), record.manoeuvre.vertical_ratio()
        gain = max(ratio * ratio, 1.0)
        gain_v = max(ratio_v * ratio_v / 3.0, 1.0)
        if aided:
            assert attitude is not None
            assert attitude.airspeed_mps is not None
            roll = min(max(attitude.roll_rad, -STEEPEST_BANK_RAD), STEEPEST_BANK_RAD)
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
        # Of the error of time stamps only the vehicle's own part changes, a clock's lasts.
        own = s.stamp_sigma_s / record.stamp_s if record.stamp_s > 0.0 else 0.0
        stamp_time_s = s.stamp_error_time_s / max(own * own, _LEAST_OWN_SHARE)
        Q = acceleration_noise(length, density, climb)
        air_s, report_s = s.air_error_time_s, s.report_error_time_s
        times_s = (s.wind_time_s, s.wind_time_s, air_s, air_s, s.baro_error_time_s, *(report_s,) * 3, stamp_time_s, s.turn_time_s)
        sigmas = (
            *(s.wind_sigma_mps, s.wind_sigma_mps, s.airspeed_sigma_mps, s.heading_sigma_rad, record.slow_baro_m),
            *(record.slow_report_h_m, record.slow_report_h_m, record.slow_report_v_m, record.stamp_s),
            s.turn_sigma_radps * min(math.sqrt(gain), _TURN_GAIN),
        )
        fade_slow_states(mean, F, Q, length, times_s, sigmas)
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

    def place(self, vehicle: int) -> FloatArray:
        """Return where a vehicle is, (3,), at the time of its states.

        What a vehicle says of itself is all late by the one error of its clock, and its states go by that clock.
        """
        start, x = self.joint.start[vehicle], self.joint.x
        if self.records[vehicle].fixed:
            return x[start : start + 3].copy()
        there: FloatArray = x[start : start + 3] - x[start + STAMP_ERROR] * x[start + 3 : start + 6]
        return there

    def placed(self, vehicle: int, A: FloatArray) -> FloatArray:
        """Return A G' (..., 3) with G the Jacobian of `place`; `A` (..., n)."""
        start, x = self.joint.start[vehicle], self.joint.x
        if self.records[vehicle].fixed:
            return A[..., start : start + 3]
        late = start + STAMP_ERROR
        v = slice(start + 3, start + 6)
        placed: FloatArray = A[..., start : start + 3] - x[late] * A[..., v] - A[..., late, np.newaxis] * x[v]
        return placed

    def relative(self, a: int, b: int) -> tuple[FloatArray, FloatArray]:
        """Return the covariance of all states with the place of `a` relative to `b`, (n, 3), and that place's own, (3, 3)."""
        with_all = self.placed(a, self.joint.P) - self.placed(b, self.joint.P)
        return with_all, self.placed(a, with_all.T) - self.placed(b, with_all.T)

    def restate(self, vehicle: int, where: slice, before: float, now: float) -> float:
        """Take a new sigma of a vehicle's slow errors where it is clearly another one; return the one now in force."""
        joint = self.joint
        start = joint.start[vehicle]
        index = slice(start + where.start, start + where.stop)
        if now < _CLEARLY_LESS * before:
            factor = now / before
            joint.x[index] *= factor
            joint.P[index] *= factor
            joint.P[:, index] *= factor
            return now
        if now > _CLEARLY_MORE * before:
            # What is more than before may have come all at once.
            joint.P[range(index.start, index.stop), range(index.start, index.stop)] += now * now - before * before
            return now
        return before

    def watch(self, vehicle: int, W: FloatArray, e: FloatArray | tuple[float, ...], at_s: float) -> None:
        """Note for the manoeuvre monitor by how much a correction W e, W (n, k), e (k,), changed a vehicle's velocity."""
        if self.records[vehicle].fixed:
            return
        monitor = self.records[vehicle].manoeuvre
        monitor.fade(at_s, self.settings.manoeuvre_memory_s)
        start = self.joint.start[vehicle] + VELOCITY.start
        east, north, up = W[start : start + 3].tolist()
        for we, wn, wu, whitened in zip(east, north, up, e, strict=True):
            monitor.add(we, wn, wu, whitened)

    def widen(self, vehicle: int, position_m2: float) -> None:
        """Add uncertainty to a vehicle that the ranges contradict: position variance in m^2 per axis, velocity to match.

        The wind goes with the velocity: one that was learned from a false velocity would bring it back with the next air data.
        """
        P, start = self.joint.P, self.joint.start[vehicle]
        time2_s2 = 4.0
        for axis in range(3):
            P[start + axis, start + axis] += position_m2
            P[start + 3 + axis, start + 3 + axis] += position_m2 / time2_s2
        for axis in (WIND.start, WIND.start + 1):
            P[start + axis, start + axis] += position_m2 / time2_s2
