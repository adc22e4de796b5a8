"""`gcs-coloc judge`: replay recordings and compare the results with a stored baseline."""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from gcs_coloc.cli.recordings import EstimatorOption, FleetOption, settings_for
from gcs_coloc.cli.task_options import JobsOption, SchedulerOption, progress_of, result_console, workers_for
from gcs_coloc.core.reasons import counted
from gcs_coloc.recorder.judged_flight import JudgedFlight, find_recordings
from gcs_coloc.recorder.judging import (
    FIGURES,
    Aspect,
    ChangeOutcome,
    FigureChange,
    Tolerance,
    compare,
    judged_with,
    read_baseline,
    write_baseline,
)
from gcs_coloc.recorder.judging import judge as judge_all
from gcs_coloc.runtime.files import check_output_file, make_output_directory, new_table

_WORSE = 3
_TOLERANCE = Tolerance()
_FILE_WIDTH = 160  # of a table that goes to a file or pipe
_SHOWN = ("without_gps_s", "located", "with_fix", "rmse_m", "p95_m", "most_m", "covered_95", "beyond_hpl", "bound_95_m", "hpl_m")
_HEADINGS = ("no GPS s", "located", "fix", "RMSE m", "95 %", "most", "covered", "> HPL", "bound m", "HPL m")


def judge(
    directories: Annotated[
        list[Path], typer.Argument(help="Directories; every recording (*.tlog) below them is judged.", metavar="DIR...")
    ],
    baseline: Annotated[
        Path | None, typer.Option(help="Compare with this baseline: exit code 3 where something is worse.", metavar="FILE")
    ] = None,
    write: Annotated[
        Path | None, typer.Option("--write-baseline", help="Write the figures for later comparisons.", metavar="FILE")
    ] = None,
    tolerance: Annotated[
        float, typer.Option(help="Of metres, seconds and counts: how far, as a share, they may move.", min=0.0)
    ] = _TOLERANCE.relative,
    share_tolerance: Annotated[
        float, typer.Option(help="Of shares such as coverage: how far they may move; 0.005 is half a percentage point.", min=0.0)
    ] = _TOLERANCE.share,
    config: Annotated[Path | None, typer.Option(help="The configuration file (TOML) of the flights.")] = None,
    fleet: FleetOption = None,
    estimator: EstimatorOption = None,
    out: Annotated[
        Path, typer.Option(help="Directory of the results; a run that was stopped goes on there.", metavar="DIR")
    ] = Path("out/judge"),
    jobs: JobsOption = 0,
    scheduler: SchedulerOption = None,
) -> None:
    """Replay recordings with the present code and compare the results with a stored baseline.

    Every recording below the directories is replayed. What changed is printed, and whether it is worse.
    """
    workers = workers_for(jobs, scheduler)
    settings = settings_for(config, fleet, estimator)
    check_output_file(write, "--write-baseline")
    make_output_directory(out, "--out")
    before = read_baseline(baseline) if baseline is not None else None
    recordings = find_recordings(directories)
    with progress_of("judging") as show:
        flights = judge_all(settings, recordings, out, workers, show)
    for flight in flights:
        if flight.error:
            print(f"gcs-coloc: warning: {flight.name}: {flight.error}", file=sys.stderr)
    if write is not None:
        write_baseline(write, settings, flights)
    console = result_console(_FILE_WIDTH)
    console.print(_figures_table(flights))
    print(_summary(flights))
    changes: list[FigureChange] = []
    if before is not None:
        its, old = before
        allowed = Tolerance(tolerance, share_tolerance)
        changes = compare(old, flights, allowed, [directory.resolve().name for directory in directories])
        if changes:
            console.print(_changes_table(changes))
        print(_comparison(its, judged_with(settings), changes, allowed))
    result = {
        "judged_with": judged_with(settings),
        "recordings": [asdict(flight) for flight in flights],
        "changes": [asdict(change) for change in changes] if before is not None else None,
    }
    path = out / "judge.json"
    path.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    for file in filter(None, (path, write)):
        print(f"written: {file}")
    if any(change.outcome is ChangeOutcome.WORSE for change in changes):
        raise typer.Exit(_WORSE)


def _figures_table(flights: Sequence[JudgedFlight]) -> Table:
    """Return a table with a row for each vehicle that was without GPS or has alarms.

    A recording without such a vehicle has one row.
    """
    table = new_table("recording", "vehicle", *_HEADINGS, "alarms", left=("recording", "alarms"))
    for flight in flights:
        rows = [(vehicle, its) for vehicle, its in flight.vehicles.items() if its.get("without_gps_s") or _alarms(its)]
        for vehicle, its in rows or [("-", {})]:
            shown = (_shown(its.get(name), is_share=FIGURES[name].is_share) for name in _SHOWN)
            table.add_row(flight.name, vehicle, *shown, _alarms(its) or ("cannot be read" if flight.error else ""))
    return table


def _alarms(figures: dict[str, float | None]) -> str:
    counts = (
        f"{name.removeprefix('alarm_')} {value:.0f}" for name, value in figures.items() if name.startswith("alarm_") and value
    )
    return ", ".join(counts)


def _changes_table(changes: Sequence[FigureChange]) -> Table:
    table = Table("recording", "vehicle", "about", "what", "before", "now", "")
    for change in changes:
        values = (_shown(value, is_share=change.is_share) for value in (change.before, change.now))
        table.add_row(change.recording, change.vehicle, change.aspect.value, change.text, *values, change.outcome.value)
    return table


def _summary(flights: Sequence[JudgedFlight]) -> str:
    read = [flight for flight in flights if not flight.error]
    hours = sum(flight.duration_s for flight in read) / 3600.0
    vehicle_hours = sum(its.get("without_gps_s") or 0.0 for flight in read for its in flight.vehicles.values()) / 3600.0
    text = f"{counted(len(flights), 'recording')}, {hours:.2f} h, {vehicle_hours:.2f} vehicle-hours without GPS"
    with_truth = sum(flight.has_truth for flight in read)
    text += f", {with_truth} with truth"
    return text + (f", {len(flights) - len(read)} cannot be read" if len(read) < len(flights) else "")


def _comparison(its: dict[str, str], here: dict[str, str], changes: Sequence[FigureChange], tolerance: Tolerance) -> str:
    differing = [
        f"{what} {its.get(key, 'unknown')}, now {here[key]}"
        for key, what in (("version", "version"), ("estimator", "estimator"), ("settings", "settings"))
        if its.get(key) != here[key]
    ]
    if its.get("estimator") == here["estimator"] and its.get("plug_in", "") != here["plug_in"]:
        differing.append("another state of the estimator's file")
    counts = Counter(change.outcome for change in changes)
    told = ", ".join(f"{counts[outcome]} {outcome.value}" for outcome in ChangeOutcome)
    aspects = ", ".join(aspect.value for aspect in Aspect if any(change.aspect is aspect for change in changes))
    whose = f" ({'; '.join(differing)})" if differing else ""
    of_what = f" ({aspects})" if aspects else ""
    allowed = f"{tolerance.relative:.1%} of metres, seconds and counts, {tolerance.share * 100:g} points of shares"
    return f"against the baseline{whose}: {told}{of_what}; tolerance {allowed}"


def _shown(value: float | None, *, is_share: bool) -> str:
    if value is None:
        return "-"
    return f"{value:.1%}" if is_share else f"{value:.4g}"
