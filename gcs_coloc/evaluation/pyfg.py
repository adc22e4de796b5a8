"""Import of PyFG files into the data-set layout.

PyFG is the text format of range-aided factor graphs (PyFactorGraph).

Of a graph its vertices are the truth, its landmarks the anchors, its range edges the ranges. Odometry and loop closures are left
out: no estimator here takes them. Source: PyFactorGraph, `py_factor_graph/io/pyfg_text.py`.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from math import sqrt
from pathlib import Path

import numpy as np

from gcs_coloc.core.errors import DataError, UsageError
from gcs_coloc.runtime.files import reading, writing

_POSES = {"VERTEX_SE2": 2, "VERTEX_SE3:QUAT": 3}
_LANDMARKS = {"VERTEX_XY": 2, "VERTEX_XYZ": 3}
_RANGE = "EDGE_RANGE"
_ROBOT = re.compile(r"([A-Za-z]+)[0-9]+$")
_ANCHOR_SIGMA_M = 0.01  # chosen: the format states none; a surveyed anchor
_START_SIGMA_M = 0.5
"""1-sigma of a denied robot's first pose, which it starts from; chosen: a surveyed start."""
_MOST_DROPPED = 0.5


@dataclass(slots=True)
class _Graph:
    """What a PyFG file holds: poses by robot, landmarks, ranges, and the lines that are wrong.

    A pose is time in s and x, y, z in m. A range is time in s, from, to, and range and sigma in m.
    """

    dims: int = 0
    poses: dict[str, list[tuple[float, ...]]] = field(default_factory=dict)
    landmarks: dict[str, tuple[float, ...]] = field(default_factory=dict)
    ranges: list[tuple[float, str, str, float, float]] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Imported:
    """What was written: numbers of rows, the denied robots, and the lines that were left out."""

    denied: tuple[str, ...]
    peers: tuple[str, ...]
    anchors: int
    ranges: int
    dropped: tuple[str, ...]


def import_pyfg(file: Path, directory: Path, denied: Collection[str], peer_sigma_m: float, seed: int) -> Imported:
    """Write a data set of a PyFG file.

    Args:
        file: the graph.
        directory: of the data set; it is made.
        denied: robots that are to be located; the first one where it is empty.
        peer_sigma_m: noise that is added to the true positions which the other robots report, per axis.
        seed: of that noise.

    Raises:
        DataError: the file cannot be read, is mostly wrong or has no ranges.
        UsageError: a denied robot is not in it, or the directory cannot be written.
    """
    graph = _read(file)
    located = tuple(denied) or tuple(sorted(graph.poses)[:1])
    for robot in located:
        if robot not in graph.poses:
            raise UsageError(f"{file}: no robot {robot!r}; there are {', '.join(sorted(graph.poses))}")
    peers = tuple(robot for robot in sorted(graph.poses) if robot not in located)
    start_s = min(*(row[0] for rows in graph.poses.values() for row in rows), graph.ranges[0][0])
    rng = np.random.default_rng(seed)
    positions: list[tuple[object, ...]] = []
    for robot in located:
        t, *place = min(graph.poses[robot])
        positions.append((_s(t - start_s), robot, *map(_m, place), _START_SIGMA_M, _START_SIGMA_M))
    for robot in peers:
        for t, *place in graph.poses[robot]:
            noisy = np.array(place) + peer_sigma_m * rng.standard_normal(3) * ((1.0, 1.0, 0.0) if graph.dims == 2 else 1.0)
            positions.append((_s(t - start_s), robot, *map(_m, noisy), peer_sigma_m, peer_sigma_m))
    truth = [(_s(t - start_s), robot, *map(_m, place)) for robot in located for t, *place in sorted(graph.poses[robot])]
    ranges = [(_s(t - start_s), a, b, _m(range_m), _m(sigma_m)) for t, a, b, range_m, sigma_m in sorted(graph.ranges)]
    with writing(directory, ""):
        directory.mkdir(parents=True, exist_ok=True)
        (directory / "meta.toml").write_text(_meta(file, graph, located, peers), encoding="utf-8")
        _write(directory / "positions.csv", "t_s,id,e_m,n_m,u_m,sigma_h_m,sigma_v_m", positions)
        _write(directory / "ranges.csv", "t_s,from_id,to_id,range_m,sigma_m", ranges)
        _write(directory / "truth.csv", "t_s,id,e_m,n_m,u_m", truth)
    return Imported(located, peers, len(graph.landmarks), len(ranges), tuple(graph.wrong))


