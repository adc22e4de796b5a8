"""`gcs-coloc export` and `gcs-coloc report`: recordings to files.

It also has the options and warnings of every command that reads a recording.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from gcs_coloc.config.fleets import load_settings
from gcs_coloc.config.settings import Settings
from gcs_coloc.core.reasons import counted
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.evaluation.data_checks.findings import DataFinding
from gcs_coloc.recorder.flight_history import FlightHistory, read_history
from gcs_coloc.runtime.files import check_drawing, check_output_file, make_output_directory, writing

RecordingArgument = Annotated[Path, typer.Argument(help="A recording (tlog).", metavar="FILE.tlog")]
RangesOption = Annotated[Path | None, typer.Option(help="Ranges: unix_s,from_sysid,to_sysid,range_m,sigma_m.")]
ConfigOption = Annotated[Path | None, typer.Option(help="The configuration file (TOML) of the flight; its links are not opened.")]
FleetOption = Annotated[str | None, typer.Option(help="Which fleet of the configuration file, where that is of several.")]
EstimatorOption = Annotated[str | None, typer.Option(help="fleet, qu_zhang, or a plug-in.")]


def export(
    file: RecordingArgument,
    ranges: RangesOption = None,
    out: Annotated[
        Path | None, typer.Option(help="Directory for the files; that of the recording unless told.", metavar="DIR")
    ] = None,
    parquet: Annotated[bool, typer.Option("--parquet", help="Write the table as Parquet too (extra parquet).")] = False,
    config: ConfigOption = None,
    fleet: FleetOption = None,
    estimator: EstimatorOption = None,
) -> None:
    """Write a recorded flight as CSV, GeoJSON and KML, and as Parquet if wanted."""
    from gcs_coloc.recorder.formats import FlightTables, write_all

    if out is not None:
        make_output_directory(out, "--out")
    base = (out if out is not None else file.parent) / file.stem
    tables = FlightTables(base, ["csv", "parquet"] if parquet else ["csv"])
    with writing(base.parent, "" if out is None else "--out"):
        history = _open(file, settings_for(config, fleet, estimator), ranges, None, tables.add)
        tables.close()
        files = [*tables.files, *write_all(history, base)]
    print(f"{', '.join(map(str, files))}: tracks of {counted(len(history.tracks), 'vehicle')}")


def report(
    file: RecordingArgument,
    ranges: RangesOption = None,
    truth: Annotated[
        Path | None, typer.Option(help="True positions, for scoring: unix_s,sysid,lat_deg,lon_deg,alt_msl_m.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="The page; FILE.html beside the recording unless told.", metavar="FILE")
    ] = None,
    config: ConfigOption = None,
    fleet: FleetOption = None,
    estimator: EstimatorOption = None,
) -> None:
    """Write one self-contained HTML page of a recorded flight."""
    from gcs_coloc.recorder.html_report import page

    check_output_file(out, "--out")
    check_drawing()
    history = _open(file, settings_for(config, fleet, estimator), ranges, truth)
    path = out if out is not None else file.with_suffix(".html")
    with writing(path, "" if out is None else "--out"):
        path.write_text(page(history), encoding="utf-8")
    print(path)


def settings_for(
    config: Path | None, fleet: str | None, estimator: str | None, flags: Mapping[str, Any] | None = None
) -> Settings:
    """The settings of one fleet, with another estimator where `estimator` names one, and further `flags`."""
    named = {"estimator": {"name": estimator}} if estimator is not None else {}
    return load_settings(config, named | dict(flags or {}), fleet)


def _open(
    file: Path,
    settings: Settings,
    ranges: Path | None,
    truth: Path | None,
    on_snapshot: Callable[[FleetSnapshot], None] | None = None,
) -> FlightHistory:
    history = read_history(file, settings, ranges, truth, on_snapshot)
    warn_of_damage(file, history.damage)
    warn_of_findings(file, history.findings)
    return history


def warn_of_damage(file: Path, damage: Mapping[str, int]) -> None:
    """Print on stderr what of a recording could not be read."""
    for kind, amount in damage.items():
        print(f"gcs-coloc: warning: {file}: {kind.replace('_', ' ')}: {amount}; replayed what is whole", file=sys.stderr)


def warn_of_findings(path: Path, findings: Iterable[DataFinding]) -> None:
    """Print on stderr what in a recording or data set does not agree, one line each."""
    for finding in findings:
        print(f"gcs-coloc: warning: {path}: {finding.text}", file=sys.stderr)
