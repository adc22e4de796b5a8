"""The main command: plain `gcs-coloc --udp 14550` runs the service; everything else is a subcommand."""

from __future__ import annotations

import asyncio
import errno
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from gcs_coloc import __version__
from gcs_coloc.cli.flags import LogLevel, UdpOption, given, links_of, web_flags
from gcs_coloc.core.errors import GcsColocError, UsageError
from gcs_coloc.runtime.process import NOBODY_READS, discard_output, importing, one_thread, open_all

if TYPE_CHECKING:
    from gcs_coloc.config.fleets import FleetOf
    from gcs_coloc.sinks.terminal import SharedConsole

PROGRAM = "gcs-coloc"

# Newer Typers carry a Click of their own inside; this names the base of their usage errors in either case.
_BadCommandLine: type[Exception] = typer.BadParameter.__bases__[0]

# Exit codes, as shells and Click have them; 130 is 128 and the number of SIGINT.
_FAILED, _MISUSED, _INTERRUPTED = 1, 2, 130

_WRONG_PATH = {errno.EACCES, errno.EPERM, errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR, errno.EISDIR, errno.EROFS}
"""What is wrong with a path that a user states, and no fault of the program."""

DEFAULT_LINK = "udpin:0.0.0.0:14550"
"""Where vehicles are heard unless told: MAVLink's customary port of ground stations, as in the example configuration."""

SUBCOMMANDS = {
    "check-config": "preflight",
    "example-config": "preflight",
    "doctor": "preflight",
    "replay": "replay",
    "export": "recordings",
    "report": "recordings",
    "evaluate": "evaluate",
    "judge": "judge",
    "calibrate": "calibrate",
    "import": "import_data",
    "plan": "plan",
    "study": "study",
    "watch": "watch",
}
"""Command to the module beside this one that has it: as a function of the command's name, or as its `app`."""


class LateCommands(TyperGroup):
    """A command group that imports the module of a command of `SUBCOMMANDS` when it is first used."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Every command's name."""
        return [*super().list_commands(ctx), *SUBCOMMANDS]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of that name, or None."""
        if cmd_name not in SUBCOMMANDS:
            return super().get_command(ctx, cmd_name)
        module = import_module(f"gcs_coloc.cli.{SUBCOMMANDS[cmd_name]}")
        if hasattr(module, "app"):
            return typer.main.get_command(module.app)
        alone = typer.Typer(add_completion=False)
        alone.command(cmd_name)(getattr(module, cmd_name.replace("-", "_")))
        return typer.main.get_command(alone)


app = typer.Typer(
    name=PROGRAM,
    cls=LateCommands,
    help="Locates MAVLink vehicles whose GPS has failed from their ranges to neighbours, and sends them their position.",
    epilog="Example: gcs-coloc --udp 14550",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command line of `gcs-coloc`; the entry point of the program.

    A user's mistake ends in one line on stderr and exit code 2 or 1, never in a traceback.
    """
    one_thread()
    open_all()
    try:
        status = app(prog_name=PROGRAM, standalone_mode=False)
        sys.stdout.flush()
    except _BadCommandLine as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context is not None else PROGRAM
        _fail(f"{error.format_message().replace('Value error, ', '')} (see {command} --help)", _MISUSED)  # type: ignore[attr-defined]
    except GcsColocError as error:
        _fail(str(error), _MISUSED if isinstance(error, UsageError) else _FAILED)
    except (typer.Abort, KeyboardInterrupt):
        sys.exit(_INTERRUPTED)
    except OSError as error:
        if error.errno in _WRONG_PATH and error.filename is not None:
            _fail(f"{error.filename}: {error.strerror}; state another path, or give this user access to it", _MISUSED)
        if error.errno not in NOBODY_READS or error.filename is not None:
            raise
        discard_output()
        if error.errno == errno.EPIPE:  # the reader, such as `head`, has what it wanted
            sys.exit(_FAILED)
        _fail(f"the output cannot be written: {error.strerror}", _FAILED)
    sys.exit(status if isinstance(status, int) else 0)


def _work(fleet: FleetOf, descriptor: int, level: str, terminal: SharedConsole | None) -> None:
    """Run one fleet as a worker of the supervisor whose socket `descriptor` is.

    Every line of its log begins with the fleet's name.
    """
    from gcs_coloc.service.service import Service
    from gcs_coloc.service.worker import SupervisorLink
    from gcs_coloc.sinks.console import log_to_stderr, log_uncaught

    log_to_stderr(level, terminal, f"{fleet.name}: ")
    log_uncaught()
    with fleet.named():
        asyncio.run(Service([replace(fleet, name="")], SupervisorLink(descriptor)).run(terminal))


