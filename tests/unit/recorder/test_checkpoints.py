"""States of a replay are kept by the work between them, found by time, and thinned where they become too large."""

from __future__ import annotations

import random
from math import inf

from gcs_coloc.recorder.checkpoints import WORK_PER_COST, Checkpoints


def flown(kept: Checkpoints, steps: range, size: int = 10, cost_s: float = 0.0) -> list[int]:
    """A second of work and of flight a step; at which of them a state was kept."""
    at = []
    for step in steps:
        if kept.worked(float(step), 1.0):
            kept.keep(float(step), b"x" * size, cost_s)
            at.append(step)
    return at


def test_a_state_is_kept_whenever_enough_was_done_and_the_newest_not_after_a_time_is_found():
    kept = Checkpoints(b"begin", every_s=5.0)
    assert flown(kept, range(1, 22)) == [5, 10, 15, 20]
    assert [kept.nearest(at_s).at_s for at_s in (-inf, 4.9, 5.0, 14.0, 99.0)] == [-inf, -inf, 5.0, 10.0, 20.0]
    assert kept.nearest(4.9).frozen == b"begin"
    assert (len(kept), kept.size_bytes) == (5, 45)


def test_going_over_the_same_again_keeps_nothing_twice():
    kept = Checkpoints(b"", every_s=5.0)
    flown(kept, range(1, 22))
    assert flown(kept, range(7, 24)) == []
    assert flown(kept, range(24, 31)) == [25, 30]


def test_what_takes_long_to_keep_is_kept_seldom():
    kept = Checkpoints(b"", every_s=1.0)
    at = flown(kept, range(1, 400), cost_s=2.0)
    assert at == list(range(1, 400, round(2 * WORK_PER_COST)))


def test_memory_is_bounded_and_no_place_is_far_from_a_state():
    kept = Checkpoints(b"", every_s=1.0, most_bytes=1000)
    flown(kept, range(1, 3001))
    assert kept.size_bytes <= 1000
    places = sorted({kept.nearest(float(at)).at_s for at in range(3001)} - {-inf})
    # A hundred at most for 3000 s; by dropping single ones the longest way to go may be twice the even one, not more.
    assert 90 <= len(places) <= 100
    assert max(b - a for a, b in zip([0.0, *places], [*places, 3000.0], strict=True)) <= 2 * 3000 / len(places) + 1


def test_a_single_state_beyond_the_bound_leaves_the_beginning_and_the_newest():
    kept = Checkpoints(b"begin", every_s=1.0, most_bytes=5)
    flown(kept, range(1, 20), size=100)
    assert len(kept) == 2
    assert (kept.nearest(18.0).frozen, kept.nearest(19.0).at_s) == (b"begin", 19.0)


def test_in_whatever_order_places_are_come_to_the_nearest_is_the_nearest():
    rng, kept, at = random.Random(4), Checkpoints(b"", every_s=7.0), set()
    for _ in range(40):
        begin = rng.randrange(1, 500)
        at.update(flown(kept, range(begin, begin + rng.randrange(1, 100))))
    for place in range(600):
        assert kept.nearest(float(place)).at_s == max((x for x in at if x <= place), default=-inf)
