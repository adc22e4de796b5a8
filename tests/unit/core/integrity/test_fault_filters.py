"""The fault filters of one denied vehicle: faults are isolated, and fault-free errors raise no alarm."""

from __future__ import annotations

from math import cos, exp, pi, sin

import numpy as np
import pytest

from gcs_coloc.core.integrity import fault_filters
from gcs_coloc.core.integrity.fault_filters import FaultFilters, LineOfSightResidual, positive_part

STEP_S = 0.2
REPORTED_SIGMA_M, NOISE_M, WANDER_S = 1.5, 1.0, 60.0
AROUND = {1: 0.1, 2: 1.7, 3: 3.0, 4: 4.8}
"""Directions from the vehicle to its peers, rad: redundancy numbers of 0.4 to 0.6."""


class Residuals:
    """Residuals to the peers: Gauss-Markov errors of a minute, white range noise, and added faults."""

    def __init__(self, seed, around=AROUND, white_m=0.0):
        self.rng, self.white_m = np.random.default_rng(seed), white_m
        self.units = {peer: (-cos(a), -sin(a)) for peer, a in around.items()}
        self.error_m = {peer: REPORTED_SIGMA_M * self.rng.standard_normal() for peer in around}

    def at(self, more_m=None):
        keep = exp(-STEP_S / WANDER_S)
        out = {}
        for peer, unit in self.units.items():
            self.error_m[peer] = keep * self.error_m[peer] + REPORTED_SIGMA_M * (1 - keep**2) ** 0.5 * self.rng.standard_normal()
            residual_m = self.error_m[peer] + np.hypot(NOISE_M, self.white_m) * self.rng.standard_normal()
            out[peer] = LineOfSightResidual(residual_m + (more_m or {}).get(peer, 0.0), NOISE_M, REPORTED_SIGMA_M, unit)
        return out


def flown(filters, residuals, from_s, to_s, rate_mps=None, offset_m=None):
    """Update with the residuals of some seconds, with faults of `rate_mps` and `offset_m` since the beginning; yield after each
    step.
    """
    for step in range(round(from_s / STEP_S), round(to_s / STEP_S)):
        t = step * STEP_S
        more = {peer: rate * (t - from_s) for peer, rate in (rate_mps or {}).items()}
        for peer, size_m in (offset_m or {}).items():
            more[peer] = more.get(peer, 0.0) + size_m
        filters.update(residuals.at(more), t)
        yield t


def probabilities(filters):
    return {h.faulty: h.probability for h in filters.hypotheses(filters.at_s)}


def test_a_growing_fault_is_detected_and_its_vehicle_identified():
    for seed in range(20):
        filters, residuals = FaultFilters(), Residuals(seed)
        list(flown(filters, residuals, 0.0, 20.0))
        list(flown(filters, residuals, 20.0, 32.0, rate_mps={1: 2.0}))
        by_vehicle = probabilities(filters)
        assert sum(by_vehicle.values()) > 0.9999
        assert max(by_vehicle, key=by_vehicle.get) == 1


def test_the_solution_separation_of_a_likely_fault_is_that_of_the_geometry():
    units = np.array([Residuals(0).units[peer] for peer in AROUND])
    ratios = []
    for seed in range(20):
        filters, residuals = FaultFilters(), Residuals(seed)
        list(flown(filters, residuals, 0.0, 20.0))
        list(flown(filters, residuals, 20.0, 28.0, rate_mps={1: 2.0}))
        moved_m = np.linalg.norm(np.linalg.solve(units.T @ units, units[0] * 16.0))
        likeliest = max(filters.hypotheses(filters.at_s), key=lambda h: h.probability)
        ratios.append(np.sqrt(likeliest.separation_m2[0] + likeliest.separation_m2[2]) / moved_m)
    # The fault is known to about 1.5 m / sqrt(r), its effect to about a sixth; of twenty draws the mean to a twenty-fifth.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("white_m", [0.0, 1.5], ids=["noise as stated", "noise nearly twice what is stated"])
