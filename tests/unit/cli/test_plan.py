"""`gcs-coloc plan` as an operator uses it: files in, an answer, a report and an exit code out."""

import csv
import json
import re
import subprocess
import sys
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from gcs_coloc.cli.main import app
from gcs_coloc.core.errors import UsageError
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.planning import assessment
from gcs_coloc.planning.assessment import assess
from gcs_coloc.planning.fleet_plan import FleetPlan, PlannedStation, PlannedVehicle
from gcs_coloc.planning.flight_path import Leg
from gcs_coloc.planning.improvement import candidates, find_improvement
from gcs_coloc.planning.prediction import predict
from gcs_coloc.runtime.tasks import Workers

FRAME = LocalFrame(47.39, 8.55, 450.0)


def write_wpl(path, *points):
    rows = ["QGC WPL 110"]
    for k, (east, north) in enumerate(points):
        lat, lon, _ = FRAME.geodetic_from_enu(east, north, 0.0)
        frame, alt = (0, 450) if k == 0 else (3, 100)
        rows.append("\t".join(map(str, (k, int(k == 0), frame, 16, 0, 0, 0, 0, f"{lat:.8f}", f"{lon:.8f}", alt, 1))))
    rows.append("\t".join(map(str, (len(points), 0, 3, 206, 25, 0, 0, 0, 0, 0, 0, 1))))
    path.write_text("\n".join(rows))
    return path


@pytest.fixture
def three(tmp_path):
    """Three vehicles for 40 s beside each other; the fourth flies away from them and is alone when they have landed."""
    return [
        write_wpl(tmp_path / "a.waypoints", (0, 0), (0, 600)),
        write_wpl(tmp_path / "b.waypoints", (500, 0), (500, 600)),
        write_wpl(tmp_path / "c.waypoints", (200, 900), (200, 300)),
        write_wpl(tmp_path / "away.waypoints", (900, 0), (3300, 0)),
    ]


def run(*arguments):
    return CliRunner().invoke(app, ["plan", *map(str, arguments), "--jobs", "1"])


def test_a_plan_gives_an_answer_files_and_an_exit_code(three, tmp_path):
    report, steps, ways = tmp_path / "r.html", tmp_path / "s.csv", tmp_path / "w.geojson"
    outputs = ("--report", report, "--csv", steps, "--geojson", ways)
    ran = run(*three, "--max-range", "2000", "--require", "0.99", "--json", "--no-improve", *outputs)
    assert ran.exit_code == 3
    assert "command 206 is no waypoint and is skipped" in ran.stderr
    assert "99.0% are required" in ran.stderr
    result = json.loads(ran.stdout)
    shares = {each["sysid"]: each["share_with_fix"] for each in result["vehicles"]}
    assert [shares[k] for k in (1, 2, 3)] == [1.0, 1.0, 1.0]
    assert 40.0 / 160.0 < shares[4] < 60.0 / 160.0
    worst = next(each for each in result["vehicles"] if each["sysid"] == 4)["worst"]
    assert (worst["has_fix"], worst["code"]) == (False, "no_peer")
    rows = list(csv.DictReader(steps.read_text().splitlines()))
    assert {row["sysid"] for row in rows} == {"1", "2", "3", "4"}
    assert {row["limit"] for row in rows if row["fix"] == "1"} == {""}
    not_told = {each["sysid"]: each["share_not_told"] for each in result["vehicles"]}
    of_four = [row["told"] for row in rows if row["sysid"] == "4"]
    assert of_four.count("0") / len(of_four) == pytest.approx(not_told[4])
    assert 0.0 < not_told[4] < 1.0
    lines = json.loads(ways.read_text())["features"]
    assert {line["properties"]["fix"] for line in lines} == {True, False}
    html = report.read_text()
    assert "3 of 4 vehicles would have a fix all along their way" in html
    assert re.search(r"Vehicle 4 is worst: a fix for \d+\.\d% of its flight", html)
    assert " helps " not in html  # no change was sought
    assert not re.search(r"(src|href)=\"(?!data:)", html)


def test_how_well_a_station_is_known_is_stated_counts_and_is_named(three, tmp_path):
    report = tmp_path / "r.html"
    levels = []
    for sigma in ("", ",9"):
        stations = [part for k, east in ((1, 8.552), (2, 8.57)) for part in ("--station", f"{k}=47.392,{east},460{sigma}")]
        ran = run(three[0], *stations, "--no-improve", "--json", "--report", report)
        assert ran.exit_code == 0, ran.output
        told = json.loads(ran.stdout)
        assert [station["sigma_m"] for station in told["stations"]] == ([9.0] * 2 if sigma else [1.0] * 2)
        assert f"1 (place known to {9 if sigma else 1} m)" in report.read_text()
        levels.append(told["vehicles"][0]["median_bound_95_m"])
    assert levels[1] > 2.0 * levels[0]


