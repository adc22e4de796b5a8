"""Entries of the journal as messages of Foxglove's well-known schemas.

Foxglove and Lichtblick draw such messages by themselves.

Schemas: https://github.com/foxglove/foxglove-sdk, schemas/jsonschema; copies of the three in use are in `foxglove_schemas`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from math import cos, sin
from typing import Any

from gcs_coloc.core.alarms.alarms import Alarm, AlarmKind
from gcs_coloc.core.error_ellipse import error_ellipse
from gcs_coloc.core.messages.outbound import HealthChanged, Notice
from gcs_coloc.core.snapshot import VehicleSnapshot
from gcs_coloc.core.station_review import StationSnapshot
from gcs_coloc.core.stations.node_id import node_name
from gcs_coloc.recorder.journal import Entry, RangeEntry, StationEntry, VehicleEntry

FRAME_ID = "fleet"
"""The frame of scenes: east, north, up of the fleet's origin."""
_UNKNOWN, _APPROXIMATED = 0, 1
"""foxglove.PositionCovarianceType; approximated, since the correlation of height and horizontal position is not recorded."""
_LINE_LIST = 2  # source: foxglove.LinePrimitive
_LOG_LEVELS = {"info": 2, "warning": 3, "error": 4}
"""foxglove.LogLevel."""
_AXES_95 = 2.4477
"""Semi-axes of the ellipse that holds 95 % of a plane Gaussian, in sigma: root of chi-square's quantile of two dimensions."""
_VEHICLE_SHOWN_S = 2
"""Chosen: five entries of a vehicle; then it leaves the scene."""
_RANGE_SHOWN_S = 1  # chosen: some rounds of ranges
_STATION_SHOWN_S = 0  # for good (foxglove.SceneEntity): it has an entry only when something of it changes
_COLOURS = {
    "healthy": (0.11, 0.62, 0.33),
    "suspect": (0.85, 0.6, 0.0),
    "failed": (0.83, 0.18, 0.18),
    "recovering": (0.16, 0.45, 0.8),
}
_NO_COLOUR = (0.5, 0.5, 0.5)  # grey

WellKnown = tuple[str, str, dict[str, Any]]
"""Topic, schema name and content of a message."""


@cache
def well_known_schema(name: str) -> bytes:
    """Return the published JSON schema of one of the messages, such as `foxglove.Log`."""
    path = files("gcs_coloc.recorder.formats") / "foxglove_schemas" / f"{name.removeprefix('foxglove.')}.json"
    return json.dumps(json.loads(path.read_bytes()), separators=(",", ":")).encode()


