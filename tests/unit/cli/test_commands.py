"""The subcommands as a user calls them: what they print and write, and one clear line for a mistake."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from command_line import gcs_coloc
from recorded_flight import write_flight

from sitl_fakes.scenario import SCENARIOS

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def data_set(tmp_path: Path) -> Path:
    """A tag that stands among four anchors, ranged exactly twice a second for ten seconds, with truth for the last four."""
    anchors = {"A": (0.0, 0.0, 0.0), "B": (20.0, 0.0, 3.0), "C": (0.0, 20.0, 5.0), "D": (20.0, 20.0, 1.0)}
    tag = (13.0, 14.0, 2.0)
    meta = 'name = "square"\nsource = "made by hand"\nlicence = "MIT"\ndims = 3\n[[node]]\nid = "tag"\nrole = "denied"\n'
    for name, (e, n, u) in anchors.items():
        meta += f'[[node]]\nid = "{name}"\nrole = "anchor"\ne_m = {e}\nn_m = {n}\nu_m = {u}\nsigma_m = 0.02\n'
    (tmp_path / "meta.toml").write_text(meta)
    (tmp_path / "positions.csv").write_text("t_s,id,e_m,n_m,u_m,sigma_h_m,sigma_v_m\n0.0,tag,13.5,13.6,2.3,1.0,1.0\n")
    ranges, truth = ["t_s,from_id,to_id,range_m,sigma_m"], ["t_s,id,e_m,n_m,u_m"]
    for k in range(1, 21):
        for name, place in anchors.items():
            length = sum((a - b) ** 2 for a, b in zip(tag, place, strict=True)) ** 0.5
            ranges.append(f"{k / 2:.2f},tag,{name},{length:.6f},0.1")
        if k > 12:
            truth.append(f"{k / 2:.2f},tag,13.0,14.0,2.0")
    (tmp_path / "ranges.csv").write_text("\n".join(ranges) + "\n")
    (tmp_path / "truth.csv").write_text("\n".join(truth) + "\n")
    return tmp_path


def test_evaluate_scores_prints_and_draws(data_set):
    picture = data_set / "picture.png"
    told = gcs_coloc("evaluate", str(data_set), "--plot", str(picture))
    assert told.returncode == 0, told.stderr
    assert "square: estimator fleet, 81 measurements" in told.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    score = json.loads(gcs_coloc("evaluate", str(data_set), "--json").stdout)["denied"]["tag"]
    assert score["share_known"] == 1.0
    assert score["spatial"]["rmse_m"] < 0.3  # ranges of a stated 0.1 m that are exact, height from anchors 5 m apart


FORGETFUL = """
class Forgetful:
    name = "forgetful"
    def set_denied(self, denied, at_s): pass
    def reset(self, vehicle, at_s): pass
    def add(self, measurement): raise LookupError("nothing learnt")
    def estimate(self, vehicle, at_s): pass
    def drain_residuals(self): return []
    def counts(self): return {}