def test_enough_of_a_fix_is_exit_code_0_and_pairs_are_told(three):
    ran = run(*three[:3], "--no-improve", "--pairs", "--require", "0.3")
    assert ran.exit_code == 0, ran.output
    assert "1 and 2" in ran.stdout
    assert "cannot tell" in ran.stdout
    assert len(re.findall(r"\d+\.\d%", ran.stdout)) == 2 * (3 + 6)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--start", "2"], "--start 2: expected VEHICLE=SECONDS"),
        (["--start", "7=3"], "--start 7=...: there is no vehicle 7"),
        (["--station", "1=47,8,450,0"], "--station 1=47,8,450,0: expected ID=LAT,LON,ALT or ID=LAT,LON,ALT,SIGMA"),
        (["--speed", "0"], "--speed 0: expected m/s from 0.1 to 200, or VEHICLE= and that, as 2=15"),
        (["--speed", "1=fast"], "--speed 1=fast: expected m/s from 0.1 to 200"),
        (["--speed", "9=10"], "--speed 9=...: there is no vehicle 9; there are 1, 2"),
        (["--class", "1=bird"], "--class 1=bird: expected a class (plane, multirotor, ground, boat, indoor)"),
        (["--station", "1=47,8"], "--station 1=47,8: expected ID=LAT,LON,ALT"),
        (["--range-sigma", "0"], "range_sigma_m must be above 0"),
        (["--report", "/nowhere/r.html"], "there is no directory /nowhere"),
    ],
)
def test_a_mistake_is_told_in_one_line(three, arguments, said):
    ran = run(*three[:2], *arguments)
    assert ran.exit_code != 0
    assert said in str(ran.exception)


def test_a_way_too_short_to_lose_a_gps_on_is_told_and_not_counted(three, tmp_path):
    short = write_wpl(tmp_path / "short.waypoints", (300, 0), (300, 15))
    ran = run(*three[:3], short, "--no-improve", "--require", "0.9")
    assert ran.exit_code == 0, ran.output
    assert "not in flight" in ran.stdout


def test_one_vehicle_alone_is_told_what_it_lacks(three):
    assert "give more plans, or --station" in str(run(three[0]).exception)


def test_the_change_that_helps_is_found_and_its_gain_is_predicted():
    def flight(sysid, east, north, start_s=0.0):
        legs = (Leg((east, north + 1200.0, 100.0), 20.0),)
        return PlannedVehicle(sysid, f"v{sysid}", (east, north, 100.0), legs, start_s)

    station = PlannedStation(1, (300.0, 700.0, 10.0))
    plan = FleetPlan(FRAME, (flight(1, 0.0, 0.0), flight(2, 500.0, 100.0, 60.0)), (station,))
    assessed = assess(plan, pairs=False, workers=Workers(), progress=lambda *_: None)
    found = find_improvement(assessed, Workers(), lambda *_: None)
    assert found is not None
    assert found.sysid == assessed.worst.predicted.sysid
    assert found.after.predicted.share_with_fix > found.before.predicted.share_with_fix + 0.2
    assert f"{found.after.predicted.share_with_fix:.1%} of its flight instead of" in found.text
    level = f"{found.after.median_hpl_m:.0f} m"
    as_often = replace(found, before=found.after)
    assert as_often.text.endswith(f" of its flight, median protection level {level} instead of {level}")
    good = FleetPlan(FRAME, tuple(flight(k, 500.0 * (k % 2), 300.0 * k) for k in range(1, 6)))
    assessed = assess(good, pairs=False, workers=Workers(), progress=lambda *_: None)
    assert find_improvement(assessed, Workers(), lambda *_: None) is None


