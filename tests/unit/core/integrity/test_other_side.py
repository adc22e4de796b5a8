"""Several located by ranges to each other: where their anchors leave open on which side of them they are."""

import math

import pytest

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, PositionPrior, RangeResidual
from gcs_coloc.core.integrity.other_side import OpenSides

FREE = {8: (30.0, 40.0, 0.0), 9: (60.0, 100.0, 0.0)}
"""Two without prior, 40 and 100 m from the line of anchors 1 and 2."""
ANCHORS = {1: (0.0, 0.0, 0.0), 2: (200.0, 0.0, 0.0)}


MAX_ACCELERATION_MPS2 = 10.0
AT_REST = (0.0, 0.0, 0.0)


def epoch(anchors, pairs, free=None, at_s=0.0):
    places = {**anchors, **(free or FREE)}
    priors = {v: PositionPrior(place, 1.5, 2.0, v not in anchors) for v, place in places.items()}
    return Epoch(at_s, priors, tuple(RangeResidual(a, b, 0.0, 0.5) for a, b in pairs))


def other_side_m(now, vehicle, sides=None, velocity=AT_REST):
    return (sides or OpenSides(MAX_ACCELERATION_MPS2)).other_side_m(now, vehicle, velocity)


def all_pairs(anchors):
    return [(8, 9), *((v, anchor) for v in FREE for anchor in anchors)]


def test_beside_two_anchors_a_figure_of_two_fits_on_either_side_and_counts_by_its_farthest():
    now = epoch(ANCHORS, all_pairs(ANCHORS))
    assert other_side_m(now, 8) == other_side_m(now, 9) == pytest.approx(200.0)


def test_one_vehicle_alone_is_no_figure():
    assert other_side_m(epoch(ANCHORS, [(8, 1), (8, 2), (9, 1), (9, 2)]), 8) == 0.0


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
    sides, third = OpenSides(MAX_ACCELERATION_MPS2), {**ANCHORS, 3: (100.0, 80.0, 0.0)}
    alone = [(8, 1), (8, 2)]
    assert other_side_m(epoch(ANCHORS, all_pairs(ANCHORS)), 8, sides) == pytest.approx(200.0)
    assert other_side_m(epoch(ANCHORS, alone), 8, sides) == pytest.approx(80.0)
    assert other_side_m(epoch(third, [*alone, (8, 3)]), 8, sides) == 0.0
    assert other_side_m(epoch(ANCHORS, alone), 8, sides) == 0.0


def told(velocity=AT_REST):
    """Sides that were told at 0 s, by ranges or receivers; both vehicles move alike."""
    sides = OpenSides(MAX_ACCELERATION_MPS2)
    for vehicle, place in FREE.items():
        sides.note_side(vehicle, 0.0, place, velocity)
    return sides


@pytest.mark.parametrize(("silent_s", "is_open"), [(1.0, False), (4.0, False), (4.5, True)])
def test_a_figure_that_cannot_have_come_to_the_line_is_on_the_side_where_it_was(silent_s, is_open):
    """10 m and 10 m/s^2 reach the 100 m from the line to the farthest after 4.2 s."""
    now = epoch(ANCHORS, all_pairs(ANCHORS), at_s=silent_s)
    assert (other_side_m(now, 8, told()) > 0.0) is is_open


def test_a_side_that_was_never_out_of_sight_stays_told():
    sides = told()
    for second in range(1, 60):
        now = epoch(ANCHORS, all_pairs(ANCHORS), at_s=float(second))
        assert other_side_m(now, 8, sides) == other_side_m(now, 9, sides) == 0.0


def test_a_course_across_the_line_opens_the_side():
    south = (0.0, -45.0, 0.0)
    ahead = {v: (e, n + 2.0 * south[1], u) for v, (e, n, u) in FREE.items()}
    now = epoch(ANCHORS, all_pairs(ANCHORS), free=ahead, at_s=2.0)
    assert other_side_m(now, 8, told(south), south) > 0.0
    assert other_side_m(epoch(ANCHORS, all_pairs(ANCHORS), at_s=2.0), 8, told(), AT_REST) == 0.0


def test_an_estimate_that_jumped_may_have_jumped_to_the_other_side():
    mirrored = {v: (e, -n, u) for v, (e, n, u) in FREE.items()}
    now = epoch(ANCHORS, all_pairs(ANCHORS), free=mirrored, at_s=1.0)
    assert other_side_m(now, 8, told()) == pytest.approx(200.0)


def test_around_one_anchor_a_figure_has_turned_by_no_more_than_its_vehicles_may_have_moved():
    one = {1: ANCHORS[1]}
    sides = told()
    assert other_side_m(epoch(one, [(8, 1), (9, 1), (9, 8)], at_s=1.0), 9, sides) == pytest.approx(2.0 * 15.0)
    assert other_side_m(epoch(one, [(8, 1), (9, 1), (9, 8)], at_s=2.0), 9, sides) == pytest.approx(2.0 * 30.0)
    assert other_side_m(epoch(ANCHORS, all_pairs(ANCHORS), at_s=2.2), 9, sides) == 0.0, "it cannot have come to the line"
