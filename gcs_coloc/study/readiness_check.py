"""The check of readiness: what was told before GPS failed, against what came about 30 s later.

What came is what the filter stated, in the median of ten seconds, and the error that it reached. In random flights of the
integrity trials' classes GPS fails at a random time. In recordings the operator's override takes it at random times.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import hypot, nan
from pathlib import Path

import numpy as np
from rich.table import Table

from gcs_coloc.core.deadlines import advance
from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.errors import UsageError
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Estimate, FloatArray
from gcs_coloc.core.messages.control import GpsOverride, OperatorCommand
from gcs_coloc.core.readiness.vehicle_readiness import HORIZON_S, ReadinessState, VehicleReadiness
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder.judged_flight import find_recording
from gcs_coloc.recorder.replay import Replay
from gcs_coloc.recorder.side_tables import read_ranges, read_truth
from gcs_coloc.recorder.tlog import TlogReader
from gcs_coloc.runtime.files import new_table
from gcs_coloc.runtime.tasks import KeptResults, Progress, Workers, run_tasks
from gcs_coloc.study.integrity.flight_classes import CLASSES
from gcs_coloc.study.integrity.simulated_fleet import SimulatedFleet

CHECKED = (
    "planes",
    "steep-turns",
    "copters",
    "mixed",
    "agile-copters",
    "three-peers",
    "two-peers",
    "one-peer",
    "no-air-data",
    "peers-aside",
    "convoy",
    "slow-ranges",
    "coarse-ranges",
    "range-bias",
    "gusts",
)
"""The classes of flights that are flown: all kinds of geometry, motion and noise, without faults."""
_CLOSE = 0.2
_ABOUT_S = 5.0
"""What is stated counts from so long before the horizon to so long after it. Chosen: longer than the bound grows between two
ranges, and than it is inflated for a contradiction."""
_SAMPLE_S = 0.5
_LOST_AT_S = (70.0, 100.0)
"""In a random flight GPS fails at some time between these. Chosen: after a minute of predictions."""
TAKEN_FROM_S = 70.0
"""In a recording GPS is taken from here on. Chosen: the same."""
_TAKEN_WITHIN_S = 10.0
"""And within so long. Chosen: the time between two predictions."""
_TRUTH_WITHIN_S = 0.06
"""Chosen: half a period of 10 Hz; at 20 m/s an error of a metre at most."""


@dataclass(frozen=True, slots=True)
class Loss:
    """One loss of GPS: what was told of it before, and what came about 30 s after; m, NaN for none.

    `is_told`: the size of the bound was told. `bound_m`, `hpl_m` and `hdop` are medians of ten seconds, `moment_bound_m` is the
    bound after exactly 30 s. `error_m` is the horizontal error reached then; `has_fix` whether a position was stated then.
    """

    kind: str
    state: str
    told_bound_m: float
    told_hpl_m: float
    told_hdop: float
    is_told: bool
    bound_m: float
    moment_bound_m: float
    hpl_m: float
    hdop: float
    error_m: float
    has_fix: bool

    @property
    def bound_ratio(self) -> float:
        """Stated over told 95 % bound."""
        return self.bound_m / self.told_bound_m

    @property
    def moment_bound_ratio(self) -> float:
        """Stated, at one moment, over told 95 % bound."""
        return self.moment_bound_m / self.told_bound_m

    @property
    def hpl_ratio(self) -> float:
        """Stated over told protection level."""
        return self.hpl_m / self.told_hpl_m

    @property
    def came_as_told(self) -> bool:
        """Whether the geometry came as it was told: the HDOP is within 20 %."""
        return abs(self.hdop / self.told_hdop - 1.0) <= _CLOSE


Task = tuple[str, int, float, str]
"""A class and its seed, or a recording's path and the draw of when GPS is taken; from how many seconds after its beginning on;
a digest of the recording and its tables, where the result is kept."""


def run_checks(
    classes: Sequence[str],
    recordings: Sequence[str],
    seeds: int,
    workers: Workers,
    progress: Progress,
    from_s: float = TAKEN_FROM_S,
    first_seed: int = 1,
    kept: KeptResults | None = None,
) -> list[Loss]:
    """Let GPS fail in flights of each class and in each recording, and return each loss.

    `seeds` flights of each class are flown, from `first_seed` on. GPS is taken as often in each recording. What is kept is not
    computed again.

    Raises:
        UsageError: no such class or recording.
    """
    for name in classes:
        if name not in CLASSES:
            raise UsageError(f"no class {name!r}; there are {', '.join(CLASSES)}")
    for path in recordings:
        if not Path(path).is_file():
            raise UsageError(f"{path}: there is no such recording")
    digests = {path: find_recording(Path(path), path).digest for path in recordings} if kept is not None else {}
    tasks = [
        (name, seed, from_s, digests.get(name, ""))
        for seed in range(first_seed, first_seed + seeds)
        for name in (*classes, *recordings)
    ]
    return [loss for found in run_tasks(_check, tasks, workers, progress, kept) for loss in found]


def _check(task: Task) -> list[Loss]:
    name, seed, from_s, _ = task
    loss = _fly(name, seed) if name in CLASSES else _replay(Path(name), seed, from_s)
    return [loss] if loss is not None else []


def _fly(name: str, seed: int) -> Loss | None:
    drawn = replace(CLASSES[name], lost_at_s=_LOST_AT_S)
    fleet = SimulatedFleet(drawn, seed, _LOST_AT_S[1] + HORIZON_S + _ABOUT_S + 5.0)
    engine = Engine(load_estimator("fleet", {}), EngineSettings(request_streams=False))
    vehicle, told = fleet.denied[0], None

    def error_m(where: Estimate, frame: LocalFrame) -> float:
        return fleet.error_m(vehicle, where.at_s, *frame.geodetic_from_enu(*where.position_enu_m.tolist()))

    after = _AfterLoss(engine, vehicle, fleet.lost_at_s, error_m)
    at_s = 0.0
    while after.due_s is not None:
        at_s, message = fleet.pop()
        for due_s, outputs in advance(engine, at_s, held_up_until_s=0.0):
            for output in outputs:
                fleet.deliver(output, due_s)
        if at_s < fleet.lost_at_s:
            told = engine.readiness(vehicle)
        if message is not None:
            engine.receive(message)
        if at_s >= after.due_s:
            after.sample(at_s)
    return after.loss(name, told)


def _replay(path: Path, draw: int, from_s: float) -> Loss | None:
    """Take one vehicle's GPS at a random time of a recording, and return the loss.

    The vehicle is the one with the most peers to range. None where no vehicle's GPS was healthy then.
    """
    engine = Engine(load_estimator("fleet", {}), EngineSettings(request_streams=False))
    found = find_recording(path, path.name)
    truth = read_truth(found.truth)
    through = Replay(engine, TlogReader(path), read_ranges(found.ranges), lambda *_: None)
    begin_s = through.next_s
    if begin_s is None:
        return None
    taken_at_s = begin_s + from_s + float(np.random.default_rng(draw).uniform(0.0, _TAKEN_WITHIN_S))
    _step_to(through, taken_at_s)
    known = {sysid: readiness for sysid in engine.sysids() if (readiness := engine.readiness(sysid)) is not None}
    if not known:
        return None
    vehicle = max(known, key=lambda sysid: (known[sysid].peers, sysid))
    engine.receive(OperatorCommand(vehicle, taken_at_s, GpsOverride.FAILED))

    def error_m(where: Estimate, frame: LocalFrame) -> float:
        near = [point for point in truth if point.sysid == vehicle and abs(point.unix_s - where.at_s) <= _TRUTH_WITHIN_S]
        if not near:
            return nan
        true = min(near, key=lambda point: abs(point.unix_s - where.at_s))
        east_m, north_m, _ = frame.enu_from_geodetic(true.lat_deg, true.lon_deg, true.alt_msl_m)
        return hypot(*(where.position_enu_m[:2] - (east_m, north_m)).tolist())

    after = _AfterLoss(engine, vehicle, taken_at_s, error_m)
    while (due_s := after.due_s) is not None:
        _step_to(through, due_s)
        after.sample(due_s)
    return after.loss(path.parent.name, known[vehicle])


def _step_to(through: Replay, to_s: float) -> None:
    while (at_s := through.next_s) is not None and at_s <= to_s:
        through.step()
    if through.next_s is not None:
        through.advance(to_s)


class _AfterLoss:
    """What is stated about the horizon after a loss of GPS, sampled at the times that are due."""

    def __init__(self, engine: Engine, vehicle: int, lost_at_s: float, error_m: Callable[[Estimate, LocalFrame], float]) -> None:
        self._engine, self._vehicle, self._error_m = engine, vehicle, error_m
        count = round(2.0 * _ABOUT_S / _SAMPLE_S)
        self._due_s = [lost_at_s + HORIZON_S - _ABOUT_S + k * _SAMPLE_S for k in range(count + 1)]
        self._moment = count // 2
        self._bounds_m: list[float] = []
        self._hpls_m: list[float] = []
        self._hdops: list[float] = []
        self._reached_m = nan

    @property
    def due_s(self) -> float | None:
        """When the next sample is due, service time in s; None after the last."""
        return self._due_s[len(self._bounds_m)] if len(self._bounds_m) < len(self._due_s) else None

    def sample(self, at_s: float) -> None:
        """Keep what is stated now; at the horizon the error as well."""
        where, frame = self._engine.estimate(self._vehicle, at_s), self._engine.frame
        bound_m = hpl_m = hdop = nan
        if isinstance(where, Estimate) and frame is not None:
            bound_m, hdop = horizontal_bound_95_m(where.covariance), _number(where.hdop)
            hpl_m = where.protection.horizontal_m if where.protection is not None else nan
            if len(self._bounds_m) == self._moment:
                self._reached_m = self._error_m(where, frame)
        self._bounds_m.append(bound_m)
        self._hpls_m.append(hpl_m)
        self._hdops.append(hdop)

    def loss(self, kind: str, told: VehicleReadiness | None) -> Loss | None:
        """Return the loss; None where nothing was told of it before."""
        if told is None:
            return None
        told_m = _number(told.bound_95_m), _number(told.hpl_m), _number(told.hdop)
        moment_m, hpl_m = self._bounds_m[self._moment], self._hpls_m[self._moment]
        came_m = float(np.median(self._bounds_m)), moment_m, float(np.median(self._hpls_m)), float(np.median(self._hdops))
        has_fix = hpl_m <= self._engine.settings.aiding.alert_limit_m
        return Loss(kind, told.state, *told_m, told.is_told, *came_m, self._reached_m, has_fix)


def _number(value: float | None) -> float:
    return nan if value is None else value


def check_table(losses: Sequence[Loss]) -> Table:
    """Return a row for each kind of flight, and one of all."""
    bounds = "flights", "losses", "stated / told 95 %", "within 20 %", "of those told", "at one moment"
    levels = (
        "of those with HDOP as told",
        "stated / told HPL",
        "within 20 %",
        "errors within",
        "told a fix: had one",
        "told none: had none",
    )
    table = new_table(*bounds, *levels, left=("flights",))
    kinds = list(dict.fromkeys(loss.kind for loss in losses))
    for kind in kinds:
        table.add_row(kind, *_cells([loss for loss in losses if loss.kind == kind]))
    table.add_row("all", *_cells(losses))
    return table


def _cells(losses: Sequence[Loss]) -> list[str]:
    bounds, told, moments, as_told, levels = (
        np.array(ratios)
        for ratios in (
            [loss.bound_ratio for loss in losses],
            [loss.bound_ratio for loss in losses if loss.is_told],
            [loss.moment_bound_ratio for loss in losses if loss.is_told],
            [loss.bound_ratio for loss in losses if loss.came_as_told],
            [loss.hpl_ratio for loss in losses],
        )
    )
    errors = np.array([loss.error_m <= loss.told_bound_m for loss in losses if np.isfinite(loss.error_m + loss.told_bound_m)])
    fixes = [loss.has_fix for loss in losses if loss.state in (ReadinessState.READY, ReadinessState.DEGRADED)]
    none = [not loss.has_fix for loss in losses if loss.state == ReadinessState.NOT_READY]
    return [
        str(len(losses)),
        _median(bounds),
        _close(bounds),
        _close(told),
        _close(moments),
        _close(as_told),
        _median(levels),
        _close(levels),
        _counted(errors.tolist()),
        _counted(fixes),
        _counted(none),
    ]


def _median(ratios: FloatArray) -> str:
    known = ratios[np.isfinite(ratios)]
    return f"{np.median(known):.2f}" if len(known) else "-"


def _close(ratios: FloatArray) -> str:
    known = ratios[np.isfinite(ratios)]
    return _counted((np.abs(known - 1.0) <= _CLOSE).tolist())


def _counted(found: Sequence[bool]) -> str:
    return f"{sum(found)} of {len(found)}" if found else "-"