def _read(file: Path) -> _Graph:
    with reading(file):
        lines = file.read_text(encoding="utf-8").splitlines()
    graph, count = _Graph(), 0
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if words:
            count += 1
            try:
                _add(graph, words)
            except IndexError:
                graph.wrong.append(f"{file}, line {number}: {len(words)} words are too few for {words[0]}")
            except ValueError as error:
                graph.wrong.append(f"{file}, line {number}: {error}")
    if len(graph.wrong) > _MOST_DROPPED * count:
        raise DataError(f"{graph.wrong[0]} ({len(graph.wrong)} of {count} lines are wrong: is it a PyFG file?)")
    if not graph.ranges or not graph.poses:
        first = f"; {graph.wrong[0]}" if graph.wrong else ""
        raise DataError(f"{file}: no {_RANGE} or no vertex of a robot in it{first}")
    return graph


def _add(graph: _Graph, words: list[str]) -> None:
    kind = words[0]
    if kind in _POSES:
        if graph.poses and graph.dims != _POSES[kind]:
            raise ValueError(f"a {kind} among vertices of {graph.dims} dimensions")
        graph.dims = _POSES[kind]
        graph.poses.setdefault(_robot(words[2]), []).append((_number(words[1]), *_place(words[3:], graph.dims)))
    elif kind in _LANDMARKS:
        graph.landmarks[words[1]] = _place(words[2:], _LANDMARKS[kind])
    elif kind == _RANGE:
        range_m, variance = _number(words[4]), _number(words[5])
        if range_m < 0.0 or variance <= 0.0:
            raise ValueError(f"a range of {range_m:g} m with a variance of {variance:g} m^2")
        ends = [word if word in graph.landmarks else _robot(word) for word in words[2:4]]
        if unknown := next((end for end in ends if end not in graph.landmarks and end not in graph.poses), None):
            raise ValueError(f"{unknown!r} has no vertex before its ranges")
        graph.ranges.append((_number(words[1]), ends[0], ends[1], range_m, sqrt(variance)))
    elif not kind.startswith(("VERTEX_", "EDGE_")):
        raise ValueError(f"{kind!r} is no kind of line of a PyFG file")


def _place(words: list[str], dims: int) -> tuple[float, ...]:
    x, y = _number(words[0]), _number(words[1])
    return (x, y, _number(words[2]) if dims == 3 else 0.0)


def _number(word: str) -> float:
    value = float(word)
    if not np.isfinite(value):
        raise ValueError(f"{word!r} is not a finite number")
    return value


def _robot(name: str) -> str:
    match = _ROBOT.match(name)
    if match is None:
        raise ValueError(f"{name!r} is not the name of a pose: letters and a number")
    return match.group(1)


def _s(seconds: float) -> str:
    return f"{seconds:.6f}"


def _m(metres: float) -> str:
    return f"{metres:.6f}"


def _meta(file: Path, graph: _Graph, denied: Iterable[str], peers: Iterable[str]) -> str:
    name, source = _toml(file.stem), _toml(f"PyFG file {file.name}")
    text = f'name = {name}\nsource = {source}\nlicence = "not stated"\ndims = {graph.dims}\n'
    for role, robots in (("denied", denied), ("peer", peers)):
        for robot in robots:
            text += f'\n[[node]]\nid = "{robot}"\nrole = "{role}"\n'
    for name, (e, n, u) in sorted(graph.landmarks.items()):
        text += f'\n[[node]]\nid = {_toml(name)}\nrole = "anchor"\ne_m = {e}\nn_m = {n}\nu_m = {u}\nsigma_m = {_ANCHOR_SIGMA_M}\n'
    return text


def _toml(text: str) -> str:
    """Return a text as TOML writes it, which is as JSON does."""
    return json.dumps(text)


def _write(path: Path, header: str, rows: Iterable[tuple[object, ...]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        file.write(header + "\n")
        csv.writer(file, lineterminator="\n").writerows(rows)
