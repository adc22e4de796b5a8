from __future__ import annotations

import math

import numpy as np
import pytest
from recordings import recording

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet.ekf.state import JointState
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.range_biases import BiasSample, BiasWindow, RangeBiases
from gcs_coloc.evaluation.evaluate import evaluate

SIGMA_M = 0.1
AROUND = [(5.0 * math.cos(a), 4.0 * math.sin(a), 1.0 + 0.1 * (k % 3)) for k, a in enumerate(np.arange(8) * math.pi / 4.0)]
BESIDE = [(6.0, -1.5, 1.0), (6.0, -0.5, 1.0), (6.0, 0.5, 1.0), (6.0, 1.5, 1.0)]
TAG = 99
OFF_M, OFF_MPS = np.array([0.3, -0.2, 0.0]), np.array([0.5, 0.0, 0.0])


def tag_at(t: float) -> np.ndarray:
    return np.array([1.5 * math.sin(0.5 * t), 1.2 * math.cos(0.4 * t), 1.0])


def observed(anchors: list[tuple[float, float, float]], biases_m: list[float], seconds: int, seed: int = 1) -> RangeBiases:
    """What a tag's ranges tell of their biases, at 10 Hz each, linearised 0.3 m and 0.5 m/s beside the truth."""
    rng = np.random.default_rng(seed)
    biases, P = RangeBiases(), np.diag([0.1, 0.1, 1e-4, 0.5, 0.5, 1e-4])
    for second in range(seconds):
        velocity = (tag_at(second + 0.05) - tag_at(second - 0.05)) / 0.1
        state = np.concatenate([tag_at(second) + OFF_M, velocity + OFF_MPS])
        window = BiasWindow(float(second), state, P, 1e-4, 4.0)
        for t in second + 0.1 * np.arange(10):
            for i, (place, bias_m) in enumerate(zip(anchors, biases_m, strict=True)):
                range_m = float(np.linalg.norm(tag_at(t) - place)) + bias_m + SIGMA_M * rng.normal()
                window = window.with_sample(BiasSample(float(t), (i, 0), range_m, SIGMA_M, 0.03, place))
        biases = biases.with_window(window, {(i, 0): 1e-4 * np.eye(3) for i in range(len(anchors))}, 0.01)
    return biases


@pytest.mark.parametrize("bias_m", [-0.3, 0.2, 0.5])
def test_a_bias_of_the_device_among_anchors_on_all_sides_is_found_within_five_centimetres(bias_m):
    found = observed(AROUND, [bias_m] * 8, 40).bias(None)
    assert found is not None
    assert found.mean_m == pytest.approx(bias_m, abs=0.05)
    assert found.sigma_m >= abs(found.mean_m), "what the geometry does not show may be as large"


def test_what_makes_pairs_differ_as_no_position_does_is_found_for_each_pair():
    differences = [0.25 if k % 2 else -0.25 for k in range(8)]
    found = observed(AROUND, differences, 40)
    assert [found.bias((k, 0)).mean_m for k in range(8)] == pytest.approx(differences, abs=0.08)


@pytest.mark.parametrize("seed", range(6))
def test_white_noise_is_no_bias(seed):
    assert observed(AROUND, [0.0] * 8, 60, seed).bias((0, 0)) is None


def test_a_bias_that_a_position_explains_as_well_is_not_learned():
    assert observed(BESIDE[:2], [0.3] * 2, 60).bias((0, 0)) is None


def test_errors_of_the_positions_of_peers_are_no_biases_of_ranges():
    rng = np.random.default_rng(5)
    offsets = rng.normal(size=(8, 3))
    biases = RangeBiases()
    for second in range(40):
        window = BiasWindow(float(second), np.concatenate([tag_at(second), np.zeros(3)]), np.eye(6), None, 4.0)
        for t in second + 0.1 * np.arange(10):
            for i, place in enumerate(AROUND):
                range_m = float(np.linalg.norm(tag_at(t) - place - offsets[i])) + SIGMA_M * rng.normal()
                window = window.with_sample(BiasSample(float(t), (i, 0), range_m, SIGMA_M, 0.03, place))
        biases = biases.with_window(window, {(i, 0): np.eye(3) for i in range(8)}, 0.01)
    assert biases.bias((0, 0)) is None


