"""A run that judges recordings, baselines, and the comparison of results with one."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any

import gcs_coloc
from gcs_coloc.config.settings import Settings
from gcs_coloc.core.alarms.alarms import AlarmKind
from gcs_coloc.core.errors import DataError
from gcs_coloc.estimators.registry import plug_in_digest
from gcs_coloc.recorder.judged_flight import Figures, FoundRecording, JudgedBy, JudgedFlight, judge_flight
from gcs_coloc.runtime.files import reading, writing
from gcs_coloc.runtime.program import program_digest
from gcs_coloc.runtime.tasks import KeptResults, Progress, Workers, run_tasks


def judged_with(settings: Settings) -> dict[str, str]:
    """Return what figures depend on besides the recordings: estimator, settings and program.

    Raises EstimatorError.
    """
    return {
        "version": gcs_coloc.__version__,
        "program": program_digest(),
        "estimator": settings.estimator.name,
        "plug_in": plug_in_digest(settings.estimator.name),
        "settings": settings.fingerprint(),
    }


def judge(
    settings: Settings, recordings: Sequence[FoundRecording], out: Path, workers: Workers, done: Progress
) -> list[JudgedFlight]:
    """Judge the recordings without a result in the directory `out`, and return all results by name.

    A result of another program, of other settings or of a changed file does not count.

    Raises:
        ClusterError, TaskError: the tasks cannot be done.
        EstimatorError: the estimator cannot be loaded.
        UsageError: results cannot be read or written.
    """
    # The longest first, so that no core waits for one at the end.
    longest_first = sorted(recordings, key=lambda recording: -recording.file.stat().st_size)
    judged = run_tasks(partial(judge_flight, JudgedBy.of(settings)), longest_first, workers, done, KeptResults(out, "--out"))
    return sorted(judged, key=lambda flight: flight.name)


def write_baseline(path: Path, settings: Settings, flights: Sequence[JudgedFlight]) -> None:
    """Write judged flights for later comparisons.

    Raises:
        UsageError: it cannot be written.
    """
    content = {"judged_with": judged_with(settings), "recordings": [asdict(flight) for flight in flights]}
    with writing(path, ""):
        path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_baseline(path: Path) -> tuple[dict[str, str], list[JudgedFlight]]:
    """Return what a baseline was judged with, and its flights.

    Raises:
        DataError: it cannot be read, or is none.
    """
    with reading(path):
        text = path.read_text(encoding="utf-8")
    try:
        content: dict[str, Any] = json.loads(text)
        return dict(content["judged_with"]), [JudgedFlight(**row) for row in content["recordings"]]
    except (KeyError, TypeError, ValueError):
        raise DataError(f"{path}: is no baseline; make one with gcs-coloc judge DIR... --write-baseline FILE") from None


class Aspect(StrEnum):
    """What a figure is about."""

    ACCURACY = "accuracy"
    COVERAGE = "coverage"
    LEVELS = "levels"
    HEALTH = "health"
    ALARMS = "alarms"
    RECORDING = "recording"


class ChangeOutcome(StrEnum):
    """What a change is."""

    WORSE = "worse"
    BETTER = "better"
    CHANGED = "changed"
    """Neither: a person has to look."""


class Good(StrEnum):
    """In which direction a figure is better."""

    LESS = "less"
    MORE = "more"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class FigureKind:
    """One figure that is compared: its aspect, its name in words, and which direction is good.

    `is_share`: it is a share of one. Otherwise it is in metres or seconds, or it counts.
    """

    aspect: Aspect
    text: str
    good: Good
    is_share: bool = False


FIGURES: Mapping[str, FigureKind] = {
    "rmse_m": FigureKind(Aspect.ACCURACY, "horizontal RMSE, m", Good.LESS),
    "p95_m": FigureKind(Aspect.ACCURACY, "95 % of errors, m", Good.LESS),
    "most_m": FigureKind(Aspect.ACCURACY, "largest error, m", Good.LESS),
    "covered_95": FigureKind(Aspect.COVERAGE, "within the 95 % bound", Good.MORE, is_share=True),
    "beyond_three_bounds": FigureKind(Aspect.COVERAGE, "beyond three 95 % bounds", Good.LESS, is_share=True),
    "beyond_hpl": FigureKind(Aspect.COVERAGE, "beyond the protection level", Good.LESS, is_share=True),
    "located": FigureKind(Aspect.LEVELS, "located", Good.MORE, is_share=True),
    "with_fix": FigureKind(Aspect.LEVELS, "sent a fix", Good.MORE, is_share=True),
    "bound_95_m": FigureKind(Aspect.LEVELS, "median 95 % bound, m", Good.LESS),
    "hpl_m": FigureKind(Aspect.LEVELS, "median protection level, m", Good.LESS),
    # Sooner found or falsely found: only a person, or the truth, can tell.
    "without_gps_s": FigureKind(Aspect.HEALTH, "GPS not trusted, s", Good.UNKNOWN),
} | {f"alarm_{kind.value}": FigureKind(Aspect.ALARMS, f"alarms: {kind.value.replace('_', ' ')}", Good.LESS) for kind in AlarmKind}
"""All figures by name, in the order in which they are shown. Those of alarms count how often they were raised."""


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far a figure may move before it counts as changed.

    `relative` of metres, seconds and times, but at least `least` of the unit; `share` of shares. Chosen: what a change of
    rounding in a filter moves is far less, what a person would notice in a flight is more.
    """

    relative: float = 0.05
    share: float = 0.005
    least: float = 0.05


