"""Reads a data set in the documented layout (docs/reference/dataset.md): a recording of any kind, for evaluation.

Strict: the first thing that is wrong is an error that names file, line and column. Nothing is guessed and nothing skipped.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gcs_coloc.core.errors import DataError
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    FloatArray,
    Measurement,
    PositionMeasurement,
    RangeMeasurement,
    Vector3,
)
from gcs_coloc.evaluation.tables import TableRow, read_layout

ROLES = ("denied", "peer", "anchor")
_ROLE_UNTIL_0_1 = {"subject": "denied"}
"""Data sets written for version 0.1 still read."""
_META_KEYS = {"name", "source", "licence", "dims", "node", "origin"}
_ORIGIN_KEYS = {"lat_deg", "lon_deg", "alt_m"}
_NODE_KEYS = {"id", "role"}
_ANCHOR_KEYS = ("e_m", "n_m", "u_m", "sigma_m")
_FARTHEST_M = 2e7
"""Half way round the Earth: grids count from afar, but no further."""
_HALF_TURN = math.pi + 0.01
"""Radians; what is beyond by less is rounding."""


@dataclass(frozen=True, slots=True)
class Node:
    """One radio of the data set; `vehicle` is its number for the estimator. An anchor has a place (ENU, m) with a sigma (m)."""

    id: str
    vehicle: int
    role: str
    place_enu_m: Vector3 | None = None
    sigma_m: float | None = None


@dataclass(frozen=True, slots=True)
class Truth:
    """Where one node truly was: times (T,) in seconds, ascending, and positions (T, 3), ENU in metres."""

    times_s: FloatArray
    positions_enu_m: FloatArray


@dataclass(frozen=True, slots=True)
class Dataset:
    """A whole data set; `measurements` are in order of arrival, `truth` is by vehicle number.

    `origin` is (latitude deg, longitude deg, altitude m) of the frame where it is given.
    """

    name: str
    source: str
    licence: str
    dims: int
    origin: Vector3 | None
    nodes: tuple[Node, ...]
    measurements: tuple[Measurement, ...]
    truth: dict[int, Truth]

    def denied(self) -> tuple[Node, ...]:
        """The nodes to be located."""
        return tuple(node for node in self.nodes if node.role == "denied")


def read_dataset(directory: Path) -> Dataset:
    """Read a data set.

    Raises:
        DataError: a file is missing or something in it is wrong; the text names the file, and line and column where there are
        any.

    """
    if not directory.is_dir():
        raise DataError(f"{directory}: no such directory")
    meta = _Meta(directory / "meta.toml")
    vehicles = {node.id: node.vehicle for node in meta.nodes}
    roles = {node.id: node.role for node in meta.nodes}
    measurements: list[Measurement] = []
    for read, name, required in (
        (_positions, "positions.csv", True),
        (_ranges, "ranges.csv", True),
        (_altitudes, "altitude.csv", False),
        (_attitudes, "attitude.csv", False),
    ):
        path = directory / name
        if required or path.exists():
            measurements.extend(read(path, vehicles, roles))
    measurements.sort(key=lambda m: (m.arrived_at_s, m.measured_at_s))
    if not any(isinstance(m, RangeMeasurement) for m in measurements):
        raise DataError(f"{directory / 'ranges.csv'}: no rows")
    truth = _truth(directory / "truth.csv", vehicles)
    if not any(node.vehicle in truth for node in meta.nodes if node.role == "denied"):
        raise DataError(f"{directory / 'truth.csv'}: no row of any denied vehicle")
    return Dataset(meta.name, meta.source, meta.licence, meta.dims, meta.origin, meta.nodes, tuple(measurements), truth)


class _Meta:
    """meta.toml, checked."""

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
        tables = content.get("node")
        if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
            raise DataError(f"{path}: at least one [[node]] is needed")
        self.nodes = tuple(self._node(i + 1, table) for i, table in enumerate(tables))
        ids = [node.id for node in self.nodes]
        for i in ids:
            if ids.count(i) > 1:
                raise DataError(f"{path}: two nodes have the id {i!r}")
        if not any(node.role == "denied" for node in self.nodes):
            raise DataError(f'{path}: no node has the role "denied": there is nothing to locate')

    def _only(self, table: dict[str, Any], allowed: set[str], where: str) -> None:
        for key in table:
            if key not in allowed:
                raise DataError(f"{self._path}: {where}unknown key {key!r}; known are {', '.join(sorted(allowed))}")

    def _text(self, table: dict[str, Any], key: str, where: str = "") -> str:
        value = table.get(key)
        if not isinstance(value, str) or not value:
            raise DataError(f"{self._path}: {where}{key} has to be a text")
        return value

    def _number(self, table: dict[str, Any], key: str, where: str) -> float:
        value = table.get(key)
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
        self._only(table, _NODE_KEYS | set(_ANCHOR_KEYS) if role == "anchor" else _NODE_KEYS, where)
        node_id = self._text(table, "id", where)
        if role != "anchor":
            return Node(node_id, number, role)
        e, n, u, sigma = (self._number(table, key, where) for key in _ANCHOR_KEYS)
        if sigma <= 0.0:
            raise DataError(f"{self._path}: {where}sigma_m has to be above 0")
        return Node(node_id, number, role, (e, n, u), sigma)


def _vehicle(row: TableRow, column: str, vehicles: dict[str, int]) -> int:
    text = row.text(column)
    if text not in vehicles:
        raise row.error(column, f"{text!r} is not the id of any node in meta.toml")
    return vehicles[text]


def _times(row: TableRow) -> tuple[float, float]:
    """When it was measured and when it arrived, in seconds."""
    measured_at_s = row.number("t_s")
    if not row.has("arrival_s"):
        return measured_at_s, measured_at_s
    arrived_at_s = row.number("arrival_s")
    if arrived_at_s < measured_at_s:
        raise row.error("arrival_s", f"it arrived {measured_at_s - arrived_at_s:g} s before it was measured")
    return measured_at_s, arrived_at_s


def _place(row: TableRow) -> Vector3:
    e, n, u = (row.within(column, -_FARTHEST_M, _FARTHEST_M, "metres are wanted") for column in ("e_m", "n_m", "u_m"))
    return (e, n, u)


_ARRIVAL = ("arrival_s",)
_VELOCITY = ("ve_mps", "vn_mps", "vu_mps", "sigma_vel_mps")


def _positions(path: Path, vehicles: dict[str, int], roles: dict[str, str]) -> Iterator[Measurement]:
    for row in read_layout(path, ("t_s", "id", "e_m", "n_m", "u_m", "sigma_h_m", "sigma_v_m"), _VELOCITY, _ARRIVAL):
        vehicle = _vehicle(row, "id", vehicles)
        if roles[row.text("id")] == "anchor":
            raise row.error("id", "an anchor stands where meta.toml says and reports no positions")
        measured_at_s, arrived_at_s = _times(row)
        moving = row.has("ve_mps")
        yield PositionMeasurement(
            vehicle=vehicle,
            measured_at_s=measured_at_s,
            arrived_at_s=arrived_at_s,
            position_enu_m=_place(row),
            sigma_h_m=row.positive("sigma_h_m"),
            sigma_v_m=row.positive("sigma_v_m"),
            velocity_enu_mps=(row.number("ve_mps"), row.number("vn_mps"), row.number("vu_mps")) if moving else None,
            sigma_velocity_mps=row.positive("sigma_vel_mps") if moving else None,
        )


def _ranges(path: Path, vehicles: dict[str, int], roles: dict[str, str]) -> Iterator[Measurement]:  # noqa: ARG001 - one signature for all readers
    for row in read_layout(path, ("t_s", "from_id", "to_id", "range_m", "sigma_m"), _ARRIVAL):
        measured_at_s, arrived_at_s = _times(row)
        a, b = _vehicle(row, "from_id", vehicles), _vehicle(row, "to_id", vehicles)
        if a == b:
            raise row.error("to_id", "a node has no range to itself")
        yield RangeMeasurement(a, b, measured_at_s, arrived_at_s, row.not_negative("range_m"), row.positive("sigma_m"))


def _altitudes(path: Path, vehicles: dict[str, int], roles: dict[str, str]) -> Iterator[Measurement]:  # noqa: ARG001 - one signature for all readers
    for row in read_layout(path, ("t_s", "id", "u_m", "sigma_v_m"), _ARRIVAL):
        measured_at_s, arrived_at_s = _times(row)
        yield AltitudeMeasurement(
            _vehicle(row, "id", vehicles), measured_at_s, arrived_at_s, row.number("u_m"), row.positive("sigma_v_m")
        )


def _attitudes(path: Path, vehicles: dict[str, int], roles: dict[str, str]) -> Iterator[Measurement]:  # noqa: ARG001 - one signature for all readers
    for row in read_layout(path, ("t_s", "id", "roll_rad", "pitch_rad", "yaw_rad", "airspeed_mps"), _ARRIVAL):
        measured_at_s, arrived_at_s = _times(row)
        yield AttitudeMeasurement(
            vehicle=_vehicle(row, "id", vehicles),
            measured_at_s=measured_at_s,
            arrived_at_s=arrived_at_s,
            roll_rad=row.within("roll_rad", -_HALF_TURN, _HALF_TURN, "radians are wanted"),
            pitch_rad=row.within("pitch_rad", -_HALF_TURN / 2.0, _HALF_TURN / 2.0, "radians are wanted"),
            yaw_rad=row.number("yaw_rad"),
            airspeed_mps=None if row.is_empty("airspeed_mps") else row.not_negative("airspeed_mps"),
        )


def _truth(path: Path, vehicles: dict[str, int]) -> dict[int, Truth]:
    rows: dict[int, list[tuple[float, float, float, float]]] = {}
    for row in read_layout(path, ("t_s", "id", "e_m", "n_m", "u_m")):
        of_node = rows.setdefault(_vehicle(row, "id", vehicles), [])
        t_s = row.number("t_s")
        if of_node and t_s < of_node[-1][0]:
            raise row.error("t_s", f"time goes back from {of_node[-1][0]:g} s")
        of_node.append((t_s, *_place(row)))
    if not rows:
        raise DataError(f"{path}: no rows")
    return {vehicle: Truth(np.array(r)[:, 0], np.array(r)[:, 1:]) for vehicle, r in rows.items()}
