"""Biases and scales of devices are found again, told by the data check, and taken out of the ranges."""

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from gcs_coloc.cli.main import app
from gcs_coloc.core.errors import DataError
from gcs_coloc.evaluation.calibration import calibrate
from gcs_coloc.evaluation.data_checks.checks import run_checks
from gcs_coloc.evaluation.data_checks.recorded_data import PositionTrack, RecordedData, recorded_data
from gcs_coloc.evaluation.dataset import read_dataset
from tests.recordings import recording

TIMES_S = np.arange(0.0, 200.0, 0.5)
SIGMA_M = 0.3


def flight(biases=(), scales=(), seed=1, outliers=0.0):
    """Four vehicles on circles with centimetre positions, ranges among all."""
    rng, biases, scales = np.random.default_rng(seed), dict(biases), dict(scales)
    tracks = {}
    for v in range(1, 5):
        angle = 0.05 * v * TIMES_S + v
        places = np.column_stack((200.0 * v * np.sin(angle), 150.0 * v * np.cos(angle), 50.0 + 0 * angle))
        tracks[v] = PositionTrack(TIMES_S, places, np.full(len(TIMES_S), 0.01))
    rows = []
    for a in tracks:
        for b in range(a + 1, 5):
            true = np.linalg.norm(tracks[a].positions_enu_m - tracks[b].positions_enu_m, axis=1)
            scale, bias = (sum(table.get(v, 0.0) for v in (a, b)) for table in (scales, biases))
            measured = (1.0 + scale) * true + bias + SIGMA_M * rng.standard_normal(len(true))
            measured += 20.0 * (rng.random(len(true)) < outliers)
            rows.append(
                np.column_stack((TIMES_S, np.full_like(true, a), np.full_like(true, b), measured, np.full_like(true, SIGMA_M)))
            )
    return RecordedData({v: f"uav{v}" for v in tracks}, tracks, {}, np.vstack(rows))


@pytest.mark.parametrize("outliers", [0.0, 0.1])
def test_bias_and_scale_are_found_again(outliers):
    found = calibrate(flight({2: 0.8, 3: -0.3}, {4: 0.002}, outliers=outliers))
    by_vehicle = {d.vehicle: d for d in found.devices}
    assert [by_vehicle[v].bias_m for v in (1, 2, 3, 4)] == pytest.approx([0.0, 0.8, -0.3, 0.0], abs=0.1)
    assert [by_vehicle[v].scale for v in (1, 2, 3, 4)] == pytest.approx([0.0, 0.0, 0.0, 0.002], abs=2e-4)
    assert max(abs(pair.after_m) for pair in found.pairs) < 0.06


def test_the_sigmas_hold_the_errors():
    errors = []
    for seed in range(20):
        found = calibrate(flight({2: 0.8}, seed=seed))
        errors += [(d.bias_m - (0.8 if d.vehicle == 2 else 0.0)) / d.bias_sigma_m for d in found.devices]
    assert np.mean(np.abs(errors) < 2.0) > 0.9


def test_the_mean_of_the_residuals_is_a_finding_that_names_the_device():
    assert run_checks(flight()) == []
    (finding,) = run_checks(flight({2: 0.2}))
    assert finding.kind == "range_mean"
    assert finding.value == pytest.approx(0.2, abs=0.03)
    assert "the ranges to and from uav2 are +0.19 m off in the mean" in finding.text


def test_the_uncertainty_of_reported_positions_is_no_finding():
    data = flight({2: 0.2})
    vague = {v: replace(track, sigmas_m=np.full(len(TIMES_S), 1.0)) for v, track in data.reports.items()}
    assert run_checks(replace(data, reports=vague)) == []


def test_without_known_positions_there_is_nothing_to_calibrate_with():
    with pytest.raises(DataError, match="nothing to calibrate with"):
        calibrate(replace(flight(), reports={}))


@pytest.mark.parametrize(("name", "bias_m"), [("rcv5", 0.24), ("lias_fast", 0.19)])
def test_the_bias_of_real_radios_is_found(name, bias_m):
    """Ultra-wideband sets with a lasting bias on all pairs; its median was measured by hand."""
    found = calibrate(recorded_data(read_dataset(recording(f"ranging/{name}"))))
    assert np.median([pair.before_m for pair in found.pairs]) == pytest.approx(bias_m, abs=0.05)
    assert max(abs(pair.after_m) for pair in found.pairs) < 0.03


def test_the_command_prints_what_goes_into_meta_toml(tmp_path):
    write_biased_set(tmp_path)
    ran = CliRunner().invoke(app, ["calibrate", str(tmp_path)])
    assert ran.exit_code == 0, ran.output
    assert '# id = "tag"\nrange_bias_m = 0.' in ran.stdout
    out = tmp_path / "calibration.toml"
    assert CliRunner().invoke(app, ["calibrate", str(tmp_path), "--out", str(out)]).exit_code == 0
    assert out.read_text().startswith("# into meta.toml")


def write_biased_set(directory):
    meta = 'name = "x"\nsource = "x"\nlicence = "x"\ndims = 2\n[[node]]\nid = "tag"\nrole = "denied"\n'
    ranges, truth = ["t_s,from_id,to_id,range_m,sigma_m"], ["t_s,id,e_m,n_m,u_m"]
    for name, (e, n) in {"A": (0, 0), "B": (30, 0), "C": (0, 30)}.items():
        meta += f'[[node]]\nid = "{name}"\nrole = "anchor"\ne_m = {e}\nn_m = {n}\nu_m = 0\nsigma_m = 0.01\n'
        ranges += [f"{k},tag,{name},{np.hypot(10 + 0.1 * k - e, 8 - n) + 0.3},0.1" for k in range(100)]
    truth += [f"{k},tag,{10 + 0.1 * k},8,0" for k in range(100)]
    for file, text in (("meta.toml", meta), ("ranges.csv", "\n".join(ranges)), ("truth.csv", "\n".join(truth))):
        (directory / file).write_text(text + "\n")
