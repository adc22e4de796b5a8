"""`gcs-coloc evaluate`: scores an estimator on data sets."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from gcs_coloc.cli.recordings import EstimatorOption, FleetOption, settings_for, warn_of_findings
from gcs_coloc.cli.task_options import (
    JobsOption,
    ResumeOption,
    SchedulerOption,
    kept_in,
    progress_of,
    result_console,
    workers_for,
)
from gcs_coloc.core.errors import UsageError
from gcs_coloc.core.estimator import GuardedEstimator
from gcs_coloc.core.measurements import Unlocated
from gcs_coloc.estimators.registry import load_estimator, plug_in_digest
from gcs_coloc.evaluation.evaluate import Evaluation
from gcs_coloc.evaluation.evaluate import Progress as EvaluationProgress
from gcs_coloc.evaluation.evaluate import evaluate as run_evaluation
from gcs_coloc.runtime.files import check_drawing, check_output_file, new_table, writing
from gcs_coloc.runtime.tasks import run_tasks

_MOST_REASONS = 3  # chosen: one line of a terminal


@dataclass(frozen=True, slots=True)
class DataSetTask:
    """One data set to be evaluated.

    `digest` is of its files, and of a plug-in estimator, where the result is kept.
    """

    directory: Path
    digest: str = ""


def evaluate(
    directories: Annotated[
        list[Path], typer.Argument(help="Data sets: directories with meta.toml, ranges.csv, ...", metavar="DIR...")
    ],
    estimator: EstimatorOption = None,
    config: Annotated[Path | None, typer.Option(help="A configuration file (TOML) for the estimator and its settings.")] = None,
    fleet: FleetOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the scores as JSON; a list for several data sets.")] = False,
    plot: Annotated[Path | None, typer.Option(help="Draw track, error against 2-sigma, and NIS into this file.")] = None,
    csv: Annotated[Path | None, typer.Option("--csv", help="Write every epoch of all data sets into this file.")] = None,
    jobs: JobsOption = 0,
    scheduler: SchedulerOption = None,
    resume: ResumeOption = None,
) -> None:
    """Run an estimator over data sets, causally, and score it against the truth.

    The scores of several data sets are printed as one table.
    """
    from gcs_coloc.evaluation.output import plot_evaluation, write_epochs

    if plot is not None and len(directories) > 1:
        raise UsageError("--plot draws one data set: state one DIR")
    check_output_file(csv, "--csv")
    check_output_file(plot, "--plot")
    if plot is not None:
        check_drawing()
    settings = settings_for(config, fleet, estimator)
    workers = workers_for(jobs, scheduler)
    run = partial(_evaluate, settings.estimator.name, settings.estimator.settings)
    with progress_of(directories[0].name if len(directories) == 1 else "data sets") as show:
        # One data set in this process shows how far into its measurements it is.
        if len(directories) == 1 and scheduler is None and resume is None:
            evaluated = [run(DataSetTask(directories[0]), show)]
        else:
            plug_in = plug_in_digest(settings.estimator.name) if resume else ""
            tasks = [DataSetTask(path.absolute(), _digest(path) + plug_in if resume else "") for path in directories]
            evaluated = run_tasks(run, tasks, workers, show, kept_in(resume))
    evaluations = [evaluation for evaluation, _ in evaluated]
    for directory, (evaluation, faults) in zip(directories, evaluated, strict=True):
        for text in faults:
            print(text, file=sys.stderr)
        warn_of_findings(directory, evaluation.findings)
    if csv is not None:
        with writing(csv, "--csv"):
            write_epochs(evaluations, csv)
    if plot is not None:
        plot_evaluation(evaluations[0], plot)
    if as_json:
        whole = [evaluation.as_dict() for evaluation in evaluations]
        print(json.dumps(whole if len(whole) > 1 else whole[0], indent=2))
    elif len(evaluations) > 1:
        result_console().print(_table(evaluations))
    else:
        _print(evaluations[0])


def _evaluate(
    name: str, settings: Mapping[str, Any], task: DataSetTask, progress: EvaluationProgress = lambda _done, _total: None
) -> tuple[Evaluation, list[str]]:
    """Evaluate one data set; the texts say where the estimator failed."""
    faults: list[str] = []
    # As in flight: what it fails at is told and scored as no answer.
    guarded = GuardedEstimator(load_estimator(name, settings), faults.append)
    return run_evaluation(task.directory, guarded, progress=progress), faults


def _digest(directory: Path) -> str:
    digest = hashlib.sha256()
    for path in sorted(path for path in directory.iterdir() if path.is_file()) if directory.is_dir() else ():
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def _table(evaluations: Sequence[Evaluation]) -> Table:
    errors = ("RMSE m", "median", "95 %", "most", "3D RMSE", "covered", "> 3 b", "ANEES")
    table = new_table("data set", "node", "answered", "first s", *errors, left=("data set", "node"))
    for evaluation in evaluations:
        for vehicle in evaluation.denied:
            s = vehicle.score
            first = "-" if s.first_known_s is None else f"{s.first_known_s:.1f}"
            cells = ["-"] * 8
            if (e := s.horizontal) is not None and s.spatial is not None:
                honesty = (f"{s.covered_95:.1%}", f"{s.beyond_three_bounds:.1%}", f"{s.anees:.2f} ({s.anees_expected})")
                sizes = (e.rmse_m, e.median_m, e.p95_m, e.max_m, s.spatial.rmse_m)
                cells = [*(f"{size:.2f}" for size in sizes), *honesty]
            table.add_row(evaluation.dataset, vehicle.node.id, f"{s.share_known:.1%}", first, *cells)
    return table


def _print(evaluation: Evaluation) -> None:
    cost = f"{evaluation.cpu_us_per_measurement:.0f} us of CPU per measurement"
    print(f"{evaluation.dataset}: estimator {evaluation.estimator}, {evaluation.measurements} measurements, {cost}")
    for denied_vehicle in evaluation.denied:
        s = denied_vehicle.score
        is_true = not np.isnan(denied_vehicle.series.truth_enu_m).all()
        print(f"{denied_vehicle.node.id}: {s.epochs} {'true positions' if is_true else 'epochs without truth'}, ", end="")
        print(f"{s.share_known:.1%} answered", end="")
        print("" if s.first_known_s is None else f", the first after {s.first_known_s:.1f} s")
        for name, e in (("horizontal", s.horizontal), ("3D", s.spatial)):
            if e is not None:
                most = f"95 % {e.p95_m:.2f} m, most {e.max_m:.2f} m"
                print(f"  {name:<10} RMSE {e.rmse_m:.2f} m, median {e.median_m:.2f} m, {most}")
        _print_unanswered(denied_vehicle.unanswered)
        if s.anees is not None and s.covered_95 is not None:
            print(f"  ANEES {s.anees:.2f} ({s.anees_expected} expected), 95 % bound covers {s.covered_95:.1%}")
    counts = ", ".join(f"{what} {times}" for what, times in sorted(evaluation.counts.items(), key=lambda item: -item[1]))
    if counts:
        print(f"measurements: {counts}")


def _print_unanswered(reasons: Mapping[Unlocated, int]) -> None:
    for reason, times in list(reasons.items())[:_MOST_REASONS]:
        print(f"  not answered {times} times: {reason.text}{' (the first time)' if times > 1 else ''}")
