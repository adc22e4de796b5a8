"""Autopilots' clocks that jump without a reboot: whole flights on MAVLink bytes.

A jump of more than two seconds is noticed at once and the clock begun anew. A smaller one looks like a late message until
TIMESYNC and the least delays have followed; meanwhile positions are as much too old as the aircraft flies in that time.
"""

from __future__ import annotations

import pytest

from tests.hazard_flight import SUBJECT, fault, fly_through

HONEST = 1.5
FROM_S = 25.0
LOST = fault("gps_lost")
PEER = 1


@pytest.mark.parametrize(("vehicle", "by_s"), [(SUBJECT, 100.0), (PEER, -5.0)])
def test_a_clock_that_jumps_far_is_begun_anew_and_told(vehicle, by_s):
    out = fly_through(LOST, fault("clock_jump", vehicle, FROM_S, by_s=by_s), duration_s=FROM_S + 20.0)
    assert any("its clock jumped" in words for words in out.words(vehicle))
    assert out.distrusted(FROM_S) == set()
    assert out.worst_ratio(SUBJECT, FROM_S) < HONEST
    assert out.share_located(SUBJECT, FROM_S + 5.0) > 0.95


@pytest.mark.parametrize(("vehicle", "by_s"), [(SUBJECT, 1.0), (SUBJECT, -1.0), (PEER, 1.0)])
def test_a_clock_that_jumps_by_a_second_accuses_nobody_and_what_is_claimed_stays_true(vehicle, by_s):
    out = fly_through(LOST, fault("clock_jump", vehicle, FROM_S, by_s=by_s), duration_s=FROM_S + 25.0)
    assert out.distrusted(FROM_S) == set()
    assert out.worst_ratio(SUBJECT, FROM_S) < HONEST
