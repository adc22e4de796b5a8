"""What the coverage benchmark counts, and that its fleets are drawn from the seed alone."""

import numpy as np

from bench.coverage import NONE, Tally, drawn_scenario, fleet_flight, tally


def test_epochs_without_a_fix_are_counted_but_not_judged():
    error = np.array([1.0, 3.0, 10.0, 1.0, np.nan])
    bound = np.array([2.0, 2.0, 2.0, 51.0, np.nan])
    assert tally(error, bound) == Tally(epochs=5, fixes=3, covered=1, far_off=1)


def test_tallies_add_up():
    assert sum([Tally(5, 3, 1, 1), Tally(2, 2, 2, 0)], start=NONE) == Tally(7, 5, 3, 1)


def test_a_fleet_is_drawn_from_its_seed():
    assert drawn_scenario(3) == drawn_scenario(3)
    assert len({drawn_scenario(seed).peers for seed in range(30)}) == 6


def test_a_drawn_fleet_is_located_within_three_bounds():
    """Seed 2, five minutes: 1425 epochs, nearly all with a fix, none confident and wrong."""
    counted = fleet_flight(2)
    assert counted.epochs == 1424
    assert counted.fixes > 1300
    assert counted.covered > 0.9 * counted.fixes
    assert counted.far_off == 0
