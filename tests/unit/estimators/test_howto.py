"""The how-to's own text is run, so that it cannot go out of date."""

import re
import tomllib
from pathlib import Path

import numpy as np
from fleet_in_flight import Fleet

from gcs_coloc.core.measurements import Estimate, Unknown
from gcs_coloc.estimators.registry import load_estimator

TEXT = (Path(__file__).parents[3] / "docs" / "how-to" / "write-an-estimator.md").read_text()


def block(language: str) -> str:
    found = re.findall(rf"```{language}\n(.*?)```", TEXT, flags=re.DOTALL)
    assert len(found) == 1
    return str(found[0])


def test_the_estimator_of_the_text_runs_and_pulls_towards_the_truth(tmp_path: Path) -> None:
    file = tmp_path / "range_pull.py"
    file.write_text(block("python"))
    config = tomllib.loads(block("toml"))["estimator"]
    estimator = load_estimator(config["name"].replace(file.name, str(file)), config["settings"])
    fleet = Fleet()
    assert isinstance(estimator.estimate(4, 0.0), Unknown)

    for measurement in fleet.round(0.0, ()):
        estimator.add(measurement)
    estimator.set_subjects([4], 0.1)
    for k in range(1, 100):
        for measurement in fleet.round(0.2 * k, (4,)):
            estimator.add(measurement)
    answer = estimator.estimate(4, 19.8)

    assert isinstance(answer, Estimate)
    assert np.linalg.norm((answer.position_enu_m - fleet.at(4, 19.8))[:2]) < 60.0
    assert np.linalg.norm(fleet.at(4, 19.8) - fleet.at(4, 0.0)) > 300.0
    assert estimator.counts()["range used"] == 297


def test_the_estimator_of_the_text_is_as_short_as_promised() -> None:
    assert len(block("python").splitlines()) < 60
