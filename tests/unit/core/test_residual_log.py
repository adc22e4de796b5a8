"""What is kept of the residuals: the newest of each pair, and a consistency that a wrong filter cannot pass."""

import statistics

import numpy as np
import pytest

from gcs_coloc.core.measurements import Residual
from gcs_coloc.core.residual_log import ResidualLog


def residual(at_s: float, innovation_m: float = 1.0, peer: int | None = 1, refused: str | None = None) -> Residual:
    return Residual(4, peer, at_s, innovation_m, 1.0, innovation_m**2, 1, refused)


def test_the_newest_range_of_each_pair_is_shown_with_its_age_and_whether_it_was_used():
    log = ResidualLog()
    log.add([residual(10.0), residual(10.2, -3.0, refused="gate"), residual(10.1), residual(10.1, peer=2)], 10.5)
    first, second = log.ranges(10.5)
    assert (first.from_sysid, first.to_sysid, first.innovation_m, first.refused) == (4, 1, -3.0, "gate")
    assert first.age_s == pytest.approx(0.3)
    assert (second.to_sysid, second.refused) == (2, None)


def test_what_is_older_than_five_seconds_is_forgotten_and_fixes_are_left_out():
    log = ResidualLog()
    log.add([residual(10.0), residual(12.0, peer=None)], 12.0)
    assert len(log.ranges(12.0)) == 1
    log.add([], 15.1)
    assert log.ranges(15.1) == ()
    assert log.consistency() == {}


@pytest.mark.parametrize("count", [1, 5, 12, 75, 200])
def test_the_band_holds_the_median_of_a_consistent_filter_with_95_percent(count):
    medians = np.median(np.random.default_rng(3).chisquare(1, (20_000, count)), axis=1)
    log = ResidualLog()
    log.add([residual(10.0)] * count, 10.0)
    c = log.consistency()[4]
    assert c.ranges == count
    # 20,000 draws: the share is known to 0.0015 (1-sigma); for an even count the band is an approximation.
    assert np.mean(medians < c.band_low) == pytest.approx(0.025, abs=0.008)
    assert np.mean(medians > c.band_high) == pytest.approx(0.025, abs=0.008)


@pytest.mark.parametrize(("scale", "place"), [(1.0, "within"), (1.6, "above"), (0.5, "below")])
def test_innovations_of_another_size_than_the_filter_says_are_out_of_the_band(scale, place):
    innovations = np.random.default_rng(3).normal(0.0, scale, 200)
    log = ResidualLog()
    log.add([residual(10.0, float(x)) for x in innovations], 10.0)
    c = log.consistency()[4]
    assert c.nis_median == pytest.approx(float(np.median(innovations**2)))
    assert place == ("below" if c.nis_median < c.band_low else "above" if c.nis_median > c.band_high else "within")


def test_a_few_refused_ranges_hardly_change_the_median_and_are_counted_half_of_them_do():
    few, half = ResidualLog(), ResidualLog()
    sound = [residual(10.0, float(x)) for x in np.random.default_rng(5).normal(0.0, 1.0, 100)]
    few.add([*sound, *[residual(10.0, 30.0, refused="gate")] * 5], 10.0)
    half.add([*sound, *[residual(10.0, 30.0, refused="gate")] * 110], 10.0)
    c = few.consistency()[4]
    assert c.band_low < c.nis_median < c.band_high
    assert (c.ranges, c.refused) == (105, 5)
    assert half.consistency()[4].nis_median > 100.0


def test_both_ends_of_a_range_are_told_and_what_is_too_old_is_not():
    log = ResidualLog()
    log.add([residual(10.0), residual(10.0, 2.0, peer=2), residual(12.0, 3.0, peer=2)], 12.0)
    assert {vehicle: c.ranges for vehicle, c in log.consistency().items()} == {1: 1, 2: 2, 4: 3}
    log.add([], 16.0)
    assert {vehicle: c.nis_median for vehicle, c in log.consistency().items()} == {2: 9.0, 4: 9.0}


def test_what_comes_and_goes_one_by_one_leaves_what_a_look_at_all_that_is_left_finds():
    rng = np.random.default_rng(11)
    log, told = ResidualLog(), []
    for step in range(120):
        now_s = 0.2 * step
        new = [
            Residual(
                from_vehicle=int(ends[0]),
                to_vehicle=int(ends[1]),
                # Late and out of order, as from several links.
                measured_at_s=now_s - float(rng.uniform(0.0, 0.5)),
                innovation_m=1.0,
                sigma_m=1.0,
                nis=float(rng.choice([0.0, 1.0, rng.chisquare(1)])),
                degrees_of_freedom=int(rng.integers(1, 3)),
                refused="gate" if rng.random() < 0.2 else None,
            )
            for ends in (rng.choice(5, 2, replace=False) for _ in range(int(rng.integers(0, 60)) if step < 80 else 0))
        ]
        log.add(new, now_s)
        told += new
        # Only from the front: what came out of order stays until what came before it is too old.
        while told and now_s - told[0].measured_at_s > 5.0:
            told.pop(0)
        seen = log.consistency()
        for vehicle in range(5):
            of_it = [r for r in told if vehicle in (r.from_vehicle, r.to_vehicle)]
            if not of_it:
                assert vehicle not in seen
                continue
            c = seen[vehicle]
            assert c.nis_median == statistics.median(r.nis / r.degrees_of_freedom for r in of_it)
            assert (c.ranges, c.refused) == (len(of_it), sum(r.refused is not None for r in of_it))
    assert not told, "the end of it was seen, too"


def test_of_more_than_four_thousand_residuals_the_first_are_forgotten():
    log = ResidualLog()
    log.add([residual(10.0, 7.0, refused="gate")] * 3000 + [residual(10.0)] * 2000, 10.0)
    c = log.consistency()[4]
    assert (c.ranges, c.refused, c.nis_median) == (4000, 2000, 25.0)


@pytest.mark.parametrize(("scale", "low", "high"), [(1.0, 0.3, 0.65), (3.0, 2.7, 5.8)])
def test_the_normalised_residual_is_the_median_of_both_ends_and_outliers_hardly_change_it(scale, low, high):
    innovations = np.random.default_rng(4).normal(0.0, scale, 200)
    log = ResidualLog()
    log.add([residual(10.0, float(x)) for x in innovations], 10.0)
    # The median of 200 draws of chi-square with one degree of freedom is within 0.455 +- 0.16 with 99 %, times the scale squared.
    assert low < log.median_nis({})[4] < high
    assert log.median_nis({})[1] == log.median_nis({})[4]
    log.add([residual(10.0, 50.0, refused="gate")] * 40, 10.0)
    assert log.median_nis({})[4] < 1.6 * high


def test_too_few_ranges_have_no_median_nis():
    log = ResidualLog()
    log.add([residual(10.0)] * 11, 10.0)
    assert log.median_nis({}) == {}


def test_ranges_agree_with_noise_that_was_found_in_them_and_in_no_other_pairs():
    """A device 2.5 m off where 1 m is stated: with a sigma of 3.3 m found, it is less than usual."""
    log = ResidualLog()
    log.add([residual(10.0, 2.5, peer=peer) for peer in (1, 2) for _ in range(12)], 10.0)
    found = log.median_nis({(4, 1): 3.3**2, (1, 4): 100.0})
    assert found[1] == pytest.approx(2.5**2 / (1.0 + 3.3**2))
    assert found[2] == 2.5**2
    assert found[4] == pytest.approx((found[1] + found[2]) / 2)
    assert log.consistency()[1].nis_median == 2.5**2, "what is shown is the estimator's own"
