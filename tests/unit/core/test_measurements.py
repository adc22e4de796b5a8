"""Measurements and answers: how reasons are counted, and which measurements are possible."""

import math

import pytest

from gcs_coloc.core.measurements import NoEstimateReason, RangeMeasurement, Unlocated, count_reasons, is_possible


def test_reasons_that_differ_in_their_numbers_alone_are_one_and_the_most_frequent_comes_first():
    too_uncertain = [Unlocated(NoEstimateReason.TOO_UNCERTAIN, sigma_m) for sigma_m in (12.5, 13.25, 1400.0)]
    not_heard = Unlocated(NoEstimateReason.NOT_HEARD)
    assert list(count_reasons([not_heard, *too_uncertain]).items()) == [(too_uncertain[0], 3), (not_heard, 1)]
    assert count_reasons([]) == {}


@pytest.mark.parametrize(
    "numbers", [(1, 1, 5.0, 0.5), (1, 2, -0.1, 0.5), (1, 2, 5.0, 0.0), (1, 2, math.nan, 0.5), (1, 2, 5.0, math.inf)]
)
def test_an_impossible_range_is_told_from_a_possible_one(numbers):
    own, peer, range_m, sigma_m = numbers
    assert is_possible(RangeMeasurement(1, 2, 0.0, 0.0, 0.0, 0.5))
    assert not is_possible(RangeMeasurement(own, peer, 0.0, 0.0, range_m, sigma_m))
