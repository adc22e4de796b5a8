"""The subcommands, each imported when it is called: the service is to start without what only they need."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup

SUBCOMMANDS = {
    "check-config": "configuration",
    "example-config": "configuration",
    "doctor": "doctor",
    "replay": "replay",
    "export": "export",
    "report": "report",
    "evaluate": "evaluate",
    "study": "study",
}
"""Command to the module beside this one that has it: as a function of the command's name, or as its `app`."""


class LateCommands(TyperGroup):
    """A command group whose members `SUBCOMMANDS` are not imported before they are asked for."""

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
