"""A start from ranges beside a faulty device: it is left out where it alone explains why the ranges contradict each other."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    NoEstimateReason,
    PositionMeasurement,
    RangeMeasurement,
    Unlocated,
)
from gcs_coloc.core.reasons import StatedReason
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.search.multilateration import MultilaterationProblem, solve_multilateration

LIMIT_M = 200.0
SQUARE = ((0.0, 0.0, 0.0), (30.0, 0.0, 0.0), (30.0, 30.0, 0.0), (0.0, 30.0, 0.0))
OCTAGON = tuple((15.0 + 20.0 * math.cos(0.785 * k), 15.0 + 20.0 * math.sin(0.785 * k), 0.0) for k in range(8))
WALKED_MPS = np.array([0.8, -0.6, 0.0])


def start(stuck_m, peers=SQUARE, truth=(12.0, 13.0, 0.0), offset_m=None, seed=0):
    """Start of a walker at a known height by four seconds of ranges of 1 m at 5 Hz.

    The devices of `stuck_m` repeat one value; those of `offset_m` are off by as much.
    """
    rng, p = np.random.default_rng(seed), MultilaterationProblem(0.0, 2.0)
    for t in np.arange(-3.8, 0.1, 0.2).tolist():
        here = np.array(truth) + WALKED_MPS * t
        p.add_altitude(AltitudeMeasurement(9, t, t, 0.0, 0.1))
        for i, peer in enumerate(peers):
            measured_m = math.dist(here, peer) + (offset_m or {}).get(i, 0.0) + rng.normal()
            report = PositionMeasurement(i, t, t, peer, 0.1, 0.1, (0.0, 0.0, 0.0), 0.2)
            p.add_range(i, report, [report], RangeMeasurement(9, i, t, t, stuck_m.get(i, abs(measured_m)), 1.0), 0.0, 0.0)
    return solve_multilateration(p, LIMIT_M)


def off_m(solution, truth=(12.0, 13.0, 0.0)):
    return math.dist(solution[0][:2], truth[:2])


@pytest.mark.parametrize("dead", range(4))
def test_one_dead_radio_of_four_is_left_out(dead):
    """In a square it balances the one opposite: by a robust loss alone nothing ever started."""
    for seed in range(5):
        assert off_m(start({dead: 36.0}, seed=seed)) < 1.5


def test_a_device_that_is_off_draws_no_start_to_itself():
    """Where the others outweigh it, such a start passed the tests of all ranges and was pulled."""
    for seed in range(8):
        solution = start({}, offset_m={1: 9.0}, seed=seed)
        if not isinstance(solution, StatedReason):
            assert off_m(solution) < 1.5


def test_two_dead_radios_of_eight_are_left_out():
    assert off_m(start({1: 36.0, 4: 30.0}, peers=OCTAGON)) < 1.5


def test_of_three_none_is_left_out():
    assert start({1: 60.0}, peers=SQUARE[:3]) == Unlocated(NoEstimateReason.CONTRADICTORY)


def test_where_several_devices_may_be_the_faulty_one_nothing_starts():
    """Of four beside the height, three fit somewhere whichever of them is left out, if the one is only a little off."""
    p = MultilaterationProblem(0.0, 2.0)
    rng, truth = np.random.default_rng(1), np.array([12.0, 13.0, 0.0])
    line = [(0.0, 0.0, 0.0), (30.0, 0.1, 0.0), (60.0, 0.0, 0.0), (90.0, 0.1, 0.0)]
    for t in np.arange(-3.8, 0.1, 0.2).tolist():
        p.add_altitude(AltitudeMeasurement(9, t, t, 0.0, 0.1))
        for i, peer in enumerate(line):
            report = PositionMeasurement(i, t, t, peer, 0.1, 0.1, (0.0, 0.0, 0.0), 0.2)
            r_m = math.dist(truth, peer) + (12.0 if i == 2 else 0.0) + rng.normal()
            p.add_range(i, report, [report], RangeMeasurement(9, i, t, t, r_m, 1.0), 0.0, 0.0)
    assert isinstance(solve_multilateration(p, LIMIT_M), StatedReason)


def test_a_dead_radio_of_four_never_leads_to_a_wrong_start():
    """A robust loss alone started in fewer cases; a value that fits elsewhere too leaves it open which device is faulty."""
    found = []
    for seed in range(24):
        rng = np.random.default_rng(100 + seed)
        solution = start({int(rng.permutation(4)[0]): float(rng.uniform(5.0, 90.0))}, seed=seed)
        if not isinstance(solution, StatedReason):
            found.append(off_m(solution))
    assert len(found) >= 12
    assert max(found) < 3.0


def test_a_start_without_a_device_waits_until_other_ranges_say_the_same():
    """Two faulty devices of four agree with the others for a moment: 19 of 40 such walkers started wrong, 14 with the wait."""
    rng, estimator = np.random.default_rng(2), FleetFilter()
    for i, place in enumerate(SQUARE):
        estimator.add(PositionMeasurement(i, 0.0, 0.0, place, 0.1, 0.1, static=True))
    estimator.set_denied({9}, 0.0)
    known_s = []
    for t in np.arange(0.0, 8.0, 0.2).tolist():
        here = np.array([12.0, 13.0, 0.0]) + WALKED_MPS * t
        estimator.add(AltitudeMeasurement(9, t, t, 0.0, 0.1))
        for i, place in enumerate(SQUARE):
            range_m = 60.0 if i == 2 else math.dist(here, place) + 0.5 * rng.normal()
            estimator.add(RangeMeasurement(9, i, t, t, range_m, 1.0))
        where = estimator.estimate(9, t)
        if isinstance(where, Estimate):
            known_s.append(t)
            assert math.dist(where.position_enu_m[:2], here[:2]) < 3.0
    assert 4.0 < known_s[0] < 6.0