def _fail(text: str, code: int) -> None:
    print(f"{PROGRAM}: error: {' '.join(text.split())}", file=sys.stderr)
    sys.exit(code)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"{PROGRAM} {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def run(
    context: typer.Context,
    udp: UdpOption = None,
    link: Annotated[
        list[str] | None,
        typer.Option(
            help="A link to vehicles: udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or "
            "serial:DEVICE:BAUD. May be given several times."
        ),
    ] = None,
    out: Annotated[
        list[str] | None,
        typer.Option(
            help="A ground tool to hand the vehicles' frames on to and take commands from: udp:HOST:PORT, udpin:HOST:PORT, "
            "tcp:HOST:PORT, tcpin:HOST:PORT or serial:DEVICE:BAUD. May be given several times."
        ),
    ] = None,
    config: Annotated[Path | None, typer.Option(help="A configuration file (TOML); flags win over it.")] = None,
    estimator: Annotated[
        str | None, typer.Option(help="fleet, qu_zhang, or a plug-in: package.module:Class or path/to/file.py:Class.")
    ] = None,
    failed: Annotated[
        list[int] | None,
        typer.Option(help="Declare the GPS of this system id failed, whatever it says. Several times for several."),
    ] = None,
    healthy: Annotated[
        list[int] | None,
        typer.Option(help="Declare the GPS of this system id healthy, whatever it says. Several times for several."),
    ] = None,
    web: Annotated[
        str | None, typer.Option(help="Address of the live page, HOST:PORT or PORT; 127.0.0.1:8080 unless told.")
    ] = None,
    no_web: Annotated[bool, typer.Option("--no-web", help="Serve no live page.")] = False,
    peer: Annotated[
        str | None, typer.Option(help="HOST:PORT of the other service of a hot standby, where it listens.", metavar="HOST:PORT")
    ] = None,
    standby: Annotated[
        bool, typer.Option("--standby", help="Start as the service that follows, and takes over where the other one fails.")
    ] = False,
    fleet: Annotated[str | None, typer.Option(help="Run this fleet of the configuration file alone.", metavar="NAME")] = None,
    record: Annotated[str | None, typer.Option(help="Record the flight in this directory.", metavar="DIR")] = None,
    log_level: Annotated[LogLevel, typer.Option(help="How much is logged.")] = LogLevel.INFO,
    supervisor: Annotated[int | None, typer.Option(hidden=True, help="The descriptor of the supervisor's socket.")] = None,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Run the service on the links that are given, until Ctrl-C, SIGTERM or SIGHUP."""
    del version
    if context.invoked_subcommand is not None:
        return
    with importing():
        from gcs_coloc.config.fleets import PER_FLEET, load_fleets, naming
        from gcs_coloc.service.service import Service
        from gcs_coloc.sinks.console import log_to_stderr, terminal_of

    if record == "":
        raise UsageError("--record '': names no directory; . is the one you are in")
    flags = given(
        {
            "links": links_of(udp, link),
            "out": out,
            "estimator": {"name": estimator},
            "fleet": {"failed": failed, "healthy": healthy},
            "web": web_flags(web, no_web),
            "record": {"directory": record},
            "standby": {"peer": peer, "role": "standby" if standby else None},
        }
    )
    with naming(fleet or "" if supervisor is not None else ""):
        fleets = load_fleets(config, flags, fleet, is_checked=supervisor is not None)
    if config is None and not fleets[0].settings.links:
        fleets = load_fleets(None, flags | {"links": [DEFAULT_LINK]})
    if not all(fleet.settings.links for fleet in fleets):
        raise UsageError(f'{config}: no link to listen on; give `links` in it, as links = ["{DEFAULT_LINK}"], or --udp 14550')
    terminal = terminal_of(sys.stdout)
    level = log_level.value.upper()
    if supervisor is not None and fleet is not None:
        _work(fleets[0], supervisor, level, terminal)
    elif fleet is None and fleets[0].settings.service.processes == PER_FLEET:
        from gcs_coloc.cli.preflight import check_fleets
        from gcs_coloc.service.supervisor import Supervisor

        check_fleets(fleets)  # what is wrong from the start ends it here, and no worker is started again and again for it
        log_to_stderr(level, None)
        # As it was started itself, whatever the Python and its options.
        asyncio.run(Supervisor(fleets, [sys.executable, *sys.orig_argv[1:]]).run())
    else:
        log_to_stderr(level, terminal)
        asyncio.run(Service(fleets).run(terminal))
