"""The demo: simulated aircraft, by default the paper's four, fly with the service.

First they fly live over loopback UDP, then the whole flight is simulated with and without the service.

`gcs-coloc study demo --out DIR` leaves `demo.png` and the logs of both processes in DIR.
"""

from __future__ import annotations

import csv
import json
import os
import socket
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from gcs_coloc.config.sections import StationConfig
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.errors import GcsColocError, UsageError
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.runtime.files import make_output_directory, new_figure, save_figure
from gcs_coloc.study.closed_loop import Flight, Sample, fly
from sitl_fakes.faults import GpsLost
from sitl_fakes.geodesy import WorldFrame
from sitl_fakes.scenario import Scenario, ScenarioError, Vehicle, load_scenario

LIVE_S = 90.0
_LOST_WITHIN_S = 60.0  # chosen: a third of the live part at least is flown without GPS
AIDED_SOURCE = "gps2 injected"


@dataclass(frozen=True, slots=True)
class Figures:
    """How the denied vehicle's flight went from the loss of its GPS on.

    Lengths are in m. `rmse_m`, `located` (share of the time) and `hdop` are the service's; None without it. `navigation_*` is how
    far the autopilot's own idea of its position was off; NaN where it never had one.
    """

    off_route_rms_m: float
    off_route_most_m: float
    navigation_rms_m: float
    navigation_most_m: float
    rmse_m: float | None
    located: float | None
    hdop: float | None


def run_demo(out: Path, scenario_file: str, estimator: str, seed: int) -> None:
    """Fly the demo, print its report, and leave a picture and logs in `out`.

    The aircraft fly live for 90 s; then the whole flight is simulated.

    Raises:
        UsageError: the scenario cannot be read, or no vehicle loses its GPS in it early enough; matplotlib is not installed; the
            directory or the picture cannot be written.
        GcsColocError: the service or the aircraft stopped early.
    """
    console = Console()
    try:
        scenario = load_scenario(scenario_file)
    except ScenarioError as error:
        raise UsageError(str(error)) from None
    loss = _first_loss(scenario, scenario_file)
    make_output_directory(out, "--out")
    figure = new_figure((12.0, 6.2))  # before minutes of flight: it may be that there is no matplotlib
    console.print(
        f"[bold]1. Live[/], over loopback UDP, {LIVE_S:.0f} s: {len(scenario.vehicle)} aircraft at "
        f"{scenario.airspeed_mps:.0f} m/s, UAV{loss.vehicle} loses its GPS at {loss.at_s:.0f} s."
    )
    check = _vehicle(scenario, loss.vehicle).params.get("EK3_GPS_CHECK")
    if check is not None:
        console.print(
            f"   The noise (GPS {scenario.gps.sigma_h_m:.0f} m, ranges {scenario.ranging.sigma_m:.0f} m) makes positions coarser "
            f"than EKF3 takes by default: UAV{loss.vehicle} flies with EK3_GPS_CHECK={check:.0f}, as its operator would have to "
            "decide."
        )
    console.print(f"   The service's alert limit is the scenario's, {scenario.alert_limit_m:.0f} m.")
    live = _fly_live(scenario, scenario_file, loss.vehicle, estimator, seed, out, console)
    console.print(f"\n[bold]2. The whole flight[/], {scenario.duration_s:.0f} s, through the same engine in process.")
    with_service, without = _fly_whole(scenario, estimator, seed, console)
    _report(scenario, loss, live, with_service, without, console)
    draw(figure, scenario, loss, with_service, without)
    picture = out / "demo.png"
    save_figure(figure, picture)
    console.print(f"\nTrack and error: {picture}")


def _first_loss(scenario: Scenario, scenario_file: str) -> GpsLost:
    within_s = min(_LOST_WITHIN_S, scenario.duration_s)
    losses = [fault for fault in scenario.fault if isinstance(fault, GpsLost) and fault.at_s < within_s]
    if not losses:
        raise UsageError(
            f"{scenario_file}: no vehicle loses its GPS in the first {within_s:.0f} s, so there is nothing to show; "
            'state a fault of kind "gps_lost"'
        )
    return min(losses, key=lambda fault: fault.at_s)


