"""`gcs-coloc judge` on recordings of simulated flights: figures, comparison, exit codes, going on after a stop."""

import json
import shutil
from pathlib import Path

import pytest
from command_line import gcs_coloc
from recorded_flight import write_flight, write_truth
from recordings import recording

from gcs_coloc.recorder import judging
from gcs_coloc.recorder.judged_flight import FoundRecording, JudgedBy, JudgedFlight, judge_flight
from gcs_coloc.runtime import tasks


@pytest.fixture(scope="module")
def year(tmp_path_factory) -> Path:
    """Two recordings: one with truth, and one that ends before the GPS of vehicle 4 fails."""
    root = tmp_path_factory.mktemp("recordings") / "year"
    for month in ("may", "june"):
        (root / month).mkdir(parents=True)
    write_flight(root / "may/flight.tlog", 6.0)
    truth = write_flight(root / "june/flight.tlog", 25.0)
    write_truth(root / "june/truth.csv", (point for point in truth if point.sysid == 4))
    return root


SEEN: list[str] = []


def see(by: JudgedBy, found: FoundRecording) -> JudgedFlight:
    SEEN.append(found.name)
    return judge_flight(by, found)


def watched(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the recordings that are replayed from here on."""
    monkeypatch.setattr(judging, "judge_flight", see)
    SEEN.clear()
    return SEEN


@pytest.fixture(scope="module")
def baseline(year: Path, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("baseline") / "baseline.json"
    with pytest.MonkeyPatch.context() as monkeypatch:
        watched(monkeypatch)
        ran = gcs_coloc("judge", year, "--write-baseline", path, "--out", path.parent / "out", "--jobs", "1")
    assert ran.returncode == 0, ran.stderr
    assert SEEN == ["year/june/flight.tlog", "year/may/flight.tlog"]
    assert "2 recordings" in ran.stdout
    assert f"written: {path}" in ran.stdout
    return path


@pytest.fixture
def judged(monkeypatch) -> list[str]:
    """The names of the recordings that are replayed."""
    return watched(monkeypatch)


def test_figures_are_those_of_the_flight(baseline: Path) -> None:
    june, may = json.loads(baseline.read_text())["recordings"]

    assert (june["name"], june["has_truth"], may["has_truth"]) == ("year/june/flight.tlog", True, False)
    four = june["vehicles"]["4"]
    assert 10.0 < four["without_gps_s"] < 16.0
    assert four["rmse_m"] < four["p95_m"] < four["most_m"] < 20.0
    assert 0.5 < four["covered_95"] <= 1.0
    assert 0.0 < four["bound_95_m"] < four["hpl_m"]
    assert four["alarm_gps_lost"] == 1.0
    assert may["vehicles"]["4"]["without_gps_s"] == 0.0
    assert "rmse_m" not in may["vehicles"]["4"]


def test_the_same_program_changes_nothing(baseline: Path, year: Path, tmp_path: Path) -> None:
    ran = gcs_coloc("judge", year, "--baseline", baseline, "--out", tmp_path, "--jobs", "2")

    assert ran.returncode == 0, ran.stderr
    assert "against the baseline: 0 worse, 0 better, 0 changed; tolerance 5.0% of metres" in ran.stdout
    result = json.loads((tmp_path / "judge.json").read_text())
    assert result["changes"] == []
    assert result["recordings"] == json.loads(baseline.read_text())["recordings"]


def test_what_got_worse_is_named_and_ends_with_3(baseline: Path, year: Path, tmp_path: Path) -> None:
    ran = gcs_coloc("judge", year, "--baseline", baseline, "--out", tmp_path, "--jobs", "1", "--estimator", "qu_zhang")

    assert ran.returncode == 3
    assert "(estimator fleet, now qu_zhang; settings " in ran.stdout
    changes = json.loads((tmp_path / "judge.json").read_text())["changes"]
    worse = {(c["recording"], c["vehicle"], c["text"]) for c in changes if c["outcome"] == "worse"}
    # The paper's filter has no protection level, so no fix is sent.
    assert ("year/june/flight.tlog", "4", "median protection level, m") in worse
    assert ("year/june/flight.tlog", "4", "sent a fix") in worse
    assert not [change for change in changes if change["recording"] == "year/may/flight.tlog"]


def test_a_run_that_was_stopped_goes_on(baseline: Path, year: Path, tmp_path: Path, judged: list[str]) -> None:
    out = shutil.copytree(baseline.parent / "out", tmp_path / "out")
    first = (out / "judge.json").read_bytes()
    (out / "judge.json").unlink()
    (of_june,) = (path for path in out.glob("*.pickle") if b"june" in path.read_bytes())
    of_june.unlink()

    assert gcs_coloc("judge", year, "--out", out, "--jobs", "1").returncode == 0

    assert judged == ["year/june/flight.tlog"]
    assert (out / "judge.json").read_bytes() == first


def test_another_program_or_file_is_judged_anew(year: Path, tmp_path: Path, judged: list[str], monkeypatch) -> None:
    copy = shutil.copytree(year, tmp_path / "year")
    (copy / "june/flight.tlog").unlink()
    arguments = ("judge", copy, "--out", tmp_path / "out", "--jobs", "1")
    assert [gcs_coloc(*arguments).returncode for _ in range(2)] == [0, 0]
    assert judged == ["year/may/flight.tlog"]

    (copy / "may/ranges.csv").write_text("unix_s,from_sysid,to_sysid,range_m,sigma_m\n")
    gcs_coloc(*arguments)
    assert len(judged) == 2
    monkeypatch.setattr(tasks, "program_versions", lambda: {"source": "another"})
    gcs_coloc(*arguments)
    assert len(judged) == 3

    plug_in = tmp_path / "mine.py"
    plug_in.write_text("from gcs_coloc.estimators.fleet.filter import FleetFilter as Mine\n")
    arguments += ("--estimator", f"{plug_in}:Mine")
    assert [gcs_coloc(*arguments).returncode for _ in range(2)] == [0, 0]
    assert len(judged) == 4
    plug_in.write_text(f"{plug_in.read_text()}# edited\n")
    gcs_coloc(*arguments)
    assert len(judged) == 5


def test_a_recording_that_cannot_be_read_is_named_and_the_others_are_judged(year: Path, baseline: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(year, tmp_path / "year")
    (copy / "broken.tlog").write_bytes(b"no recording" * 100)
    (copy / "june/truth.csv").write_text("unix_s\n1\n")

    ran = gcs_coloc("judge", copy, "--baseline", baseline, "--out", tmp_path / "out", "--jobs", "1")

    assert ran.returncode == 0, ran.stderr
    assert "warning: year/broken.tlog: " in ran.stderr
    assert "warning: year/june/flight.tlog: " in ran.stderr
    assert "truth.csv" in ran.stderr
    assert "3 recordings" in ran.stdout
    assert "2 cannot be read" in ran.stdout


def test_mistakes_end_in_one_line(year: Path, tmp_path: Path) -> None:
    (tmp_path / "none.json").write_text("{}")
    for arguments, code, told in (
        ((tmp_path / "missing",), 2, "is no directory"),
        ((tmp_path,), 1, "no recording (*.tlog) below"),
        ((year, "--baseline", tmp_path / "none.json"), 1, "is no baseline; make one with"),
        ((year, "--baseline", tmp_path / "missing.json"), 1, "cannot be read"),
        ((year, "--write-baseline", tmp_path), 2, "it is a directory"),
    ):
        ran = gcs_coloc("judge", *arguments, "--out", tmp_path / "out", "--jobs", "1")
        assert (ran.returncode, len(ran.stderr.splitlines())) == (code, 1), ran.stderr
        assert told in ran.stderr


def test_real_flights_are_judged(tmp_path: Path) -> None:
    copter = recording("arduplane-flights/copter-loss")

    ran = gcs_coloc("judge", copter, "--out", tmp_path, "--jobs", "1")

    assert ran.returncode == 0, ran.stderr
    (flight,) = json.loads((tmp_path / "judge.json").read_text())["recordings"]
    four = flight["vehicles"]["4"]
    # Its README: 0.83 m rmse, 99.5 % covered, with version 0.1.
    assert four["rmse_m"] < 1.0
    assert four["covered_95"] > 0.95
    assert four["beyond_hpl"] == 0.0
