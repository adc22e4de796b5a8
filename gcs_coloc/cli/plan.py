"""`gcs-coloc plan`: where along planned ways vehicles would be located if their GPS failed."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, TypeVar

import typer
from rich.table import Table

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
from gcs_coloc.core.measurements import VehicleClass
from gcs_coloc.core.stations.node_id import MAX_STATION_ID
from gcs_coloc.core.stations.stations import LEAST_STATION_SIGMA_M, MOST_STATION_SIGMA_M, STATION_SIGMA_M
from gcs_coloc.planning.assessment import Assessment, assess
from gcs_coloc.planning.fleet_plan import FleetPlan
from gcs_coloc.planning.improvement import find_improvement, no_improvement
from gcs_coloc.planning.load import load_plan
from gcs_coloc.planning.mission import LEAST_SPEED_MPS, MOST_SPEED_MPS, ListedStation, PerVehicle
from gcs_coloc.runtime.files import check_drawing, check_output_file, new_table, writing

_FILE_WIDTH = 160  # of a table that goes to a file or pipe
_NOT_ENOUGH = 3
"""Exit code where --require is not met: a script has to tell a plan that is refused from one that cannot be read (1)."""
_CLASSES = ", ".join(VehicleClass)

T = TypeVar("T")


def plan(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="QGroundControl .plan, Mission Planner .waypoints or scenario .toml, one a vehicle.", metavar="PLAN..."
        ),
    ],
    start: Annotated[
        list[str] | None, typer.Option(help="VEHICLE=SECONDS: when a vehicle starts; 0 unless told. Several times for several.")
    ] = None,
    speed: Annotated[
        list[str] | None,
        typer.Option(
            help="M/S: speed of all vehicles, VEHICLE=M/S: of one; as their plans say unless told. Several times for several."
        ),
    ] = None,
    vehicle_class: Annotated[
        list[str] | None,
        typer.Option(
            "--class",
            help=f"How all vehicles move, VEHICLE=CLASS: one of them; as their plans say unless told. {_CLASSES}.",
        ),
    ] = None,
    station: Annotated[
        list[str] | None,
        typer.Option(
            help=f"ID=LAT,LON,ALT[,SIGMA]: a fixed station, degrees, metres above sea level, its place known to SIGMA m on each "
            f"axis ({STATION_SIGMA_M:g} unless told, as in the configuration)."
        ),
    ] = None,
    max_range: Annotated[float | None, typer.Option(help="Longest range, m.")] = None,
    range_sigma: Annotated[float | None, typer.Option(help="1-sigma of a range, m.")] = None,
    range_rate: Annotated[float | None, typer.Option(help="Ranges per second of each pair.")] = None,
    position_sigma: Annotated[float | None, typer.Option(help="1-sigma of a healthy vehicle's position, each axis, m.")] = None,
    alert_limit: Annotated[float | None, typer.Option(help="No fix beyond this protection level, m.")] = None,
    no_air_data: Annotated[bool, typer.Option("--no-air-data", help="Planes send no attitude and airspeed.")] = False,
    pairs: Annotated[bool, typer.Option("--pairs", help="Every pair of vehicles without GPS too.")] = False,
    improve: Annotated[bool, typer.Option(help="Look for the one change that helps most.")] = True,
    require: Annotated[
        float | None,
        typer.Option(help="Share of each flight that needs a fix: exit code 3 where one has less.", min=0.0, max=1.0),
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Write the report as one HTML page into this file.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    csv: Annotated[Path | None, typer.Option("--csv", help="Write every step into this file.")] = None,
    geojson: Annotated[Path | None, typer.Option(help="Write the ways, cut where a fix begins or ends, into this file.")] = None,
    jobs: JobsOption = 0,
    scheduler: SchedulerOption = None,
    resume: ResumeOption = None,
) -> None:
    """Predict where along planned ways vehicles would have a fix from ranges if their GPS failed.

    Where one would have none, the prediction says what limits it.
    """
    from gcs_coloc.planning import plan_tables

    for path, option in ((report, "--report"), (csv, "--csv"), (geojson, "--geojson")):
        check_output_file(path, option)
    if report is not None:
        check_drawing()
    assumed = {
        "max_range_m": max_range, "range_sigma_m": range_sigma, "range_rate_hz": range_rate, "position_sigma_m": position_sigma,
        "alert_limit_m": alert_limit, "has_air_data": False if no_air_data else None,
    }  # fmt: skip
    fleet = load_plan(
        files,
        classes=_per_vehicle("--class", vehicle_class or (), VehicleClass, f"a class ({_CLASSES})", "2=multirotor"),
        speeds_mps=_per_vehicle("--speed", speed or (), _speed, f"m/s from {LEAST_SPEED_MPS:g} to {MOST_SPEED_MPS:g}", "2=15"),
        starts_s=dict(_start(text) for text in start or ()),
        stations=[_station(text) for text in station or ()],
        assumed=assumed,
    )
    for line in fleet.remarks:
        print(line, file=sys.stderr)
    if len(fleet.vehicles) + len(fleet.stations) < 2:
        raise UsageError("one vehicle alone has nothing to range: give more plans, or --station")
    workers, kept = workers_for(jobs, scheduler), kept_in(resume)
    with progress_of("predicting") as show:
        assessed = assess(fleet, pairs=pairs, workers=workers, progress=show, kept=kept)
    improvement = None
    if improve:
        with progress_of("looking for a change that helps") as show:
            improvement = find_improvement(assessed, workers, show, kept)
    if csv is not None:
        with writing(csv, "--csv"):
            plan_tables.write_csv(assessed, csv)
    if geojson is not None:
        with writing(geojson, "--geojson"):
            plan_tables.write_geojson(assessed, geojson)
    if report is not None:
        from gcs_coloc.planning.plan_report import page

        with writing(report, "--report"):
            report.write_text(page(assessed, improvement, is_improvement_sought=improve), encoding="utf-8")
    if as_json:
        print(json.dumps(plan_tables.as_dict(assessed, improvement), indent=2, allow_nan=False))
    else:
        result_console(_FILE_WIDTH).print(_table(fleet, assessed))
        if improvement is not None:
            print(f"What helps most: {improvement.text}.")
        elif improve and (none := no_improvement(assessed)):
            print(none)
        for path in filter(None, (report, csv, geojson)):
            print(f"written: {path}")
    if require is not None and assessed.least_share < require:
        print(f"a vehicle has a fix for {assessed.least_share:.1%} of its flight, {require:.1%} are required", file=sys.stderr)
        raise typer.Exit(_NOT_ENOUGH)


def _table(fleet: FleetPlan, assessed: Assessment) -> Table:
    headings = ("without GPS", "vehicle", "with a fix", "cannot tell", "95 % m", "HPL m", "worst stretch", "cause")
    table = new_table(*headings, left=("cause", "without GPS"))
    for each in (*assessed.singles, *assessed.pairs):
        p, worst = each.predicted, each.worst
        when = f"{worst.from_s:.0f} to {worst.until_s:.0f} s" if worst is not None else "-"
        shown = (f"{value:.1f}" if value == value else "-" for value in (each.median_bound_95_m, each.median_hpl_m))
        name = fleet.vehicle(p.sysid).name if len(p.denied) == 1 else " and ".join(map(str, p.denied))
        table.add_row(
            name,
            str(p.sysid),
            f"{p.share_with_fix:.1%}",
            f"{each.cannot_tell:.1%}",
            *shown,
            when,
            worst.cause if worst is not None else "not in flight",
        )
    return table


def _per_vehicle(option: str, texts: Sequence[str], parse: Callable[[str], T], expected: str, example: str) -> PerVehicle[T]:
    """Return the values of an option, each a plain one for all vehicles or VEHICLE=VALUE."""
    of_all: T | None = None
    of_one: dict[int, T] = {}
    for text in texts:
        vehicle, separator, value = text.rpartition("=")
        try:
            if separator:
                of_one[int(vehicle)] = parse(value)
            else:
                of_all = parse(value)
        except ValueError:
            raise UsageError(f"{option} {text}: expected {expected}, or VEHICLE= and that, as {example}") from None
    return PerVehicle(of_all, of_one)


def _speed(text: str) -> float:
    speed_mps = float(text)
    if not LEAST_SPEED_MPS <= speed_mps <= MOST_SPEED_MPS:
        raise ValueError
    return speed_mps


def _start(text: str) -> tuple[int, float]:
    vehicle, separator, seconds = text.partition("=")
    try:
        start_s = float(seconds)
        if not separator or not 0.0 <= start_s <= 86_400.0:
            raise ValueError
        return int(vehicle), start_s
    except ValueError:
        raise UsageError(f"--start {text}: expected VEHICLE=SECONDS with seconds from 0 to 86400, as 2=60") from None


def _station(text: str) -> ListedStation:
    number, separator, place = text.partition("=")
    try:
        lat, lon, alt, *more = (float(value) for value in place.split(","))
        (sigma_m,) = more or (STATION_SIGMA_M,)
        if (
            not separator
            or not abs(lat) <= 90.0
            or not abs(lon) <= 180.0
            or not abs(alt) <= 20_000.0
            or not LEAST_STATION_SIGMA_M <= sigma_m <= MOST_STATION_SIGMA_M
            or not 0 <= int(number) <= MAX_STATION_ID
        ):
            raise ValueError
        return ListedStation(int(number), (lat, lon, alt), sigma_m)
    except ValueError:
        raise UsageError(
            f"--station {text}: expected ID=LAT,LON,ALT or ID=LAT,LON,ALT,SIGMA in degrees and metres, as 1=47.001,8.002,512,0.5"
        ) from None
