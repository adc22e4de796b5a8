"""Ideal flights: every aircraft flies its route on its true position, without sensors, links or MAVLink. For studies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl_fakes.dynamics import LateralAircraft, turn_radius_m
from sitl_fakes.guidance import EndOfRoute, Guidance, Point, Route, heading_for_course

PAPER_ROUTES: tuple[tuple[Point, ...], ...] = (
    ((0.0, 0.0), (0.0, 4000.0), (4000.0, 4000.0), (4000.0, 0.0)),
    ((8000.0, 0.0), (4000.0, 8000.0), (12000.0, 4000.0)),
    ((7000.0, 8000.0), (3000.0, 9000.0), (8000.0, 14000.0)),
    ((2000.0, -4000.0), (6000.0, -4000.0), (7000.0, -7000.0), (5000.0, -9000.0), (1000.0, -6000.0)),
)
"""Waypoints (east, north) in metres of UAV1 to UAV4: Qu & Zhang 2010, Table 1."""


@dataclass(frozen=True, slots=True)
class NominalFlight:
    """Flown routes: `times_s` (T,), the rest (V, T) for V aircraft: position (m), velocity over ground (m/s), attitude (rad).

    `psi_rad` is the heading from north, clockwise; `leg` the number of the leg in force, from 0.
    """

    times_s: NDArray[np.float64]
    east_m: NDArray[np.float64]
    north_m: NDArray[np.float64]
    ve_mps: NDArray[np.float64]
    vn_mps: NDArray[np.float64]
    phi_rad: NDArray[np.float64]
    psi_rad: NDArray[np.float64]
    airspeed_mps: NDArray[np.float64]
    leg: NDArray[np.int64]


_LONGEST_STEP_S = 0.02  # the actuators' time constant is 0.05 s


def fly_routes(
    routes: Sequence[Sequence[Point]] = PAPER_ROUTES,
    *,
    airspeed_mps: float = 50.0,
    step_s: float = 0.02,
    duration_s: float = 360.0,
    end_of_route: EndOfRoute = EndOfRoute.STRAIGHT,
    wind_east_mps: float = 0.0,
    wind_north_mps: float = 0.0,
    waypoint_radius_m: float | None = None,
) -> NominalFlight:
    """Fly each route from its first waypoint, heading along its first leg; sample 0 is the start, sample k is k steps later.

    `waypoint_radius_m` defaults to the radius of the tightest turn. The wind is constant and blows towards east and north.
    `step_s` is the guidance's and the samples' step; the aircraft itself is integrated in steps of at most 0.02 s.
    """
    steps = round(duration_s / step_s)
    substeps = math.ceil(step_s / _LONGEST_STEP_S - 1e-9)
    columns: NDArray[np.float64] = np.empty((len(routes), steps + 1, 7))
    legs = np.empty((len(routes), steps + 1), dtype=np.int64)
    for v, waypoints in enumerate(routes):
        route = Route(waypoints, end_of_route)
        guidance = Guidance(route, airspeed_mps, waypoint_radius_m or turn_radius_m(airspeed_mps))
        start = waypoints[0]
        aircraft = LateralAircraft(start[0], start[1], route.track(0).track_heading_rad(start), airspeed_mps)
        for k in range(steps + 1):
            s = aircraft.state
            course = s.psi_rad + s.beta_rad
            columns[v, k] = (
                s.east_m,
                s.north_m,
                airspeed_mps * math.sin(course) + wind_east_mps,
                airspeed_mps * math.cos(course) + wind_north_mps,
                s.phi_rad,
                s.psi_rad,
                airspeed_mps,
            )
            legs[v, k] = guidance.leg_index
            course = guidance.course_command_rad((s.east_m, s.north_m), step_s)
            heading = heading_for_course(course, airspeed_mps, wind_east_mps, wind_north_mps)
            for _ in range(substeps):
                aircraft.step(heading, step_s / substeps, wind_east_mps, wind_north_mps)
    east, north, ve, vn, phi, psi, airspeed = (columns[..., i].copy() for i in range(7))
    return NominalFlight(np.arange(steps + 1, dtype=np.float64) * step_s, east, north, ve, vn, phi, psi, airspeed, legs)