def flown(rate_hz: int, bias_m: float, seed: int) -> tuple[float, float, FleetFilter]:
    """The share of the errors within the 95 % bound and the RMSE of a tag whose device is off; pairs differ by a third of it."""
    rng = np.random.default_rng(seed)
    pairs_m = bias_m * (1.0 + rng.normal(size=8) / 3.0)
    estimator = FleetFilter()
    estimator.add(VehicleClassReport(TAG, 0.0, 0.0, VehicleClass.INDOOR))
    for k, place in enumerate(AROUND):
        estimator.add(PositionMeasurement(k, 0.0, 0.0, place, 0.01, 0.01, static=True))
    estimator.add(PositionMeasurement(TAG, 0.0, 0.0, tuple(tag_at(0.0).tolist()), 0.3, 0.1, (0.0, 0.0, 0.0), 0.6))
    estimator.set_denied({TAG}, 0.01)
    inside, squares = [], []
    for n in range(1, 30 * rate_hz):
        t = n / rate_hz
        if n % rate_hz == 0:
            estimator.add(AltitudeMeasurement(TAG, t, t, 1.0, 0.1))
        for k, place in enumerate(AROUND):
            range_m = float(np.linalg.norm(tag_at(t) - place)) + pairs_m[k] + SIGMA_M * rng.normal()
            estimator.add(RangeMeasurement(TAG, k, t, t, range_m, SIGMA_M))
        if t > 15.0 and n % (rate_hz // 5) == 0:
            where = estimator.estimate(TAG, t)
            assert isinstance(where, Estimate)
            e = (where.position_enu_m - tag_at(t))[:2]
            squares.append(float(e @ e))
            inside.append(float(e @ np.linalg.solve(where.covariance[:2, :2], e)) < 5.99)
    return float(np.mean(inside)), math.sqrt(float(np.mean(squares))), estimator


@pytest.mark.parametrize("rate_hz", [5, 15])
def test_the_bound_covers_at_any_rate_where_a_device_is_off(rate_hz):
    share, rmse_m, _ = flown(rate_hz, 0.2, seed=1)
    assert share > 0.93
    assert rmse_m < 0.15


def test_a_considered_state_keeps_mean_and_variance_and_its_correlation_is_that_of_a_gain_of_zero():
    rng = np.random.default_rng(2)
    root = rng.normal(size=(4, 4))
    P, x = root @ root.T + np.eye(4), rng.normal(size=4)
    joint = JointState()
    joint.augment("all", x, P, 0.0)
    H, R, nu = rng.normal(size=4), 0.5, 0.7
    S = float(H @ P @ H) + R
    W = joint.correct_scalar(np.concatenate([[-nu], H @ P]), S)
    joint.restore([3], W)
    gain = P @ H / S
    gain[2] = 0.0
    whole = (np.eye(4) - np.outer(gain, H)) @ P @ (np.eye(4) - np.outer(gain, H)).T + R * np.outer(gain, gain)
    np.testing.assert_allclose(joint.A[1:, 1:], whole, atol=1e-12)
    np.testing.assert_allclose(joint.A[0, 1:], x + gain * nu, atol=1e-12)


@pytest.mark.integration
def test_a_recorded_tag_whose_pairs_are_all_off_is_covered_by_its_bound():
    (tag,) = evaluate(recording("ranging/lias_fast"), FleetFilter()).denied
    assert tag.score.horizontal.rmse_m <= 0.12
    assert 0.93 <= tag.score.covered_95 <= 0.99
    assert tag.score.beyond_three_bounds == 0.0
