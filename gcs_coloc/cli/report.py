"""`gcs-coloc report`: a recorded flight as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gcs_coloc.cli.replay import warn_of_damage
from gcs_coloc.cli.warnings import warn_of_findings
from gcs_coloc.config.fleets import load_settings
from gcs_coloc.core.errors import UsageError
from gcs_coloc.recorder.flight_history import read_history
from gcs_coloc.recorder.reports.html_report import page


def report(
    file: Annotated[Path, typer.Argument(help="A recording (tlog).", metavar="FILE.tlog")],
    ranges: Annotated[Path | None, typer.Option(help="Ranges: unix_s,from_sysid,to_sysid,range_m,sigma_m.")] = None,
    truth: Annotated[
        Path | None, typer.Option(help="True positions, for scoring: unix_s,sysid,lat_deg,lon_deg,alt_msl_m.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="The page; FILE.html beside the recording unless told.", metavar="FILE")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="The configuration file (TOML) of the flight.")] = None,
    fleet: Annotated[str | None, typer.Option(help="Which fleet of the configuration file, where that is of several.")] = None,
    estimator: Annotated[str | None, typer.Option(help="fleet, qu_zhang, or a plug-in.")] = None,
) -> None:
    """Write one self-contained HTML page of a recorded flight."""
    settings = load_settings(config, {"estimator": {"name": estimator}} if estimator is not None else {}, fleet)
    history = read_history(file, settings, ranges, truth)
    warn_of_damage(file, history.damage)
    warn_of_findings(file, history.findings)
    path = out if out is not None else file.with_suffix(".html")
    try:
        path.write_text(page(history), encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None
    print(path)
