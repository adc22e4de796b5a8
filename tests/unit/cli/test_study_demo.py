"""The demo's own command line: a mistake ends in one line."""

from __future__ import annotations

from command_line import gcs_coloc


def test_a_scenario_that_is_not_there_is_named_in_one_line(tmp_path):
    arguments = ["--scenario", str(tmp_path / "none.toml"), "--out", str(tmp_path / "out")]
    demo = gcs_coloc("study", "demo", *arguments)
    assert (demo.returncode, demo.stdout) == (2, "")
    said = "no such file, and no scenario of that name; see sitl-fakes --list"
    assert demo.stderr == f"gcs-coloc: error: {tmp_path / 'none.toml'}: {said}\n"
