"""The reference is complete: every command, option and setting stands in it, with its default."""

import dataclasses
import tomllib
from pathlib import Path

import pytest
import typer
from pydantic import BaseModel

from gcs_coloc.cli.main import app
from gcs_coloc.config.settings import Settings

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


def keys() -> list[tuple[str, str, object]]:
    found = []
    settings = Settings()
    for name in Settings.model_fields:
        value = getattr(settings, name)
        if isinstance(value, BaseModel):
            found += [(name, key, getattr(value, key)) for key in type(value).model_fields]
        elif dataclasses.is_dataclass(value):
            found += [(name, f.name, getattr(value, f.name)) for f in dataclasses.fields(value)]
        else:
            found.append(("", name, value))
    return found


@pytest.mark.parametrize(("section", "key", "default"), keys())
def test_every_setting_is_in_the_reference_with_its_default(section, key, default):
    start = CONFIGURATION.index(f"`[{section}]`") if section else 0
    row = CONFIGURATION.find(f"\n| `{key}` |", start)
    assert row >= 0, f"{section}.{key} is not in configuration.md"
    cell = CONFIGURATION[row:].split("|")[2].strip().strip("`")
    if default in ((), {}):
        assert cell == "none"
    else:
        assert cell == (str(default).lower() if isinstance(default, bool) else str(default))


def test_the_default_configuration_file_holds_every_setting_with_its_default():
    file = tomllib.loads((ROOT / "configs/default.toml").read_text(encoding="utf-8"))
    for section, key, default in keys():
        if key == "links":
            continue
        value = file[section][key] if section else file[key]
        assert (tuple(value) if isinstance(value, list) else value) == default, f"{section}.{key}"