@dataclass(frozen=True, slots=True)
class FigureChange:
    """One figure of one vehicle of one recording, before and now; None: there was or is none.

    `vehicle` is empty where the recording as a whole changed; `text` says what changed.
    """

    recording: str
    vehicle: str
    aspect: Aspect
    text: str
    before: float | None
    now: float | None
    outcome: ChangeOutcome
    is_share: bool = False


def compare(
    before: Sequence[JudgedFlight], now: Sequence[JudgedFlight], tolerance: Tolerance, directories: Sequence[str]
) -> list[FigureChange]:
    """Return what changed, recording by recording.

    `directories` are the names of those that were judged: a recording of the baseline that is missing below one of them is worse.
    """
    known = {flight.name: flight for flight in before}
    changes: list[FigureChange] = []
    for flight in now:
        old = known.pop(flight.name, None)
        changes += _of_flight(old, flight, tolerance)
    for name in sorted(known):
        if name.partition("/")[0] in directories:
            changes.append(_whole(name, "is missing", ChangeOutcome.WORSE))
    return changes


def _of_flight(old: JudgedFlight | None, new: JudgedFlight, tolerance: Tolerance) -> Iterator[FigureChange]:
    if old is None:
        yield _whole(new.name, "is not in the baseline", ChangeOutcome.CHANGED)
    elif new.digest != old.digest:
        yield _whole(new.name, "is another file, or has other tables, than in the baseline: not compared", ChangeOutcome.CHANGED)
    elif new.error or old.error:
        if new.error and not old.error:
            yield _whole(new.name, f"can no longer be read: {new.error}", ChangeOutcome.WORSE)
        elif not new.error:
            yield _whole(new.name, "could not be read", ChangeOutcome.BETTER)
    else:
        for vehicle in sorted({*old.vehicles, *new.vehicles}, key=lambda text: (len(text), text)):
            yield from _of_vehicle(new.name, vehicle, old.vehicles.get(vehicle, {}), new.vehicles.get(vehicle, {}), tolerance)


def _of_vehicle(name: str, vehicle: str, old: Figures, new: Figures, tolerance: Tolerance) -> Iterator[FigureChange]:
    for key, kind in FIGURES.items():
        before, now = old.get(key), new.get(key)
        if kind.aspect is Aspect.ALARMS:
            before, now = before or 0.0, now or 0.0
        outcome = _outcome(kind, before, now, tolerance)
        if outcome is not None:
            yield FigureChange(name, vehicle, kind.aspect, kind.text, before, now, outcome, kind.is_share)


def _outcome(kind: FigureKind, before: float | None, now: float | None, tolerance: Tolerance) -> ChangeOutcome | None:
    """Return what a change is; None where there is none beyond the tolerance."""
    if before is None or now is None:
        if before is now:
            return None
        return ChangeOutcome.WORSE if now is None and kind.good is not Good.UNKNOWN else ChangeOutcome.CHANGED
    allowed = tolerance.share if kind.is_share else max(tolerance.relative * abs(before), tolerance.least)
    if abs(now - before) <= allowed:
        return None
    if kind.good is Good.UNKNOWN:
        return ChangeOutcome.CHANGED
    if kind.aspect is Aspect.ALARMS and now == 0.0:
        return ChangeOutcome.WORSE  # what somebody was warned of is passed over now
    return ChangeOutcome.BETTER if (now < before) == (kind.good is Good.LESS) else ChangeOutcome.WORSE


def _whole(name: str, text: str, outcome: ChangeOutcome) -> FigureChange:
    return FigureChange(name, "", Aspect.RECORDING, text, None, None, outcome)
