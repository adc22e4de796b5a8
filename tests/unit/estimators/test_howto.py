"""The how-to's own text is run, so that it cannot go out of date."""

import re
import tomllib
from pathlib import Path

import numpy as np
from fleet_in_flight import Fleet

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.measurements import Estimate, NoEstimate
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder.flight_report import FlightReport
from gcs_coloc.recorder.replay import Replay, replay
from gcs_coloc.recorder.side_tables import read_ranges, read_truth
from gcs_coloc.recorder.tlog import TlogReader
from tests.recordings import part, recording

TEXT = (Path(__file__).parents[3] / "docs" / "how-to" / "write-an-estimator.md").read_text()


def block(language: str) -> str:
    found = re.findall(rf"```{language}\n(.*?)```", TEXT, flags=re.DOTALL)
    assert len(found) == 1
    return str(found[0])


def test_the_estimator_of_the_text_runs_and_pulls_towards_the_truth(tmp_path: Path) -> None:
    file = tmp_path / "own_estimator.py"
    file.write_text(block("python"))
    config = tomllib.loads(block("toml"))["estimator"]
    estimator = load_estimator(config["name"].replace(file.name, str(file)), config["settings"])
    fleet = Fleet()
    assert isinstance(estimator.estimate(4, 0.0), NoEstimate)

    for measurement in fleet.round(0.0, ()):
        estimator.add(measurement)
    estimator.set_denied([4], 0.1)
    for k in range(1, 100):
        for measurement in fleet.round(0.2 * k, (4,)):
            estimator.add(measurement)
    answer = estimator.estimate(4, 19.8)

    assert isinstance(answer, Estimate)
    assert np.linalg.norm((answer.position_enu_m - fleet.at(4, 19.8))[:2]) < 60.0
    assert np.linalg.norm(fleet.at(4, 19.8) - fleet.at(4, 0.0)) > 300.0
    assert estimator.counts()["range used"] == 297


def test_the_estimator_of_the_text_follows_a_real_aircraft_within_what_it_states(tmp_path: Path) -> None:
    """From half a minute before it loses GPS for the first minute without."""
    file = tmp_path / "own_estimator.py"
    file.write_text(block("python"))
    flight = recording("arduplane")
    lost_unix_s = TlogReader(flight / "flight.tlog").span()[0] + 150.2
    ends_unix_s = lost_unix_s + 60.0
    flown = part(flight / "flight.tlog", tmp_path, lost_unix_s - 30.0, ends_unix_s)
    engine = Engine(load_estimator(f"{file}:RangePull", tomllib.loads(block("toml"))["estimator"]["settings"]))
    report = FlightReport(engine, read_truth(flight / "truth.csv"))
    ranges = [each for each in read_ranges(flight / "ranges.csv") if lost_unix_s - 30.0 <= each.received_at_s <= ends_unix_s]
    through = Replay(engine, TlogReader(flown), ranges, report.add_outputs)
    replay(through, [at_s for at_s in report.observation_times() if at_s <= ends_unix_s], report.observe)
    score = report.score(4)
    assert score is not None
    assert score.epochs > 150
    assert score.horizontal is not None
    assert score.horizontal.rmse_m < 25.0  # its sigma_m
    assert score.beyond_three_bounds == 0.0


def test_the_estimator_of_the_text_is_the_example() -> None:
    assert block("python") == (Path(__file__).parents[3] / "examples" / "own_estimator.py").read_text()
