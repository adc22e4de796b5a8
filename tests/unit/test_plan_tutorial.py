"""The tutorial on plans holds what it says: its last command, on the plans that come with it, finds enough of a fix."""

import re
from pathlib import Path

from typer.testing import CliRunner

from gcs_coloc.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
TUTORIAL = (ROOT / "docs/tutorial/plan-a-flight.md").read_text(encoding="utf-8")


def test_the_last_plan_of_the_tutorial_is_good_enough(monkeypatch):
    monkeypatch.chdir(ROOT / "examples/plans")
    (command,) = re.findall(r"    gcs-coloc (plan .*--require .*)", TUTORIAL.replace("\\\n", ""))
    ran = CliRunner().invoke(app, [*command.split(), "--no-improve", "--jobs", "1"])
    assert ran.exit_code == 0, ran.output
    assert ran.stdout.count("%") >= 3
