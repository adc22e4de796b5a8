"""The joint state of a cluster of vehicles: how it moves on in time, where its vehicles are, and what widens it.

A cluster is a set of vehicles whose states are correlated: the vehicles that range each other or share neighbours, and these
neighbours. `corrections` brings the vehicles of a measurement to its time and corrects the joint density.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np

from gcs_coloc.core.measurements import FloatArray, Vector3
from gcs_coloc.estimators.fleet.ekf._kernels import (
    GRAVITY_MPS2,
    STAMP_ERROR,
    STEEPEST_BANK_RAD,
    TURN,
    VELOCITY,
    WIND,
    Transition,
    turn_rate_radps,
)
from gcs_coloc.estimators.fleet.ekf.records import VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import JointState
from gcs_coloc.estimators.fleet.settings import FleetSettings

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
_new = tuple.__new__


class RangeEnd(NamedTuple):
    """One end of a range: where its states are in `A`, its place (m), velocity (m/s), and how late its time stamps are (s).

    The place is as `Cluster.place` has it. A fixed anchor has neither velocity nor clock.
    """

    vehicle: int
    where: slice
    position: Vector3
    velocity: Vector3 = (0.0, 0.0, 0.0)
    time_stamp_offset_s: float | None = None


def _write_place(g: memoryview[float], n: int, end: RangeEnd, unit: Vector3, sign: float) -> None:
    """Write a sign times the Jacobian of a vehicle's place by its states into four flat rows of n: along `unit`, E, N, U."""
    e, time_stamp_offset_s = end.where.start, end.time_stamp_offset_s
    ux, uy, uz = unit
    g[e], g[e + 1], g[e + 2] = sign * ux, sign * uy, sign * uz
    g[n + e] = g[2 * n + e + 1] = g[3 * n + e + 2] = sign
    if time_stamp_offset_s is None:
        return
    time_stamp_offset_s *= -sign
    v, s = e + VELOCITY.start, e + STAMP_ERROR
    g[v], g[v + 1], g[v + 2] = time_stamp_offset_s * ux, time_stamp_offset_s * uy, time_stamp_offset_s * uz
    g[n + v] = g[2 * n + v + 1] = g[3 * n + v + 2] = time_stamp_offset_s
    ve, vn, vu = end.velocity
    g[s] = -sign * (ux * ve + uy * vn + uz * vu)
    g[n + s], g[2 * n + s], g[3 * n + s] = -sign * ve, -sign * vn, -sign * vu


def _steps(from_s: float, to_s: float) -> Sequence[float]:
    """Return the ends of the steps to a later time: short, for a turn bends the way, but not many. Empty if it is not later."""
    span_s = to_s - from_s
    if span_s <= _LONGEST_STEP_S:
        return (to_s,) if span_s > 0.0 else ()
    count = min(math.ceil(span_s / _LONGEST_STEP_S), _MOST_STEPS)
    return [from_s + span_s * i / count for i in range(1, count)] + [to_s]


