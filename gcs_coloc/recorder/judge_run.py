"""A run that judges recordings, and the baselines for later comparisons.

Each result is written at once, so that a run that was stopped goes on where it was.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import gcs_coloc
from gcs_coloc.config.settings import Settings
from gcs_coloc.core.errors import DataError
from gcs_coloc.estimators.registry import plug_in_digest
from gcs_coloc.recorder.judged_flight import FoundRecording, JudgedBy, JudgedFlight, judge_flight
from gcs_coloc.runtime.output_files import writing
from gcs_coloc.runtime.program import program_digest
from gcs_coloc.runtime.tasks import Workers, iterate_tasks

_FLIGHTS = "judged.jsonl"

Done = Callable[[int, int], None]
"""Called with how many of how many recordings are judged."""


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
    settings: Settings, recordings: Sequence[FoundRecording], out: Path, workers: Workers, done: Done
) -> list[JudgedFlight]:
    """Judge the recordings without a result in the directory `out`, and return all results.

    A result of another program, of other settings or of a changed file does not count.

    Raises:
        ClusterError, TaskError: the tasks cannot be done.
        EstimatorError: the estimator cannot be loaded.
        UsageError: the directory cannot be written to.
    """
    path, header = out / _FLIGHTS, judged_with(settings)
    known = _read_known(path, header)
    judged = {r.name: known[r.name] for r in recordings if r.name in known and known[r.name].digest == r.digest}
    done(len(judged), len(recordings))
    # The longest first, so that no core waits for one at the end.
    missing = sorted((r for r in recordings if r.name not in judged), key=lambda r: -r.file.stat().st_size)
    with writing(path, ""):
        # What another program judged, or is of a file that has changed, is of no use any more.
        lines = [json.dumps(header), *(json.dumps(asdict(flight)) for flight in judged.values())]
        path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
        with path.open("a", encoding="utf-8") as file:
            for flight in iterate_tasks(partial(judge_flight, JudgedBy.of(settings)), missing, workers):
                file.write(json.dumps(asdict(flight)) + "\n")
                file.flush()
                judged[flight.name] = flight
                done(len(judged), len(recordings))
    return [judged[recording.name] for recording in recordings]


def _read_known(path: Path, header: Mapping[str, str]) -> dict[str, JudgedFlight]:
    """Return what was judged before by the same program; a line that was cut off is left out."""
    if not path.exists():
        return {}
    first, *lines = path.read_text(encoding="utf-8").rpartition("\n")[0].splitlines() or [""]
    try:
        if not first or json.loads(first) != header:
            return {}
        flights = [JudgedFlight(**json.loads(line)) for line in lines]
    except (TypeError, ValueError) as error:
        raise DataError(f"{path}: was not written by this command ({error}); state another --out") from None
    return {flight.name: flight for flight in flights}


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
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return dict(content["judged_with"]), [JudgedFlight(**row) for row in content["recordings"]]
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    except (KeyError, TypeError, ValueError):
        raise DataError(f"{path}: is no baseline; make one with gcs-coloc judge DIR... --write-baseline FILE") from None
