"""Readers of plan files: QGroundControl's .plan, Mission Planner's .waypoints, and scenarios.

A .waypoints file is in the format QGC WPL 110, a scenario in TOML.

Sources: https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html,
https://mavlink.io/en/file_formats/#mission_plain_text_file.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AliasChoices, BaseModel, ConfigDict, Field
from pydantic.alias_generators import to_camel

from gcs_coloc.core.errors import DataError
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import VehicleClass
from gcs_coloc.core.reasons import counted
from gcs_coloc.core.stations.node_id import MAX_STATION_ID, MAX_SYSTEM_ID
from gcs_coloc.planning.fleet_plan import PlanAssumptions
from gcs_coloc.planning.flight_path import LONGEST_S
from gcs_coloc.planning.mission import (
    FAR_M,
    HIGHEST_M,
    LEAST_SPEED_MPS,
    MOST_SPEED_MPS,
    LatLonAlt,
    ListedStation,
    Mission,
    MissionCommand,
    MissionFile,
    MissionItem,
    MissionLeg,
    PerVehicle,
    check_place,
    check_speed,
    mission_of,
)
from gcs_coloc.runtime.checked_tables import Number, checked, read_toml

_WPL_HEADER = "QGC WPL 110"
_WPL_COLUMNS = (
    *("index", "current", "frame", "command", "param 1", "param 2", "param 3", "param 4"),
    *("latitude", "longitude", "altitude", "autocontinue"),
)
_PLANE_VEHICLE_TYPES = frozenset({1, *range(19, 26)})
"""MAV_TYPE: fixed wing and VTOL."""
_CLASSES_BY_TYPE = {10: VehicleClass.GROUND, 11: VehicleClass.BOAT, 12: VehicleClass.BOAT}
_MOST_LEGS = 100_000  # chosen: one for each second of a day
_LARGEST_FILE_BYTES = 50_000_000  # chosen: a thousand waypoints take 1 MB
_PLANE_SPEED_MPS, _OTHER_SPEED_MPS = 15.0, 5.0  # QGroundControl's own
_NO_CLASS = "the file states no class of vehicle; a plane is taken, --class sets another one"

_Speed = Annotated[Number, Field(ge=LEAST_SPEED_MPS, le=MOST_SPEED_MPS)]
_Far = Annotated[Number, Field(ge=-FAR_M, le=FAR_M)]
_Height = Annotated[Number, Field(ge=-HIGHEST_M, le=HIGHEST_M)]
_Latitude = Annotated[Number, Field(ge=-90.0, le=90.0)]
_Longitude = Annotated[Number, Field(ge=-180.0, le=180.0)]
_Place = tuple[_Latitude, _Longitude, _Height]
_Param = Number | None
"""QGroundControl writes null for what is not used."""
_EndOfRoute = Literal["straight", "loop", "hold"]


def read_plan_file(
    path: Path,
    classes: PerVehicle[VehicleClass] | None = None,
    speeds_mps: PerVehicle[float] | None = None,
    sysid: int | None = None,
) -> MissionFile:
    """Read one file by its contents.

    Args:
        path: the file.
        classes: how its vehicles move; where this does not say: as the file says, a plane where it does not either.
        speeds_mps: how fast they fly; where this does not say: as the file says.
        sysid: the vehicle of a file that has no system ids, None: not known yet.

    Raises:
        DataError: it cannot be read or is malformed; the text names file and item, and what was expected.

    """
    try:
        if path.stat().st_size > _LARGEST_FILE_BYTES:
            raise DataError(f"{path}: has more than {_LARGEST_FILE_BYTES // 1_000_000} MB, expected a plan")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: is no text, expected a .plan, .waypoints or scenario file") from error
    classes, speeds_mps = classes or PerVehicle(), speeds_mps or PerVehicle()
    if text.lstrip().startswith("{"):
        return _read_qgc(path, text, classes.of(sysid), speeds_mps.of(sysid))
    if text.startswith("QGC WPL"):
        return _read_wpl(path, text, classes.of(sysid), speeds_mps.of(sysid))
    if path.suffix == ".toml":
        return _read_scenario(path, classes, speeds_mps)
    raise DataError(f"{path}: expected a QGroundControl .plan (JSON), {_WPL_HEADER!r} in the first line, or a scenario (.toml)")


class _Qgc(BaseModel):
    """A part of a .plan, whose keys are in camel case."""

    model_config = ConfigDict(alias_generator=to_camel)


class _SimpleItem(_Qgc):
    type: Literal["SimpleItem"]
    command: Number
    frame: Number
    params: tuple[_Param, _Param, _Param, _Param, _Param, _Param, _Param]


class _Transect(_Qgc):
    items: list[_Item] | None = Field(None, alias="Items")


class _ComplexItem(_Qgc):
    """A survey or the like with items of its own, a landing pattern with places, or one with neither."""

    type: Literal["ComplexItem"]
    complex_item_type: str = "a complex item"
    transect: _Transect | None = Field(None, alias="TransectStyleComplexItem")
    land_coordinate: _Place | None = None
    landing_approach_coordinate: _Place | None = Field(
        None, validation_alias=AliasChoices("landingApproachCoordinate", "loiterCoordinate")
    )
    altitudes_are_relative: bool = True
    use_loiter_to_alt: bool = True
    use_do_change_speed: bool = False
    final_approach_speed: Number = 0.0


_Item = Annotated[_SimpleItem | _ComplexItem, Field(discriminator="type")]


class _QgcMission(_Qgc):
    items: list[_Item]
    planned_home_position: _Place | None = None
    vehicle_type: Number | None = None
    cruise_speed: Number = _PLANE_SPEED_MPS
    hover_speed: Number = _OTHER_SPEED_MPS


class _Fence(_Qgc):
    polygons: list[Any] = []
    circles: list[Any] = []


class _Rally(_Qgc):
    points: list[Any] = []


class _QgcPlan(_Qgc):
    mission: _QgcMission
    geo_fence: _Fence = _Fence()
    rally_points: _Rally = _Rally()


def _read_qgc(path: Path, text: str, vehicle_class: VehicleClass | None, speed_mps: float | None) -> MissionFile:
    plan = checked(_QgcPlan, text, str(path))
    mission, kind = plan.mission, plan.mission.vehicle_type
    remarks: list[str] = []
    if vehicle_class is None and not kind:
        vehicle_class = VehicleClass.PLANE
        remarks.append(f"{path}: {_NO_CLASS}")
    elif vehicle_class is None:
        is_plane = kind in _PLANE_VEHICLE_TYPES
        vehicle_class = VehicleClass.PLANE if is_plane else _CLASSES_BY_TYPE.get(int(kind or 0), VehicleClass.MULTIROTOR)
    if speed_mps is None:
        is_cruise = vehicle_class is VehicleClass.PLANE
        name, stated_mps = ("cruiseSpeed", mission.cruise_speed) if is_cruise else ("hoverSpeed", mission.hover_speed)
        speed_mps = check_speed(f"{path}: mission", name, stated_mps)
    items: list[MissionItem] = []
    for at, item in enumerate(mission.items, start=1):
        items += _qgc_items(f"{path}: item {at}", at, item, remarks)
    home = mission.planned_home_position
    found = mission_of(str(path), home if home and any(home[:2]) else None, items, vehicle_class, speed_mps, remarks)
    return MissionFile(found.missions, (*found.remarks, *_beside_the_mission(path, plan)))


def _beside_the_mission(path: Path, plan: _QgcPlan) -> Iterator[str]:
    """Yield a remark for a geofence, and one for rally points: what a .plan holds besides its mission."""
    if areas := len(plan.geo_fence.polygons) + len(plan.geo_fence.circles):
        yield f"{path}: geoFence: {counted(areas, 'area')} of a geofence, which is not looked at"
    if points := len(plan.rally_points.points):
        yield f"{path}: rallyPoints: {counted(points, 'rally point')}, not flown to"


def _qgc_items(where: str, at: int, item: _SimpleItem | _ComplexItem, remarks: list[str]) -> Iterator[MissionItem]:
    if isinstance(item, _SimpleItem):
        p1, p2, p3, p4, lat, lon, alt = (value or 0.0 for value in item.params)
        yield MissionItem(at, int(item.command), int(item.frame), (p1, p2, p3, p4), lat, lon, alt)
    elif item.land_coordinate is not None and item.landing_approach_coordinate is not None:
        yield from _landing(at, item, item.landing_approach_coordinate, item.land_coordinate)
    elif item.transect is None or item.transect.items is None:
        remarks.append(f"{where}: {item.complex_item_type} holds no items of its own and is skipped")
    else:
        for each in item.transect.items:
            yield from _qgc_items(where, at, each, remarks)


def _landing(at: int, item: _ComplexItem, approach: _Place, land: _Place) -> Iterator[MissionItem]:
    """Yield the items that QGroundControl sends of a landing pattern: a speed, the approach, the landing."""
    frame, none = 3 if item.altitudes_are_relative else 0, (0.0, 0.0, 0.0, 0.0)
    if item.use_do_change_speed:
        yield MissionItem(at, MissionCommand.DO_CHANGE_SPEED, frame, (0.0, item.final_approach_speed, 0.0, 0.0), 0.0, 0.0, 0.0)
    entry = MissionCommand.LOITER_TO_ALT if item.use_loiter_to_alt else MissionCommand.WAYPOINT
    yield MissionItem(at, entry, frame, none, *approach)
    yield MissionItem(at, MissionCommand.LAND, frame, none, *land)


def _read_wpl(path: Path, text: str, vehicle_class: VehicleClass | None, speed_mps: float | None) -> MissionFile:
    header, *lines = text.splitlines()
    if header.strip() != _WPL_HEADER:
        raise DataError(f"{path}: line 1: is {header.strip()!r:.60}, expected {_WPL_HEADER!r}")
    items: list[MissionItem] = []
    for at, line in enumerate(lines, start=2):
        # MAVProxy lets a line of comment begin with #.
        if line.strip() and not line.startswith("#"):
            items.append(_wpl_item(f"{path}: line {at}", line))
    if not items:
        raise DataError(f"{path}: expected home and waypoints after the first line, found none")
    home: LatLonAlt | None = None
    # Of ArduPilot item 0 is home; where it is no waypoint, as of PX4, it is the first item that is flown.
    if items[0].number == 0 and items[0].command == MissionCommand.WAYPOINT:
        first, items = items[0], items[1:]
        check_place(f"{path}: item 0 (home)", first.lat_deg, first.lon_deg, first.alt_m)
        home = (first.lat_deg, first.lon_deg, first.alt_m) if first.lat_deg or first.lon_deg else None
    remarks: list[str] = []
    if vehicle_class is None:
        vehicle_class = VehicleClass.PLANE
        remarks.append(f"{path}: {_NO_CLASS}")
    if speed_mps is None:
        speed_mps = _PLANE_SPEED_MPS if vehicle_class is VehicleClass.PLANE else _OTHER_SPEED_MPS
        remarks.append(f"{path}: the file states no speed; {speed_mps:g} m/s is taken, --speed sets another one")
    return mission_of(str(path), home, items, vehicle_class, speed_mps, remarks)


def _wpl_item(where: str, line: str) -> MissionItem:
    columns = line.split()
    if len(columns) != len(_WPL_COLUMNS):
        raise DataError(f"{where}: has {len(columns)} columns, expected {len(_WPL_COLUMNS)}: {' '.join(_WPL_COLUMNS)}")
    values: list[float] = []
    for name, column in zip(_WPL_COLUMNS, columns, strict=True):
        try:
            value = float(column)
        except ValueError:
            value = math.nan
        # MAVLink's NaN stands for what is not used, as null in a .plan.
        if math.isnan(value) and column.lower() == "nan" and name.startswith("param"):
            value = 0.0
        if not math.isfinite(value):
            raise DataError(f"{where}: {name} is {column!r:.60}, expected a number")
        values.append(value)
    index, _, frame, command, p1, p2, p3, p4, lat, lon, alt, _ = values
    return MissionItem(int(index), int(command), int(frame), (p1, p2, p3, p4), lat, lon, alt)


class _Origin(BaseModel):
    lat_deg: _Latitude
    lon_deg: _Longitude
    alt_msl_m: _Height = 0.0


class _ScenarioVehicle(BaseModel):
    sysid: Annotated[int, Field(strict=True, ge=1, le=MAX_SYSTEM_ID)]
    waypoints: Annotated[list[tuple[_Far, _Far]], Field(min_length=2)]
    height_m: _Height = 100.0
    airspeed_mps: _Speed | None = None
    end_of_route: _EndOfRoute | None = None


class _ScenarioStation(BaseModel):
    id: Annotated[int, Field(strict=True, ge=0, le=MAX_STATION_ID)]
    east_m: _Far
    north_m: _Far
    height_m: _Height = 0.0


class _Ranging(BaseModel):
    sigma_m: Number = 0.5
    rate_hz: Number = 10.0
    max_range_m: Number = 100_000.0


class _Gps(BaseModel):
    sigma_h_m: Number = 1.5
    rate_hz: Number = 5.0
    sigma_velocity_mps: Number = 0.3
    correlation_time_s: Number = 60.0


class _Scenario(BaseModel):
    """What a plan takes of a scenario of simulated vehicles."""

    origin: _Origin
    vehicle: Annotated[list[_ScenarioVehicle], Field(min_length=1)]
    station: list[_ScenarioStation] = []
    duration_s: Annotated[Number, Field(gt=0.0, le=LONGEST_S)] = 360.0
    airspeed_mps: _Speed = 22.0
    end_of_route: _EndOfRoute = "straight"
    hold_radius_m: Annotated[Number, Field(gt=0.0, le=FAR_M)] = 400.0
    ranging: _Ranging = _Ranging()
    gps: _Gps = _Gps()
    global_position: str = ""
    alert_limit_m: Number = 50.0


def _read_scenario(path: Path, classes: PerVehicle[VehicleClass], speeds_mps: PerVehicle[float]) -> MissionFile:
    table = read_toml(path)
    lacking = [name for key, name in (("origin", "[origin]"), ("vehicle", "[[vehicle]]")) if key not in table]
    if lacking:
        raise DataError(f"{path}: has no {' and no '.join(lacking)}: expected a scenario of simulated vehicles")
    scenario = checked(_Scenario, table, str(path))
    frame = LocalFrame(scenario.origin.lat_deg, scenario.origin.lon_deg, scenario.origin.alt_msl_m)
    missions = tuple(
        _scenario_mission(path, at, each, scenario, frame, classes.of(each.sysid), speeds_mps.of(each.sysid))
        for at, each in enumerate(scenario.vehicle, start=1)
    )
    stations = tuple(
        ListedStation(each.id, frame.geodetic_from_enu(each.east_m, each.north_m, each.height_m)) for each in scenario.station
    )
    remarks = (f"{path}: {scenario.duration_s:g} s are flown, as duration_s says; faults and wind in it are left out",)
    return MissionFile(missions, remarks, stations, _scenario_assumptions(path, scenario))


def _scenario_mission(
    path: Path,
    at: int,
    vehicle: _ScenarioVehicle,
    scenario: _Scenario,
    frame: LocalFrame,
    vehicle_class: VehicleClass | None,
    speed_mps: float | None,
) -> Mission:
    speed = speed_mps or vehicle.airspeed_mps or scenario.airspeed_mps
    places, hold_s, radius_m = vehicle.waypoints, 0.0, 0.0
    if (end := vehicle.end_of_route or scenario.end_of_route) == "hold":
        hold_s, radius_m = scenario.duration_s, scenario.hold_radius_m
    else:
        places = [*places, *_ways_after(f"{path}: vehicle {at}", places, end, speed * scenario.duration_s)]
    ends = [frame.geodetic_from_enu(e, n, vehicle.height_m) for e, n in places]
    legs = [MissionLeg(place, speed) for place in ends[1:]]
    legs[-1] = MissionLeg(ends[-1], speed, hold_s, radius_m)
    name, vehicle_class = f"{path.name}: vehicle {vehicle.sysid}", vehicle_class or VehicleClass.PLANE
    return Mission(name, ends[0], tuple(legs), vehicle_class, vehicle.sysid, scenario.duration_s)


def _ways_after(where: str, places: Sequence[tuple[float, float]], end: str, length_m: float) -> list[tuple[float, float]]:
    """Return the places that are flown to after the last waypoint, until a length is reached.

    `end` says whether the vehicle goes straight on or round again.
    """
    if end == "loop":
        around_m = sum(math.dist(a, b) for a, b in pairwise([*places, places[0]]))
        laps = length_m / max(around_m, 1.0)
        if laps * len(places) > _MOST_LEGS:
            fits = f"{_MOST_LEGS} waypoints in all: a shorter duration_s or a longer loop"
            raise DataError(
                f"{where}: waypoints: {laps:.0f} laps of {around_m:.0f} m are flown in duration_s, expected at most {fits}"
            )
        return list(places) * math.ceil(laps)
    (ae, an), (be, bn) = places[-2], places[-1]
    last_m = max(math.hypot(be - ae, bn - an), 1e-6)
    return [(be + (be - ae) / last_m * length_m, bn + (bn - an) / last_m * length_m)]


def _scenario_assumptions(path: Path, scenario: _Scenario) -> PlanAssumptions:
    ranging, gps = scenario.ranging, scenario.gps
    try:
        return PlanAssumptions(
            range_sigma_m=ranging.sigma_m,
            range_rate_hz=ranging.rate_hz,
            max_range_m=ranging.max_range_m,
            position_sigma_m=gps.sigma_h_m,
            position_rate_hz=gps.rate_hz,
            velocity_sigma_mps=gps.sigma_velocity_mps,
            position_white_share=float(scenario.global_position == "raw" and gps.correlation_time_s == 0.0),
            alert_limit_m=scenario.alert_limit_m,
        )
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error
