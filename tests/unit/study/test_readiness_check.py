"""The check of readiness compares what was told with what came, and takes GPS at a random time."""

from __future__ import annotations

import json
from dataclasses import replace
from math import nan
from types import SimpleNamespace

import pytest
from recordings import recording
from typer.testing import CliRunner

from gcs_coloc.cli.main import app
from gcs_coloc.core.errors import UsageError
from gcs_coloc.runtime.tasks import KeptResults, Workers
from gcs_coloc.study import readiness_check
from gcs_coloc.study.readiness_check import Loss, check_table, run_checks

AS_TOLD = Loss("planes", "ready", 2.0, 14.0, 1.1, True, 2.1, 2.5, 15.0, 1.0, 1.5, True)


def cells(*losses: Loss) -> list[str]:
    """Return the row of all losses."""
    return [list(column.cells)[-1] for column in check_table(losses).columns]


def test_ratios_and_counts_are_those_of_the_losses() -> None:
    far = replace(AS_TOLD, bound_m=5.0, hpl_m=29.0, hdop=2.6, error_m=4.0, has_fix=False)
    not_claimed = replace(AS_TOLD, is_told=False)
    assert cells(AS_TOLD, not_claimed, far) == [
        "all", "3", "1.05", "2 of 3", "1 of 2", "0 of 2", "2 of 2", "1.07", "2 of 3", "2 of 3", "2 of 3", "-",
    ]  # fmt: skip


def test_what_was_not_told_or_not_stated_is_no_ratio_but_counts_for_the_fix() -> None:
    none = Loss("one-peer", "not_ready", nan, nan, nan, False, nan, nan, nan, nan, nan, False)
    assert cells(none) == ["all", "1", "-", "-", "-", "-", "-", "-", "-", "-", "-", "1 of 1"]


def test_a_flight_is_told_of_before_its_loss_and_comes_as_told() -> None:
    """The geometry of this flight stays what it is: the size of the bound is told."""
    [loss] = run_checks(["planes"], [], 1, Workers(), lambda *_: None, first_seed=3)
    assert loss.is_told
    assert loss.state == "ready"
    assert loss.has_fix
    assert loss.bound_ratio == pytest.approx(1.0, abs=0.5)
    assert 0.0 < loss.error_m < loss.hpl_m


def test_in_a_recording_the_operators_override_takes_gps() -> None:
    flight = recording("arduplane-flights/loss") / "flight.tlog"
    [loss] = run_checks([], [str(flight)], 1, Workers(), lambda *_: None)
    assert loss.kind == "loss"
    assert loss.error_m < loss.hpl_m


def test_a_recording_has_the_tables_that_judge_gives_it(tmp_path, monkeypatch) -> None:
    replayed: list[list[float]] = []

    def of_nothing(engine, log, ranges, on_poll):
        replayed.append([one.range_m for one in ranges])
        return SimpleNamespace(next_s=None)

    monkeypatch.setattr(readiness_check, "Replay", of_nothing)
    for name in ("mine.tlog", "another.tlog"):
        (tmp_path / name).write_bytes(b"frames")
    (tmp_path / "mine.ranges.csv").write_text("unix_s,from_sysid,to_sysid,range_m\n1780000000.0,4,1,812.5\n")
    (tmp_path / "truth.csv").write_text("of neither: the directory holds two recordings\n")
    assert run_checks([], [str(tmp_path / "mine.tlog")], 1, Workers(), lambda *_: None) == []
    assert replayed == [[812.5]]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["--class", "nonsense"], "no class 'nonsense'"), (["--recording", "none.tlog"], "none.tlog: there is no such recording")],
)
def test_what_there_is_not_is_named(arguments: list[str], words: str) -> None:
    result = CliRunner().invoke(app, ["study", "readiness", *arguments])
    assert result.exit_code != 0
    assert isinstance(result.exception, UsageError)
    assert words in str(result.exception)


def test_a_check_goes_on_where_it_was_stopped_unless_the_recording_has_changed(tmp_path, monkeypatch) -> None:
    seen: list[tuple[str, int]] = []
    monkeypatch.setattr(readiness_check, "_fly", lambda name, seed: seen.append((name, seed)))
    monkeypatch.setattr(readiness_check, "_replay", lambda path, draw, from_s: seen.append((path.name, draw)))
    flight, kept = tmp_path / "flight.tlog", KeptResults(tmp_path / "kept")
    flight.write_bytes(b"frames")

    def check(seeds: int) -> None:
        run_checks(["planes"], [str(flight)], seeds, Workers(), lambda *_: None, kept=kept)

    check(1)
    check(2)
    assert seen == [("planes", 1), ("flight.tlog", 1), ("planes", 2), ("flight.tlog", 2)]
    (tmp_path / "truth.csv").write_text("unix_s\n")
    check(1)
    assert seen[4:] == [("flight.tlog", 1)]


def test_every_loss_comes_as_json() -> None:
    result = CliRunner().invoke(app, ["study", "readiness", "--class", "one-peer", "--seeds", "1", "--jobs", "1", "--json"])
    [loss] = json.loads(result.stdout)
    assert loss["kind"] == "one-peer"
    assert loss["state"] == "not_ready"
