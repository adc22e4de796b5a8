"""The reference of the fakes is complete: every scenario key, fault, option, parameter and truth column stands in it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import typer
from pydantic import BaseModel

from sitl_fakes import cli, faults, scenario
from sitl_fakes.flight import CSV_HEADER
from sitl_fakes.parameters import DEFAULTS

REFERENCE = Path(__file__).resolve().parents[3] / "docs" / "reference"
SCENARIOS = (REFERENCE / "scenarios.md").read_text(encoding="utf-8")
PROGRAM = (REFERENCE / "sitl-fakes.md").read_text(encoding="utf-8")
TABLES = {
    "origin": scenario.Origin,
    "wind": scenario.Wind,
    "gps": scenario.Gps,
    "ranging": scenario.Ranging,
    "telemetry": scenario.Telemetry,
    "dead_reckoning": scenario.DeadReckoning,
    "[vehicle]": scenario.Vehicle,
}


def section(heading):
    start = SCENARIOS.index(heading)
    end = SCENARIOS.find("\n## ", start + 1)
    return SCENARIOS[start : end if end > 0 else None]


def as_written(default):
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, float) and default == int(default):
        return str(int(default))
    return str(default)


@pytest.mark.parametrize(
    ("heading", "model"), [("## Top level", scenario.Scenario), *((f"## `[{k}]`", m) for k, m in TABLES.items())]
)
def test_every_key_of_a_scenario_is_in_its_section_with_its_default(heading, model):
    text = section(heading)
    for key, field in model.model_fields.items():
        default = field.default
        if key in TABLES or key in ("vehicle", "station", "fault"):
            continue
        assert f"`{key}`" in text, key
        if isinstance(default, int | float) and not isinstance(default, bool):
            row = next(line for line in text.splitlines() if f"`{key}`" in line)
            assert re.search(rf"(?<![\d.]){re.escape(as_written(default))}(?![\d.]*\d)", row), (key, default)


def test_every_fault_and_its_keys_are_in_the_reference():
    text = section("## `[[fault]]`")
    kinds = [c for c in vars(faults).values() if isinstance(c, type) and issubclass(c, BaseModel) and "kind" in c.model_fields]
    assert len(kinds) == 10
    for model in kinds:
        row = next(line for line in text.splitlines() if line.startswith(f"| `{model.model_fields['kind'].default}`"))
        for key in set(model.model_fields) - {"kind", "vehicle", "at_s", "until_s"}:
            assert f"`{key}`" in row, (model, key)


def test_every_option_parameter_and_truth_column_is_in_the_reference():
    options = [name for p in typer.main.get_command(cli._app).params for name in p.opts if name.startswith("--")]
    assert len(options) >= 6
    for word in [*options, *DEFAULTS["ardupilot"], *DEFAULTS["px4"], *CSV_HEADER]:
        assert f"`{word}`" in PROGRAM, word
