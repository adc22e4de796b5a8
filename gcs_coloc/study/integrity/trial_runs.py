"""Runs of trials: each result is written at once, so that a run that was stopped goes on where it was."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import count
from pathlib import Path

from gcs_coloc.core.errors import DataError, UsageError
from gcs_coloc.estimators.registry import plug_in_digest
from gcs_coloc.runtime.files import make_output_directory, writing
from gcs_coloc.runtime.program import program_digest
from gcs_coloc.runtime.tasks import Workers, iterate_tasks
from gcs_coloc.study.integrity.flight_classes import CLASSES
from gcs_coloc.study.integrity.trial import EventKind, TrialEvent, TrialScore, fly_trial

_FLIGHTS = "flights.jsonl"

Done = Callable[[TrialScore], None]
"""Called with each flight's score, those that were flown before included."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What is flown: the classes, and how many flights.

    Either `seeds` says how many of each class, or `hours` how long under aid in all. Raises UsageError for values that make no
    run. `out`: the directory in which the flights are written and found again.
    """

    out: Path
    classes: tuple[str, ...] = tuple(CLASSES)
    first_seed: int = 1
    seeds: int | None = None
    hours: float | None = None
    workers: Workers = field(default_factory=Workers)
    estimator: str = "fleet"

    def __post_init__(self) -> None:
        unknown = [name for name in self.classes if name not in CLASSES]
        if unknown:
            raise UsageError(f"no class {unknown[0]!r}; there are {', '.join(CLASSES)}")
        if (self.seeds is None) == (self.hours is None):
            raise UsageError("state either --seeds or --hours")
        if (self.seeds is not None and self.seeds < 1) or (self.hours is not None and self.hours <= 0.0):
            raise UsageError("--seeds and --hours have to be above 0")


def flown_with(estimator: str) -> dict[str, str]:
    """Return what flights depend on besides class and seed: the program, and the estimator.

    Raises EstimatorError.
    """
    return {"program": program_digest(), "estimator": estimator, "plug_in": plug_in_digest(estimator)}


def run_trials(options: RunOptions, done: Done) -> list[TrialScore]:
    """Fly the flights that the directory does not hold yet, and return all scores.

    The scores are those of all flights that were wanted, by class and seed.

    Raises:
        DataError: the directory holds flights of another state of the program, or of another estimator or state of it.
        EstimatorError: there is no such estimator.
        UsageError: it cannot be written.
    """
    path = options.out / _FLIGHTS
    header = flown_with(options.estimator)
    known = _read(path, header)
    scores: list[TrialScore] = []

    def collect(score: TrialScore) -> None:
        scores.append(score)
        done(score)

    def flown_s() -> float:
        return sum(score.under_aid_s for score in scores)

    def missing() -> Iterator[tuple[str, int]]:
        """Yield the flights to be flown, all classes of one seed before the next, until there are enough."""
        for seed in count(options.first_seed):
            if options.seeds is not None and seed >= options.first_seed + options.seeds:
                return
            for name in options.classes:
                if options.hours is not None and flown_s() >= options.hours * 3600.0:
                    return
                if (name, seed) in known:
                    collect(known[name, seed])
                else:
                    yield name, seed

    make_output_directory(options.out, "--out")
    with writing(path, ""), path.open("a", encoding="utf-8") as file:
        if file.tell() == 0:
            file.write(json.dumps(header) + "\n")
        for score in iterate_tasks(partial(_fly, estimator=options.estimator), missing(), options.workers):
            file.write(json.dumps(asdict(score)) + "\n")
            file.flush()
            collect(score)
    order = {name: place for place, name in enumerate(CLASSES)}
    return sorted(scores, key=lambda score: (order[score.name], score.seed))


def _fly(task: tuple[str, int], estimator: str) -> TrialScore:
    return fly_trial(*task, estimator=estimator)


def _read(path: Path, header: dict[str, str]) -> dict[tuple[str, int], TrialScore]:
    if not path.exists():
        return {}
    whole, end, cut_off = path.read_text(encoding="utf-8").rpartition("\n")
    if cut_off:  # the program was stopped while it wrote
        os.truncate(path, len((whole + end).encode()))
    try:
        found: Sequence[object] = [json.loads(line) for line in whole.splitlines()]
    except ValueError as error:
        raise DataError(f"{path}: not flights that were written by this command: {error}") from None
    if found and found[0] != header:
        raise DataError(f"{path}: flown by another state of the program or with another estimator; state another --out")
    scores = {}
    for row in found[1:]:
        assert isinstance(row, dict)
        events = [TrialEvent(**event | {"kind": EventKind(event["kind"])}) for event in row["events"]]
        score = TrialScore(**row | {"events": events})
        scores[score.name, score.seed] = score
    return scores
