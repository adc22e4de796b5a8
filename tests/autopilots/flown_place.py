"""Where four vehicles move: their homes about the origin, their heights, and missions in the air and on the ground."""

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


MissionItem = tuple[int, int, Sequence[float], float, float, float]
"""MISSION_ITEM_INT: command, frame, parameters 1 to 4, latitude and longitude in degrees, height in m."""

_FRAME = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
_NONE = (0.0, 0.0, 0.0, 0.0)


def mission(sysid: int, half_east_m: float, half_north_m: float) -> list[MissionItem]:
    """Home, take-off, a corner of a rectangle, and round the other three for ever."""
    home, height = place(sysid), HEIGHT_M[sysid]
    pitch = (15.0, 0.0, 0.0, 0.0)
    take_off = (mavlink.MAV_CMD_NAV_TAKEOFF, _FRAME, pitch, home.lat_deg, home.lon_deg, min(height, 50.0))
    return [_home(sysid), take_off, *_corners(sysid, half_east_m, half_north_m, height), _again_from(3)]


def ground_mission(sysid: int, half_east_m: float, half_north_m: float) -> list[MissionItem]:
    """Home, and round a rectangle on the ground for ever."""
    return [_home(sysid), *_corners(sysid, half_east_m, half_north_m, 0.0), _again_from(1)]


def vtol_mission(sysid: int, half_east_m: float, half_north_m: float) -> list[MissionItem]:
    """Home, vertical take-off, and round a rectangle for ever: on wings, but for a part of its southern side, on rotors."""
    home, height = place(sysid), HEIGHT_M[sysid]
    take_off = (mavlink.MAV_CMD_NAV_VTOL_TAKEOFF, _FRAME, _NONE, home.lat_deg, home.lon_deg, 80.0)
    first, second, *rest = _corners(sysid, half_east_m, half_north_m, height)
    on_rotors = [_waypoint(place(sysid, half_east_m - 100.0, -half_north_m + north_m), height) for north_m in (0.0, 80.0)]
    to_rotors, to_wings = (
        (mavlink.MAV_CMD_DO_VTOL_TRANSITION, _FRAME, (float(state), 0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
        for state in (mavlink.MAV_VTOL_STATE_MC, mavlink.MAV_VTOL_STATE_FW)
    )
    return [_home(sysid), take_off, first, second, to_rotors, *on_rotors, to_wings, *rest, _again_from(2)]


def _home(sysid: int) -> MissionItem:
    home = place(sysid)
    return (mavlink.MAV_CMD_NAV_WAYPOINT, 0, _NONE, home.lat_deg, home.lon_deg, ORIGIN_ALT_M)


def _waypoint(at: Place, height_m: float) -> MissionItem:
    return (mavlink.MAV_CMD_NAV_WAYPOINT, _FRAME, _NONE, at.lat_deg, at.lon_deg, height_m)


def _corners(sysid: int, half_east_m: float, half_north_m: float, height_m: float) -> list[MissionItem]:
    signs = ((1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0))
    return [_waypoint(place(sysid, east * half_east_m, north * half_north_m), height_m) for east, north in signs]


def _again_from(item: int) -> MissionItem:
    return (mavlink.MAV_CMD_DO_JUMP, _FRAME, (float(item), -1.0, 0.0, 0.0), 0.0, 0.0, 0.0)