def test_gauss_markov_errors_and_noise_above_its_stated_sigma_raise_no_alarm(white_m):
    """Four flights of four minutes: a fault is at most a few per cent likely, far below 0.9999 where it has consequences."""
    worst, mean = [], []
    for seed in range(4):
        filters, residuals = FaultFilters(), Residuals(seed, white_m=white_m)
        by_vehicle = [sum(probabilities(filters).values()) for t in flown(filters, residuals, 0.0, 240.0) if t > 60.0]
        worst.append(max(by_vehicle))
        mean.append(np.mean(by_vehicle))
    assert max(worst) < 0.9
    assert np.mean(mean) < 0.05


def test_multipath_raises_no_alarm():
    for seed in range(4):
        filters, residuals = FaultFilters(), Residuals(seed)
        for step in range(600):
            late = {peer: residuals.rng.uniform(5.0, 100.0) for peer in AROUND if residuals.rng.random() < 0.1}
            filters.update(residuals.at(late), step * STEP_S)
            assert sum(probabilities(filters).values()) < 0.999


def test_a_biased_own_device_is_distinguished_from_a_faulty_peer():
    for seed in range(10):
        filters, residuals = FaultFilters(), Residuals(seed, around={1: 0.0, 2: pi / 3, 3: 2 * pi / 3, 4: pi})
        list(flown(filters, residuals, 0.0, 20.0))
        list(flown(filters, residuals, 20.0, 40.0, rate_mps=dict.fromkeys((1, 2, 3, 4), 1.0)))
        by_vehicle = probabilities(filters)
        assert max(by_vehicle, key=by_vehicle.get) is None


def test_a_fault_of_one_of_two_peers_in_one_line_is_not_isolated():
    filters, residuals = FaultFilters(), Residuals(3, around={1: 0.0, 2: pi, 3: pi / 2, 4: 3 * pi / 2})
    list(flown(filters, residuals, 0.0, 20.0))
    list(flown(filters, residuals, 20.0, 32.0, rate_mps={1: 2.0}))
    by_vehicle = probabilities(filters)
    # Whether 1 is too far away or 2, the vehicle between them is displaced alike: only the model of fault-free errors
    # distinguishes them.
    assert by_vehicle[1] + by_vehicle[2] > 0.99
    assert min(by_vehicle[1], by_vehicle[2]) > 100.0 * max(by_vehicle[3], by_vehicle[4])


def test_after_an_exclusion_the_next_fault_is_detected_as_well():
    filters, residuals = FaultFilters(), Residuals(5, around={**AROUND, 5: 2.4})
    list(flown(filters, residuals, 0.0, 20.0))
    list(flown(filters, residuals, 20.0, 30.0, rate_mps={1: 2.0}))
    filters.exclude({1})
    assert filters.peers == [2, 3, 4, 5]
    assert sum(probabilities(filters).values()) < 0.01
    del residuals.units[1]
    list(flown(filters, residuals, 30.0, 50.0))
    assert sum(probabilities(filters).values()) < 0.2
    list(flown(filters, residuals, 50.0, 62.0, rate_mps={3: 2.0}))
    by_vehicle = probabilities(filters)
    assert sum(by_vehicle.values()) > 0.999
    assert max(by_vehicle, key=by_vehicle.get) == 3


def test_added_and_removed_peers_leave_the_others_unchanged():
    filters, residuals = FaultFilters(), Residuals(7)
    late = residuals.units.pop(4)
    list(flown(filters, residuals, 0.0, 10.0))
    assert filters.peers == [1, 2, 3]
    residuals.units[4] = late
    list(flown(filters, residuals, 10.0, 20.0))
    del residuals.units[2]
    list(flown(filters, residuals, 20.0, 30.0))
    assert filters.peers == [1, 3, 4]
    assert sum(probabilities(filters).values()) < 0.3


