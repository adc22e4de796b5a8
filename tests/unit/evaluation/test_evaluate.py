from __future__ import annotations

import csv
import json
import math
import os
import subprocess
import sys
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
import pytest
from command_line import gcs_coloc
from typer.testing import CliRunner

from gcs_coloc import __version__
from gcs_coloc.cli.main import app
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    Measurement,
    NoEstimate,
    NoEstimateReason,
    Residual,
    Unlocated,
)
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.evaluation.evaluate import evaluate
from gcs_coloc.evaluation.output import plot_evaluation, write_epochs
from gcs_coloc.evaluation.scoring import EstimateSeries, score
from tests.recordings import recording


def write_walk(directory: Path, dims: int) -> Path:
    """A walker between four anchors, exact ranges, arrivals 0.2 s late."""
    anchors = {"A": (0.0, 0.0), "B": (30.0, 0.0), "C": (0.0, 30.0), "D": (30.0, 30.0)}
    meta = f'name = "walk"\nsource = "made"\nlicence = "CC0"\ndims = {dims}\n[[node]]\nid = "w"\nrole = "denied"\n'
    heights = dict(zip(anchors, (1.0, 1.0, 1.0, 1.0) if dims == 2 else (0.0, 6.0, 6.0, 0.0), strict=True))
    ranges = ["t_s,from_id,to_id,range_m,sigma_m,arrival_s"]
    truth = ["t_s,id,e_m,n_m,u_m"]
    for name, (e, n) in anchors.items():
        meta += f'[[node]]\nid = "{name}"\nrole = "anchor"\ne_m = {e}\nn_m = {n}\nu_m = {heights[name]}\nsigma_m = 0.01\n'
    for k in range(200):
        t = 0.1 * k
        here = (10.0 + 0.5 * t, 8.0 + 0.3 * t, 1.0)
        for name, (e, n) in anchors.items():
            r = math.dist(here, (e, n, heights[name]))
            ranges.append(f"{t:.3f},w,{name},{r:.5f},0.1,{t + 0.2:.3f}")
        if k >= 50:
            truth.append(f"{t:.3f},w,{here[0]},{here[1]},{here[2]}")
    (directory / "meta.toml").write_text(meta)
    (directory / "ranges.csv").write_text("\n".join(ranges) + "\n")
    (directory / "truth.csv").write_text("\n".join(truth) + "\n")
    header = "t_s,id,e_m,n_m,u_m,sigma_h_m,sigma_v_m\n"
    (directory / "positions.csv").write_text(header + "0.0,w,10,8,1,1,1\n")
    return directory


@pytest.mark.parametrize("dims", [2, 3])
def test_a_walk_is_followed_and_scored(tmp_path, dims):
    evaluation = evaluate(write_walk(tmp_path, dims), FleetFilter())
    (denied_vehicle,) = evaluation.denied
    assert denied_vehicle.score.share_known == 1.0
    assert denied_vehicle.score.first_known_s == pytest.approx(5.0)
    assert denied_vehicle.score.horizontal is not None
    assert denied_vehicle.score.horizontal.rmse_m < 0.3
    assert denied_vehicle.score.anees_expected == dims
    figures = json.loads(json.dumps(evaluation.as_dict()))
    assert figures["denied"]["w"]["epochs"] == 150


def test_why_there_is_no_answer_is_told_by_reason_in_the_words_of_the_first_time(tmp_path):
    walk = write_walk(tmp_path, 3)
    ranges = (walk / "ranges.csv").read_text().splitlines()
    (walk / "positions.csv").write_text((walk / "positions.csv").read_text().splitlines()[0])
    (walk / "ranges.csv").write_text("\n".join([ranges[0], *(line for line in ranges if ",w,A," in line)]))
    (denied_vehicle,) = evaluate(walk, FleetFilter()).denied
    missing = denied_vehicle.score.epochs
    assert denied_vehicle.score.share_known == 0.0
    [(reason, times)] = denied_vehicle.unanswered.items()
    assert times == missing
    assert reason.reason is NoEstimateReason.FEW_RANGES
    told = gcs_coloc("evaluate", walk).stdout
    assert f"  not answered {missing} times: {reason.text} (the first time)" in told.splitlines()
    assert "measurements: kept: waiting for initialisation 200" in told