class Cluster:
    """The joint state of some vehicles.

    `records` is shared with the model: this changes the records of its own vehicles. `step` is room to work in for who has no
    state of it: clusters may share one.
    """

    __slots__ = ("joint", "records", "settings", "step")

    def __init__(
        self, settings: FleetSettings, records: Mapping[int, VehicleRecord], step: Transition, joint: JointState
    ) -> None:
        self.settings = settings
        self.records = records
        self.step = step
        self.joint = joint

    def motion(self, vehicle: int, x: Sequence[float], P: FloatArray, step_s: float, at_s: float) -> tuple[float, ...]:
        """Fill `step` with the way of a vehicle over a step (negative: back) to `at_s`; return the mean of its first five states.

        `x` (16,) and `P` (16, 16) are its state before the step.
        """
        s, record, step = self.settings, self.records[vehicle], self.step
        attitude = record.attitude
        length = abs(step_s)
        # A slow vehicle turns on the spot, which a turn rate does not describe.
        slowness = 1.0 / (1.0 + (x[3] * x[3] + x[4] * x[4]) / (s.slow_speed_mps * s.slow_speed_mps))
        density = s.acceleration_density_m2ps3 + slowness * (s.slow_density_m2ps3 - s.acceleration_density_m2ps3)
        climb = s.climb_density_m2ps3
        if record.denied_vehicle and record.baro_error_sigma_m == 0.0:
            # Nobody tells its height: what flies fast soon climbs fast.
            climb += (1.0 - slowness) * max(s.unseen_climb_density_m2ps3 - climb, 0.0)
        gain, gain_v = record.manoeuvre.gains()
        # How long the turn of now lasts, within the step.
        lasting_s = math.copysign(s.turn_time_s * -math.expm1(-length / s.turn_time_s), step_s)
        aided = attitude is not None and at_s - attitude.measured_at_s <= s.attitude_fresh_s
        if aided:
            assert attitude is not None
            assert attitude.airspeed_mps is not None
            roll = min(max(attitude.roll_rad, -STEEPEST_BANK_RAD), STEEPEST_BANK_RAD)
            turn = turn_rate_radps(roll, attitude.airspeed_mps)
            # A steep turn is never quite level: the lift that is over or wanting acts to the side and upwards.
            uneven = 2.0 * _TURN_TIME_S * (s.turn_share * GRAVITY_MPS2 * math.tan(roll)) ** 2
            density = s.aided_density_m2ps3 + uneven
            climb += uneven
        else:
            turn = x[TURN] * lasting_s / step_s
            if at_s - record.updated_at_s > _COAST_TIME_S:
                # Nobody has seen steady flight lately: a manoeuvre may have begun since.
                gain = max(gain, min(((at_s - record.updated_at_s) / _COAST_TIME_S) ** 2, _COAST_GAIN))
            if record.denied_vehicle:
                # Where a place is known badly a manoeuvre is noticed late: one may have been under way for long.
                ee_m2, en_m2, nn_m2 = P.item(0, 0), P.item(0, 1), P.item(1, 1)
                half, skew = 0.5 * (ee_m2 + nn_m2), 0.5 * (ee_m2 - nn_m2)
                worst_m2 = half + math.sqrt(skew * skew + en_m2 * en_m2)
                gain = max(gain, min(worst_m2 / (_NOTICED_M * _NOTICED_M), _UNNOTICED_GAIN))
        mean = step.set_motion(x, step_s, turn, in_wind=aided)
        if not aided:
            step.set_turn_column(step_s, lasting_s, mean[3], mean[4])
        step.set_acceleration_noise(length, density * min(gain, s.manoeuvre_gain), climb * min(gain_v, s.manoeuvre_gain))
        # Of the error of time stamps only the vehicle's own part changes, a clock's lasts.
        own = s.stamp_sigma_s / record.time_stamp_offset_sigma_s if record.time_stamp_offset_sigma_s > 0.0 else 0.0
        stamp_time_s = s.stamp_error_time_s / max(own * own, _LEAST_OWN_SHARE)
        turning = s.turn_sigma_radps * min(math.sqrt(gain), _TURN_GAIN)
        step.set_gauss_markov(
            length,
            (s.wind_time_s, s.air_error_time_s, s.baro_error_time_s, s.report_error_time_s, stamp_time_s, s.turn_time_s),
            (
                *(s.wind_sigma_mps, s.airspeed_sigma_mps, s.heading_sigma_rad, record.baro_error_sigma_m),
                *(record.report_error_sigma_h_m, record.report_error_sigma_v_m, record.time_stamp_offset_sigma_s, turning),
            ),
        )
        return mean

    def propagate(self, vehicle: int, at_s: float) -> None:
        """Propagate one vehicle to a time; a vehicle that is there already, or fixed, is left."""
        joint = self.joint
        from_s = joint.time_s[vehicle]
        if at_s <= from_s or self.records[vehicle].static:
            return
        A, step, where = joint.A, self.step, joint.where[vehicle]
        P = A[where, where]
        for to_s in (at_s,) if at_s - from_s <= _LONGEST_STEP_S else _steps(from_s, at_s):
            mean = self.motion(vehicle, A[0, where].tolist(), P, to_s - from_s, to_s)
            joint.propagate(vehicle, mean, step.F, step.Q, to_s)
            from_s = to_s

    def predict(self, vehicle: int, at_s: float) -> tuple[FloatArray, FloatArray]:
        """Return mean (16,) and covariance (16, 16) of a vehicle at a time after, or shortly before, that of its states."""
        joint, step = self.joint, self.step
        x, P, from_s = joint.mean(vehicle), joint.covariance(vehicle), joint.time_s[vehicle]
        for to_s in _steps(from_s, at_s) if at_s >= from_s else [at_s]:
            mean = self.motion(vehicle, x.tolist(), P, to_s - from_s, to_s)
            x = step.F @ x
            x[: len(mean)] = mean
            P = step.F @ P @ step.F.T
            P += step.Q
            from_s = to_s
        return x, P

    def position(self, vehicle: int) -> Vector3:
        """Return where a vehicle is, at the time of its states.

        What a vehicle says of itself is all late by the one error of its clock, and its states go by that clock.
        """
        x = self.joint.mean(vehicle).tolist()
        if self.records[vehicle].static:
            return x[0], x[1], x[2]
        time_stamp_offset_s = x[STAMP_ERROR]
        return x[0] - time_stamp_offset_s * x[3], x[1] - time_stamp_offset_s * x[4], x[2] - time_stamp_offset_s * x[5]

    def range_end(self, vehicle: int) -> RangeEnd:
        """Return what a vehicle is as one end of a range."""
        where = self.joint.where[vehicle]
        x = self.joint.A[0, where].tolist()
        if self.records[vehicle].static:
            return RangeEnd(vehicle, where, (x[0], x[1], x[2]))
        time_stamp_offset_s, ve, vn, vu = x[STAMP_ERROR], x[3], x[4], x[5]
        place = (x[0] - time_stamp_offset_s * ve, x[1] - time_stamp_offset_s * vn, x[2] - time_stamp_offset_s * vu)
        # As RangeEnd(...) does, at half the time.
        return _new(RangeEnd, (vehicle, where, place, (ve, vn, vu), time_stamp_offset_s))

    def range_jacobian(self, a: RangeEnd, b: RangeEnd, unit: Vector3) -> FloatArray:
        """Return the Jacobian (4, 1 + n) of the way from `b` to `a` by all states: along a unit vector, and east, north, up."""
        n = len(self.joint.A)
        G = np.zeros((4, n))
        flat = cast("memoryview[float]", G.reshape(-1).data)
        _write_place(flat, n, a, unit, 1.0)
        _write_place(flat, n, b, unit, -1.0)
        return G

    def change_sigma(self, vehicle: int, where: slice, before: float, now: float) -> float:
        """Take a new sigma of a vehicle's slow errors where it is clearly another one; return the one now in force."""
        if _CLEARLY_LESS * before <= now <= _CLEARLY_MORE * before:
            return before
        joint = self.joint
        start = joint.where[vehicle].start
        first, stop = start + where.start, start + where.stop
        if now < before:
            joint.scale(first, stop, now / before)
        else:
            # What is more than before may have come all at once.
            joint.A[range(first, stop), range(first, stop)] += now * now - before * before
        return now

    def update_manoeuvre_detector(self, vehicle: int, W: FloatArray, innovations: Sequence[float], at_s: float) -> None:
        """Note for the manoeuvre monitor how much a correction, W (1 + n, k) and k innovations, changed a velocity."""
        record = self.records[vehicle]
        if record.static:
            return
        start = self.joint.where[vehicle].start + VELOCITY.start
        east, north, up = W[start : start + 3].tolist()
        record.manoeuvre.update(at_s, self.settings.manoeuvre_memory_s, east, north, up, innovations)

    def inflate_covariance(self, vehicle: int, position_m2: float) -> None:
        """Add uncertainty to a vehicle that the ranges contradict: position variance in m^2 per axis, velocity to match.

        The wind goes with the velocity: one that was learned from a false velocity would bring it back with the next air data.
        """
        P, start = self.joint.A, self.joint.where[vehicle].start
        time2_s2 = 4.0
        for axis in range(3):
            P[start + axis, start + axis] += position_m2
            P[start + 3 + axis, start + 3 + axis] += position_m2 / time2_s2
        for axis in (WIND.start, WIND.start + 1):
            P[start + axis, start + axis] += position_m2 / time2_s2
