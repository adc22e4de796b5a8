"""One recording judged: replayed with the present code, and the figures of each vehicle."""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from gcs_coloc.config.settings import Settings
from gcs_coloc.core.alarms.alarms import AlarmList
from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.errors import DataError, UsageError
from gcs_coloc.core.messages.outbound import Notice, Outbound
from gcs_coloc.core.schedule import SAME_S
from gcs_coloc.core.snapshot import VehicleSnapshot
from gcs_coloc.estimators.registry import load_estimator, plug_in_digest
from gcs_coloc.recorder.flight_history import WITHOUT_GPS
from gcs_coloc.recorder.flight_report import FlightReport
from gcs_coloc.recorder.replay import Replay, replay
from gcs_coloc.recorder.side_tables import read_ranges, read_truth
from gcs_coloc.recorder.tlog import TlogReader
from gcs_coloc.runtime.files import reading


@dataclass(frozen=True, slots=True)
class FoundRecording:
    """One recording, with the tables beside it.

    Of one that was searched for, `name` is the name of the directory and the path below it, so that it is the same wherever that
    directory lies, and `file`, `ranges` and `truth` are absolute. `digest` is of the bytes of all three.
    """

    name: str
    file: Path
    ranges: Path | None
    truth: Path | None
    digest: str


def find_recordings(directories: Sequence[Path]) -> list[FoundRecording]:
    """Return every recording (`*.tlog`) below the directories, by name.

    Raises:
        DataError: there is none below one of the directories, or a file cannot be read.
        UsageError: a directory is none, or two recordings would have the same name.
    """
    found: dict[str, FoundRecording] = {}
    for directory in directories:
        if not directory.is_dir():
            raise UsageError(f"{directory}: is no directory; state directories with recordings (*.tlog) below them")
        root = directory.resolve()
        files = sorted(root.rglob("*.tlog"))
        if not files:
            raise DataError(f"{directory}: there is no recording (*.tlog) below it")
        for file in files:
            name = (Path(root.name) / file.relative_to(root)).as_posix()
            if name in found and found[name].file != file:
                raise UsageError(f"{file} and {found[name].file} would both be {name}; judge their directories one by one")
            found[name] = find_recording(file, name)
    return [found[name] for name in sorted(found)]


def find_recording(file: Path, name: str) -> FoundRecording:
    """Return a recording with its tables.

    Those of `NAME.tlog` are `NAME.ranges.csv` and `NAME.truth.csv` beside it, or `ranges.csv` and `truth.csv` where it is the
    only recording of its directory.

    Raises:
        DataError: a file cannot be read.
    """
    is_alone = all(other == file for other in file.parent.glob("*.tlog"))
    ranges, truth = (_table(file, what, is_alone=is_alone) for what in ("ranges", "truth"))
    digest = hashlib.sha256()
    for path in (file, ranges, truth):
        digest.update(_digest(path) if path is not None else b"-")
    return FoundRecording(name, file, ranges, truth, digest.hexdigest()[:16])


def _digest(path: Path) -> bytes:
    with reading(path), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


def _table(file: Path, what: str, *, is_alone: bool) -> Path | None:
    own, common = file.with_suffix(f".{what}.csv"), file.with_name(f"{what}.csv")
    return own if own.exists() else common if is_alone and common.exists() else None


FLEET = "fleet"
"""Stands for a vehicle where an alarm is about the whole fleet."""
_LOOK_EVERY_S = 1.0
"""Levels, states and alarms are looked at so often, as the service looks for alarms."""

Figures = dict[str, float | None]
"""Figures by name (see `comparison.FIGURES`); None where there is nothing to state."""


@dataclass(frozen=True, slots=True)
class JudgedFlight:
    """The figures of one recording, by vehicle.

    `vehicles` is by system id as text, or `FLEET`. `error` says why the recording could not be read; it is empty where it could.
    `duration_s` is from the first frame to the last, `has_truth` whether positions were scored.
    """

    name: str
    digest: str
    duration_s: float = 0.0
    has_truth: bool = False
    vehicles: Mapping[str, Figures] = field(default_factory=dict)
    error: str = ""


