"""The parameters that are flown are those of the guide, but for those of which the page on these flights says otherwise."""

from __future__ import annotations

import re
from pathlib import Path

from simulators import GUIDE

HOW_TO = Path(__file__).resolve().parents[2] / "docs/how-to"


def test_each_parameter_of_the_guide_is_flown_or_named_as_an_exception():
    table = (HOW_TO / "set-up-ardupilot.md").read_text(encoding="utf-8").split("\n\n")[2]
    asked = {name: float(value) for name, value in re.findall(r"^\| `([A-Z0-9_]+)`[^|]*\| (\d+) \|", table, re.MULTILINE)}
    assert len(asked) == 5
    page = (HOW_TO / "fly-real-autopilots.md").read_text(encoding="utf-8")
    others = {name for name, value in asked.items() if GUIDE.get(name) != value}
    assert others == {name for name in asked if f"`{name}`" in page}