def four_and_one_that_starts_when_they_have_landed():
    def flight(sysid, east, north, start_s):
        legs = (Leg((east, north + 900.0, 100.0), 20.0),)
        return PlannedVehicle(sysid, f"v{sysid}", (east, north, 100.0), legs, start_s)

    around = [flight(k, 600.0 * (k % 2), 700.0 * (k // 2), 0.0) for k in (1, 2, 3, 4)]
    return FleetPlan(FRAME, (*around, flight(5, 250.0, 500.0, 60.0)))


def test_the_change_is_the_best_of_all_as_the_filter_predicts_them_and_may_be_of_the_worst_vehicle_itself():
    assessed = assess(four_and_one_that_starts_when_they_have_landed(), pairs=False, workers=Workers(), progress=lambda *_: None)
    worst = assessed.worst
    assert worst.predicted.sysid == 5
    found = find_improvement(assessed, Workers(), lambda *_: None)
    every = {each.text: predict(each.plan, (5,))[0].share_with_fix for each in candidates(assessed.plan, worst)}
    assert len(every) > 50
    assert found is not None
    assert every[found.change.text] == max(every.values()) > worst.predicted.share_with_fix + 0.3
    assert found.change.text == "start vehicle 5 60 s earlier"


def test_that_nothing_helps_is_said_on_the_terminal_as_on_the_page(tmp_path):
    # The second flight is the longer one: of two alike either is the worst.
    ways = ((0, 2400), (9000, 3600))
    apart = [write_wpl(tmp_path / f"{east}.waypoints", (east, 0), (east, north)) for east, north in ways]
    ran = run(*apart, "--max-range", "50", "--report", tmp_path / "r.html")
    assert ran.exit_code == 0, ran.output
    told = "No shifted start, no route to the side and no single station on a grid helps vehicle 2."
    assert told in ran.stdout
    assert told in (tmp_path / "r.html").read_text()
    assert "No shifted start" not in run(*apart, "--max-range", "50", "--no-improve").stdout


def test_short_predictions_share_a_task_and_long_ones_have_their_own(monkeypatch):
    tasks = []

    def run_here(function, batches, *_):
        tasks.append([len(batch) for batch in batches])
        return [function(batch) for batch in batches]

    def flights(length_m):
        ways = [(500.0 * (k % 2), 300.0 * k) for k in range(1, 6)]
        return tuple(
            PlannedVehicle(k, f"v{k}", (*way, 100.0), (Leg((way[0], way[1] + length_m, 100.0), 20.0),))
            for k, way in enumerate(ways, start=1)
        )

    monkeypatch.setattr(assessment, "run_tasks", run_here)
    monkeypatch.setattr(assessment, "predict", lambda plan, denied: [(sysid, denied) for sysid in denied])
    monkeypatch.setattr(assessment, "outlook", lambda predicted: predicted)
    # 60 s are 30 steps, 1200 s are 600.
    short = assess(FleetPlan(FRAME, flights(1200.0)), pairs=True, workers=Workers(), progress=lambda *_: None)
    assess(FleetPlan(FRAME, flights(24_000.0)), pairs=False, workers=Workers(), progress=lambda *_: None)
    assert [sum(sizes) for sizes in tasks] == [5 + 10, 5]
    assert len(tasks[0]) == 3
    assert tasks[1] == [1] * 5
    assert [denied for _, denied in short.singles] == [(k,) for k in range(1, 6)]
    assert [denied for _, denied in short.pairs[:4]] == [(1, 2), (1, 2), (1, 3), (1, 3)]


def test_a_file_that_the_system_refuses_is_named(tmp_path):
    near = [write_wpl(tmp_path / f"{east}.waypoints", (east, 0), (east, 60)) for east in (0, 300)]
    done = run(*near, "--no-improve", "--csv", "/proc/no_such_entry")
    assert isinstance(done.exception, UsageError)
    assert str(done.exception) == "--csv /proc/no_such_entry: cannot be written: No such file or directory"


def test_a_prediction_that_was_stopped_goes_on_in_another_process_with_what_is_kept(three, tmp_path):
    kept = tmp_path / "kept"
    options = ("--pairs", "--improve", "--json", "--resume", kept)
    told = run(*three, *options)
    assert told.exit_code == 0, told.stderr
    files = {path.name: path.stat().st_mtime_ns for path in kept.iterdir()}
    assert len(files) > len(three)
    lost = sorted(files)[0]
    (kept / lost).unlink()
    command = [
        sys.executable,
        "-m",
        "gcs_coloc",
        "plan",
        *map(str, three),
        "--pairs",
        "--improve",
        "--json",
        "--resume",
        str(kept),
    ]
    again = subprocess.run([*command, "--jobs", "1"], capture_output=True, text=True, check=True)
    assert json.loads(again.stdout) == json.loads(told.stdout)
    after = {path.name: path.stat().st_mtime_ns for path in kept.iterdir()}
    assert after.keys() == files.keys()
    assert {name for name, at_ns in after.items() if at_ns != files[name]} == {lost}
