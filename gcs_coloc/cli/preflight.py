"""Preflight commands: `gcs-coloc check-config`, `gcs-coloc example-config`, `gcs-coloc doctor`."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from gcs_coloc.cli.flags import UdpOption, given, links_of
from gcs_coloc.config.examples import EXAMPLES
from gcs_coloc.config.fleets import PER_FLEET, FleetOf, load_fleets, load_settings
from gcs_coloc.core.errors import UsageError
from gcs_coloc.core.stations.node_id import LARGEST_READ_SYSTEM_ID
from gcs_coloc.doctor.finding import Setup
from gcs_coloc.doctor.listen import listen
from gcs_coloc.doctor.parameter_files import write_parameter_files
from gcs_coloc.doctor.report import Report
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.links.base import check_outs
from gcs_coloc.links.signed_links import SignedLinks, read_key
from gcs_coloc.runtime.clock import ServiceClock, read_host_clock


def check_config(file: Annotated[Path, typer.Argument(help="The configuration file (TOML).", metavar="FILE")]) -> None:
    """Check a configuration file, fleet by fleet.

    Its keys, values, links and estimator are checked, and every file that it names.
    """
    fleets = load_fleets(file, {})
    check_fleets(fleets)
    found = []
    for fleet in fleets:
        whose = f"fleet {fleet.name}: " if fleet.name else ""
        links = f"{len(fleet.settings.links)} link(s)" if fleet.settings.links else "no link: give one with --udp or --link"
        found.append(f"{whose}{links}, estimator {fleet.settings.estimator.name}")
    if fleets[0].settings.service.processes == PER_FLEET:
        found.append("a process for each fleet")
    print(f"{file}: good; {'; '.join(found)}")


def example_config(
    name: Annotated[str, typer.Argument(help="default: every setting with its default; fleets: two fleets.")] = "default",
) -> None:
    """Print an example configuration file, to start one of your own from."""
    examples = {file.stem: file for file in sorted(EXAMPLES.glob("*.toml"))}
    if name not in examples:
        raise UsageError(f"there is no example {name!r}, but {', '.join(examples)}")
    print(examples[name].read_text(encoding="utf-8"), end="")


def doctor(
    udp: UdpOption = None,
    link: Annotated[
        list[str] | None, typer.Option(help="A link to vehicles, by connection string. May be given several times.")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="The configuration file (TOML) of the flight; flags win over it.")] = None,
    fleet: Annotated[str | None, typer.Option(help="Which fleet of the configuration file, where that is of several.")] = None,
    aid: Annotated[
        list[int] | None,
        typer.Option(
            min=1,
            max=LARGEST_READ_SYSTEM_ID,
            help="A vehicle (system id) that is to be located; several times for several. All, unless told.",
        ),
    ] = None,
    seconds: Annotated[float, typer.Option(min=5.0, max=3600.0, help="How long to listen.")] = 15.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
    write_params: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write what is to be set on each vehicle as parameter files for ground stations."),
    ] = None,
) -> None:
    """Check the set-up before a flight: the vehicles' parameters, telemetry, ranges, addresses and clocks."""
    settings = load_settings(config, given({"links": links_of(udp, link)}), fleet)
    if not settings.links:
        raise UsageError("no link to listen on; give --udp 14550, another --link, or `links` in the configuration file")
    told = f"listening on {', '.join(settings.links)} for {seconds:g} s"
    clock = ServiceClock()
    survey = asyncio.run(listen(settings, seconds, clock, read_host_clock(clock()), lambda: print(told, file=sys.stderr)))
    setup = Setup(
        settings.mavlink.system_id,
        settings.aiding,
        settings.time.require_synchronised_clock,
        frozenset(aid or ()),
    )
    report = Report(survey, setup)
    if as_json:
        print(json.dumps(report.as_json(), indent=2))
    else:
        print("\n".join(report.lines()))
    if write_params is not None:
        written = list(write_parameter_files(write_params, survey.vehicles, setup))
        for path in written:
            print(f"written: {path}", file=sys.stderr)
        if not written:
            print("no parameter file is written: there is nothing to set", file=sys.stderr)
    if not report.is_ready:
        raise typer.Exit(1)


def check_fleets(fleets: Iterable[FleetOf]) -> None:
    """Check each fleet of a configuration file, and read every file that it names.

    Raises:
        GcsColocError: something is wrong; the text names the fleet, the setting and the remedy.
    """
    # Here, as nothing else in this module needs the packages of page and broker.
    from gcs_coloc.sinks.broker_connection import read_credentials
    from gcs_coloc.web.server import read_token
    from gcs_coloc.web.tiles import TileFile

    for fleet in fleets:
        settings = fleet.settings
        with fleet.named():
            check_outs(settings.out, settings.links)
            SignedLinks(settings.signing, settings.links, settings.out)
            load_estimator(settings.estimator.name, settings.estimator.settings)
            read_credentials(settings.mqtt)
            if settings.standby.key_file:
                read_key(Path(settings.standby.key_file))
            if settings.web.token_file:
                read_token(Path(settings.web.token_file))
            if settings.web.tiles:
                TileFile(Path(settings.web.tiles)).close()
