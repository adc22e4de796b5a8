"""Flags of several commands, and the settings that they state."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Annotated, Any

import typer

from gcs_coloc.core.errors import UsageError

UdpOption = Annotated[
    list[str] | None, typer.Option(help="Listen for vehicles on a UDP port: PORT or HOST:PORT. May be given several times.")
]


class LogLevel(str, Enum):  # noqa: UP042 - typer shows the values of a str Enum as choices
    """How much is logged."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


def given(flags: Mapping[str, Any]) -> dict[str, Any]:
    """Return the flags that were given: those that are neither None nor empty, in their tables too."""
    tables = {key: given(value) if isinstance(value, Mapping) else value for key, value in flags.items()}
    return {key: value for key, value in tables.items() if value not in (None, [], {})}


def links_of(udp: list[str] | None, link: list[str] | None) -> list[str]:
    """Return the links to vehicles that --udp and --link name."""
    return [*(f"udpin:{where}" for where in udp or ()), *(link or ())]


def web_flags(web: str | None, no_web: bool) -> dict[str, Any]:
    """Return the settings of the page that --web or --no-web states.

    Raises:
        UsageError: both are stated.
    """
    if web is not None and no_web:
        raise UsageError("--web and --no-web exclude each other")
    return {"on": not no_web, "address": web} if web is not None or no_web else {}