@dataclass(frozen=True, slots=True)
class JudgedBy:
    """What replays a recording: the estimator, the engine's settings and our own ids.

    All of it can be sent to another process. `own` is our system and component id, `plug_in` the digest of a plug-in's file.
    """

    estimator: str
    estimator_settings: Mapping[str, Any]
    engine: EngineSettings
    own: tuple[int, int]
    fingerprint: str
    plug_in: str

    @classmethod
    def of(cls, settings: Settings) -> JudgedBy:
        """Take it from the settings of a fleet.

        Raises:
            EstimatorError: there is no such estimator.
        """
        name, own, fingerprint = settings.estimator.name, settings.mavlink.own, settings.fingerprint()
        return cls(name, dict(settings.estimator.settings), settings.engine(), own, fingerprint, plug_in_digest(name))


def judge_flight(by: JudgedBy, recording: FoundRecording) -> JudgedFlight:
    """Replay one recording and return its figures.

    Raises:
        EstimatorError: the estimator cannot be loaded.
    """
    try:
        return _Judgement(by, recording).run()
    except DataError as error:
        return JudgedFlight(recording.name, recording.digest, error=str(error))


class _Judgement:
    def __init__(self, by: JudgedBy, recording: FoundRecording) -> None:
        self._recording = recording
        self._engine = Engine(load_estimator(by.estimator, by.estimator_settings), by.engine)
        self._report = FlightReport(self._engine, read_truth(recording.truth))
        self._alarms = AlarmList()
        self._raised: set[tuple[int, int]] = set()
        self._alarm_counts: dict[str, Counter[str]] = defaultdict(Counter)
        self._looks: dict[int, list[VehicleSnapshot]] = defaultdict(list)
        self._due_s = float("-inf")
        self._through = Replay(
            self._engine, TlogReader(recording.file), read_ranges(recording.ranges), self._on_poll, by.own, by.fingerprint
        )

    def run(self) -> JudgedFlight:
        counts = replay(self._through, self._report.observation_times(), self._report.observe)
        vehicles = {str(sysid): self._figures(sysid) for sysid in sorted(self._engine.sysids())}
        if FLEET in self._alarm_counts:
            vehicles[FLEET] = self._alarm_figures(FLEET)
        recording = self._recording
        has_truth = recording.truth is not None
        return JudgedFlight(recording.name, recording.digest, counts.last_s - counts.first_s, has_truth, vehicles)

    def _on_poll(self, at_s: float, outputs: list[Outbound]) -> None:
        self._report.add_outputs(at_s, outputs)
        changed = [alarm for output in outputs if isinstance(output, Notice) for alarm in self._alarms.add_notice(output)]
        if at_s >= self._due_s:
            self._due_s = at_s + _LOOK_EVERY_S - SAME_S
            fleet = self._engine.snapshot(at_s)
            changed += self._alarms.update(fleet)
            for vehicle in fleet.vehicles:
                if vehicle.gps_state in WITHOUT_GPS:
                    self._looks[vehicle.sysid].append(vehicle)
        for alarm in changed:
            if (alarm.id, alarm.times) not in self._raised:
                self._raised.add((alarm.id, alarm.times))
                self._alarm_counts[str(alarm.sysid) if alarm.sysid is not None else FLEET][alarm.kind.value] += 1

    def _figures(self, sysid: int) -> Figures:
        looks = self._looks[sysid]
        bounds = [v.bound_95_m for v in looks if v.bound_95_m is not None]
        levels = [v.hpl_m for v in looks if v.hpl_m is not None]
        figures: Figures = {
            "without_gps_s": len(looks) * _LOOK_EVERY_S,
            "located": len(bounds) / len(looks) if looks else None,
            "with_fix": sum(v.aiding_has_fix for v in looks) / len(looks) if looks else None,
            "bound_95_m": median(bounds) if bounds else None,
            "hpl_m": median(levels) if levels else None,
        }
        score = self._report.score(sysid)
        if score is not None and (errors := score.horizontal) is not None:
            figures |= {"rmse_m": errors.rmse_m, "p95_m": errors.p95_m, "most_m": errors.max_m}
            figures |= {"covered_95": score.covered_95, "beyond_three_bounds": score.beyond_three_bounds}
            figures["beyond_hpl"] = self._report.beyond_protection_level(sysid)
        return figures | self._alarm_figures(str(sysid))

    def _alarm_figures(self, whose: str) -> Figures:
        return {f"alarm_{kind}": float(times) for kind, times in sorted(self._alarm_counts[whose].items())}
