"""From ranges with the places of both ends to lines, and from chances to suspects and covariances."""

from __future__ import annotations

from math import cos, sin

import numpy as np

from gcs_coloc.core.integrity.epoch import PositionPrior
from gcs_coloc.core.integrity.fault_monitor import FaultMonitor
from gcs_coloc.core.measurements import RangeMeasurement

STEP_S, APART_M = 0.2, 800.0
SUBJECT, LIAR = 100, 1
AROUND = {1: 0.1, 2: 1.7, 3: 3.0, 4: 4.8}


def place(east_m, north_m, free=False):
    return PositionPrior((east_m, north_m, 100.0), 0.0 if free else 1.5, 2.0, free)


class Flight:
    """A denied vehicle at the origin among peers that stand; from 20 s on peer 1 claims to be further and further off."""

    def __init__(self, watch, seed=1, around=AROUND, towards=0.1, reversed_for=()):
        self.watch, self.rng, self.around, self.towards, self.reversed_for = (
            watch,
            np.random.default_rng(seed),
            around,
            towards,
            reversed_for,
        )

    def fly(self, from_s, to_s, walk_mps=0.0, disbelieved=(), own_free=True):
        for step in range(round(from_s / STEP_S), round(to_s / STEP_S)):
            t = step * STEP_S
            for peer, a in self.around.items():
                lie_m = max(t - 20.0, 0.0) * walk_mps if peer == LIAR else 0.0
                claimed = place(APART_M * cos(a) + lie_m * cos(self.towards), APART_M * sin(a) + lie_m * sin(self.towards))
                range_m = APART_M + float(self.rng.standard_normal())
                own = place(0.0, 0.0, free=own_free)
                ends = [(SUBJECT, own), (peer, claimed)]
                (i, at_i), (j, at_j) = reversed(ends) if peer in self.reversed_for else ends
                self.watch.range(RangeMeasurement(i, j, t, t, range_m, 1.0), at_i, at_j)
            self.watch.step(t, disbelieved)
        return t


def test_a_peer_that_walks_off_is_suspected_whoever_measures_and_the_doubt_points_along_its_line():
    for reversed_for in ((), (1, 2, 3, 4)):
        watch = FaultMonitor()
        flight = Flight(watch, reversed_for=reversed_for)
        t = flight.fly(0.0, 20.0)
        assert watch.suspects() == frozenset()
        before_m2 = float(np.trace(watch.doubt_m2(t)[SUBJECT]))
        t = flight.fly(20.0, 30.0, walk_mps=2.0)
        assert watch.suspects() == {LIAR}
        values, axes = np.linalg.eigh(watch.doubt_m2(t)[SUBJECT])
        # 20 m along the line, of which least squares hands on a half.
        assert 25.0 < values[1] < 200.0
        assert abs(axes[:, 1] @ (cos(0.1), sin(0.1))) > 0.9
        assert before_m2 < 2.0


def test_who_is_not_believed_any_more_is_left_out_and_nobody_else_is_suspected():
    watch = FaultMonitor()
    flight = Flight(watch, around={**AROUND, 5: 2.4})
    flight.fly(0.0, 20.0)
    flight.fly(20.0, 30.0, walk_mps=2.0)
    t = flight.fly(30.0, 60.0, walk_mps=2.0, disbelieved={LIAR})
    assert watch.suspects() == frozenset()
    assert float(np.trace(watch.doubt_m2(t)[SUBJECT])) < 2.0


def test_three_lines_are_needed_to_say_anything_and_ranges_between_claims_say_nothing():
    watch = FaultMonitor()
    t = Flight(watch, around={1: 0.1, 2: 1.7}).fly(0.0, 40.0, walk_mps=5.0)
    assert watch.suspects() == frozenset()
    assert watch.doubt_m2(t) == {}
    watch = FaultMonitor()
    t = Flight(watch).fly(0.0, 40.0, walk_mps=5.0, own_free=False)
    assert watch.doubt_m2(t) == {}


def test_a_vehicle_that_is_forgotten_or_has_no_lines_for_half_a_minute_is_no_more_in_doubt():
    watch = FaultMonitor()
    t = Flight(watch).fly(0.0, 30.0, walk_mps=2.0)
    assert SUBJECT in watch.doubt_m2(t)
    watch.step(t + 31.0, ())
    assert watch.doubt_m2(t + 31.0) == {}
    t = Flight(watch).fly(80.0, 82.0)
    assert SUBJECT in watch.doubt_m2(t)
    watch.forget(SUBJECT)
    assert watch.doubt_m2(t) == {}
