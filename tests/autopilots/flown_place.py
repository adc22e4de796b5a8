"""Where four vehicles fly: their homes about the origin, their heights, and missions round a rectangle."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from simulators import ORIGIN_ALT_M, ORIGIN_LAT_DEG, ORIGIN_LON_DEG, Place

_METRES_PER_DEGREE = 111_177.0
"""Of latitude at 47.5 degrees: places a mission, judges nothing."""

HOMES_M: Mapping[int, tuple[float, float]] = {1: (0.0, 650.0), 2: (600.0, -350.0), 3: (-600.0, -350.0), 4: (0.0, 0.0)}
"""East and north of each vehicle's home from the origin: a triangle of anchors round the denied one."""

HEIGHT_M: Mapping[int, float] = {1: 100.0, 2: 130.0, 3: 160.0, 4: 115.0}


def place(sysid: int, east_m: float = 0.0, north_m: float = 0.0) -> Place:
    """A point of a vehicle's mission, by its distance from its home."""
    east, north = HOMES_M[sysid][0] + east_m, HOMES_M[sysid][1] + north_m
    lon_m = _METRES_PER_DEGREE * math.cos(math.radians(ORIGIN_LAT_DEG))
    return Place(ORIGIN_LAT_DEG + north / _METRES_PER_DEGREE, ORIGIN_LON_DEG + east / lon_m)


def mission(sysid: int, half_east_m: float, half_north_m: float) -> list[tuple[int, int, Sequence[float], float, float, float]]:
    """Home, take-off, and round a rectangle for ever."""
    frame, height = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, HEIGHT_M[sysid]
    home = place(sysid)
    none = (0.0, 0.0, 0.0, 0.0)
    corners = [
        (half_east_m, half_north_m),
        (half_east_m, -half_north_m),
        (-half_east_m, -half_north_m),
        (-half_east_m, half_north_m),
    ]
    turn = [place(sysid, *corner) for corner in corners]
    return [
        (mavlink.MAV_CMD_NAV_WAYPOINT, 0, none, home.lat_deg, home.lon_deg, ORIGIN_ALT_M),
        (mavlink.MAV_CMD_NAV_TAKEOFF, frame, (15.0, 0.0, 0.0, 0.0), home.lat_deg, home.lon_deg, min(height, 50.0)),
        *((mavlink.MAV_CMD_NAV_WAYPOINT, frame, none, p.lat_deg, p.lon_deg, height) for p in turn),
        (mavlink.MAV_CMD_DO_JUMP, frame, (3.0, -1.0, 0.0, 0.0), 0.0, 0.0, 0.0),
    ]  # fmt: skip
