"""`gcs-coloc watch`: all fleets of all hosts on one page, from MQTT alone."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlsplit

import typer

from gcs_coloc.cli.flags import LogLevel, given, web_flags
from gcs_coloc.config.settings import settings_of
from gcs_coloc.core.errors import ConfigError, UsageError
from gcs_coloc.runtime.checked_tables import read_toml

DEFAULT_PAGE = "127.0.0.1:8081"
"""Where the page is unless told: beside that of a service on the same computer, which is on 8080."""
_SECTIONS = ("mqtt", "web")


def watch(
    mqtt: Annotated[
        str | None, typer.Option(help="The MQTT broker: HOST or HOST:PORT; port 1883 unless told.", metavar="HOST[:PORT]")
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            help="A configuration file (TOML): its sections mqtt (broker, user, TLS) and web are used; flags win over it."
        ),
    ] = None,
    web: Annotated[str | None, typer.Option(help=f"Address of the page, HOST:PORT or PORT; {DEFAULT_PAGE} unless told.")] = None,
    no_web: Annotated[bool, typer.Option("--no-web", help="Serve no page; the terminal's table alone.")] = False,
    log_level: Annotated[LogLevel, typer.Option(help="How much is logged.")] = LogLevel.INFO,
) -> None:
    """Show all fleets of all hosts that publish on an MQTT broker, until Ctrl-C.

    It sends nothing to anybody.
    """
    from gcs_coloc.service.watch import Watch
    from gcs_coloc.sinks.console import log_to_stderr, terminal_of

    table = read_toml(config, ConfigError) if config is not None else {}
    used: dict[str, Any] = {key: table[key] for key in _SECTIONS if key in table}
    flags = given({"mqtt": _broker(mqtt) if mqtt is not None else None, "web": web_flags(web, no_web)})
    settings = settings_of([used], flags, str(config) if config is not None else "settings")
    if not settings.mqtt.host:
        raise UsageError("no broker: --mqtt HOST[:PORT], or a --config with host in [mqtt]")
    page = settings.web if settings.web.must_open else settings.web.model_copy(update={"address": DEFAULT_PAGE})
    shown = Watch(settings.mqtt, page)
    terminal = terminal_of(sys.stdout)
    log_to_stderr(log_level.value.upper(), terminal)
    asyncio.run(shown.run(terminal))


def _broker(text: str) -> dict[str, Any]:
    try:
        parts = urlsplit(f"//{text}")
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if host is None or port == 0 or any(mark in text for mark in "/?#@"):
        raise UsageError(f"--mqtt {text}: is not HOST or HOST:PORT, as broker.example:1883")
    return given({"host": host, "port": port})
