"""`sitl-fakes SCENARIO`: fly a scenario in real time.

The vehicles send MAVLink to a ground station.
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from sitl_fakes.fleet import Fleet
from sitl_fakes.scenario import FakesError, ScenarioError, load_scenario, shipped_scenarios
from sitl_fakes.shell import Address, TruthFile, run

# Newer Typers carry a Click of their own inside; this names the base of their usage errors in either case.
_BadCommandLine: type[Exception] = typer.BadParameter.__bases__[0]

_EXAMPLE_GROUP = "239.255.40.4:14600"

_app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _address(option: str, text: str, example: str) -> Address:
    host, colon, port = text.rpartition(":")
    if not colon or not host or not port.isascii() or not port.isdigit() or not 0 < int(port) < 65536:
        raise ScenarioError(f"{option} {text!r}: expected HOST:PORT, for example {example}")
    return host.removeprefix("[").removesuffix("]"), int(port)


def _group(text: str) -> Address:
    address = _address("--airspace", text, _EXAMPLE_GROUP)
    try:
        if ipaddress.IPv4Address(address[0]).is_multicast:
            return address
    except ValueError:
        pass
    raise ScenarioError(f"--airspace {text!r}: expected an IPv4 multicast group, for example {_EXAMPLE_GROUP}")


def _list(wanted: bool) -> None:
    if wanted:
        for name, description in shipped_scenarios().items():
            print(f"{name:<12} {description}")
        raise typer.Exit


@_app.command()
def fly(
    scenario: Annotated[
        str, typer.Argument(help="A scenario that comes with the program, as paper (see --list), or a scenario file (TOML).")
    ],
    target: Annotated[str, typer.Option(help="Where the vehicles send to, HOST:PORT.")] = "127.0.0.1:14550",
    seed: Annotated[int, typer.Option(min=0, help="Seed of every random draw.")] = 1,
    vehicle: Annotated[
        list[int] | None, typer.Option(help="System id of a vehicle that has a socket (may be repeated); all of them fly.")
    ] = None,
    duration: Annotated[float | None, typer.Option(min=0.0, help="Seconds to fly; default: the scenario's.")] = None,
    truth: Annotated[Path | None, typer.Option(help="Write the true positions to this CSV file.")] = None,
    port_base: Annotated[
        int | None, typer.Option(min=1, max=65280, help="Bind vehicle N to port PORT_BASE + N; default: any free port.")
    ] = None,
    airspace: Annotated[
        str | None,
        typer.Option(
            metavar="GROUP:PORT",
            help="Fly only the vehicles of --vehicle; the others are flown by other processes in this multicast group.",
        ),
    ] = None,
    listed: Annotated[
        bool,
        typer.Option("--list", callback=_list, is_eager=True, help="List the scenarios that come with it, and exit."),
    ] = False,
) -> None:
    """Fly a scenario in real time over UDP: simulated ArduPilot and PX4 aircraft that speak MAVLink."""
    del listed
    address = _address("--target", target, "127.0.0.1:14550")
    group = None if airspace is None else _group(airspace)
    if group is not None and not vehicle:
        raise ScenarioError("--airspace: name the vehicles to fly here with --vehicle")
    plan = load_scenario(scenario)
    known = [v.sysid for v in plan.vehicle]
    for sysid in vehicle or []:
        if sysid not in known:
            raise ScenarioError(f"--vehicle {sysid}: {scenario} has only {', '.join(map(str, known))}")
    fleet = Fleet(plan, seed, unix_epoch_s=time.time(), sysids=None if group is None else vehicle)
    try:
        truth_file = TruthFile(truth) if truth else None
    except OSError as error:
        raise FakesError(f"cannot write {truth}: {error.strerror}") from error
    flight_s = plan.duration_s if duration is None else duration
    logging.info("%s: %d vehicles to %s for %g s, seed %d", plan.name, len(fleet.sysids), target, flight_s, seed)
    try:
        asyncio.run(
            run(fleet, target=address, duration_s=flight_s, sysids=vehicle, port_base=port_base, truth=truth_file, airspace=group)
        )
    finally:
        if truth_file:
            truth_file.close()


def main() -> None:
    """Run the command line; a deliberate error is one line on stderr and its exit code."""
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    try:
        code = _app(standalone_mode=False)
    except _BadCommandLine as error:
        _fail(f"{error.format_message()} (see sitl-fakes --help)", 2)  # type: ignore[attr-defined]
    except (typer.Abort, KeyboardInterrupt):
        _fail("interrupted", 130)
    except FakesError as error:
        _fail(str(error), error.exit_code)
    else:
        sys.exit(code or 0)


def _fail(text: str, code: int) -> None:
    print(f"sitl-fakes: {' '.join(text.split())}", file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    main()