class FoxgloveMessages:
    """Converter of entries to messages of well-known schemas.

    It remembers where each vehicle and station was last, as the line of a range needs both ends.
    """

    def __init__(self) -> None:
        self._enu_m: dict[int, tuple[float, float, float]] = {}

    def messages(self, entry: Entry) -> Iterator[WellKnown]:
        """Return the messages of one entry. Topics: /estimate/N, /reported/N, /scene, /log."""
        if isinstance(entry, VehicleEntry):
            yield from self._of_vehicle(entry.vehicle, entry.at_s)
        elif isinstance(entry, RangeEntry):
            yield from self._of_range(entry)
        elif isinstance(entry, StationEntry):
            yield from self._of_station(entry.station, entry.at_s)
        elif isinstance(entry, HealthChanged):
            # No warning: what needs a person is an alarm.
            yield _log(entry.at_s, "info", entry.sysid, f"GPS {entry.before} -> {entry.after}: {entry.reason}")
        elif isinstance(entry, Notice):
            yield _log(entry.at_s, entry.level, entry.sysid, entry.text)
        elif isinstance(entry, Alarm) and entry.kind is not AlarmKind.NOTICE:  # its notice is there already
            level = entry.level if entry.state == "active" else "info"
            yield _log(entry.at_s, level, entry.sysid, f"alarm {entry.state}: {entry.text}")

    def _of_vehicle(self, v: VehicleSnapshot, at_s: float) -> Iterator[WellKnown]:
        colour = _colour(*_COLOURS.get(v.gps_state, _NO_COLOUR))
        if v.lat_deg is not None and v.lon_deg is not None and v.alt_msl_m is not None:
            content = _location(at_s, v, (v.lat_deg, v.lon_deg, v.alt_msl_m), colour)
            if v.covariance_h_m2 is not None and v.sigma_v_m is not None:
                ee, en, nn = v.covariance_h_m2
                content["position_covariance"] = [ee, en, 0.0, en, nn, 0.0, 0.0, 0.0, v.sigma_v_m**2]
                content["position_covariance_type"] = _APPROXIMATED
            yield f"/estimate/{v.sysid}", "foxglove.LocationFix", content
        if v.reported_lat_deg is not None and v.reported_lon_deg is not None and v.reported_alt_msl_m is not None:
            reported = (v.reported_lat_deg, v.reported_lon_deg, v.reported_alt_msl_m)
            yield f"/reported/{v.sysid}", "foxglove.LocationFix", _location(at_s, v, reported, _colour(*_NO_COLOUR))
        enu_m = v.enu_m or v.reported_enu_m
        if enu_m is None:
            return
        self._enu_m[v.sysid] = enu_m
        entity = _entity(at_s, f"vehicle {v.sysid}", _VEHICLE_SHOWN_S)
        if v.enu_m is not None and v.covariance_h_m2 is not None:
            ellipse = error_ellipse(*v.covariance_h_m2)
            entity["cylinders"] = [
                {
                    "pose": _pose(v.enu_m, ellipse.angle_rad),
                    "size": _vector(2 * _AXES_95 * ellipse.semi_major_m, 2 * _AXES_95 * ellipse.semi_minor_m, 0.1),
                    "bottom_scale": 1.0,
                    "top_scale": 1.0,
                    "color": colour | {"a": 0.3},
                }
            ]
        entity["texts"] = [_label(enu_m, str(v.sysid), colour)]
        yield "/scene", "foxglove.SceneUpdate", {"deletions": [], "entities": [entity]}

    def _of_station(self, station: StationSnapshot, at_s: float) -> Iterator[WellKnown]:
        if station.enu_m is None:
            return
        self._enu_m[station.node] = station.enu_m
        label = node_name(station.node)
        entity = _entity(at_s, label, _STATION_SHOWN_S)
        entity["texts"] = [_label(station.enu_m, station.name or label, _colour(*_NO_COLOUR))]
        yield "/scene", "foxglove.SceneUpdate", {"deletions": [], "entities": [entity]}

    def _of_range(self, entry: RangeEntry) -> Iterator[WellKnown]:
        one = entry.range
        ends = [self._enu_m.get(node) for node in (one.from_sysid, one.to_sysid)]
        if None in ends:
            return
        entity = _entity(entry.at_s, f"range {one.from_sysid} {node_name(one.to_sysid)}", _RANGE_SHOWN_S)
        entity["metadata"] = [
            {"key": "innovation_m", "value": f"{one.innovation_m:.2f}"},
            {"key": "refused", "value": one.refused or "no"},
        ]
        entity["lines"] = [
            {
                "type": _LINE_LIST,
                "pose": _pose((0.0, 0.0, 0.0)),
                "thickness": 2.0,
                "scale_invariant": True,
                "points": [_vector(*end) for end in ends if end is not None],
                "color": _colour(*_COLOURS["failed" if one.refused else "recovering"]),
                "colors": [],
                "indices": [],
            }
        ]
        yield "/scene", "foxglove.SceneUpdate", {"deletions": [], "entities": [entity]}


def _location(at_s: float, v: VehicleSnapshot, lla: tuple[float, float, float], colour: dict[str, float]) -> dict[str, Any]:
    return {
        "timestamp": _time(at_s),
        "frame_id": f"vehicle {v.sysid}",
        "latitude": lla[0],
        "longitude": lla[1],
        "altitude": lla[2],
        "position_covariance": [0.0] * 9,
        "position_covariance_type": _UNKNOWN,
        "color": colour,
    }


def _log(at_s: float, level: str, sysid: int | None, text: str) -> WellKnown:
    name = f"vehicle {sysid}" if sysid is not None else "fleet"
    content = {"timestamp": _time(at_s), "level": _LOG_LEVELS[level], "message": text, "name": name, "file": "", "line": 0}
    return "/log", "foxglove.Log", content


def _entity(at_s: float, entity_id: str, shown_s: int) -> dict[str, Any]:
    """A scene entity without anything to draw."""
    empty: dict[str, Any] = {
        kind: [] for kind in ("metadata", "arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    }
    lifetime = {"sec": shown_s, "nsec": 0}
    about = {"timestamp": _time(at_s), "frame_id": FRAME_ID, "id": entity_id, "lifetime": lifetime, "frame_locked": False}
    return about | empty


def _label(at: tuple[float, float, float], text: str, colour: dict[str, float]) -> dict[str, Any]:
    look = {"billboard": True, "font_size": 14.0, "scale_invariant": True, "color": colour}
    return {"pose": _pose(at), "text": text} | look


def _time(at_s: float) -> dict[str, int]:
    """The time of an entry, to the microsecond, as its MCAP message has it."""
    seconds, microseconds = divmod(round(at_s * 1e6), 1_000_000)
    return {"sec": seconds, "nsec": microseconds * 1000}


def _pose(at: tuple[float, float, float], yaw_rad: float = 0.0) -> dict[str, Any]:
    """A pose at east, north, up; `yaw_rad` counts from east to north."""
    return {
        "position": _vector(*at),
        "orientation": {"x": 0.0, "y": 0.0, "z": sin(0.5 * yaw_rad), "w": cos(0.5 * yaw_rad)},
    }


def _vector(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def _colour(red: float, green: float, blue: float) -> dict[str, float]:
    return {"r": red, "g": green, "b": blue, "a": 1.0}
