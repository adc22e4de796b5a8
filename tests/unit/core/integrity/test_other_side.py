"""Several located by ranges to each other: where their anchors leave open on which side of them they are."""

import math

import pytest

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, PositionPrior, RangeResidual
from gcs_coloc.core.integrity.other_side import OpenSides, other_side_m

FREE = {8: (30.0, 40.0, 0.0), 9: (60.0, 100.0, 0.0)}
"""Two without prior, 40 and 100 m from the line of anchors 1 and 2."""
ANCHORS = {1: (0.0, 0.0, 0.0), 2: (200.0, 0.0, 0.0)}


def epoch(anchors, pairs, free=None):
    places = {**anchors, **(free or FREE)}
    priors = {v: PositionPrior(place, 1.5, 2.0, v not in anchors) for v, place in places.items()}
    return Epoch(0.0, priors, tuple(RangeResidual(a, b, 0.0, 0.5) for a, b in pairs))


def all_pairs(anchors):
    return [(8, 9), *((v, anchor) for v in FREE for anchor in anchors)]


def test_beside_two_anchors_a_figure_of_two_fits_on_either_side_and_counts_by_its_farthest():
    now = epoch(ANCHORS, all_pairs(ANCHORS))
    assert other_side_m(now, 8) == other_side_m(now, 9) == pytest.approx(200.0)


def test_one_vehicle_alone_is_no_figure_unless_it_comes_out_of_one():
    alone = epoch(ANCHORS, [(8, 1), (8, 2), (9, 1), (9, 2)])
    assert other_side_m(alone, 8) == 0.0
    assert other_side_m(alone, 8, was_open=True) == pytest.approx(80.0)


@pytest.mark.parametrize(("third", "is_open"), [((100.0, 0.5, 0.0), True), ((100.0, 80.0, 0.0), False)])
def test_a_third_anchor_tells_the_sides_apart_unless_it_is_on_the_line(third, is_open):
    anchors = {**ANCHORS, 3: third}
    assert (other_side_m(epoch(anchors, all_pairs(anchors)), 8) > 0.0) is is_open


def test_the_anchors_of_any_of_the_figure_hold_it():
    """8 ranges one anchor and 9, which ranges three that are on no line."""
    anchors = {**ANCHORS, 3: (100.0, 80.0, 0.0)}
    assert other_side_m(epoch(anchors, [(8, 1), (8, 9), (9, 1), (9, 2), (9, 3)]), 8) == 0.0


def test_around_one_anchor_a_figure_turns_freely_and_without_any_it_is_anywhere():
    assert other_side_m(epoch({1: ANCHORS[1]}, [(8, 1), (9, 1), (9, 8)]), 9) == pytest.approx(2.0 * math.hypot(60.0, 100.0))
    assert other_side_m(epoch({}, [(9, 8)]), 9) == 10_000.0


def test_the_side_of_one_that_leaves_a_figure_stays_open_until_ranges_tell_it():
    sides, third = OpenSides(), {**ANCHORS, 3: (100.0, 80.0, 0.0)}
    alone = epoch(ANCHORS, [(8, 1), (8, 2)])
    assert sides.other_side_m(alone, 8) == 0.0
    sides.other_side_m(epoch(ANCHORS, all_pairs(ANCHORS)), 8)
    assert sides.other_side_m(alone, 8) == pytest.approx(80.0)
    assert sides.other_side_m(epoch(third, [(8, 1), (8, 2), (8, 3)]), 8) == 0.0
    assert sides.other_side_m(alone, 8) == 0.0
