"""`gcs-coloc export`: writes a recorded flight in every export format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gcs_coloc.cli.replay import warn_of_damage
from gcs_coloc.cli.warnings import warn_of_findings
from gcs_coloc.config.fleets import load_settings
from gcs_coloc.core.errors import UsageError
from gcs_coloc.recorder.flight_history import read_history
from gcs_coloc.recorder.formats import write_all


def export(
    file: Annotated[Path, typer.Argument(help="A recording (tlog).", metavar="FILE.tlog")],
    ranges: Annotated[Path | None, typer.Option(help="Ranges: unix_s,from_sysid,to_sysid,range_m,sigma_m.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Directory for the files; that of the recording unless told.", metavar="DIR")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="The configuration file (TOML) of the flight.")] = None,
    fleet: Annotated[str | None, typer.Option(help="Which fleet of the configuration file, where that is of several.")] = None,
    estimator: Annotated[str | None, typer.Option(help="fleet, qu_zhang, or a plug-in.")] = None,
) -> None:
    """Write a recorded flight as CSV, GeoJSON and KML."""
    settings = load_settings(config, {"estimator": {"name": estimator}} if estimator is not None else {}, fleet)
    history = read_history(file, settings, ranges, None)
    warn_of_damage(file, history.damage)
    warn_of_findings(file, history.findings)
    base = (out if out is not None else file.parent) / file.stem
    try:
        base.parent.mkdir(parents=True, exist_ok=True)
        files = write_all(history, base)
    except OSError as error:
        raise UsageError(f"{error.filename or base.parent}: cannot be written: {error.strerror}") from None
    print(f"{', '.join(map(str, files))}: tracks of {len(history.tracks)} vehicles")