def test_ranges_in_millimetres_are_warned_of_on_stderr_and_in_the_json_and_a_sound_walk_is_not(tmp_path):
    walk = write_walk(tmp_path, 3)
    # Whatever the estimator; one that searches for a place for ranges of kilometres takes seconds.
    flags = ("--json", "--estimator", "qu_zhang")
    sound = gcs_coloc("evaluate", walk, *flags)
    assert (json.loads(sound.stdout)["warnings"], sound.stderr) == ([], "")
    header, *rows = (walk / "ranges.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    millimetres = [",".join([*c[:3], f"{1000.0 * float(c[3]):.2f}", *c[4:]]) for c in cells]
    (walk / "ranges.csv").write_text("\n".join([header, *millimetres]))
    wrong = gcs_coloc("evaluate", walk, *flags)
    words = "the ranges are 1000 times the distances between the positions: are the ranges in mm, or the positions in km?"
    assert wrong.stderr == f"gcs-coloc: warning: {walk}: {words}\n"
    figures = json.loads(wrong.stdout)
    assert figures["version"] == __version__
    (warning,) = figures["warnings"]
    assert (warning["kind"], warning["text"]) == ("range_factor", words)
    assert warning["value"] == pytest.approx(1000.0, rel=1e-3)


def test_the_heights_of_a_flat_data_set_are_not_held_against_its_ranges(tmp_path):
    walk = write_walk(tmp_path, 2)
    truth = (walk / "truth.csv").read_text().splitlines()
    (walk / "truth.csv").write_text("\n".join([truth[0], *(f"{row.rsplit(',', 1)[0]},0.0" for row in truth[1:])]))
    meta = (walk / "meta.toml").read_text()
    (walk / "meta.toml").write_text(meta.replace("u_m = 1.0", "u_m = 25.0"))
    assert evaluate(walk, FleetFilter()).findings == ()


def test_the_figures_do_not_depend_on_the_process_or_its_hash_seed(tmp_path):
    walk = write_walk(tmp_path, 3)
    command = [sys.executable, "-m", "gcs_coloc", "evaluate", str(walk), "--json"]
    environment = os.environ | {"PYTHONHASHSEED": "77"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120, env=environment)
    told = [json.loads(text) for text in (done.stdout, gcs_coloc("evaluate", walk, "--json").stdout)]
    first, second = ({key: value for key, value in one.items() if not key.startswith("cpu_")} for one in told)
    assert first == second


def test_the_picture_is_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "walk.png"
    plot_evaluation(evaluate(write_walk(tmp_path, 2), FleetFilter()), picture)
    assert picture.read_bytes().startswith(b"\x89PNG")


class Recorder:
    """Answers with the newest arrival it has heard of, and writes down what it was asked."""

    name = "recorder"

    def __init__(self) -> None:
        self.newest_s = -math.inf
        self.asked: list[tuple[float, float]] = []
        self.denied: list[tuple[frozenset[int], float]] = []
        self.heights = 0

    def set_denied(self, denied: Collection[int], at_s: float) -> None:
        self.denied.append((frozenset(denied), at_s))

    def add(self, measurement: Measurement) -> None:
        self.newest_s = max(self.newest_s, measurement.arrived_at_s)
        self.heights += isinstance(measurement, AltitudeMeasurement)

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        self.asked.append((at_s, self.newest_s))
        return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.OTHER, detail="never"))

    def drain_residuals(self) -> list[Residual]:
        return []

    def counts(self) -> Mapping[str, int]:
        return {}