def test_a_jump_of_the_estimate_resets_the_displacement_and_raises_no_alarm():
    filters, residuals = FaultFilters(), Residuals(9)
    list(flown(filters, residuals, 0.0, 20.0))
    shift = {peer: 60.0 * unit[0] for peer, unit in residuals.units.items()}
    list(flown(filters, residuals, 20.0, 40.0, offset_m=shift))
    assert sum(probabilities(filters).values()) < 0.3


def test_a_first_outlier_is_forgotten_after_three_ranges_where_each_step_has_those_of_one_peer():
    filters, units = FaultFilters(), {1: (0.0, 1.0), 2: (0.8, -0.6), 3: (-0.8, -0.6)}
    for step in range(18):
        peer = 1 + step % 3
        residual_m = 15.0 if step == 1 else 0.0
        filters.update({peer: LineOfSightResidual(residual_m, NOISE_M, REPORTED_SIGMA_M, units[peer])}, step / 3.0)
    for hypothesis in filters.hypotheses(filters.at_s):
        ee, _, nn = hypothesis.separation_m2
        assert np.sqrt(ee + nn) < 3.0


def test_faults_that_begin_and_end_at_once_keep_probabilities_within_bounds(monkeypatch):
    monkeypatch.setattr(fault_filters, "_ONSET_RATE_PER_S", 1.0)
    monkeypatch.setattr(fault_filters, "_END_RATE_PER_S", 1.0)
    filters = FaultFilters()
    says_nothing = {peer: LineOfSightResidual(0.0, 1e6, REPORTED_SIGMA_M, (-cos(a), -sin(a))) for peer, a in AROUND.items()}
    faulty = []
    for at_s in (0.0, 3.0, 6.0):
        filters.update(says_nothing, at_s)
        faulty.append(sum(probabilities(filters).values()))
    # Five faults: 15 are expected to begin in a step of 3 s; a share of exp(-3) goes on.
    begin, go_on = 1.0 - exp(-15.0), exp(-3.0)
    expected = [begin, begin * go_on + (1.0 - begin) * begin]
    expected.append(expected[1] * go_on + (1.0 - expected[1]) * begin)
    assert faulty == pytest.approx(expected, rel=1e-3)


def test_of_a_peer_that_has_left_nothing_is_remembered():
    """Its residuals once scattered by 40 m: the first one after its return counts as much as if they had not."""
    moved_m2 = []
    for scattered_m in (0.0, 40.0):
        filters, residuals = FaultFilters(), Residuals(3)
        for step in range(200):
            filters.update(residuals.at({4: scattered_m * (-1) ** step}), step * STEP_S)
        del residuals.units[4]
        list(flown(filters, residuals, 40.0, 80.0))
        filters.update({4: LineOfSightResidual(0.0, NOISE_M, REPORTED_SIGMA_M, (-cos(4.8), -sin(4.8)))}, 80.0)
        east_m2, _, north_m2 = filters.hypotheses(80.0)[-1].separation_m2
        moved_m2.append(east_m2 + north_m2)
    assert moved_m2[0] == pytest.approx(moved_m2[1], rel=0.1)


@pytest.mark.parametrize("shift", [3.0, 0.0, -3.0], ids=["positive", "of either sign", "negative"])
def test_the_positive_part_of_a_matrix_keeps_its_positive_eigenvalues(shift):
    rng = np.random.default_rng(11)
    for _ in range(50):
        half = rng.normal(size=(2, 2))
        matrix = half + half.T + shift * np.eye(2)
        values, axes = np.linalg.eigh(matrix)
        ee, en, nn = positive_part(matrix[0, 0], matrix[0, 1], matrix[1, 1])
        np.testing.assert_allclose([[ee, en], [en, nn]], axes * np.maximum(values, 0.0) @ axes.T, atol=1e-12)
    assert positive_part(shift, 0.0, shift) == (max(shift, 0.0), 0.0, max(shift, 0.0))
