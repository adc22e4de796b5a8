"""The meta data of a data set: `meta.toml`.

It has the nodes, their antennas and what is known of their ranging devices.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gcs_coloc.core.errors import DataError
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Vector3, VehicleClass
from gcs_coloc.core.stations.node_id import MAX_STATION_ID, station_node

ROLES = ("denied", "peer", "anchor")
_ROLE_UNTIL_0_1 = {"subject": "denied"}
"""Data sets written for version 0.1 still read."""
_META_KEYS = {"name", "source", "licence", "dims", "node", "station", "origin", "vehicle_class"}
_ORIGIN_KEYS = {"lat_deg", "lon_deg", "alt_m"}
_NODE_KEYS = {"id", "role", "antenna", "range_bias_m", "range_scale", "vehicle_class"}
_ANCHOR_KEYS = ("e_m", "n_m", "u_m", "sigma_m")
_STATION_KEYS = {"id", "name", "lat_deg", "lon_deg", "alt_m", "sigma_m", "range_bias_m", "range_scale"}
"""As those of the configuration's `[[station]]`."""
_STATION_SIGMA_M = 1.0
"""As the configuration has it."""
_ANTENNA_KEYS = ("forward_m", "right_m", "down_m")
_MOST_SCALE = 0.5  # chosen: a half or a double is a wrong unit


@dataclass(frozen=True, slots=True)
class Node:
    """One radio of the data set; `vehicle` is its number for the estimator.

    An anchor has a place (ENU, m) with a sigma (m).

    `antennas`: lever arms (forward, right, down, m) by the antenna's id. `range_bias_m` and `range_scale` are the calibration of
    its device: a range of two nodes is (1 + both scales) times the distance plus both biases. `vehicle_class`: how it moves, None
    where that is not stated.
    """

    id: str
    vehicle: int
    role: str
    place_enu_m: Vector3 | None = None
    sigma_m: float | None = None
    antennas: Mapping[str, Vector3] = field(default_factory=dict)
    range_bias_m: float = 0.0
    range_scale: float = 0.0
    vehicle_class: VehicleClass | None = None


