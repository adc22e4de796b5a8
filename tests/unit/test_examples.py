"""The examples run as a reader would run them, and the library's public names are what they say."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from recorded_flight import EPOCH_S, write_flight

import gcs_coloc

ROOT = Path(__file__).parents[2]


def run(example: str, *arguments: str, cwd: Path) -> str:
    command = [sys.executable, str(ROOT / "examples" / example), *arguments]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=120, cwd=cwd, env=environment).stdout


@pytest.fixture(scope="module")
def flight(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("flight") / "flight.tlog"
    write_flight(path, 20.0)
    return path


def test_a_vehicle_is_located_from_its_ranges(tmp_path):
    east_m, north_m, up_m, sigma_m = map(float, re.findall(r"([\d.]+) m", run("locate_from_ranges.py", cwd=tmp_path)))
    assert (east_m, north_m, up_m) == pytest.approx((59.6, 30.0, 10.0), abs=0.1)
    assert sigma_m < 0.5


@pytest.mark.parametrize(("estimator", "most_m"), [("fleet", 0.5), ("qu_zhang", 1.0), ("own_estimator.py:RangePull", 5.0)])
def test_a_data_set_is_evaluated_with_any_estimator(tmp_path, estimator, most_m):
    if estimator == "fleet":
        told = run("evaluate_dataset.py", cwd=tmp_path)
    else:
        made = subprocess.run(
            [sys.executable, "-c", "import evaluate_dataset as e, pathlib; e.write_dataset(pathlib.Path('.'))"],
            cwd=tmp_path, env=os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'examples'}"}, check=True, timeout=60,
        )  # fmt: skip
        assert made.returncode == 0
        name = estimator if estimator == "qu_zhang" else str(ROOT / "examples" / estimator)
        told = run("evaluate_dataset.py", str(tmp_path), name, cwd=tmp_path)
    assert "warning" not in told
    assert float(re.findall(r"RMSE ([\d.]+) m", told)[0]) < most_m


def test_a_recording_is_read_into_arrays(flight, tmp_path):
    told = run("read_recording.py", str(flight), cwd=tmp_path)
    assert [line.split(":")[0] for line in told.splitlines()[:4]] == ["vehicle 1", "vehicle 2", "vehicle 3", "vehicle 4"]
    recording = gcs_coloc.read_recording(flight)
    lost = recording.vehicles[4]
    rows = len(lost.unix_s)
    assert rows == pytest.approx(50, abs=5)
    assert (np.diff(lost.unix_s) > 0.0).all()
    assert lost.unix_s[0] == pytest.approx(EPOCH_S, abs=5.0)
    assert lost.enu_m.shape == lost.velocity_enu_mps.shape == lost.reported_enu_m.shape == (rows, 3)
    assert lost.covariance_h_m2.shape == (rows, 2, 2)
    assert lost.gps_state[-1] != recording.vehicles[1].gps_state[-1]
    assert recording.origin is not None
    used = recording.residuals[recording.residuals[:, 5] == 1.0]
    assert len(used) > 50
    assert np.median(np.abs(used[:, 3]) / used[:, 4]) < 2.0


def test_reading_a_recording_refuses_what_it_cannot_do_in_one_line(flight, tmp_path):
    with pytest.raises(gcs_coloc.DataError, match=r"none\.tlog"):
        gcs_coloc.read_recording(tmp_path / "none.tlog")
    with pytest.raises(gcs_coloc.EstimatorError, match="no estimator is called 'kalman'"):
        gcs_coloc.read_recording(flight, estimator="kalman")


def test_every_public_name_is_there_and_type_checkers_see_the_same(tmp_path):
    tree = ast.parse(Path(gcs_coloc.__file__).read_text())
    checked = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {alias.name: one.module for one in checked.body if isinstance(one, ast.ImportFrom) for alias in one.names}
    assert set(seen) | {"__version__"} == set(gcs_coloc.__all__)
    for name, module in seen.items():
        assert getattr(gcs_coloc, name) is getattr(sys.modules[module], name)
    assert set(gcs_coloc.__all__) <= set(dir(gcs_coloc))
    with pytest.raises(AttributeError, match="nothing"):
        gcs_coloc.nothing  # noqa: B018


def test_importing_the_package_loads_nothing_else():
    code = "import sys, gcs_coloc; print(sorted({m.split('.')[0] for m in sys.modules} & {'numpy', 'scipy', 'pydantic'}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60, cwd=ROOT)
    assert done.stdout.strip() == "[]"
