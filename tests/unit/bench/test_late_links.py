"""The benchmark of late links: what a vehicle's UTC shows of them keeps what is stated true, and nobody is distrusted."""

import pytest

from bench.late_links import Late, all_late, fly, none_late, one_peer_late


@pytest.mark.parametrize("delays_s", [none_late, one_peer_late, all_late])
def test_by_its_utc_a_late_vehicle_is_where_it_is_and_a_fix_is_stated_throughout(delays_s):
    flown = fly((Late(delays_s, utc=True), 1))
    assert flown.distrusted == 0
    assert flown.stated.fixes == flown.stated.epochs
    # 0.1 s by which a UTC may be less behind than is held is 2 m at 20 m/s: the bound has that in it.
    assert flown.stated.covered > 0.9 * flown.stated.fixes
    assert flown.stated.far_off == 0


def test_without_it_a_single_late_peer_costs_the_fix_rather_than_a_wrong_one():
    flown = fly((Late(one_peer_late), 2))
    assert flown.stated.fixes < flown.stated.epochs
    assert flown.stated.far_off == 0
