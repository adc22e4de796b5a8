"""Reads a data set in the documented layout (docs/reference/dataset.md).

It is a recording of any kind, for evaluation.

A row that is wrong is dropped and told with its file and line; a file that is mostly wrong is an error. Nothing is guessed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gcs_coloc.core.errors import DataError
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    FloatArray,
    Measurement,
    OdometryMeasurement,
    PositionMeasurement,
    RangeMeasurement,
    Vector3,
)
from gcs_coloc.evaluation.antennas import Attitudes, antenna_range
from gcs_coloc.evaluation.dataset_meta import FARTHEST_M, Node, read_meta
from gcs_coloc.evaluation.tables import DroppedRows, TableRow, read_layout

_FARTHEST_S = 1e11
"""Three thousand years: POSIX times are within, those in milliseconds beyond."""
_LEAST_SIGMA = 1e-6  # chosen: a micrometre; the square of a far smaller one is zero
_HALF_TURN = math.pi + 0.01
"""Radians; what is beyond by less is rounding."""
_FASTEST_TURN = 20.0
"""Radians a second, three turns; what is beyond is in degrees."""
_NO_ARM = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Truth:
    """Where one node truly was: times (T,) in seconds, ascending, and positions (T, 3), ENU in metres."""

    times_s: FloatArray
    positions_enu_m: FloatArray


@dataclass(frozen=True, slots=True)
class Dataset:
    """A whole data set; `measurements` are in order of arrival, `truth` is by vehicle number.

    `origin` is (latitude deg, longitude deg, altitude m) of the frame where it is given. `dropped`: rows that are not in it.
    """

    name: str
    source: str
    licence: str
    dims: int
    origin: Vector3 | None
    nodes: tuple[Node, ...]
    measurements: tuple[Measurement, ...]
    truth: dict[int, Truth]
    dropped: tuple[DroppedRows, ...] = ()

    def denied(self) -> tuple[Node, ...]:
        """The nodes to be located."""
        return tuple(node for node in self.nodes if node.role == "denied")


def read_dataset(directory: Path | str) -> Dataset:
    """Read a data set.

    Of the tables only `ranges.csv` has to be there; without `truth.csv` nothing can be scored.

    Raises:
        DataError: a file is missing, its header or most of its rows are wrong, or there are no ranges; the text names the file,
        and line and column where there are any.

    """
    directory = _dataset_directory(Path(directory))
    meta = read_meta(directory / _META)
    nodes = meta.nodes()
    rows = _Rows(nodes)
    tables: dict[str, list[Measurement]] = {}
    dropped: list[DroppedRows] = []
    for name, parse, required, optional in (
        ("positions.csv", rows.position, ("t_s", "id", "e_m", "n_m", "u_m", "sigma_h_m", "sigma_v_m"), (_VELOCITY,)),
        ("altitude.csv", rows.altitude, ("t_s", "id", "u_m", "sigma_v_m"), ()),
        ("attitude.csv", rows.attitude, ("t_s", "id", "roll_rad", "pitch_rad", "yaw_rad", "airspeed_mps"), ()),
        ("odometry.csv", rows.odometry, ("t_s", "id", "forward_mps", "right_mps", "turn_radps", *_ODOMETRY_SIGMAS), ()),
        # Last: lever arms are turned by the attitudes.
        ("ranges.csv", rows.range, ("t_s", "from_id", "to_id", "range_m", "sigma_m"), (_ANTENNAS,)),
    ):
        if (path := directory / name).exists() or name == "ranges.csv":
            tables[name], wrong = read_layout(path, parse, required, *optional, _ARRIVAL)
            dropped.append(wrong)
        if name == "attitude.csv":
            rows.attitudes = Attitudes(tables.get(name, ()))
    if not tables["ranges.csv"]:
        raise DataError(f"{directory / 'ranges.csv'}: no rows")
    in_order = ("positions.csv", "ranges.csv", "altitude.csv", "attitude.csv", "odometry.csv")
    measurements = [m for name in in_order for m in tables.get(name, ())]
    measurements.sort(key=lambda m: (m.arrived_at_s, m.measured_at_s))
    truth: dict[int, Truth] = {}
    if (path := directory / "truth.csv").exists():
        _, wrong = read_layout(path, rows.truth, ("t_s", "id", "e_m", "n_m", "u_m"))
        truth = rows.truths()
        dropped.append(wrong)
        if not any(node.vehicle in truth for node in nodes if node.role == "denied"):
            raise DataError(f"{path}: no row of any denied vehicle")
    lost = tuple(one for one in dropped if one.count)
    return Dataset(meta.name, meta.source, meta.licence, meta.dims, meta.place(), nodes, tuple(measurements), truth, lost)


def _dataset_directory(path: Path) -> Path:
    """Return the directory of the data set that a path names: itself, or that of a file in it."""
    if (path.is_file() and path.suffix == ".csv" and (path.parent / _META).exists()) or (path.name == _META and path.is_file()):
        return path.parent
    if not path.exists():
        raise DataError(f"{path}: no such directory")
    if not path.is_dir():
        wanted = "a data set is a directory with meta.toml and ranges.csv; of a recording (tlog), gcs-coloc report"
        raise DataError(f"{path}: is a file: {wanted} has the scores")
    if not (path / _META).exists():
        inside = ", ".join(sorted(found.parent.name for found in path.glob(f"*/{_META}")))
        remedy = f"it has data sets in it: {inside}; state one of them, or {path}/*" if inside else _LAYOUT_PAGE
        raise DataError(f"{path}: is no data set: it has no {_META}; {remedy}")
    return path


_META = "meta.toml"
_LAYOUT_PAGE = "docs/reference/dataset.md says how one is made"
_ARRIVAL = ("arrival_s",)
_VELOCITY = ("ve_mps", "vn_mps", "vu_mps", "sigma_vel_mps")
_ODOMETRY_SIGMAS = ("sigma_vel_mps", "sigma_turn_radps")
_ANTENNAS = ("antenna_from", "antenna_to")


class _Rows:
    """Turns rows of the tables into measurements. Every method raises DataError where a row is wrong."""

    def __init__(self, nodes: tuple[Node, ...]) -> None:
        self.attitudes = Attitudes(())
        self._nodes = {node.id: node for node in nodes}
        self._anchors = {node.vehicle: node.place_enu_m for node in nodes if node.place_enu_m is not None}
        self._truth: dict[int, list[tuple[float, float, float, float]]] = {}

    def position(self, row: TableRow) -> Measurement:
        node = self._node(row, "id")
        if node.role == "anchor":
            raise row.error("id", "an anchor stands where meta.toml says and reports no positions")
        measured_at_s, arrived_at_s = _times(row)
        moving = row.has("ve_mps")
        return PositionMeasurement(
            vehicle=node.vehicle,
            measured_at_s=measured_at_s,
            arrived_at_s=arrived_at_s,
            position_enu_m=_place(row),
            sigma_h_m=_sigma(row, "sigma_h_m"),
            sigma_v_m=_sigma(row, "sigma_v_m"),
            velocity_enu_mps=(row.number("ve_mps"), row.number("vn_mps"), row.number("vu_mps")) if moving else None,
            sigma_velocity_mps=_sigma(row, "sigma_vel_mps") if moving else None,
        )

    def altitude(self, row: TableRow) -> Measurement:
        measured_at_s, arrived_at_s = _times(row)
        vehicle = self._node(row, "id").vehicle
        return AltitudeMeasurement(vehicle, measured_at_s, arrived_at_s, _metres(row, "u_m"), _sigma(row, "sigma_v_m"))

    def attitude(self, row: TableRow) -> Measurement:
        measured_at_s, arrived_at_s = _times(row)
        return AttitudeMeasurement(
            vehicle=self._node(row, "id").vehicle,
            measured_at_s=measured_at_s,
            arrived_at_s=arrived_at_s,
            roll_rad=row.within("roll_rad", -_HALF_TURN, _HALF_TURN, "radians are wanted"),
            pitch_rad=row.within("pitch_rad", -_HALF_TURN / 2.0, _HALF_TURN / 2.0, "radians are wanted"),
            yaw_rad=row.number("yaw_rad"),
            airspeed_mps=None if row.is_empty("airspeed_mps") else row.not_negative("airspeed_mps"),
        )

    def odometry(self, row: TableRow) -> Measurement:
        node = self._node(row, "id")
        if node.role == "anchor":
            raise row.error("id", "an anchor does not move")
        measured_at_s, arrived_at_s = _times(row)
        return OdometryMeasurement(
            vehicle=node.vehicle,
            measured_at_s=measured_at_s,
            arrived_at_s=arrived_at_s,
            forward_mps=row.number("forward_mps"),
            right_mps=row.number("right_mps"),
            turn_radps=row.within("turn_radps", -_FASTEST_TURN, _FASTEST_TURN, "radians a second are wanted"),
            sigma_velocity_mps=_sigma(row, "sigma_vel_mps"),
            sigma_turn_radps=_sigma(row, "sigma_turn_radps"),
        )

    def range(self, row: TableRow) -> Measurement:
        measured_at_s, arrived_at_s = _times(row)
        ends = a, b = self._node(row, "from_id"), self._node(row, "to_id")
        if a is b:
            raise row.error("to_id", "a node has no range to itself")
        measured_m, sigma_m = row.not_negative("range_m"), _sigma(row, "sigma_m")
        range_m = (measured_m - a.range_bias_m - b.range_bias_m) / (1.0 + a.range_scale + b.range_scale)
        ids = [_antenna(row, column, node) for column, node in zip(_ANTENNAS, ends, strict=True)]
        places = [list(node.antennas).index(i) + 1 if i else 0 for node, i in zip(ends, ids, strict=True)]
        device_id = places[0] + places[1] * (len(a.antennas) + 1)
        m = RangeMeasurement(a.vehicle, b.vehicle, measured_at_s, arrived_at_s, max(range_m, 0.0), sigma_m, device_id)
        if not any(ids):
            return m
        arms = [node.antennas[i] if i else _NO_ARM for node, i in zip(ends, ids, strict=True)]
        return antenna_range(m, arms, self.attitudes, self._anchors)

    def truth(self, row: TableRow) -> None:
        of_node = self._truth.setdefault(self._node(row, "id").vehicle, [])
        t_s, place = _time(row, "t_s"), _place(row)
        if of_node and t_s < of_node[-1][0]:
            raise row.error("t_s", f"time goes back from {of_node[-1][0]:g} s")
        of_node.append((t_s, *place))

    def truths(self) -> dict[int, Truth]:
        found = {vehicle: np.array(rows) for vehicle, rows in self._truth.items() if rows}
        return {vehicle: Truth(rows[:, 0], rows[:, 1:]) for vehicle, rows in found.items()}

    def _node(self, row: TableRow, column: str) -> Node:
        text = row.text(column)
        if text not in self._nodes:
            raise row.error(column, f"{text!r} is not the id of any node in meta.toml")
        return self._nodes[text]


def _antenna(row: TableRow, column: str, node: Node) -> str:
    if row.is_empty(column):
        return ""
    text = row.text(column)
    if text not in node.antennas:
        raise row.error(column, f"{text!r} is not the id of any antenna of {node.id!r} in meta.toml")
    return text


def _times(row: TableRow) -> tuple[float, float]:
    """Return when a row's quantity was measured and when it arrived, s."""
    measured_at_s = _time(row, "t_s")
    if not row.has("arrival_s"):
        return measured_at_s, measured_at_s
    arrived_at_s = _time(row, "arrival_s")
    if arrived_at_s < measured_at_s:
        raise row.error("arrival_s", f"it arrived {measured_at_s - arrived_at_s:g} s before it was measured")
    return measured_at_s, arrived_at_s


def _time(row: TableRow, column: str) -> float:
    return row.within(column, -_FARTHEST_S, _FARTHEST_S, "seconds are wanted")


def _sigma(row: TableRow, column: str) -> float:
    row.positive(column)
    return row.within(column, _LEAST_SIGMA, FARTHEST_M, "one standard deviation is wanted")


def _place(row: TableRow) -> Vector3:
    return _metres(row, "e_m"), _metres(row, "n_m"), _metres(row, "u_m")


def _metres(row: TableRow, column: str) -> float:
    return row.within(column, -FARTHEST_M, FARTHEST_M, "metres are wanted")
