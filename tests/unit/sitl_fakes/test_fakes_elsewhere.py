"""A vehicle that flies in another process: seen where it was said to be, for as long as that is recent."""

import math
import struct

import pytest

from sitl_fakes.fleet import STEP_S, Fleet
from sitl_fakes.flight import SharedState
from tests.unit.sitl_fakes.fakes_support import scenario

PEER_RANGE = (181600).to_bytes(3, "little")
EXACT = {"sigma_m": 1e-3, "rate_hz": 10.0}


def ranges_m(datagrams):
    return [struct.unpack_from("<Qf", d.payload, 10)[1] for d in datagrams if d.payload[7:10] == PEER_RANGE]


def test_two_processes_measure_the_ranges_that_one_would():
    plan = scenario(ranging=EXACT)
    whole, one, two = Fleet(plan, 7), Fleet(plan, 7, sysids=[1]), Fleet(plan, 7, sysids=[2])
    assert (one.sysids, two.sysids) == ([1], [2])
    measured, expected = [], []
    for k in range(500):
        at_s = k * STEP_S
        two.advance(at_s)
        for seen in two.shared_states():
            one.add_shared_state(seen)
        measured += ranges_m(one.advance(at_s))
        expected += ranges_m(whole.advance(at_s))
    assert len(expected) == 100
    assert measured == pytest.approx(expected, abs=1e-4)  # a float32 of 1 km


def test_an_aircraft_flies_on_between_two_reports_and_is_gone_a_second_after_the_last():
    fleet = Fleet(scenario(ranging=EXACT), 1, sysids=[1])
    assert ranges_m(fleet.advance(2.0)) == []
    east, north, up = fleet.shared_states()[0].position_m
    fleet.add_shared_state(SharedState(2, 2.0, (east + 300.0, north, up), (0.0, 22.0, 0.0)))
    for k in range(1, 6):
        fleet.advance(2.0 + (k - 1) * 0.1)
        here = SharedState(2, 2.0, (east + 300.0, north, up), (0.0, 22.0, 0.0)).position_at(2.0 + k * 0.1)
        measured = ranges_m(fleet.advance(2.0 + k * 0.1))
        assert measured == [pytest.approx(math.dist(here, fleet.shared_states()[0].position_m), abs=0.01)]
    fleet.advance(3.0)
    assert ranges_m(fleet.advance(6.0)) == []
