"""What is kept of the residuals: the newest of each pair, and a consistency that a wrong filter cannot pass."""

import numpy as np
import pytest
from scipy.stats import chi2

from gcs_coloc.core.measurements import Residual
from gcs_coloc.core.residuals import ResidualLog


def residual(at_s: float, innovation_m: float = 1.0, peer: int | None = 1, refused: str | None = None) -> Residual:
    return Residual(4, peer, at_s, innovation_m, 1.0, innovation_m**2, 1, refused)


def test_the_newest_range_of_each_pair_is_shown_with_its_age_and_verdict():
    log = ResidualLog()
    log.take([residual(10.0), residual(10.2, -3.0, refused="gate"), residual(10.1), residual(10.1, peer=2)], 10.5)
    first, second = log.ranges(10.5)
    assert (first.from_sysid, first.to_sysid, first.innovation_m, first.refused) == (4, 1, -3.0, "gate")
    assert first.age_s == pytest.approx(0.3)
    assert (second.to_sysid, second.refused) == (2, None)


def test_what_is_older_than_five_seconds_is_forgotten_and_fixes_are_left_out():
    log = ResidualLog()
    log.take([residual(10.0), residual(12.0, peer=None)], 12.0)
    assert len(log.ranges(12.0)) == 1
    log.take([], 15.1)
    assert log.ranges(15.1) == ()
    assert log.consistency() == {}


@pytest.mark.parametrize(("scale", "inside"), [(1.0, True), (1.6, False), (0.5, False)])
def test_the_band_holds_a_consistent_filter_and_no_other(scale, inside):
    innovations = np.random.default_rng(3).normal(0.0, scale, 200)
    log = ResidualLog()
    log.take([residual(10.0, float(x)) for x in innovations], 10.0)
    c = log.consistency()[4]
    assert c.degrees_of_freedom == 200
    assert c.band_low == pytest.approx(chi2.ppf(0.025, 200) / 200)
    assert c.band_high == pytest.approx(chi2.ppf(0.975, 200) / 200)
    assert c.nis_mean == pytest.approx(float(np.mean(innovations**2)))
    assert (c.band_low <= c.nis_mean <= c.band_high) is inside


def test_refused_ranges_count_against_consistency():
    log = ResidualLog()
    log.take([residual(10.0)] * 50 + [residual(10.0, 9.0, refused="gate")] * 5, 10.0)
    c = log.consistency()[4]
    assert c.nis_mean > c.band_high


@pytest.mark.parametrize(("scale", "low", "high"), [(1.0, 0.3, 0.65), (3.0, 2.7, 5.8)])
def test_the_misfit_is_the_median_of_both_ends_and_outliers_hardly_change_it(scale, low, high):
    innovations = np.random.default_rng(4).normal(0.0, scale, 200)
    log = ResidualLog()
    log.take([residual(10.0, float(x)) for x in innovations], 10.0)
    # The median of 200 draws of chi-square with one degree of freedom is within 0.455 +- 0.16 with 99 %, times the scale squared.
    assert low < log.misfit()[4] < high
    assert log.misfit()[1] == log.misfit()[4]
    log.take([residual(10.0, 50.0, refused="gate")] * 40, 10.0)
    assert log.misfit()[4] < 1.6 * high


def test_too_few_ranges_have_no_misfit():
    log = ResidualLog()
    log.take([residual(10.0)] * 11, 10.0)
    assert log.misfit() == {}
