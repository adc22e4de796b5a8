"""Evidence over time that receivers are worse than they state: found where they are, and nowhere else."""

from __future__ import annotations

from math import exp, sqrt

import numpy as np
import pytest

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, PositionPrior, RangeResidual
from gcs_coloc.core.integrity.epoch_tests.noise_evidence import AccuracyEvidence
from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel

STATED_M, RANGE_SIGMA_M, EVERY_S = 1.5, 0.6, 5.0


def noise_found(seed: int, *, factor: float, for_s: float, drawn_off_mps: float = 0.0, bias_m: float = 0.0) -> NoiseModel:
    """Five vehicles range each other; their receivers err by `factor` times what they state, with a correlation time of 60 s.

    From a minute on the receiver of vehicle 1 is drawn off; each device's ranges are off by a lasting error of `bias_m`.
    """
    rng = np.random.default_rng(seed)
    vehicles = range(1, 6)
    true = {v: np.append(rng.uniform(-1000.0, 1000.0, 2), rng.uniform(80.0, 140.0)) for v in vehicles}
    error = {v: factor * STATED_M * rng.standard_normal(2) for v in vehicles}
    bias = {v: bias_m * rng.standard_normal() for v in vehicles}
    kept = exp(-EVERY_S / 60.0)
    evidence, noise = AccuracyEvidence(), NoiseModel()
    for at_s in np.arange(0.0, for_s, EVERY_S).tolist():
        priors, residuals = {}, []
        for v in vehicles:
            error[v] = kept * error[v] + factor * STATED_M * sqrt(1.0 - kept * kept) * rng.standard_normal(2)
            off_m = drawn_off_mps * max(at_s - 60.0, 0.0) if v == 1 else 0.0
            place = true[v] + (*(error[v] + (off_m, 0.0)), 0.5 * rng.standard_normal())
            priors[v] = PositionPrior(tuple(place.tolist()), STATED_M, STATED_M, False)
        for i in vehicles:
            for j in vehicles:
                if i != j:
                    measured_m = np.linalg.norm(true[i] - true[j]) + RANGE_SIGMA_M * rng.standard_normal() + bias[i]
                    computed_m = np.linalg.norm(np.subtract(priors[i].position_enu_m, priors[j].position_enu_m))
                    residuals.append(RangeResidual(i, j, float(measured_m - computed_m), RANGE_SIGMA_M))
        noise = noise.after(EVERY_S)
        noise = evidence.update(Epoch(at_s, priors, tuple(residuals)), noise)
    return noise


def test_receivers_that_state_a_third_of_their_error_are_found_within_three_minutes():
    """20 fleets. All of 60 others were found, so 95 % of all are at least, and 17 of 20 that is less three sigmas."""
    assert sum(noise_found(seed, factor=3.0, for_s=180.0).position_factor > 1.0 for seed in range(20)) >= 17


def test_receivers_that_are_worse_than_was_found_first_are_found_worse_again():
    """What was found decays between epochs, so the next factor is no longer twice the first."""
    assert [seed for seed in range(10) if noise_found(seed, factor=8.0, for_s=120.0).position_factor < 2.5] == []


def test_receivers_that_are_as_good_as_they_state_are_never_suspected():
    assert [seed for seed in range(20) if not noise_found(seed, factor=1.0, for_s=600.0).is_as_stated] == []


@pytest.mark.parametrize("drawn_off_mps", [0.2, 1.0])
def test_one_receiver_that_is_drawn_off_is_not_taken_for_less_accurate_receivers(drawn_off_mps):
    """Up to 10 m, by which the tests of single epochs name it."""
    until_s = 60.0 + 10.0 / drawn_off_mps
    flights = [noise_found(seed, factor=1.0, for_s=until_s, drawn_off_mps=drawn_off_mps) for seed in range(20)]
    assert [noise for noise in flights if not noise.is_as_stated] == []


def test_what_lasting_errors_of_ranges_explain_better_says_nothing_of_receivers():
    assert [s for s in range(20) if noise_found(s, factor=1.0, for_s=300.0, bias_m=6.0).position_factor > 1.0] == []