def test_scoring_is_causal_and_a_vehicle_is_denied_after_its_last_report(tmp_path):
    recorder = Recorder()
    evaluation = evaluate(write_walk(tmp_path, 3), recorder)
    assert len(recorder.asked) == 150
    assert all(newest <= at + 1e-9 for at, newest in recorder.asked)
    assert all(newest > at - 0.11 for at, newest in recorder.asked)
    ((denied, at_s),) = recorder.denied
    assert denied == {1}
    assert 0.0 < at_s <= 0.2
    assert recorder.heights == 0
    score_of_none = evaluation.denied[0].score
    assert (score_of_none.share_known, score_of_none.horizontal, score_of_none.anees) == (0.0, None, None)


def test_an_answer_is_scored_as_it_was_given_though_the_estimator_goes_on_to_change_it(tmp_path):
    class InPlace(Recorder):
        here = np.zeros(3)

        def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
            self.here += 1.0
            return Estimate(vehicle, at_s, self.here, np.zeros(3), np.eye(6), 1.0, 3)

    series = evaluate(write_walk(tmp_path, 3), InPlace()).denied[0].series
    assert series.estimate_enu_m[:, 0].tolist() == [float(n) for n in range(1, 151)]


def test_two_dimensions_tell_the_estimator_the_plane(tmp_path):
    recorder = Recorder()
    evaluate(write_walk(tmp_path, 2), recorder)
    assert recorder.heights > 50


def test_the_figures_are_those_worked_out_by_hand():
    truth = np.zeros((4, 3))
    estimate = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 2.0], [np.nan] * 3, [6.0, 8.0, 0.0]])
    covariance = np.broadcast_to(4.0 * np.eye(3), (4, 3, 3))
    result = score(EstimateSeries(np.arange(4.0) + 10.0, truth, estimate, covariance), 9.0, 3)
    assert result.share_known == 0.75
    assert result.first_known_s == 1.0
    assert result.horizontal is not None
    assert result.spatial is not None
    assert result.horizontal.rmse_m == pytest.approx(math.sqrt((25.0 + 0.0 + 100.0) / 3.0))
    assert result.spatial.rmse_m == pytest.approx(math.sqrt((25.0 + 4.0 + 100.0) / 3.0))
    assert result.horizontal.median_m == 5.0
    assert result.horizontal.max_m == 10.0
    assert result.anees == pytest.approx((25.0 + 4.0 + 100.0) / 4.0 / 3.0)
    assert result.covered_95 == pytest.approx(1.0 / 3.0)  # the bound is 2.45 times 2 m


def test_real_outdoor_ranges_are_located_as_well_as_with_an_inertial_unit():
    evaluation = evaluate(recording("hanyang") / "los_b4", FleetFilter())
    (denied_vehicle,) = evaluation.denied
    # One epoch of 791 fits another place, 2.6 m away, as well.
    assert denied_vehicle.score.share_known > 0.998
    assert denied_vehicle.score.spatial is not None
    assert denied_vehicle.score.spatial.rmse_m <= 0.70  # the authors' filter with an inertial unit


def test_without_truth_it_is_located_all_the_same(tmp_path):
    walk = write_walk(tmp_path, 3)
    (walk / "truth.csv").unlink()
    (vehicle,) = evaluate(walk, FleetFilter()).denied
    assert vehicle.score.share_known > 0.95
    assert vehicle.score.horizontal is None
    write_epochs([evaluate(walk, FleetFilter())], str(tmp_path / "epochs.csv"))
    rows = list(csv.DictReader((tmp_path / "epochs.csv").read_text().splitlines()))
    assert float(rows[50]["e_m"]) == pytest.approx(10.0 + 0.5 * float(rows[50]["t_s"]), abs=0.5)
    assert rows[50]["error_h_m"] == ""