class Meta:
    """meta.toml, checked. Raises DataError."""

    def __init__(self, path: Path) -> None:
        try:
            content = tomllib.loads(path.read_text(encoding="utf-8-sig"))
        except OSError as error:
            raise DataError(f"{path}: {error.strerror or error}") from error
        except UnicodeDecodeError as error:
            raise DataError(f"{path}: not UTF-8 text (byte {error.start})") from error
        except tomllib.TOMLDecodeError as error:
            raise DataError(f"{path}: not TOML: {error}") from error
        self._path = path
        self._only(content, _META_KEYS, "")
        self.name = self._text(content, "name")
        self.source = self._text(content, "source")
        self.licence = self._text(content, "licence")
        dims = content.get("dims")
        if type(dims) is not int or dims not in (2, 3):
            raise DataError(f"{path}: dims has to be 2 or 3, not {dims!r}")
        self.dims: int = dims
        self.origin = self._origin(content.get("origin"))
        self._vehicle_class = self._class(content, "", None)
        tables = content.get("node")
        if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
            raise DataError(f"{path}: at least one [[node]] is needed")
        nodes = tuple(self._node(i + 1, table) for i, table in enumerate(tables))
        self.nodes = nodes + self._stations(content.get("station"))
        self._unique([node.id for node in self.nodes], "nodes", "")
        if not any(node.role == "denied" for node in self.nodes):
            raise DataError(f'{path}: no node has the role "denied": there is nothing to locate')

    def _only(self, table: dict[str, Any], allowed: set[str], where: str) -> None:
        for key in table:
            if key not in allowed:
                raise DataError(f"{self._path}: {where}unknown key {key!r}; known are {', '.join(sorted(allowed))}")

    def _unique(self, ids: list[str], what: str, where: str) -> None:
        for i in ids:
            if ids.count(i) > 1:
                raise DataError(f"{self._path}: {where}two {what} have the id {i!r}")

    def _text(self, table: dict[str, Any], key: str, where: str = "") -> str:
        value = table.get(key)
        if not isinstance(value, str) or not value:
            raise DataError(f"{self._path}: {where}{key} has to be a text")
        return value

    def _class(self, table: dict[str, Any], where: str, default: VehicleClass | None) -> VehicleClass | None:
        value = table.get("vehicle_class", default)
        if value is not None and value not in set(VehicleClass):
            raise DataError(f"{self._path}: {where}vehicle_class has to be one of {', '.join(VehicleClass)}, not {value!r}")
        return VehicleClass(value) if value is not None else None

    def _number(self, table: dict[str, Any], key: str, where: str, default: float | None = None) -> float:
        value = table.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise DataError(f"{self._path}: {where}{key} has to be a number")
        return float(value)

    def _origin(self, table: Any) -> Vector3 | None:
        if table is None:
            return None
        if not isinstance(table, dict):
            raise DataError(f"{self._path}: origin has to be a table")
        self._only(table, _ORIGIN_KEYS, "[origin] ")
        lat, lon, alt = (self._number(table, key, "[origin] ") for key in ("lat_deg", "lon_deg", "alt_m"))
        return (lat, lon, alt)

    def _node(self, number: int, table: dict[str, Any]) -> Node:
        where = f"[[node]] {number}: "
        role = self._text(table, "role", where)
        role = _ROLE_UNTIL_0_1.get(role, role)
        if role not in ROLES:
            raise DataError(f"{self._path}: {where}role has to be one of {', '.join(ROLES)}, not {role!r}")
        self._only(table, _NODE_KEYS - {"vehicle_class"} | set(_ANCHOR_KEYS) if role == "anchor" else _NODE_KEYS, where)
        node_id = self._text(table, "id", where)
        place, sigma_m = None, None
        if role == "anchor":
            e, n, u, sigma_m = (self._number(table, key, where) for key in _ANCHOR_KEYS)
            place = (e, n, u)
            if sigma_m <= 0.0:
                raise DataError(f"{self._path}: {where}sigma_m has to be above 0")
        bias_m, scale = self._calibration(table, where)
        antennas = self._antennas(table.get("antenna"), where)
        vehicle_class = self._class(table, where, self._vehicle_class) if role != "anchor" else None
        return Node(node_id, number, role, place, sigma_m, antennas, bias_m, scale, vehicle_class)

    def _stations(self, tables: Any) -> tuple[Node, ...]:
        """Return the fixed stations: anchors with the ids that ranges name them by, STN3 for station 3."""
        if tables is None:
            return ()
        if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
            raise DataError(f"{self._path}: a station is a table: [[station]]")
        if self.origin is None:
            raise DataError(f"{self._path}: [[station]] needs [origin]: its position is in degrees, all others are in metres")
        frame = LocalFrame(*self.origin)
        return tuple(self._station(i + 1, table, frame) for i, table in enumerate(tables))

    def _station(self, number: int, table: dict[str, Any], frame: LocalFrame) -> Node:
        where = f"[[station]] {number}: "
        self._only(table, _STATION_KEYS, where)
        station_id = table.get("id")
        if type(station_id) is not int or not 0 <= station_id <= MAX_STATION_ID:
            raise DataError(f"{self._path}: {where}id has to be a whole number from 0 to {MAX_STATION_ID}, not {station_id!r}")
        lat, lon, alt = (self._number(table, key, where) for key in ("lat_deg", "lon_deg", "alt_m"))
        if abs(lat) > 90.0 or abs(lon) > 180.0:
            raise DataError(f"{self._path}: {where}lat_deg and lon_deg have to be within 90 and 180 degrees")
        sigma_m = self._number(table, "sigma_m", where, _STATION_SIGMA_M)
        if sigma_m <= 0.0:
            raise DataError(f"{self._path}: {where}sigma_m has to be above 0")
        place, calibration = frame.enu_from_geodetic(lat, lon, alt), self._calibration(table, where)
        return Node(f"STN{station_id}", station_node(station_id), "anchor", place, sigma_m, {}, *calibration)

    def _calibration(self, table: dict[str, Any], where: str) -> tuple[float, float]:
        bias_m, scale = self._number(table, "range_bias_m", where, 0.0), self._number(table, "range_scale", where, 0.0)
        if abs(scale) > _MOST_SCALE:
            raise DataError(f"{self._path}: {where}range_scale is the excess over 1, within {_MOST_SCALE}: 0.01 is one per cent")
        return bias_m, scale

    def _antennas(self, tables: Any, where: str) -> dict[str, Vector3]:
        if tables is None:
            return {}
        if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
            raise DataError(f"{self._path}: {where}an antenna is a table: [[node.antenna]]")
        antennas = {}
        for table in tables:
            self._only(table, {"id", *_ANTENNA_KEYS}, f"{where}[[node.antenna]] ")
            forward, right, down = (self._number(table, key, f"{where}[[node.antenna]] ") for key in _ANTENNA_KEYS)
            antennas[self._text(table, "id", f"{where}[[node.antenna]] ")] = (forward, right, down)
        self._unique([table["id"] for table in tables], "antennas", where)
        return antennas
