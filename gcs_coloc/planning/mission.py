"""Missions: MAVLink mission items as plan files hold them, and the way that a vehicle flies by them.

Source: https://mavlink.io/en/messages/common.html (MAV_CMD, MAV_FRAME).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Generic, NamedTuple, TypeVar

from gcs_coloc.core.errors import DataError
from gcs_coloc.core.measurements import VehicleClass
from gcs_coloc.core.stations.stations import STATION_SIGMA_M
from gcs_coloc.planning.fleet_plan import PlanAssumptions
from gcs_coloc.planning.flight_path import LONGEST_S

LatLonAlt = tuple[float, float, float]
"""Degrees, and metres above mean sea level."""
HIGHEST_M = 20_000.0
"""Chosen: nothing of ours flies higher."""
FAR_M = 300_000.0
"""Beyond it the plane of a frame and the earth part by kilometres; plans so far apart are of two sites."""
LEAST_SPEED_MPS, MOST_SPEED_MPS = 0.1, 200.0
"""Chosen: at less a way takes days; no vehicle of ours is faster."""


class MissionCommand(IntEnum):
    """The mission commands that make a way (MAV_CMD)."""

    WAYPOINT = 16
    LOITER_UNLIM = 17
    LOITER_TURNS = 18
    LOITER_TIME = 19
    RETURN_TO_LAUNCH = 20
    LAND = 21
    TAKEOFF = 22
    LOITER_TO_ALT = 31
    ARC_WAYPOINT = 36
    SPLINE_WAYPOINT = 82
    VTOL_TAKEOFF = 84
    VTOL_LAND = 85
    PAYLOAD_PLACE = 94
    DO_CHANGE_SPEED = 178


_CHANGE_THE_WAY = {
    30: "CONTINUE_AND_CHANGE_ALT",
    83: "ALTITUDE_WAIT",
    92: "GUIDED_ENABLE",
    93: "DELAY",
    112: "CONDITION_DELAY",
    177: "DO_JUMP",
    601: "DO_JUMP_TAG",
    42702: "SCRIPT_TIME",
    42703: "ATTITUDE_TIME",
}
"""Commands that are not flown here though they change the way or its times (MAV_CMD)."""
_FENCE_COMMANDS, _RALLY_COMMAND = range(5000, 5005), 5100  # MAV_CMD_NAV_FENCE_*, MAV_CMD_NAV_RALLY_POINT
_OF_CLIMB_OR_DESCENT = frozenset({2.0, 3.0})  # SPEED_TYPE
_TERRAIN_FRAMES = frozenset({10, 11})
_ABSOLUTE_FRAMES = frozenset({0, 5})  # MAV_FRAME_GLOBAL, MAV_FRAME_GLOBAL_INT
_RELATIVE_FRAMES = frozenset({3, 6}) | _TERRAIN_FRAMES
"""Above home, and above the terrain, which is taken as above home."""
_LANDS = frozenset({MissionCommand.LAND, MissionCommand.VTOL_LAND})
_HOLDS_FOREVER_S = 600.0
"""Chosen: who loiters until told otherwise does so for ten minutes here."""
_LOITER_RADIUS_M = 60.0
"""Source: WP_LOITER_RAD of ArduPlane."""


T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class PerVehicle(Generic[T]):
    """A value of all vehicles, and of single ones by system id.

    That of a single one goes before; None: as the files say.
    """

    of_all: T | None = None
    of_one: Mapping[int, T] = field(default_factory=dict)

    def of(self, sysid: int | None) -> T | None:
        """Return the value of a vehicle, or None where the files decide.

        `sysid` is None for a vehicle whose number is not known.
        """
        return self.of_one.get(sysid, self.of_all) if sysid is not None else self.of_all


@dataclass(frozen=True, slots=True)
class MissionItem:
    """One item as a file has it: its number there, MAV_CMD, MAV_FRAME, four parameters, degrees, metres."""

    number: int
    command: int
    frame: int
    params: tuple[float, float, float, float]
    lat_deg: float
    lon_deg: float
    alt_m: float


@dataclass(frozen=True, slots=True)
class MissionLeg:
    """The way to one place, flown at a speed; `hold_s` as `flight_path.Leg` has it."""

    end: LatLonAlt
    speed_mps: float
    hold_s: float = 0.0
    radius_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Mission:
    """The way of one vehicle.

    `duration_s` cuts it; None means that all is flown. `sysid` None means that it is numbered by the order of the files.
    """

    name: str
    begin: LatLonAlt
    legs: tuple[MissionLeg, ...]
    vehicle_class: VehicleClass
    sysid: int | None = None
    duration_s: float | None = None


class ListedStation(NamedTuple):
    """A station as a file or an option lists it; `sigma_m`: how well its place is known, 1-sigma per axis."""

    station_id: int
    place: LatLonAlt
    sigma_m: float = STATION_SIGMA_M


@dataclass(frozen=True, slots=True)
class MissionFile:
    """What one file holds: missions, and of a scenario stations and assumptions.

    `remarks` are on what was skipped.
    """

    missions: tuple[Mission, ...]
    remarks: tuple[str, ...] = ()
    stations: tuple[ListedStation, ...] = ()
    assumptions: PlanAssumptions | None = None


def mission_of(
    file: str,
    home: LatLonAlt | None,
    items: Sequence[MissionItem],
    vehicle_class: VehicleClass,
    speed_mps: float,
    skipped: Sequence[str] = (),
) -> MissionFile:
    """Return the mission of some items.

    Args:
        file: its name, for errors and remarks.
        home: where relative heights count from; None: the first place counts, and relative heights from sea level.
        items: in their order.
        vehicle_class: how the vehicle moves.
        speed_mps: how fast it flies until an item changes that.
        skipped: remarks on what was skipped already; those on the items follow them.

    Raises:
        DataError: an item is impossible, or there are no two places; the text names file and item.

    """
    legs: list[MissionLeg] = []
    remarks = list(skipped)
    above_terrain: list[int] = []
    for at, item in enumerate(items):
        where = f"{file}: item {item.number}"
        if item.command == MissionCommand.DO_CHANGE_SPEED:
            if item.params[0] in _OF_CLIMB_OR_DESCENT:
                remarks.append(f"{where}: DO_CHANGE_SPEED of climb or descent is skipped")
            elif item.params[1] > 0.0:
                speed_mps = check_speed(where, "speed", item.params[1])
            else:
                remarks.append(f"{where}: DO_CHANGE_SPEED without a speed is skipped")
            continue
        if item.command not in MissionCommand._value2member_map_:
            remarks.append(f"{where}: {_skipped(item.command)}")
            continue
        command = MissionCommand(item.command)
        here = legs[-1].end if legs else home
        end = _place(file, item, command, home, here)
        if end is None:
            remarks.append(f"{where}: {command.name} without a place is skipped")
            continue
        if item.frame in _TERRAIN_FRAMES and command is not MissionCommand.RETURN_TO_LAUNCH:
            above_terrain.append(item.number)
        hold_s, radius_m = _hold(item, command, vehicle_class, speed_mps)
        if command is MissionCommand.ARC_WAYPOINT:
            remarks.append(f"{where}: ARC_WAYPOINT is taken as the straight way to its end")
        if command is MissionCommand.LOITER_UNLIM:
            remarks.append(f"{where}: loiters until told otherwise; taken as {_HOLDS_FOREVER_S:.0f} s")
        legs.append(MissionLeg(end, speed_mps, hold_s, radius_m))
        if command in _LANDS or command is MissionCommand.RETURN_TO_LAUNCH or command is MissionCommand.LOITER_UNLIM:
            if left := items[at + 1 :]:
                which = f"item {left[0].number}" if len(left) == 1 else f"items {left[0].number} to {left[-1].number}"
                remarks.append(f"{file}: {which}: after {command.name} of item {item.number} and not flown")
            break
    if above_terrain:
        more = f" and {len(above_terrain) - 1} more" if len(above_terrain) > 1 else ""
        remarks.append(f"{file}: item {above_terrain[0]}{more}: height above the terrain is taken as above home")
    if home is None and legs:
        home, legs = legs[0].end, legs[1:]
    if home is None or not legs:
        more = f" and {len(remarks) - 1} more" if len(remarks) > 1 else ""
        why = f"; {remarks[0].removeprefix(f'{file}: ')}{more}" if remarks else ""
        raise DataError(f"{file}: expected two places at least: home and one waypoint{why}")
    return MissionFile((Mission(file, home, tuple(legs), vehicle_class),), tuple(remarks))


def _skipped(command: int) -> str:
    """Return why a command is not flown, in words."""
    if command in _CHANGE_THE_WAY:
        return f"{_CHANGE_THE_WAY[command]} changes the way or its times; the way is taken without it"
    if command in _FENCE_COMMANDS:
        return f"command {command} is of a geofence, which is not looked at"
    if command == _RALLY_COMMAND:
        return "a rally point is not flown to"
    return f"command {command} is no waypoint and is skipped"


def _place(
    file: str, item: MissionItem, command: MissionCommand, home: LatLonAlt | None, here: LatLonAlt | None
) -> LatLonAlt | None:
    """Return where an item leads; None where it names no place and none is known."""
    if command is MissionCommand.RETURN_TO_LAUNCH:
        return (home[0], home[1], here[2]) if home is not None and here is not None else None
    lat, lon, alt = item.lat_deg, item.lon_deg, item.alt_m
    if lat == 0.0 and lon == 0.0:
        # As autopilots have it: no position means where the vehicle is.
        if here is None:
            return None
        lat, lon = here[0], here[1]
    check_place(f"{file}: item {item.number}", lat, lon, alt)
    if item.frame in _RELATIVE_FRAMES:
        alt += home[2] if home is not None else 0.0
    elif item.frame not in _ABSOLUTE_FRAMES:
        known = ", ".join(map(str, sorted(_ABSOLUTE_FRAMES | _RELATIVE_FRAMES)))
        raise DataError(f"{file}: item {item.number}: frame is {item.frame}, expected one of {known}")
    return lat, lon, alt


def check_place(where: str, lat_deg: float, lon_deg: float, alt_m: float) -> None:
    """Check that a place is one on earth.

    Raises:
        DataError: it is none on earth; the text begins with `where`.
    """
    for name, value, most in (("latitude", lat_deg, 90.0), ("longitude", lon_deg, 180.0), ("altitude", alt_m, HIGHEST_M)):
        if not abs(value) <= most:
            unit = "metres" if name == "altitude" else "degrees"
            raise DataError(f"{where}: {name} is {value:g}, expected {unit} from {-most:g} to {most:g}")


def check_speed(where: str, name: str, speed_mps: float) -> float:
    """Return a speed that can be flown at.

    Raises:
        DataError: it cannot; the text begins with `where` and names it.
    """
    if not LEAST_SPEED_MPS <= speed_mps <= MOST_SPEED_MPS:
        raise DataError(f"{where}: {name} is {speed_mps:g}, expected m/s from {LEAST_SPEED_MPS:g} to {MOST_SPEED_MPS:g}")
    return speed_mps


def _hold(item: MissionItem, command: MissionCommand, vehicle_class: VehicleClass, speed_mps: float) -> tuple[float, float]:
    """Return how long a vehicle stays at an item's place, s, at most a day, and on which radius, m."""
    circles = vehicle_class is VehicleClass.PLANE
    radius_m = (abs(item.params[2]) or _LOITER_RADIUS_M) if circles else 0.0
    match command:
        case MissionCommand.LOITER_UNLIM:
            return _HOLDS_FOREVER_S, radius_m
        case MissionCommand.LOITER_TIME:
            return _within(item.params[0]), radius_m
        case MissionCommand.LOITER_TURNS:
            around_m = 2.0 * math.pi * (abs(item.params[2]) or _LOITER_RADIUS_M)
            return _within(item.params[0] * around_m / speed_mps), radius_m
        case MissionCommand.WAYPOINT if not circles:
            return _within(item.params[0]), 0.0
    return 0.0, 0.0


def _within(hold_s: float) -> float:
    return min(max(hold_s, 0.0), LONGEST_S)