def test_lever_arms_are_reduced_while_the_estimator_runs(tmp_path):
    """A tag half a metre ahead of the body's reference point, which heads east."""
    walk = write_walk(tmp_path, 3)
    meta = (walk / "meta.toml").read_text()
    arm = '[[node.antenna]]\nid = "nose"\nforward_m = 0.5\nright_m = 0.0\ndown_m = 0.0\n'
    (walk / "meta.toml").write_text(meta.replace('role = "denied"\n', f'role = "denied"\n{arm}', 1))
    anchors = {"A": (0.0, 0.0, 0.0), "B": (30.0, 0.0, 6.0), "C": (0.0, 30.0, 6.0), "D": (30.0, 30.0, 0.0)}
    ranges, attitude = (
        ["t_s,from_id,to_id,range_m,sigma_m,antenna_from,antenna_to"],
        ["t_s,id,roll_rad,pitch_rad,yaw_rad,airspeed_mps"],
    )
    for k in range(200):
        t = 0.1 * k
        nose = (10.5 + 0.5 * t, 8.0 + 0.3 * t, 1.0)
        attitude.append(f"{t:.3f},w,0,0,{math.pi / 2},")
        ranges += [f"{t:.3f},w,{name},{math.dist(nose, place):.5f},0.1,nose," for name, place in anchors.items()]
    (walk / "ranges.csv").write_text("\n".join(ranges) + "\n")
    without = evaluate(walk, FleetFilter()).denied[0].score.horizontal.rmse_m
    (walk / "attitude.csv").write_text("\n".join(attitude) + "\n")
    turned = evaluate(walk, FleetFilter()).denied[0].score.horizontal.rmse_m
    assert without == pytest.approx(0.5, abs=0.15)
    assert turned < 0.1


def test_an_evaluation_goes_on_where_it_was_stopped_unless_a_file_has_changed(tmp_path):
    walk = write_walk(tmp_path, 2)
    flags = ("--json", "--jobs", "1", "--resume", tmp_path / "kept")
    first = gcs_coloc("evaluate", walk, *flags).stdout
    # The CPU time in it would differ if it were computed again.
    assert gcs_coloc("evaluate", walk, *flags).stdout == first
    assert len(list((tmp_path / "kept").iterdir())) == 1
    (walk / "ranges.csv").write_text((walk / "ranges.csv").read_text().rstrip().rpartition("\n")[0] + "\n")
    assert json.loads(gcs_coloc("evaluate", walk, *flags).stdout)["measurements"] == json.loads(first)["measurements"] - 1


def test_an_evaluation_by_a_plug_in_is_done_again_once_its_file_is_edited(tmp_path):
    walk, plug_in = write_walk(tmp_path, 2), tmp_path / "mine.py"
    plug_in.write_text(
        "from gcs_coloc.estimators.fleet.filter import FleetFilter\n\n\nclass Mine(FleetFilter):\n    name = 'mine'\n"
    )
    flags = ("--json", "--jobs", "1", "--estimator", f"{plug_in}:Mine", "--resume", tmp_path / "kept")
    first = gcs_coloc("evaluate", walk, *flags).stdout
    assert gcs_coloc("evaluate", walk, *flags).stdout == first
    plug_in.write_text(plug_in.read_text().replace("'mine'", "'edited'"))
    assert (json.loads(first)["estimator"], json.loads(gcs_coloc("evaluate", walk, *flags).stdout)["estimator"]) == (
        "mine",
        "edited",
    )


def test_several_data_sets_give_one_table_and_one_csv(tmp_path):
    walks = [tmp_path / "one", tmp_path / "two"]
    for walk in walks:
        walk.mkdir()
        write_walk(walk, 2)
    ranges = (walks[0] / "ranges.csv").read_text().splitlines()
    (walks[0] / "ranges.csv").write_text("\n".join([*ranges[:3], "0.1,w,A,-4,0.1,0.3", *ranges[3:]]) + "\n")
    ran = CliRunner().invoke(app, ["evaluate", *map(str, walks), "--jobs", "1", "--csv", str(tmp_path / "all.csv")])
    assert ran.exit_code == 0, ran.output
    assert ran.stdout.count("walk") == 2
    assert "1 of 801 rows of ranges.csv are wrong and left out" in ran.stderr
    assert "line 4, column 4 (range_m): -4 must not be negative" in ran.stderr
    rows = list(csv.DictReader((tmp_path / "all.csv").read_text().splitlines()))
    assert len(rows) == 300
    assert max(float(row["error_h_m"]) for row in rows) < 1.0
    assert CliRunner().invoke(app, ["evaluate", *map(str, walks), "--plot", "x.png"]).exit_code != 0
