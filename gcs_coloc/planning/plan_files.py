"""Readers of plan files: QGroundControl's .plan, Mission Planner's .waypoints, and scenarios.

A .waypoints file is in the format QGC WPL 110, a scenario in TOML.

Sources: https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html,
https://mavlink.io/en/file_formats/#mission_plain_text_file.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from gcs_coloc.core.errors import DataError
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import VehicleClass
from gcs_coloc.core.stations.node_id import MAX_STATION_ID, MAX_SYSTEM_ID, is_system_id
from gcs_coloc.planning.fleet_plan import PlanAssumptions
from gcs_coloc.planning.flight_path import LONGEST_S
from gcs_coloc.planning.mission import (
    FAR_M,
    LatLonAlt,
    ListedStation,
    Mission,
    MissionFile,
    MissionItem,
    MissionLeg,
    PerVehicle,
    check_place,
    check_speed,
    mission_of,
    number,
    numbers,
    shown,
)

_PARAMS = ("param 1", "param 2", "param 3", "param 4", "latitude", "longitude", "altitude")
_WPL_HEADER = "QGC WPL 110"
_WPL_COLUMNS = ("index", "current", "frame", "command", *_PARAMS, "autocontinue")
_PLANE_VEHICLE_TYPES = frozenset({1, *range(19, 26)})
"""MAV_TYPE: fixed wing and VTOL."""
_CLASSES_BY_TYPE = {10: VehicleClass.GROUND, 11: VehicleClass.BOAT, 12: VehicleClass.BOAT}
_MOST_DIGITS = 30  # chosen: beyond any field of a plan; Python refuses to convert some thousand
_MOST_LEGS = 100_000  # chosen: one for each second of a day
_HIGHEST_M = 20_000.0  # chosen: nothing of ours flies higher
_ENDS_OF_ROUTE = ("straight", "loop", "hold")
_LARGEST_FILE_BYTES = 50_000_000  # chosen: a thousand waypoints take 1 MB


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
    try:
        if text.lstrip().startswith("{"):
            return _read_qgc(path, text, classes.of(sysid), speeds_mps.of(sysid))
        if text.startswith("QGC WPL"):
            return _read_wpl(path, text, classes.of(sysid), speeds_mps.of(sysid))
        if path.suffix == ".toml":
            return _read_scenario(path, text, classes, speeds_mps)
    except RecursionError as error:
        raise DataError(f"{path}: is nested too deep, expected a plan") from error
    raise DataError(f"{path}: expected a QGroundControl .plan (JSON), {_WPL_HEADER!r} in the first line, or a scenario (.toml)")


def _read_qgc(path: Path, text: str, vehicle_class: VehicleClass | None, speed_mps: float | None) -> MissionFile:
    try:
        whole = json.loads(text, parse_int=_parse_int)
    except json.JSONDecodeError as error:
        raise DataError(f"{path}: not valid JSON: {error}") from error
    mission = whole.get("mission") if isinstance(whole, dict) else None
    if not isinstance(mission, dict) or not isinstance(mission.get("items"), list):
        raise DataError(f"{path}: mission: expected an object with items, as QGroundControl writes a .plan")
    home = _home(path, mission.get("plannedHomePosition"))
    kind = None if mission.get("vehicleType") is None else number(str(path), "vehicleType", mission["vehicleType"])
    if vehicle_class is None:
        is_plane = kind is None or kind in _PLANE_VEHICLE_TYPES
        vehicle_class = VehicleClass.PLANE if is_plane else _CLASSES_BY_TYPE.get(int(kind or 0), VehicleClass.MULTIROTOR)
    if speed_mps is None:
        key = "cruiseSpeed" if vehicle_class is VehicleClass.PLANE else "hoverSpeed"
        speed_mps = check_speed(str(path), key, number(str(path), key, mission.get(key, 15.0 if key == "cruiseSpeed" else 5.0)))
    items: list[MissionItem] = []
    remarks: list[str] = []
    for at, item in enumerate(mission["items"], start=1):
        items += _qgc_items(f"{path}: item {at}", at, item, remarks)
    found = mission_of(str(path), home, items, vehicle_class, speed_mps)
    return MissionFile(found.missions, (*remarks, *found.remarks, *_beside_the_mission(path, whole)))


def _beside_the_mission(path: Path, whole: Mapping[str, Any]) -> Iterator[str]:
    """Yield a remark for a geofence, and one for rally points: what a .plan holds besides its mission."""

    def count(table: str, key: str) -> int:
        found = whole.get(table)
        several = found.get(key) if isinstance(found, dict) else None
        return len(several) if isinstance(several, list) else 0

    if areas := count("geoFence", "polygons") + count("geoFence", "circles"):
        yield f"{path}: geoFence: {areas} area{'s' if areas > 1 else ''} of a geofence, which is not looked at"
    if points := count("rallyPoints", "points"):
        yield f"{path}: rallyPoints: {points} rally point{'s' if points > 1 else ''}, not flown to"


def _parse_int(digits: str) -> float:
    """Return an integer; one of more digits than any plan has as a float.

    That may be infinite, and is refused at its item.
    """
    return int(digits) if len(digits) <= _MOST_DIGITS else float(digits)


def _home(path: Path, value: object) -> LatLonAlt | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 3:
        raise DataError(f"{path}: plannedHomePosition is {shown(value)}, expected [latitude, longitude, altitude]")
    lat, lon, alt = numbers(f"{path}: plannedHomePosition", ("latitude", "longitude", "altitude"), value)
    check_place(f"{path}: plannedHomePosition", lat, lon, alt)
    return lat, lon, alt


def _qgc_items(where: str, at: int, item: object, remarks: list[str]) -> list[MissionItem]:
    if not isinstance(item, dict):
        raise DataError(f"{where}: is {shown(item)}, expected an object")
    kind = item.get("type")
    if kind == "ComplexItem":
        transect = item.get("TransectStyleComplexItem")
        inner = transect.get("Items") if isinstance(transect, dict) else None
        if not isinstance(inner, list):
            remarks.append(f"{where}: {item.get('complexItemType', 'a complex item')} holds no items of its own and is skipped")
            return []
        return [each for one in inner for each in _qgc_items(where, at, one, remarks)]
    if kind != "SimpleItem":
        raise DataError(f"{where}: type is {shown(kind)}, expected SimpleItem or ComplexItem")
    params = item.get("params")
    if not isinstance(params, list) or len(params) != 7:
        raise DataError(f"{where}: params is {shown(params)}, expected a list of 7 numbers")
    command, frame = number(where, "command", item.get("command")), number(where, "frame", item.get("frame"))
    p1, p2, p3, p4, lat, lon, alt = numbers(where, _PARAMS, params)
    return [MissionItem(at, int(command), int(frame), (p1, p2, p3, p4), lat, lon, alt)]


def _read_wpl(path: Path, text: str, vehicle_class: VehicleClass | None, speed_mps: float | None) -> MissionFile:
    header, *lines = text.splitlines()
    if header.strip() != _WPL_HEADER:
        raise DataError(f"{path}: line 1: is {shown(header.strip())}, expected {_WPL_HEADER!r}")
    items: list[MissionItem] = []
    for at, line in enumerate(lines, start=2):
        if line.strip():
            items.append(_wpl_item(f"{path}: line {at}", line))
    if not items:
        raise DataError(f"{path}: expected home and waypoints after the first line, found none")
    home: LatLonAlt | None = None
    if items[0].number == 0:
        first, items = items[0], items[1:]
        check_place(f"{path}: item 0 (home)", first.lat_deg, first.lon_deg, first.alt_m)
        home = (first.lat_deg, first.lon_deg, first.alt_m) if first.lat_deg or first.lon_deg else None
    vehicle_class = vehicle_class or VehicleClass.PLANE
    remarks: tuple[str, ...] = ()
    if speed_mps is None:
        speed_mps = 15.0 if vehicle_class is VehicleClass.PLANE else 5.0
        remarks = (f"{path}: the file states no speed; {speed_mps:g} m/s is taken, --speed sets another one",)
    found = mission_of(str(path), home, items, vehicle_class, speed_mps)
    return MissionFile(found.missions, (*remarks, *found.remarks))


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
        if not math.isfinite(value):
            raise DataError(f"{where}: {name} is {shown(column)}, expected a number")
        values.append(value)
    index, _, frame, command, p1, p2, p3, p4, lat, lon, alt, _ = values
    return MissionItem(int(index), int(command), int(frame), (p1, p2, p3, p4), lat, lon, alt)


def _read_scenario(path: Path, text: str, classes: PerVehicle[VehicleClass], speeds_mps: PerVehicle[float]) -> MissionFile:
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise DataError(f"{path}: not valid TOML: {error}") from error
    except ValueError as error:  # Python refuses to convert an integer of thousands of digits
        at = next((k for k, line in enumerate(text.splitlines(), start=1) if re.search(r"\d{1000}", line)), 1)
        raise DataError(f"{path}: line {at}: expected a number of fewer digits") from error
    lacking = [shown for key, shown in (("origin", "[origin]"), ("vehicle", "[[vehicle]]")) if key not in table]
    if lacking:
        raise DataError(f"{path}: has no {' and no '.join(lacking)}: expected a scenario of simulated vehicles")
    origin = _table(path, table, "origin")
    base_m = number(f"{path}: origin", "alt_msl_m", origin.get("alt_msl_m", 0.0))
    lat, lon = (number(f"{path}: origin", key, origin.get(key)) for key in ("lat_deg", "lon_deg"))
    check_place(f"{path}: origin", lat, lon, base_m)
    frame = LocalFrame(lat, lon, base_m)
    duration_s = number(str(path), "duration_s", table.get("duration_s", 360.0))
    if not 0.0 < duration_s <= LONGEST_S:
        raise DataError(f"{path}: duration_s is {duration_s:g}, expected seconds above 0, at most {LONGEST_S:g}")
    vehicles = table.get("vehicle")
    if not isinstance(vehicles, list) or not vehicles:
        raise DataError(f"{path}: vehicle: expected at least one [[vehicle]]")
    missions = tuple(
        _scenario_vehicle(path, at, each, table, frame, speeds_mps, duration_s) for at, each in enumerate(vehicles, start=1)
    )
    listed = table.get("station", [])
    if not isinstance(listed, list):
        raise DataError(f"{path}: station is {shown(listed)}, expected a [[station]] for each")
    missions = tuple(replace(mission, vehicle_class=classes.of(mission.sysid) or mission.vehicle_class) for mission in missions)
    stations = tuple(_scenario_station(path, at, each, frame) for at, each in enumerate(listed, start=1))
    remarks = (f"{path}: {duration_s:g} s are flown, as duration_s says; faults and wind in it are left out",)
    return MissionFile(missions, remarks, stations, _scenario_assumptions(path, table))


def _scenario_vehicle(
    path: Path,
    at: int,
    vehicle: Any,
    table: Mapping[str, Any],
    frame: LocalFrame,
    speeds_mps: PerVehicle[float],
    duration_s: float,
) -> Mission:
    where = f"{path}: vehicle {at}"
    if not isinstance(vehicle, dict):
        raise DataError(f"{where}: is {shown(vehicle)}, expected a table [[vehicle]]")
    sysid = vehicle.get("sysid")
    if isinstance(sysid, bool) or not isinstance(sysid, int) or not is_system_id(sysid):
        raise DataError(f"{where}: sysid is {shown(sysid)}, expected a system id, a whole number from 1 to {MAX_SYSTEM_ID}")
    points = vehicle.get("waypoints")
    if not isinstance(points, list) or len(points) < 2:
        raise DataError(f"{where}: waypoints: expected two [east, north] at least")
    height_m = _metres(where, "height_m", vehicle.get("height_m", 100.0), _HIGHEST_M)
    places: list[tuple[float, float]] = []
    for k, point in enumerate(points, start=1):
        if not isinstance(point, list) or len(point) != 2:
            raise DataError(f"{where}: waypoint {k}: is {shown(point)}, expected [east, north] in metres")
        east, north = (
            _metres(f"{where}: waypoint {k}", name, v, FAR_M) for name, v in zip(("east", "north"), point, strict=True)
        )
        places.append((east, north))
    speed = speeds_mps.of(sysid)
    if speed is None:
        stated = vehicle.get("airspeed_mps", table.get("airspeed_mps", 22.0))
        speed = check_speed(where, "airspeed_mps", number(where, "airspeed_mps", stated))
    end = vehicle.get("end_of_route", table.get("end_of_route", "straight"))
    if end not in _ENDS_OF_ROUTE:
        raise DataError(f"{where}: end_of_route is {shown(end)}, expected one of {', '.join(_ENDS_OF_ROUTE)}")
    hold_s, radius_m = 0.0, 0.0
    if end == "hold":
        hold_s, radius_m = duration_s, number(str(path), "hold_radius_m", table.get("hold_radius_m", 400.0))
        if not 0.0 < radius_m <= FAR_M:
            raise DataError(f"{path}: hold_radius_m is {radius_m:g}, expected metres above 0, at most {FAR_M:g}")
    else:
        places += _ways_after(where, places, end, speed * duration_s)
    ends = [frame.geodetic_from_enu(e, n, height_m) for e, n in places]
    legs = [MissionLeg(place, speed) for place in ends[1:]]
    legs[-1] = MissionLeg(ends[-1], speed, hold_s, radius_m)
    return Mission(f"{path.name}: vehicle {sysid}", ends[0], tuple(legs), VehicleClass.PLANE, sysid, duration_s)


def _metres(where: str, name: str, value: object, most_m: float) -> float:
    """Return a coordinate of a scenario."""
    found = number(where, name, value)
    if not abs(found) <= most_m:
        raise DataError(f"{where}: {name} is {found:g}, expected metres from {-most_m:g} to {most_m:g}")
    return found


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


def _scenario_station(path: Path, at: int, station: Any, frame: LocalFrame) -> ListedStation:
    where = f"{path}: station {at}"
    if not isinstance(station, dict):
        raise DataError(f"{where}: is {shown(station)}, expected a table [[station]]")
    station_id = station.get("id")
    if isinstance(station_id, bool) or not isinstance(station_id, int) or not 0 <= station_id <= MAX_STATION_ID:
        raise DataError(f"{where}: id is {shown(station_id)}, expected a whole number from 0 to {MAX_STATION_ID}")
    e, n = (_metres(where, key, station.get(key), FAR_M) for key in ("east_m", "north_m"))
    up = _metres(where, "height_m", station.get("height_m", 0.0), _HIGHEST_M)
    return ListedStation(station_id, frame.geodetic_from_enu(e, n, up))


def _scenario_assumptions(path: Path, table: Mapping[str, Any]) -> PlanAssumptions:
    ranging, gps = _table(path, table, "ranging"), _table(path, table, "gps")
    known = {
        "range_sigma_m": ranging.get("sigma_m", 0.5),
        "range_rate_hz": ranging.get("rate_hz", 10.0),
        "max_range_m": ranging.get("max_range_m", 100_000.0),
        "position_sigma_m": gps.get("sigma_h_m", 1.5),
        "position_rate_hz": gps.get("rate_hz", 5.0),
        "velocity_sigma_mps": gps.get("sigma_velocity_mps", 0.3),
        "alert_limit_m": table.get("alert_limit_m", 50.0),
    }
    is_white = table.get("global_position") == "raw" and gps.get("correlation_time_s", 60.0) == 0.0
    values = {name: number(str(path), name, value) for name, value in known.items()}
    try:
        return replace(PlanAssumptions(position_white_share=float(is_white)), **values)  # type: ignore[arg-type]
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error


def _table(path: Path, table: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = table.get(name, {})
    if not isinstance(found, dict):
        raise DataError(f"{path}: {name}: expected a table [{name}]")
    return found
