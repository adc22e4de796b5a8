"""Waypoint guidance: the route's legs, cross-track error and heading command.

Source: Qu & Zhang's equations (32), (33) and (35)-(37).

Positions are (east, north) in metres; headings in rad from north, clockwise; the cross-track error dZ is positive to the left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sitl_fakes.dynamics import LateralAircraft, turn_radius_m

_INTEGRATE_BELOW_RAD = 0.35  # chosen: in a turn the integral would wind up
_LONGEST_STEP_S = 0.02  # the actuators' time constant is 0.05 s
_TIME_CONSTANT_S = 8.0  # a small error off the track dies out with it
_INTEGRAL_TIME_S = 30.0  # chosen: long beside the time constant


Point = tuple[float, float]


class EndOfRoute(StrEnum):
    """What an aircraft does after its last waypoint.

    STRAIGHT: it flies straight on. LOOP: it flies round again from the first. HOLD: it circles the last.
    """

    STRAIGHT = "straight"
    LOOP = "loop"
    HOLD = "hold"


@dataclass(frozen=True, slots=True)
class Leg:
    """The straight track from one waypoint to the next; `endless` carries on beyond the second."""

    start: Point
    end: Point
    endless: bool = False

    @property
    def length_m(self) -> float:
        """Length of the leg, m."""
        return math.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1])

    def along_track_m(self, at: Point) -> float:
        """Distance flown along the track from its start, m."""
        (ax, ay), (bx, by) = self.start, self.end
        return ((at[0] - ax) * (bx - ax) + (at[1] - ay) * (by - ay)) / self.length_m

    def cross_track_m(self, at: Point) -> float:
        """Cross-track error (35)-(37): (AB x AP).k / |AB|, positive left of track, m."""
        (ax, ay), (bx, by) = self.start, self.end
        return ((bx - ax) * (at[1] - ay) - (by - ay) * (at[0] - ax)) / self.length_m

    def track_heading_rad(self, at: Point) -> float:  # noqa: ARG002 - the same on the whole of a straight leg
        """Direction of the track, rad."""
        return math.atan2(self.end[0] - self.start[0], self.end[1] - self.start[1])

    def distance_m(self, at: Point) -> float:
        """Least distance to the leg, m."""
        along = max(0.0, self.along_track_m(at))
        if not self.endless:
            along = min(self.length_m, along)
        share = along / self.length_m
        foot_e = self.start[0] + share * (self.end[0] - self.start[0])
        foot_n = self.start[1] + share * (self.end[1] - self.start[1])
        return math.hypot(at[0] - foot_e, at[1] - foot_n)


@dataclass(frozen=True, slots=True)
class Circle:
    """A clockwise circle round a point: where an aircraft that holds stays. The outside is its left."""

    centre: Point
    radius_m: float

    def cross_track_m(self, at: Point) -> float:
        """Distance outside the circle, m (negative inside)."""
        return math.hypot(at[0] - self.centre[0], at[1] - self.centre[1]) - self.radius_m

    def track_heading_rad(self, at: Point) -> float:
        """Direction of the clockwise tangent, rad."""
        return math.atan2(at[0] - self.centre[0], at[1] - self.centre[1]) + math.pi / 2.0

    def distance_m(self, at: Point) -> float:
        """Least distance to the circle, m."""
        return abs(self.cross_track_m(at))


class Route:
    """A route: waypoints and what follows the last, as tracks numbered from 0.

    There are at least two waypoints, and no two neighbours are equal.
    """

    def __init__(self, waypoints: Sequence[Point], end: EndOfRoute = EndOfRoute.STRAIGHT, hold_radius_m: float = 400.0) -> None:
        self._end = end
        points = list(waypoints)
        if end is EndOfRoute.LOOP and points[0] != points[-1]:
            points.append(points[0])
        last = len(points) - 2
        straight = end is EndOfRoute.STRAIGHT
        self._tracks: list[Leg | Circle] = [
            Leg(a, b, endless=straight and i == last) for i, (a, b) in enumerate(pairwise(points))
        ]
        if end is EndOfRoute.HOLD:
            self._tracks.append(Circle(points[-1], hold_radius_m))

    def track(self, index: int) -> Leg | Circle:
        """Return the track of that number."""
        return self._tracks[index]

    def next_index(self, index: int) -> int:
        """Return the number of the track after this one; the last endless one follows itself."""
        if index + 1 < len(self._tracks):
            return index + 1
        return 0 if self._end is EndOfRoute.LOOP else index

    def distance_m(self, at: Point) -> float:
        """Least distance of a point to the whole route, m: how far off its route an aircraft really is."""
        return min(track.distance_m(at) for track in self._tracks)


class Guidance:
    """The guidance law along a route, with its integral and its place on the route.

    psi_cmd = psi_track + clamp(Kp dZ + Ki integral(dZ), -pi/2, +pi/2). Kp is 1 / (speed x time constant), so that a small
    error dies out with that time constant; Ki is Kp / integral time. The integral stands still far
    from the track (it would only wind up) and starts anew on each leg. A waypoint is reached within `waypoint_radius_m` or on
    passing abeam.
    """

    def __init__(self, route: Route, speed_mps: float, waypoint_radius_m: float) -> None:
        self.route = route
        self.leg_index = 0
        self._radius = waypoint_radius_m
        self._kp = 1.0 / (speed_mps * _TIME_CONSTANT_S)
        self._ki = self._kp / _INTEGRAL_TIME_S
        self._integral = 0.0

    def course_command_rad(self, at: Point, step_s: float) -> float:
        """Return the course to make good from a (believed) position, rad.

        Where the waypoint is reached, it is the course of the next leg. It is psi_cmd: without wind it is the heading, too.
        """
        track = self.route.track(self.leg_index)
        if isinstance(track, Leg) and not track.endless:
            near = math.hypot(at[0] - track.end[0], at[1] - track.end[1]) <= self._radius
            if near or track.along_track_m(at) >= track.length_m:
                self.leg_index = self.route.next_index(self.leg_index)
                self._integral = 0.0
                track = self.route.track(self.leg_index)
        error = track.cross_track_m(at)
        correction = self._kp * error + self._ki * self._integral
        limit = math.pi / 2.0
        if abs(self._kp * error) < _INTEGRATE_BELOW_RAD:
            self._integral += error * step_s
        return track.track_heading_rad(at) + max(-limit, min(limit, correction))


def heading_for_course(course_rad: float, airspeed_mps: float, wind_east_mps: float, wind_north_mps: float) -> float:
    """Return the heading (rad) that makes good a course (rad) in a wind.

    The wind blows towards east and north. Without wind the heading is the course.
    """
    from_left_mps = wind_east_mps * math.cos(course_rad) - wind_north_mps * math.sin(course_rad)
    return course_rad - math.asin(max(-0.9, min(0.9, from_left_mps / airspeed_mps)))


PAPER_ROUTES: tuple[tuple[Point, ...], ...] = (
    ((0.0, 0.0), (0.0, 4000.0), (4000.0, 4000.0), (4000.0, 0.0)),
    ((8000.0, 0.0), (4000.0, 8000.0), (12000.0, 4000.0)),
    ((7000.0, 8000.0), (3000.0, 9000.0), (8000.0, 14000.0)),
    ((2000.0, -4000.0), (6000.0, -4000.0), (7000.0, -7000.0), (5000.0, -9000.0), (1000.0, -6000.0)),
)
"""Waypoints (east, north) in metres of UAV1 to UAV4: Qu & Zhang 2010, Table 1."""


@dataclass(frozen=True, slots=True)
class NominalFlight:
    """Flown routes of V aircraft.

    `times_s` is (T,), the rest (V, T): position (m), velocity over ground (m/s), attitude (rad).

    `psi_rad` is the heading from north, clockwise; `leg` the number of the leg in force, from 0.
    """

    times_s: NDArray[np.float64]
    east_m: NDArray[np.float64]
    north_m: NDArray[np.float64]
    ve_mps: NDArray[np.float64]
    vn_mps: NDArray[np.float64]
    phi_rad: NDArray[np.float64]
    psi_rad: NDArray[np.float64]
    leg: NDArray[np.int64]


def fly_routes(
    routes: Sequence[Sequence[Point]] = PAPER_ROUTES,
    *,
    airspeed_mps: float = 50.0,
    step_s: float = 0.02,
    duration_s: float = 360.0,
    end_of_route: EndOfRoute = EndOfRoute.STRAIGHT,
    wind_east_mps: float = 0.0,
) -> NominalFlight:
    """Fly each route from its first waypoint, heading along its first leg.

    Sample 0 is the start, sample k is k steps later.

    A waypoint is reached within the radius of the tightest turn. The wind is constant and blows towards east.
    `step_s` is the guidance's and the samples' step; the aircraft itself is integrated in steps of at most 0.02 s.
    """
    steps = round(duration_s / step_s)
    substeps = math.ceil(step_s / _LONGEST_STEP_S - 1e-9)
    flown = []
    for waypoints in routes:
        route = Route(waypoints, end_of_route)
        guidance = Guidance(route, airspeed_mps, turn_radius_m(airspeed_mps))
        start = waypoints[0]
        aircraft = LateralAircraft(start[0], start[1], route.track(0).track_heading_rad(start), airspeed_mps)
        for _ in range(steps + 1):
            s = aircraft.state
            course = s.psi_rad + s.beta_rad
            ve_mps, vn_mps = airspeed_mps * math.sin(course) + wind_east_mps, airspeed_mps * math.cos(course)
            flown.append((s.east_m, s.north_m, ve_mps, vn_mps, s.phi_rad, s.psi_rad, guidance.leg_index))
            course = guidance.course_command_rad((s.east_m, s.north_m), step_s)
            heading = heading_for_course(course, airspeed_mps, wind_east_mps, 0.0)
            for _ in range(substeps):
                aircraft.step(heading, step_s / substeps, wind_east_mps)
    east, north, ve, vn, phi, psi, legs = np.array(flown).reshape(len(routes), steps + 1, 7).transpose(2, 0, 1).copy()
    times_s = np.arange(steps + 1, dtype=np.float64) * step_s
    return NominalFlight(times_s, east, north, ve, vn, phi, psi, legs.astype(np.int64))
