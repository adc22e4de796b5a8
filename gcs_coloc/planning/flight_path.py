"""Flight path along planned legs: a point mass that flies each leg at the speed of the leg.

Its turns are as tight as the vehicle's class flies them. A vehicle steers for a point ahead on its leg and takes up the next leg
where a turn of its radius meets it, so it cuts corners as an autopilot does. Height goes evenly from waypoint to waypoint. No
wind, no noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gcs_coloc.core.measurements import FloatArray, Vector3, VehicleClass
from gcs_coloc.estimators.fleet.ekf.tilt import GRAVITY_MPS2

_SIDEWAYS_MPS2: Mapping[VehicleClass, float] = {
    VehicleClass.PLANE: GRAVITY_MPS2 * math.tan(math.radians(30.0)),
    VehicleClass.MULTIROTOR: 3.0,
    VehicleClass.GROUND: 1.5,
    VehicleClass.BOAT: 1.0,
    VehicleClass.INDOOR: 1.0,
}
"""Acceleration in a turn, m/s². Chosen: 30 degrees of bank of a plane; of others what autopilots allow in missions."""
STEP_S = 0.5
"""Step of the flight. Chosen: 10 m at 20 m/s; turns within it are arcs."""
_AHEAD_S = 2.0
_LEAST_AHEAD_RADII = 1.2
_SAME_PLACE_M = 0.5
"""Chosen: files round coordinates to centimetres; a leg shorter than this leads up or down alone."""
LONGEST_S = 24.0 * 3600.0
"""Longest flight. Chosen: a longer plan has a wrong speed."""
_SHARPEST_RAD = math.radians(150.0)
_MOST_EARLY_M = 90.0
"""A turn is begun no farther before its waypoint. Source: WP_RADIUS of ArduPlane."""


@dataclass(frozen=True, slots=True)
class Leg:
    """The way to one waypoint: where it ends, m in the plan's frame, at what speed it is flown, m/s.

    `hold_s`: how long the vehicle stays there, on a circle of `radius_m` if that is above zero, else on the spot.
    """

    end_enu_m: Vector3
    speed_mps: float
    hold_s: float = 0.0
    radius_m: float = 0.0

    def moved(self, east_m: float, north_m: float) -> Leg:
        """Return the same leg to a waypoint beside this one."""
        east, north, up = self.end_enu_m
        return replace(self, end_enu_m=(east + east_m, north + north_m, up))


@dataclass(frozen=True, slots=True)
class PathMotion:
    """Positions (N, 3) m, velocities (N, 3) m/s and bank angles (N,) rad at some times.

    The right wing down is positive.
    """

    positions_m: FloatArray
    velocities_mps: FloatArray
    bank_rad: FloatArray


@dataclass(frozen=True)
class FlightPath:
    """One vehicle's flight at steps of `STEP_S` from `begin_s` on.

    Positions are (N, 3) m, velocities (N, 3) m/s and bank angles (N,) rad.
    """

    begin_s: float
    positions_m: FloatArray
    velocities_mps: FloatArray
    bank_rad: FloatArray

    @property
    def end_s(self) -> float:
        """When the way ends."""
        return self.begin_s + (len(self.positions_m) - 1) * STEP_S

    def is_flying(self, at_s: float) -> bool:
        """Whether the vehicle is on its way."""
        return self.begin_s <= at_s <= self.end_s

    def position(self, at_s: float) -> FloatArray:
        """Return the position (3,) at a time, m."""
        return np.asarray(self.at(np.array([at_s])).positions_m[0])

    def at(self, times_s: FloatArray) -> PathMotion:
        """Return the motion at some times (N,)."""
        place = np.clip((times_s - self.begin_s) / STEP_S, 0.0, len(self.positions_m) - 1.0)
        step = np.minimum(place.astype(int), len(self.positions_m) - 2)
        share = place - step

        def between(rows: FloatArray) -> FloatArray:
            low, high = rows[step], rows[step + 1]
            return np.asarray(low + (share if rows.ndim == 1 else share[:, None]) * (high - low))

        return PathMotion(between(self.positions_m), between(self.velocities_mps), between(self.bank_rad))


def fly_legs(
    begin_enu_m: Vector3, legs: Sequence[Leg], start_s: float, vehicle_class: VehicleClass, end_s: float | None = None
) -> FlightPath:
    """Fly some legs from a place, and return the flight; `end_s` cuts it."""
    pilot = _Pilot(begin_enu_m, legs, _SIDEWAYS_MPS2[vehicle_class], banks=vehicle_class is VehicleClass.PLANE)
    most = round((min(end_s - start_s, LONGEST_S) if end_s is not None else LONGEST_S) / STEP_S)
    rows = pilot.fly(max(most, 1))
    return FlightPath(start_s, rows[:, :3], rows[:, 3:6], rows[:, 6])


class _Pilot:
    """A point mass on its way; `fly` gives its rows of position, velocity and bank."""

    def __init__(self, begin: Vector3, legs: Sequence[Leg], sideways_mps2: float, *, banks: bool) -> None:
        self._legs = [leg for at, leg in enumerate(legs) if leg.hold_s > 0.0 or _distance(begin, legs, at) > 1e-3]
        self._sideways_mps2, self._banks = sideways_mps2, banks
        self._e, self._n, self._u = begin
        self._from = begin
        self._heading = self._first_course()
        self._rows: list[tuple[float, ...]] = []

    def fly(self, most: int) -> FloatArray:
        for at, leg in enumerate(self._legs):
            self._fly_leg(at, leg, most)
            if leg.hold_s > 0.0:
                self._hold(leg, most)
            self._from = leg.end_enu_m
            if len(self._rows) > most:
                break
        if not self._rows:
            self._step(0.0, 0.0, 0.0)
        self._add(0.0, 0.0, 0.0)
        return np.array(self._rows[: most + 1])

    def _fly_leg(self, at: int, leg: Leg, most: int) -> None:
        (fe, fn, fu), (te, tn, tu) = self._from, leg.end_enu_m
        length = math.hypot(te - fe, tn - fn)
        if length < _SAME_PLACE_M:
            self._climb(leg, most)
            return
        ue, un = (te - fe) / length, (tn - fn) / length
        speed = leg.speed_mps
        radius = speed * speed / self._sideways_mps2
        early = 0.0 if leg.hold_s > 0.0 else self._turn_begins_before(at, radius, length)
        ahead = max(_AHEAD_S * speed, _LEAST_AHEAD_RADII * radius)
        climb_mps = (tu - fu) / length * speed
        while len(self._rows) <= most:
            along = (self._e - fe) * ue + (self._n - fn) * un
            left = length - along
            if left <= max(early, 0.5 * speed * STEP_S):
                break
            aim_e, aim_n = fe + (along + ahead) * ue, fn + (along + ahead) * un
            wanted = math.atan2(aim_e - self._e, aim_n - self._n)
            off = math.remainder(wanted - self._heading, 2.0 * math.pi)
            # The rate that follows the circle through the point ahead, as L1 guidance.
            rate = 2.0 * speed * math.sin(off) / ahead if abs(off) < 0.5 * math.pi else math.copysign(math.inf, off)
            most_rate = self._sideways_mps2 / speed
            self._step(speed, min(max(rate, -most_rate), most_rate), self._climb_rate(climb_mps, tu, along, length, fu))

    def _climb_rate(self, climb_mps: float, to_u: float, along: float, length: float, from_u: float) -> float:
        wanted = from_u + (to_u - from_u) * min(max(along / length, 0.0), 1.0)
        return climb_mps + 0.5 * (wanted - self._u)

    def _climb(self, leg: Leg, most: int) -> None:
        """Go straight up or down, at a third of the speed."""
        rate = max(leg.speed_mps / 3.0, 0.1)
        while abs(leg.end_enu_m[2] - self._u) > 0.5 * rate * STEP_S and len(self._rows) <= most:
            self._step(0.0, 0.0, math.copysign(rate, leg.end_enu_m[2] - self._u))

    def _hold(self, leg: Leg, most: int) -> None:
        steps = min(round(leg.hold_s / STEP_S), most + 1 - len(self._rows))
        speed = leg.speed_mps if leg.radius_m > 0.0 else 0.0
        radius = max(leg.radius_m, speed * speed / self._sideways_mps2)
        centre_e, centre_n, _ = leg.end_enu_m
        for _ in range(steps):
            if speed == 0.0:
                self._step(0.0, 0.0, 0.0)
                continue
            off_e, off_n = self._e - centre_e, self._n - centre_n
            outside = math.hypot(off_e, off_n) - radius
            # Clockwise round the centre, and back to the circle.
            tangent = math.atan2(off_n, -off_e) if off_e or off_n else self._heading
            wanted = tangent + math.atan(outside / max(radius, 2.0 * speed))
            off = math.remainder(wanted - self._heading, 2.0 * math.pi)
            most_rate = 1.2 * self._sideways_mps2 / speed
            rate = speed / radius + off / _AHEAD_S
            self._step(speed, min(max(rate, -most_rate), most_rate), 0.5 * (leg.end_enu_m[2] - self._u))

    def _turn_begins_before(self, at: int, radius: float, length: float) -> float:
        """Return how far before the waypoint the turn to the next leg begins, m."""
        if at + 1 >= len(self._legs):
            return 0.0
        turn = abs(math.remainder(self._course(at + 1) - self._course(at), 2.0 * math.pi))
        return min(radius * math.tan(0.5 * min(turn, _SHARPEST_RAD)), 0.5 * length, _MOST_EARLY_M)

    def _first_course(self) -> float:
        """Return the course of the first leg that leads anywhere but up."""
        for leg in self._legs:
            east, north = leg.end_enu_m[0] - self._from[0], leg.end_enu_m[1] - self._from[1]
            if math.hypot(east, north) > _SAME_PLACE_M:
                return math.atan2(east, north)
        return 0.0

    def _course(self, at: int) -> float:
        begin = self._legs[at - 1].end_enu_m if at else self._from
        end = self._legs[at].end_enu_m
        return math.atan2(end[0] - begin[0], end[1] - begin[1])

    def _step(self, speed: float, rate: float, climb: float) -> None:
        self._add(speed, rate, climb)
        turn = rate * STEP_S
        # The chord of the arc.
        chord = speed * STEP_S * (math.sin(0.5 * turn) / (0.5 * turn) if abs(turn) > 1e-9 else 1.0)
        self._e += chord * math.sin(self._heading + 0.5 * turn)
        self._n += chord * math.cos(self._heading + 0.5 * turn)
        self._u += climb * STEP_S
        self._heading += turn

    def _add(self, speed: float, rate: float, climb: float) -> None:
        ve, vn = speed * math.sin(self._heading), speed * math.cos(self._heading)
        bank = math.atan(speed * rate / GRAVITY_MPS2) if self._banks else 0.0
        self._rows.append((self._e, self._n, self._u, ve, vn, climb, bank))


def _distance(begin: Vector3, legs: Sequence[Leg], at: int) -> float:
    return math.dist(legs[at - 1].end_enu_m if at else begin, legs[at].end_enu_m)