"""


def test_evaluate_takes_an_estimator_by_its_file_and_tells_where_it_fails(data_set):
    file = data_set / "forgetful.py"
    file.write_text(FORGETFUL)
    told = gcs_coloc("evaluate", str(data_set), "--estimator", f"{file}:Forgetful")
    assert told.returncode == 0, told.stderr
    assert "LookupError: nothing learnt (forgetful.py, line 6)" in told.stderr
    assert "is no position with a covariance" in told.stderr
    assert len(told.stderr.strip().splitlines()) == 2
    assert "8 true positions, 0.0% answered" in told.stdout


def test_replay_tells_what_the_operator_was_told_as_an_error(tmp_path):
    (tmp_path / "forgetful.py").write_text(FORGETFUL)
    write_flight(tmp_path / "flight.tlog", 3.0)
    told = gcs_coloc("replay", str(tmp_path / "flight.tlog"), "--estimator", f"{tmp_path}/forgetful.py:Forgetful")
    assert told.returncode == 0, told.stderr
    (line,) = [line for line in told.stdout.splitlines() if "LookupError" in line]
    assert line.startswith("error at 0.")
    assert "forgetful.py, line 6" in line


def test_evaluate_names_the_place_of_a_mistake(data_set):
    (data_set / "ranges.csv").write_text("t_s,from_id,to_id,range_m,sigma_m\n0.5,tag,A,x,0.1\n")
    told = gcs_coloc("evaluate", str(data_set))
    assert told.returncode == 1
    assert len(told.stderr.strip().splitlines()) == 1
    for words in ("ranges.csv", "line 2", "range_m"):
        assert words in told.stderr


def test_study_paper_prints_table_2_and_writes_its_files(tmp_path):
    flags = ["--seeds", "2", "--fleet-seeds", "0", "--q", "5", "--q", "20", "--cycle", "0.5", "--jobs", "1"]
    told = gcs_coloc("study", "paper", *flags, "--out", str(tmp_path))
    assert told.returncode == 0, told.stderr
    assert "14.5" in told.stdout  # the paper's own figure beside ours
    assert {"table2.csv", "study.json", "figure5.png", "figure6.png", "figure7.png"} <= {p.name for p in tmp_path.iterdir()}
    options = json.loads((tmp_path / "study.json").read_text())["readings"]
    assert (options["step_s"], options["seeds"], options["qs"]) == (0.5, 2, [5.0, 20.0])


@pytest.mark.parametrize(
    ("arguments", "computes"),
    [
        (["study", "paper", "--out", "OUT"], "gcs_coloc.study.paper.run_paper_study"),
        (["study", "bound", "paper", "--plot", "OUT.png"], "gcs_coloc.study.bound.run_scenario_bound"),
        (["evaluate", "OUT", "--plot", "OUT.png"], "gcs_coloc.cli.evaluate._evaluate"),
        (["report", "OUT.tlog"], "gcs_coloc.cli.recordings.read_history"),
        (["plan", "OUT.plan", "--report", "OUT.html"], "gcs_coloc.cli.plan.load_plan"),
    ],
)
def test_that_there_is_no_matplotlib_is_told_before_anything_is_computed(arguments, computes, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setattr(computes, lambda *_, **__: pytest.fail("computed"))
    told = gcs_coloc(*(text.replace("OUT", str(tmp_path / "out")) for text in arguments))
    assert (told.returncode, told.stdout) == (2, "")
    assert told.stderr == 'gcs-coloc: error: drawing needs matplotlib: pip install "gcs-coloc[plots]"\n'


def test_study_bound_tells_the_least_error(tmp_path):
    picture = tmp_path / "bound.png"
    short = tmp_path / "scenario.toml"
    text = (SCENARIOS / "uwb.toml").read_text()
    short.write_text(text.replace("duration_s = 300.0", "duration_s = 40.0"))
    told = gcs_coloc("study", "bound", str(short), "--plot", str(picture))
    assert told.returncode == 0, told.stderr
    assert "vehicle 4, 20 to 40 s: horizontal RMSE at least 0." in told.stdout
    assert picture.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["evaluate", "pyproject.toml"], "pyproject.toml: is a file: a data set is a directory with meta.toml and ranges.csv"),
        (["evaluate", "n" * 300], "File name too long; state another path"),
        (["evaluate", "docs", "--csv", "docs"], "--csv docs: cannot be written: it is a directory; state a file in it"),
        (["study", "demo", "--out", "README.md"], "--out README.md: cannot be written to: it is a file; state a directory"),
        (["study", "paper", "--end-of-route", "nowhere"], "nowhere"),
        (["study", "bound", "pyproject.toml"], "pyproject.toml"),
        (["study"], "Missing command"),
        (["check-config"], "Missing argument 'FILE'. (see gcs-coloc check-config --help)"),
        (["doctor", "--seconds", "1"], "(see gcs-coloc doctor --help)"),
        (["--web", "80801", "--udp", "14550"], "--web: 80801 is not HOST:PORT"),
    ],
)
def test_mistakes_end_in_one_line(monkeypatch, arguments, words):
    monkeypatch.chdir(ROOT)
    told = gcs_coloc(*arguments)
    assert told.returncode in (1, 2)
    assert len(told.stderr.strip().splitlines()) == 1
    assert words in told.stderr


@pytest.fixture
def per_fleet(tmp_path: Path) -> Path:
    """A configuration of two fleets, each with a process of its own."""
    tables = "".join(f'[[fleet]]\nname = "{name}"\nlinks = ["udpin:127.0.0.1:{port}"]\n' for name, port in (("a", 1), ("b", 2)))
    (tmp_path / "fleets.toml").write_text(f'[service]\nprocesses = "per-fleet"\n{tables}')
    return tmp_path / "fleets.toml"


def test_a_configuration_without_links_is_good_for_what_needs_none_and_for_links_on_the_command_line(tmp_path):
    (tmp_path / "coloc.toml").write_text('[estimator]\nname = "qu_zhang"\n')
    done = gcs_coloc("check-config", tmp_path / "coloc.toml")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.endswith("coloc.toml: good; no link: give one with --udp or --link, estimator qu_zhang\n")


def test_check_config_says_that_each_fleet_has_a_process(per_fleet):
    done = gcs_coloc("check-config", per_fleet)
    assert done.stdout.endswith("fleet b: 1 link(s), estimator fleet; a process for each fleet\n"), done.stderr


def test_what_one_fleets_files_lack_is_told_before_any_process_is_started(per_fleet):
    per_fleet.write_text(per_fleet.read_text() + f'[fleet.web]\ntoken_file = "{per_fleet.parent / "absent"}"\n')
    done = gcs_coloc("--config", per_fleet)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("gcs-coloc: error: fleet b: web.token_file: ")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--fleet", "c"], "has no such fleet, but a, b"),
        (["--failed", "4"], "say it in the table of the fleet that is meant"),
        (["--fleet", "a", "--supervisor", "999"], "--supervisor 999: is no socket"),
    ],
)
def test_what_a_process_for_each_fleet_cannot_be_told_is_one_clear_line(per_fleet, arguments, words):
    done = gcs_coloc("--config", per_fleet, *arguments)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert words in line


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("study", "bound", "paper", "--seed", "-1"), "'--seed'"),
        (("study", "demo", "--seed", "-1"), "'--seed'"),
        (("study", "paper", "--first-seed", "-1"), "'--first-seed'"),
        (("study", "integrity", "--first-seed", "-1"), "'--first-seed'"),
        (("study", "planning", "--first-seed", "-1"), "'--first-seed'"),
        (("study", "readiness", "--first-seed", "-1"), "'--first-seed'"),
        (("import", "pyfg", "x.pyfg", "set", "--seed", "-1"), "'--seed'"),
    ],
)
def test_a_seed_below_zero_is_told(arguments, told):
    ended = gcs_coloc(*arguments)
    assert ended.returncode == 2
    assert f"Invalid value for {told}" in ended.stderr


@pytest.mark.parametrize("option", ["--ranges", "--truth", "--config", "--fleet"])
def test_calibrate_refuses_what_is_of_a_recording(data_set, option):
    ended = gcs_coloc("calibrate", data_set, option, "absent")
    assert ended.returncode == 2
    assert f"{option}" in ended.stderr
    assert "are of a recording" in ended.stderr
