import math

import numpy as np
import pytest

from gcs_coloc.estimators.qu_zhang.cv_filter import CvFilter, nis, position_rows
from gcs_coloc.estimators.qu_zhang.track import NisGate, threshold


def test_thresholds_are_chi_square_quantiles() -> None:
    # Textbook: 95 % of chi-square with 2 degrees of freedom lie below 5.991; for 1 below 3.841.
    assert threshold(0.95, 2) == pytest.approx(5.991, abs=1e-3)
    assert threshold(0.95, 1) == pytest.approx(3.841, abs=1e-3)


def test_a_consistent_measurement_passes_and_an_outlier_does_not() -> None:
    gate = NisGate(0.999, patience=3)

    assert gate.test(13.0, 2).accepted
    assert not gate.test(14.0, 2).accepted
    assert not gate.test(math.nan, 2).accepted


def test_single_outliers_never_widen() -> None:
    gate = NisGate(0.999, patience=2)

    results = [gate.test(nis_value, 2) for nis_value in [100.0, 100.0, 1.0] * 5]

    assert all(result.inflation == 1.0 for result in results)


def test_refusals_in_a_row_widen_until_the_filter_finds_its_way_back() -> None:
    # Confident to a metre and 500 m wrong: a plain gate would refuse the truth for ever.
    one = CvFilter(0.0, np.zeros(2), np.eye(2), np.zeros(2), 1.0, 0.1, memory_s=1.0)
    gate, truth, R, H = NisGate(0.9999, patience=4), np.array([300.0, 400.0]), np.eye(2), position_rows(2)
    for step in range(1, 31):
        result = gate.test(nis(*one.innovation(truth, R, H, 0.2 * step)), 2)
        if result.accepted:
            one.update(truth, R, H, 0.2 * step)
        else:
            one.inflate_covariance(result.inflation)

    assert one.state[[0, 2]] == pytest.approx(truth, abs=2.0)
