"""What operators have decided about single vehicles: the overrides in force, and where each came from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from gcs_coloc.core.messages.control import AidingOverride, CommandSource, GpsOverride, OperatorCommand, Override, PrimaryOverride
from gcs_coloc.core.messages.outbound import Notice

_WHAT: Mapping[type[Override], str] = {GpsOverride: "GPS", AidingOverride: "aiding", PrimaryOverride: "GPS_PRIMARY"}
_Kind = TypeVar("_Kind", GpsOverride, AidingOverride, PrimaryOverride)


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

    def of(self, sysid: int, kind: type[_Kind]) -> _Kind:
        """Return what was decided of a vehicle, AUTO where nothing was."""
        command = self._commands.get((sysid, kind))
        return command.override if command is not None and isinstance(command.override, kind) else kind.AUTO

    def source(self, sysid: int, kind: type[Override]) -> CommandSource | None:
        """Return who decided it; None where it is automatic."""
        command = self._commands.get((sysid, kind))
        return command.source if command is not None and command.override is not kind.AUTO else None

    def in_force(self) -> tuple[OperatorCommand, ...]:
        """Return the commands that are in force, those that are automatic left out."""
        return tuple(command for command in self._commands.values() if command.override.value != "auto")
