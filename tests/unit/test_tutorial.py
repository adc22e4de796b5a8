"""The tutorial for researchers does what it says: its script and its commands, on a log of a radio that is off by 30 cm."""

import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from gcs_coloc.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
TUTORIAL = ROOT / "docs/tutorial/ranges-to-results.md"
ANCHORS = {"A": (0.0, 0.0, 2.0), "B": (40.0, 0.0, 3.0), "C": (0.0, 40.0, 2.5), "D": (40.0, 40.0, 3.5)}
BIAS_M = 0.3


def write_log(directory):
    rng = np.random.default_rng(1)
    log, truth = ["time_ms,tag,anchor,distance_mm"], ["t_s,id,e_m,n_m,u_m"]
    heights = ["t_s,id,u_m,sigma_v_m"]
    for k in range(300):
        t = 0.2 * k
        here = (20.0 + 12.0 * math.cos(t / 12.0), 20.0 + 12.0 * math.sin(t / 12.0), 1.5)
        truth.append(f"{t:.1f},T1,{here[0]:.3f},{here[1]:.3f},{here[2]}")
        heights.append(f"{t:.1f},T1,{here[2]},0.2")
        for name, place in ANCHORS.items():
            log.append(f"{1000 * t:.0f},T1,{name},{1000 * (math.dist(here, place) + BIAS_M + 0.05 * rng.standard_normal()):.0f}")
    log.insert(5, "200,T1,A,-12")
    (directory / "log.csv").write_text("\n".join(log) + "\n")
    return truth, heights


def test_a_log_becomes_results_as_the_tutorial_says(tmp_path):
    truth, heights = write_log(tmp_path)
    (script,) = re.findall(r"```python\n(.*?)```", TUTORIAL.read_text(), re.DOTALL)
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True, timeout=60)
    made = tmp_path / "my-set"
    (made / "truth.csv").write_text("\n".join(truth) + "\n")
    (made / "altitude.csv").write_text("\n".join(heights) + "\n")
    first = run("evaluate", str(made))
    assert "1 of 1201 rows of ranges.csv are wrong" in first.stderr
    assert re.search(r"the ranges are \+0\.\d\d m off in the mean", first.stderr)
    calibration = run("calibrate", str(made)).stdout
    found = re.findall(r'id = "(\w+)"\n(range_bias.*)\n(range_scale.*)', calibration)
    meta = (made / "meta.toml").read_text()
    for name, *lines in found:
        meta = meta.replace(f'id = "{name}"\n', f'id = "{name}"\n' + "\n".join(lines) + "\n")
    (made / "meta.toml").write_text(meta)
    second = run("evaluate", str(made), "--csv", str(tmp_path / "epochs.csv"))
    assert "off in the mean" not in second.stderr
    assert rmse_m(second.stdout) < min(rmse_m(first.stdout), 0.1)
    assert len((tmp_path / "epochs.csv").read_text().splitlines()) == 301
    own = run("evaluate", str(made), "--estimator", f"{ROOT / 'examples/own_estimator.py'}:RangePull")
    assert "T1: 300 true positions" in own.stdout


def run(*arguments):
    ran = CliRunner().invoke(app, [*arguments])
    assert ran.exit_code == 0, ran.output
    return ran


def rmse_m(printed):
    return float(re.search(r"horizontal +RMSE ([0-9.]+) m", printed).group(1))
