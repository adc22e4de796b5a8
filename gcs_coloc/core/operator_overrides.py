"""What operators have decided about single vehicles: the overrides in force, and where each came from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from gcs_coloc.core.messages.control import (
    AidingOverride,
    CommandSource,
    GpsOverride,
    OperatorCommand,
    Override,
    PrimaryOverride,
)
from gcs_coloc.core.messages.outbound import Notice

_WHAT: Mapping[type[Override], str] = {GpsOverride: "GPS", AidingOverride: "aiding", PrimaryOverride: "GPS_PRIMARY"}


class OverrideSources(NamedTuple):
    """Where the overrides of one vehicle came from; None for one that is not in force."""

    gps: CommandSource | None
    aiding: CommandSource | None
    primary: CommandSource | None


class OperatorOverrides:
    """The newest command of each kind for each vehicle."""

    def __init__(self) -> None:
        self._commands: dict[tuple[int, type[Override]], OperatorCommand] = {}

    def add(self, command: OperatorCommand) -> Notice:
        """Keep a command; returns what people are told of it."""
        override = command.override
        self._commands[command.sysid, type(override)] = command
        by = f", by {command.source}" if command.source is not None else ""
        text = f"operator: {_WHAT[type(override)]} {override.value}{by}"
        return Notice(command.received_at_s, command.sysid, "info", text)

    def in_force(self) -> tuple[OperatorCommand, ...]:
        """Return the commands that are in force, those that are automatic left out."""
        return tuple(command for command in self._commands.values() if command.override.value != "auto")

    def sources(self, sysid: int) -> OverrideSources:
        """Return who gave each override of a vehicle that is in force."""
        given = [self._commands.get((sysid, kind)) for kind in _WHAT]
        gps, aiding, primary = (one.source if one is not None and one.override.value != "auto" else None for one in given)
        return OverrideSources(gps, aiding, primary)
