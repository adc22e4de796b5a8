"""`gcs-coloc replay`: a recorded flight through the engine, and a report."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from gcs_coloc.config import load_settings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.errors import UsageError
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder import replay as driver
from gcs_coloc.recorder.flight_report import FlightReport
from gcs_coloc.recorder.tlog import TlogReader


def replay(
    file: Annotated[Path, typer.Argument(help="A recording (tlog).", metavar="FILE.tlog")],
    ranges: Annotated[Path | None, typer.Option(help="Ranges: unix_s,from_sysid,to_sysid,range_m,sigma_m.")] = None,
    truth: Annotated[
        Path | None, typer.Option(help="True positions, for scoring: unix_s,sysid,lat_deg,lon_deg,alt_msl_m.")
    ] = None,
    speed: Annotated[str, typer.Option(help="N times real time, or max.")] = "max",
    config: Annotated[Path | None, typer.Option(help="A configuration file (TOML); its links are not opened.")] = None,
    estimator: Annotated[str | None, typer.Option(help="fleet, qu_zhang, or a plug-in.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Send a recorded flight through the same engine, on recorded time, and report how well it went."""
    pace = _pace(speed)
    settings = load_settings(config, {"estimator": {"name": estimator}} if estimator is not None else {})
    engine = Engine(load_estimator(settings.estimator.name, settings.estimator.settings), settings.engine())
    log = TlogReader(file)
    report = FlightReport(engine, driver.read_truth(truth) if truth is not None else [])
    told = driver.read_ranges(ranges) if ranges is not None else []
    own = (settings.mavlink.system_id, settings.mavlink.component_id)
    through = driver.Replay(engine, log, told, report.polled, own)
    counts = driver.replay(through, report.observation_times(), report.observe, pace)
    result: dict[str, Any] = {
        "file": str(file),
        "estimator": engine.estimator.name,
        "first_unix_s": counts.first_s,
        "last_unix_s": counts.last_s,
        "records": counts.records,
        "messages": counts.messages,
        "damage": dict(log.counts),
        "wire": dict(counts.wire),
        **report.as_dict(),
    }
    warn_of_damage(file, log.counts)
    if as_json:
        print(json.dumps(result, indent=2))
    else:
        print("\n".join(_lines(result)))


def warn_of_damage(file: Path, damage: Mapping[str, int]) -> None:
    """Say on stderr what of a recording could not be read."""
    for kind, amount in damage.items():
        print(f"gcs-coloc: warning: {file}: {kind.replace('_', ' ')}: {amount}; replayed what is whole", file=sys.stderr)


def _pace(speed: str) -> Callable[[float], None]:
    if speed == "max":
        return lambda _: None
    try:
        factor = float(speed)
    except ValueError:
        factor = 0.0
    if not 0.0 < factor < float("inf"):
        raise UsageError(f"--speed {speed}: a number above zero, or max")
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
        out.append(f"vehicle {vehicle['sysid']}: GPS_INPUT with a fix {sent['fix']}, without {sent['no_fix']}")
        out.extend(
            f"  {change['at_s'] - first_s:8.1f} s  GPS {change['before']} -> {change['after']}: {change['reason']}"
            for change in vehicle["health"]
        )
        if vehicle["score"] is not None:
            out.append("  while its GPS was not trusted: " + _score(vehicle["score"]))
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
