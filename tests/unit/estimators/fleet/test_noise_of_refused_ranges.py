"""Ranges that the gate refuses show nothing of the noise of the others: the bound stays as wide as without them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.measurements import AltitudeMeasurement, Estimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.filter import FleetFilter

DENIED = 9
ANCHORS_M = {1: (0.0, 0.0, 0.0), 2: (6.0, 0.0, 0.0), 3: (6.0, 5.0, 0.0), 4: (0.0, 5.0, 0.0)}
SIGMA_M, DRIFT_S, STEP_S, END_S = 0.15, 5.0, 0.1, 30.0
NO_ANSWER_M = 338_210.0
"""What a radio gives that got no answer: its counter less one, in metres."""


def sigma_m(seed: int, unanswered_share: float) -> float:
    """Return the horizontal sigma at the end, where errors of ranges last for seconds and some ranges are none."""
    rng, chance, estimator = np.random.default_rng(seed), np.random.default_rng(seed + 100), FleetFilter()
    for anchor, place in ANCHORS_M.items():
        estimator.add(PositionMeasurement(anchor, 0.0, 0.0, place, 0.02, 0.02, static=True))
    estimator.set_denied({DENIED}, 0.0)
    errors_m, kept = dict.fromkeys(ANCHORS_M, 0.0), math.exp(-STEP_S / DRIFT_S)
    for k in range(round(END_S / STEP_S)):
        t = STEP_S * k
        where = (3.0 + math.cos(0.2 * t), 2.5 + math.sin(0.2 * t), 0.0)
        estimator.add(AltitudeMeasurement(DENIED, t, t, 0.0, 0.1))
        for anchor, place in ANCHORS_M.items():
            errors_m[anchor] = kept * errors_m[anchor] + math.sqrt(1.0 - kept**2) * SIGMA_M * rng.normal()
            range_m = math.dist(where, place) + errors_m[anchor] + 0.03 * rng.normal()
            estimator.add(RangeMeasurement(DENIED, anchor, t, t, range_m, SIGMA_M))
            if chance.random() < unanswered_share:
                estimator.add(RangeMeasurement(DENIED, anchor, t + 0.05, t + 0.05, NO_ANSWER_M, SIGMA_M))
    found = estimator.estimate(DENIED, END_S)
    assert isinstance(found, Estimate)
    return math.sqrt(float(np.trace(found.covariance[:2, :2])))


@pytest.mark.parametrize("seed", range(3))
def test_ranges_that_got_no_answer_make_the_others_no_better(seed):
    """They counted as white noise, four times each, so the errors of all ranges averaged away: a sigma of 0.88 of the other."""
    assert sigma_m(seed, 0.05) == pytest.approx(sigma_m(seed, 0.0), rel=0.02)
