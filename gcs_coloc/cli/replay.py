"""`gcs-coloc replay`: a recorded flight through the engine, and a report."""

from __future__ import annotations

import asyncio
import json
import re
import time
from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from gcs_coloc import __version__
from gcs_coloc.cli.recordings import (
    ConfigOption,
    EstimatorOption,
    FleetOption,
    RangesOption,
    RecordingArgument,
    settings_for,
    warn_of_damage,
    warn_of_findings,
)
from gcs_coloc.config.settings import Settings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.errors import UsageError
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder import replay as driver
from gcs_coloc.recorder.flight_report import FlightReport, MeasurementTap
from gcs_coloc.recorder.side_tables import read_ranges, read_truth
from gcs_coloc.recorder.tlog import TlogReader


def replay(
    file: RecordingArgument,
    ranges: RangesOption = None,
    truth: Annotated[
        Path | None,
        typer.Option(help="True positions, for scoring or for marks on the page: unix_s,sysid,lat_deg,lon_deg,alt_msl_m."),
    ] = None,
    speed: Annotated[
        str | None, typer.Option(help="N times real time, or max; 1 on the page and max without it unless told.")
    ] = None,
    config: ConfigOption = None,
    fleet: FleetOption = None,
    estimator: EstimatorOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
    web: Annotated[
        str | None,
        typer.Option(
            help="Show it on the live page instead, with play, pause, seek; 127.0.0.1:8080 unless told.", metavar="[[HOST:]PORT]"
        ),
    ] = None,
) -> None:
    """Send a recorded flight through the same engine, on recorded time, and report how well it went."""
    if web is not None and as_json:
        raise UsageError("--web and --json exclude each other: the page does not end with a report")
    factor = _factor(speed if speed is not None else ("1" if web is not None else "max"))
    settings = settings_for(config, fleet, estimator, {"web": {"address": web}} if web else None)
    if web is not None:
        _show(file, settings, ranges, truth, factor)
        return
    tap = MeasurementTap(load_estimator(settings.estimator.name, settings.estimator.settings))
    engine = Engine(tap, settings.engine())
    log = TlogReader(file)
    points = read_truth(truth)
    report = FlightReport(engine, points)
    own = settings.mavlink.own
    through = driver.Replay(engine, log, read_ranges(ranges), report.add_outputs, own, settings.fingerprint())
    counts = driver.replay(through, report.observation_times(), report.observe, _pace(factor))
    findings = tap.findings(points, engine.frame)
    result: dict[str, Any] = {
        "version": __version__,
        "file": str(file),
        "estimator": engine.estimator.name,
        "first_unix_s": counts.first_s,
        "last_unix_s": counts.last_s,
        "records": counts.records,
        "messages": counts.messages,
        "damage": dict(log.counts),
        "wire": dict(counts.wire),
        **report.as_dict(),
        "warnings": [asdict(finding) for finding in findings],
    }
    warn_of_damage(file, log.counts)
    warn_of_findings(file, findings)
    if as_json:
        print(json.dumps(result, indent=2))
    else:
        print("\n".join(_lines(result)))


def _show(file: Path, settings: Settings, ranges: Path | None, truth: Path | None, factor: float) -> None:
    # Here, because a replay without the page is to start without its packages.
    from gcs_coloc.service.replay_service import ReplayService

    service = ReplayService(file, settings, ranges, truth, factor)
    asyncio.run(service.run())
    warn_of_damage(file, service.damage)


def _factor(speed: str) -> float:
    """Recorded seconds a second; infinity for max."""
    if speed == "max":
        return float("inf")
    try:
        factor = float(speed)
    except ValueError:
        factor = 0.0
    if not 0.0 < factor < float("inf"):
        raise UsageError(f"--speed {speed}: a number above zero, or max")
    return factor


def _pace(factor: float) -> Callable[[float], None]:
    if factor == float("inf"):
        return lambda _: None
    started: list[float] = []

    def wait(at_s: float) -> None:
        if not started:
            started.extend((time.monotonic(), at_s))
        ahead_s = (at_s - started[1]) / factor - (time.monotonic() - started[0])
        if ahead_s > 0.0:
            time.sleep(ahead_s)

    return wait


def _lines(result: dict[str, Any]) -> list[str]:
    first_s, last_s = result["first_unix_s"], result["last_unix_s"]
    span = f"{last_s - first_s:.1f} s from {_utc(first_s)}"
    out = [f"{result['file']}: {result['records']} frames, {span}, estimator {result['estimator']}"]
    for vehicle in result["vehicles"]:
        sent = vehicle["gps_input"]
        line = f"vehicle {vehicle['sysid']}: GPS_INPUT with a fix {sent['fix']}, without {sent['no_fix']}"
        for name, key in (("external position estimates", "external_positions"), ("positions to PX4", "global_positions")):
            line += f", {name} {vehicle[key]}" if vehicle[key] else ""
        out.append(line)
        out.extend(
            f"  {change['at_s'] - first_s:8.1f} s  GPS {change['before']} -> {change['after']}: {change['reason']}"
            for change in vehicle["health"]
        )
        if vehicle["score"] is not None:
            out.append("  while its GPS was not trusted: " + _score(vehicle["score"]))
    for error in result["errors"]:
        whose = f"vehicle {error['sysid']}: " if error["sysid"] is not None else ""
        out.append(f"error at {error['at_s'] - first_s:.1f} s: {whose}{error['text']}")
    out.extend(f"refused: {reason}: {times}" for reason, times in sorted(result["refused"].items()))
    return out


def _score(score: dict[str, Any]) -> str:
    text = f"{score['epochs']} true positions, located {score['share_known']:.1%}"
    if score["horizontal"] is None:
        return text
    e = score["horizontal"]
    return (
        f"{text}, horizontal RMSE {e['rmse_m']:.2f} m, median {e['median_m']:.2f} m, 95 % {e['p95_m']:.2f} m, "
        f"most {e['max_m']:.2f} m, 3D RMSE {score['spatial']['rmse_m']:.2f} m; "
        f"95 % bound covers {score['covered_95']:.1%}, beyond 3 x the bound {score['beyond_three_bounds']:.2%}, "
        f"ANEES {score['anees']:.2f} ({score['anees_expected']} expected)"
    )


def _utc(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


class _WebMayBeBare(TyperCommand):
    """Lets `--web` stand without an address, for which Typer has no option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As the base class, after an empty address was put behind a bare `--web`."""
        full: list[str] = []
        for arg, following in zip_longest(args, args[1:], fillvalue=""):
            full.append(arg)
            if arg == "--web" and not re.search(r"(:\w+|^\d+)$", following):
                full.append("")
        return list(super().parse_args(ctx, full))


app = typer.Typer(add_completion=False)
app.command("replay", cls=_WebMayBeBare)(replay)
