"""`gcs-coloc study`: the paper's tables and figures, and the bound that no estimator beats."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import Progress

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
from gcs_coloc.runtime.files import check_drawing, check_output_file, make_output_directory, writing
from gcs_coloc.study.paper_options import PaperOptions, QForm, QUnit

app = typer.Typer(
    name="study",
    add_completion=False,
    help="The paper's tables and figures, integrity trials, the best that any estimator can do.",
)


StudiedOption = Annotated[str, typer.Option("--estimator", help="fleet, qu_zhang, or a plug-in.")]
ClassesOption = Annotated[list[str] | None, typer.Option("--class", help="A class of flights; several times for several.")]
FirstSeedOption = Annotated[int, typer.Option(help="Seed of the first flight of each class.", min=0)]


@app.command("demo")
def demo(
    out: Annotated[Path, typer.Option(help="Where the picture and the logs go.")] = Path("out/demo"),
    scenario: Annotated[
        str, typer.Option(help="A scenario that comes with sitl-fakes (sitl-fakes --list), or a scenario file (TOML).")
    ] = "paper",
    estimator: StudiedOption = "fleet",
    seed: Annotated[int, typer.Option(help="Seed of the simulated aircraft's noise.", min=0)] = 1,
) -> None:
    """Fly simulated aircraft: live for 90 s, then the whole flight in process; report and draw."""
    from gcs_coloc.study.demo import run_demo

    run_demo(out, scenario, estimator, seed)


@app.command("paper")
def paper(
    seeds: Annotated[int, typer.Option(help="Draws of noise.")] = 20,
    first_seed: Annotated[int, typer.Option(help="Seed of the first draw.", min=0)] = 1,
    jobs: JobsOption = 0,
    scheduler: SchedulerOption = None,
    resume: ResumeOption = None,
    fleet_seeds: Annotated[int, typer.Option(help="Draws for the fleet filter: it takes minutes for each.")] = 2,
    q: Annotated[list[float] | None, typer.Option(help="A value of q; several times for several. Table 2's by default.")] = None,
    end_of_route: Annotated[str, typer.Option(help="What follows the last waypoint: straight, loop or hold.")] = "straight",
    cycle: Annotated[float, typer.Option(help="Computing cycle in seconds.")] = 0.02,
    q_unit: Annotated[QUnit, typer.Option(help="What q counts: a variance per step, or a spectral density.")] = QUnit.PER_STEP,
    q_form: Annotated[QForm, typer.Option(help="What a step's process noise is.")] = QForm.VELOCITY,
    out: Annotated[Path, typer.Option(help="Directory for table, JSON and figures.")] = Path("out/paper"),
) -> None:
    """Fly Table 1 of Qu & Zhang, run its filters and ours, and print Table 2.

    All filters get the same noise. The published figures stand beside ours.
    """
    from gcs_coloc.study import paper as study
    from gcs_coloc.study import paper_report

    workers = workers_for(jobs, scheduler)
    make_output_directory(out, "--out")
    check_drawing()
    options = PaperOptions(
        seeds=seeds,
        first_seed=first_seed,
        fleet_seeds=fleet_seeds,
        end_of_route=end_of_route,
        step_s=cycle,
        q_form=q_form,
        q_unit=q_unit,
    )
    if q:
        options = replace(options, qs=tuple(q), figure_q=5.0 if 5.0 in q else q[0])
    console = result_console()
    with Progress(console=console) as progress:
        task = progress.add_task("flying", total=None)
        result = study.run_paper_study(
            options, workers, lambda done, total: progress.update(task, completed=done, total=total), kept_in(resume)
        )
    for table in paper_report.tables(result):
        console.print(table)
    for path in paper_report.write(result, out):
        print(f"written: {path}")


@app.command("bound")
def bound(
    scenario: Annotated[
        str, typer.Argument(help="A scenario that comes with sitl-fakes, or a scenario file (TOML).", metavar="SCENARIO")
    ],
    seed: Annotated[int, typer.Option(help="Seed of the flight (wind and the aircraft's own errors).", min=0)] = 1,
    peer_sigma: Annotated[
        float, typer.Option(help="1-sigma of each peer's position, m, new in every range; 0 is the least.")
    ] = 0.0,
    density: Annotated[float, typer.Option(help="How much the vehicle is left to itself: acceleration density, m^2/s^3.")] = 1.0,
    plot: Annotated[Path | None, typer.Option(help="Draw the bound over time into this file.")] = None,
) -> None:
    """Compute the posterior Cramer-Rao bound along the true flight of each vehicle that loses its GPS."""
    from gcs_coloc.study.bound import BoundOptions, plot_bounds, run_scenario_bound

    check_output_file(plot, "--plot")
    if plot is not None:
        check_drawing()
    bounds = run_scenario_bound(scenario, seed, BoundOptions(peer_sigma_m=peer_sigma, density_m2ps3=density))
    for sysid, least in bounds.items():
        sigma_m = least.horizontal_sigma_m
        print(
            f"vehicle {sysid}, {least.times_s[0]:.0f} to {least.times_s[-1]:.0f} s: horizontal RMSE at least "
            f"{least.horizontal_rmse_m():.2f} m, at any one time {sigma_m.min():.2f} to {sigma_m.max():.2f} m"
        )
    if plot is not None:
        plot_bounds(bounds, plot)


@app.command("integrity")
def integrity(
    classes: ClassesOption = None,
    seeds: Annotated[int | None, typer.Option(help="Flights of each class; 2 where neither this nor --hours is stated.")] = None,
    hours: Annotated[float | None, typer.Option(help="Hours under aid in all classes together, instead of --seeds.")] = None,
    first_seed: FirstSeedOption = 1,
    jobs: JobsOption = 0,
    scheduler: SchedulerOption = None,
    estimator: StudiedOption = "fleet",
    out: Annotated[
        Path, typer.Option(help="Directory of the flights and the JSON; a run that was stopped goes on there.")
    ] = Path("out/integrity"),
    events: Annotated[bool, typer.Option(help="Print each event with the seed of its flight.")] = True,
    trace: Annotated[Path | None, typer.Option(help="Fly --class at --first-seed alone, and write every sample as CSV.")] = None,
    show_classes: Annotated[bool, typer.Option("--list", help="Print the classes and end.")] = False,
) -> None:
    """Fly random flights of many classes and count the errors beyond what is stated.

    Each flight goes through the whole engine. An error beyond what is stated may never happen.
    """
    from gcs_coloc.study.integrity import trial_report
    from gcs_coloc.study.integrity.flight_classes import CLASSES
    from gcs_coloc.study.integrity.trial import TrialScore, write_trace
    from gcs_coloc.study.integrity.trial_runs import RunOptions, run_trials

    if show_classes:
        for drawn in CLASSES.values():
            print(f"{drawn.name:<26}{drawn.group.value:<11}{drawn.text}")
        return
    if seeds is None and hours is None:
        seeds = 2
    options = RunOptions(out, tuple(classes or CLASSES), first_seed, seeds, hours, workers_for(jobs, scheduler), estimator)
    console = result_console()
    check_output_file(trace, "--trace")
    if trace is not None:
        if len(options.classes) != 1:
            raise UsageError("--trace is of one flight: state one --class, and its seed with --first-seed")
        with writing(trace, "--trace"):
            scores = [write_trace(options.classes[0], first_seed, estimator, trace)]
    else:
        with Progress(console=console) as progress:
            task = progress.add_task("flying", total=hours * 3600.0 if hours is not None else len(options.classes) * (seeds or 1))

            def count(score: TrialScore) -> None:
                progress.update(task, advance=score.under_aid_s if hours is not None else 1.0)

            scores = run_trials(options, count)
    results = trial_report.all_results(scores)
    for line in trial_report.event_lines(scores) if events else []:
        console.print(line, highlight=False, soft_wrap=True)
    console.print(trial_report.result_table(results))
    for line in trial_report.limit_lines(results):
        console.print(line, highlight=False)
    if trace is None:
        print(f"written: {trial_report.write_report(options, scores, results)}")


@app.command("planning")
def planning(
    plans: Annotated[list[str] | None, typer.Option("--plan", help="A plan of the check; several times for several.")] = None,
    flights: Annotated[int, typer.Option(help="Drawn flights of each plan.", min=1)] = 20,
    first_seed: Annotated[int, typer.Option(help="Seed of the first flight of each plan.", min=0)] = 1,
    jobs: JobsOption = 0,
    scheduler: SchedulerOption = None,
    resume: ResumeOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print every window as JSON.")] = False,
) -> None:
    """Check the predictions of `gcs-coloc plan` against simulated flights.

    Ten plans of different kind are flown with drawn noise through the whole engine.
    """
    from gcs_coloc.study.plan_check import CHECK_PLANS, PlanCheck, check_table, run_checks

    names, workers = plans or list(CHECK_PLANS), workers_for(jobs, scheduler)
    for name in names:
        if name not in CHECK_PLANS:
            raise UsageError(f"--plan {name}: there is no such plan; there are {', '.join(CHECK_PLANS)}")
    with progress_of("flying") as show:
        checks: list[PlanCheck] = run_checks(names, flights, first_seed, workers, show, kept_in(resume))
    if as_json:
        print(json.dumps([asdict(check) for check in checks], indent=2))
        return
    result_console().print(check_table(checks))
    told = [window for check in checks for window in check.told]
    windows = sum(len(check.windows) for check in checks)
    close = sum(window.is_close for window in told)
    print(f"{flights} flights of each plan, seeds from {first_seed}")
    levels = sum(window.is_level_close for window in told)
    print(f"of {windows} windows {len(told)} are told, {close} of them within 20 %; protection level: {levels}")


@app.command("readiness")
def readiness(
    classes: ClassesOption = None,
    recording: Annotated[
        list[str] | None, typer.Option(help="A recording (tlog), its tables beside it; several times for several.")
    ] = None,
    seeds: Annotated[int, typer.Option(help="Flights of each class, and losses in each recording.", min=1)] = 5,
    first_seed: FirstSeedOption = 1,
    from_s: Annotated[
        float, typer.Option("--from", help="In a recording GPS is taken within 10 s from here, s.", min=0.0)
    ] = 70.0,
    jobs: JobsOption = 0,
    scheduler: SchedulerOption = None,
    resume: ResumeOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print every loss as JSON.")] = False,
) -> None:
    """Check what readiness says before GPS is lost against the filter's accuracy 30 s after.

    GPS is taken at a random time of each flight.
    """
    from gcs_coloc.study.readiness_check import CHECKED, check_table, run_checks

    names = classes if classes is not None else () if recording else CHECKED
    workers = workers_for(jobs, scheduler)
    with progress_of("flying") as show:
        losses = run_checks(names, recording or (), seeds, workers, show, from_s, first_seed, kept_in(resume))
    if as_json:
        print(json.dumps([asdict(loss) for loss in losses], indent=2))
        return
    result_console().print(check_table(losses))
    print(f"{seeds} losses of each, seeds from {first_seed}; 30 s after the loss, told before it")
