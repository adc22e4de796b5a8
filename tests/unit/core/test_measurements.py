"""Measurements and answers: how reasons are counted."""

from gcs_coloc.core.measurements import count_reasons


def test_reasons_that_differ_in_their_numbers_alone_are_one_and_the_most_frequent_comes_first():
    too_uncertain = [f"too uncertain: {sigma_m:.1f} m; more ranges are needed" for sigma_m in (12.5, 13.25, 1400.0)]
    assert count_reasons(["never heard", *too_uncertain]) == {too_uncertain[0]: 3, "never heard": 1}
    assert count_reasons([]) == {}