def _vehicle(scenario: Scenario, sysid: int) -> Vehicle:
    return next(vehicle for vehicle in scenario.vehicle if vehicle.sysid == sysid)


def _stations(scenario: Scenario) -> list[dict[str, float]]:
    """Where the scenario's stations stand, as the service's configuration has it."""
    o = scenario.origin
    frame = WorldFrame(o.lat_deg, o.lon_deg, o.alt_msl_m, o.geoid_height_m)
    places = [(station.id, *frame.to_lla(station.east_m, station.north_m, station.height_m)) for station in scenario.station]
    return [dict(zip(("id", "lat_deg", "lon_deg", "alt_m"), place, strict=True)) for place in places]


def _fly_live(
    scenario: Scenario, scenario_file: str, denied_vehicle: int, estimator: str, seed: int, out: Path, console: Console
) -> list[dict[str, str]]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    truth = out / "live-truth.csv"
    truth.unlink(missing_ok=True)
    service_log, fakes_log = out / "service.log", out / "sitl-fakes.log"
    with service_log.open("w") as service_out, fakes_log.open("w") as fakes_out:
        service = subprocess.Popen(  # noqa: S603 - our own program with our own arguments
            [sys.executable, "-m", "gcs_coloc", "--udp", f"127.0.0.1:{port}", "--estimator", estimator],
            env={
                **os.environ,
                "GCS_COLOC_AIDING__ALERT_LIMIT_M": str(scenario.alert_limit_m),
                "GCS_COLOC_STATION": json.dumps(_stations(scenario)),
            },
            stdout=service_out,
            stderr=subprocess.STDOUT,
        )
        flags = ["--target", f"127.0.0.1:{port}", "--seed", str(seed), "--duration", f"{LIVE_S:.0f}", "--truth", str(truth)]
        fakes = subprocess.Popen(  # noqa: S603
            [sys.executable, "-m", "sitl_fakes", scenario_file, *flags],
            stdout=fakes_out,
            stderr=subprocess.STDOUT,
        )
        try:
            _watch(fakes, service, truth, denied_vehicle, console)
        finally:
            for process in (fakes, service):
                process.terminate()
                process.wait(10)
    if fakes.returncode not in (0, -15) or not truth.exists():
        raise GcsColocError(f"the simulated aircraft stopped early; see {fakes_log}")
    with truth.open(newline="") as file:
        return [row for row in csv.DictReader(file) if int(row["sysid"]) == denied_vehicle]


def _watch(
    fakes: subprocess.Popen[bytes], service: subprocess.Popen[bytes], truth: Path, denied_vehicle: int, console: Console
) -> None:
    columns = (TextColumn("   "), BarColumn(), TextColumn("{task.completed:.0f} s  {task.description}"), TimeElapsedColumn())
    last_line = time.monotonic()
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("starting", total=LIVE_S)
        while fakes.poll() is None:
            if service.poll() is not None:
                raise GcsColocError(f"the service stopped early with exit code {service.returncode}; see its log")
            time.sleep(0.5)
            row = _last_row(truth, denied_vehicle)
            if row is None:
                continue
            text = f"UAV{denied_vehicle} navigates on {row['source']}, {float(row['off_route_m']):.0f} m off its route"
            progress.update(task, completed=float(row["at_s"]), description=text)
            if not console.is_terminal and time.monotonic() - last_line >= 10.0:
                last_line = time.monotonic()
                console.print(f"   {float(row['at_s']):.0f} s  {text}")


def _last_row(truth: Path, sysid: int) -> dict[str, str] | None:
    """The newest whole row of a vehicle in a truth file that is still being written."""
    if not truth.exists():
        return None
    with truth.open("rb") as file:
        header = file.readline().decode().strip().split(",")
        size = file.seek(0, 2)
        file.seek(max(0, size - 4096))
        lines = file.read().decode().split("\n")[1:-1]
    rows = [dict(zip(header, line.strip().split(","), strict=False)) for line in lines]
    mine = [row for row in rows if row.get("sysid") == str(sysid)]
    return mine[-1] if mine else None


def _fly_whole(scenario: Scenario, estimator: str, seed: int, console: Console) -> tuple[Flight, Flight]:
    """The flight with and without the service, side by side on two cores."""
    columns = (TextColumn("   {task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress, ProcessPoolExecutor(2) as pool:
        progress.add_task("with and without the service", total=None)
        flights = [pool.submit(_fly_one, scenario, estimator, seed, aided) for aided in (True, False)]
        return flights[0].result(), flights[1].result()


def _fly_one(scenario: Scenario, estimator: str, seed: int, aided: bool) -> Flight:
    stations = tuple(StationConfig.model_validate(station).station() for station in _stations(scenario))
    settings = EngineSettings(aiding=AidingSettings(alert_limit_m=scenario.alert_limit_m), stations=stations)
    return fly(scenario, seed, Engine(load_estimator(estimator, {}), settings), aided=aided)


def figures(flight: Flight, loss: GpsLost, aided: bool) -> Figures:
    """The figures of the denied vehicle's flight from the loss of its GPS on."""
    samples = [s for s in flight.samples[loss.vehicle] if s.at_s >= loss.at_s]
    off_m = np.array([s.truth.off_route_m for s in samples])
    errors_m = np.array([np.hypot(s.error_enu_m[0], s.error_enu_m[1]) for s in samples if s.error_enu_m is not None])
    hdops = [s.hdop for s in samples if s.hdop is not None]
    navigation_m = np.array(
        [
            np.hypot(t.estimate_east_m - t.east_m, t.estimate_north_m - t.north_m)
            for t in (s.truth for s in samples)
            if t.estimate_east_m is not None and t.estimate_north_m is not None
        ]
        or [np.nan]
    )
    return Figures(
        off_route_rms_m=float(np.sqrt(np.mean(off_m**2))),
        off_route_most_m=float(off_m.max()),
        navigation_rms_m=float(np.sqrt(np.mean(navigation_m**2))),
        navigation_most_m=float(navigation_m.max()),
        rmse_m=float(np.sqrt(np.mean(errors_m**2))) if aided and len(errors_m) else None,
        located=len(errors_m) / len(samples) if aided else None,
        hdop=float(np.median(hdops)) if aided and hdops else None,
    )


def _report(
    scenario: Scenario, loss: GpsLost, live: list[dict[str, str]], with_service: Flight, without: Flight, console: Console
) -> None:
    after = [row for row in live if float(row["at_s"]) >= loss.at_s + 5.0]
    on_aid = sum(row["source"] == AIDED_SOURCE for row in after) / max(len(after), 1)
    off_m = [float(row["off_route_m"]) for row in after]
    console.print(f"\n[bold]Report[/], UAV{loss.vehicle} after the loss of its GPS at {loss.at_s:.0f} s")
    console.print(
        f"   live, {LIVE_S:.0f} s with the service:  flew on GPS_INPUT {on_aid:.0%} of the time, "
        f"at most {max(off_m, default=float('nan')):.0f} m off its route"
    )
    on, off = figures(with_service, loss, aided=True), figures(without, loss, aided=False)
    console.print(f"   whole flight, {scenario.duration_s:.0f} s      off its route       off in its own position")
    console.print("                               rms      most          rms      most")
    for name, f in (("with the service", on), ("without", off)):
        route = f"{f.off_route_rms_m:8.0f} m{f.off_route_most_m:8.0f} m"
        console.print(f"   {name:<24}{route}   {f.navigation_rms_m:8.0f} m{f.navigation_most_m:8.0f} m")
    if on.rmse_m is not None:
        console.print(
            f"   the service's own position of UAV{loss.vehicle}: RMSE {on.rmse_m:.1f} m, known {on.located:.1%} of the time, "
            f"median HDOP {on.hdop:.1f}; {with_service.gps_inputs.get(loss.vehicle, 0)} GPS_INPUT sent"
        )


def draw(figure: Any, scenario: Scenario, loss: GpsLost, with_service: Flight, without: Flight) -> None:
    """Draw the flight: tracks on the left, errors and HDOP over time on the right.

    The errors are that of the service's position, with its 95 % bound, and the distance off the route.
    """
    denied_vehicle = loss.vehicle
    grid = figure.add_gridspec(3, 2, width_ratios=(1.15, 1))
    track, error, route, hdop = (figure.add_subplot(grid[:, 0]), *(figure.add_subplot(grid[i, 1]) for i in range(3)))

    fleet = track.inset_axes((0.045, 0.04, 0.36, 0.36))
    for vehicle in scenario.vehicle:
        east, north = _track(with_service.samples[vehicle.sysid])
        fleet.plot(east, north, color="#0072b2" if vehicle.sysid == denied_vehicle else "0.5", lw=1)
        fleet.annotate(f"{vehicle.sysid}", (east[0], north[0]), fontsize=8)
    fleet.set_title("the fleet, km", fontsize=8)
    fleet.tick_params(labelsize=7)
    fleet.set_aspect("equal", adjustable="datalim")
    waypoints = np.array(_vehicle(scenario, denied_vehicle).waypoints) / 1e3
    track.plot(waypoints[:, 0], waypoints[:, 1], "k:", lw=1, marker="s", ms=4, label=f"UAV{denied_vehicle}: planned route")
    track.plot(*_track(without.samples[denied_vehicle]), color="#d55e00", lw=1.5, label="flown without the service")
    track.plot(*_track(with_service.samples[denied_vehicle]), color="#0072b2", lw=1.8, label="flown with the service")
    at_loss = next(s for s in with_service.samples[denied_vehicle] if s.at_s >= loss.at_s)
    track.plot(at_loss.truth.east_m / 1e3, at_loss.truth.north_m / 1e3, "kx", ms=9, mew=2, label="GPS lost")
    track.set(xlabel="east, km", ylabel="north, km", title=f"UAV{denied_vehicle}: planned and flown")
    track.set_aspect("equal", adjustable="datalim")
    track.grid(alpha=0.3)
    track.legend(fontsize=8, loc="lower right")

    known = [s for s in with_service.samples[denied_vehicle] if s.error_enu_m is not None and s.covariance is not None]
    times = [s.at_s for s in known]
    error.plot(times, [np.hypot(*s.error_enu_m[:2]) for s in known if s.error_enu_m is not None], color="#0072b2", lw=0.8)
    bound = [horizontal_bound_95_m(s.covariance) for s in known if s.covariance is not None]
    error.plot(times, bound, color="0.3", lw=1, ls="--", label="95 % bound")
    error.set(ylabel="position error, m", title=f"gcs-coloc's position of UAV{denied_vehicle}")
    error.legend(fontsize=8, loc="upper left")
    for flight, colour in ((without, "#d55e00"), (with_service, "#0072b2")):
        samples = flight.samples[denied_vehicle]
        route.plot([s.at_s for s in samples], [s.truth.off_route_m for s in samples], color=colour, lw=1)
    route.set(ylabel="off its route, m")
    with_hdop = [s for s in with_service.samples[denied_vehicle] if s.hdop is not None]
    hdop.plot([s.at_s for s in with_hdop], [s.hdop for s in with_hdop], color="#009e73", lw=1)
    hdop.set(ylabel="HDOP", xlabel="time, s", ylim=(0, 12))
    for axes in (error, route, hdop):
        axes.axvline(loss.at_s, color="k", lw=0.8)
        axes.set_xlim(0, scenario.duration_s)
        axes.grid(alpha=0.3)


def _track(samples: list[Sample]) -> tuple[list[float], list[float]]:
    return [s.truth.east_m / 1e3 for s in samples], [s.truth.north_m / 1e3 for s in samples]
