"""Autopilots' clocks that jump without a reboot: whole flights on MAVLink bytes.

A clock that is set back, or far forward, is begun anew and the operator is told. What is less is followed by the next TIMESYNC
exchanges, without a warning: a simulation's clock does so several times a minute.
"""

from __future__ import annotations

import pytest

from tests.hazard_flight import DENIED, FROM_S, HONEST, LOST, PEER, fault, fly_through


@pytest.mark.parametrize(("vehicle", "by_s"), [(DENIED, 100.0), (PEER, -5.0), (DENIED, -1.0), (PEER, -1.0)])
def test_a_clock_that_jumps_is_begun_anew_and_told_and_the_aircraft_stays_located(vehicle, by_s):
    out = fly_through(LOST, fault("clock_jump", vehicle, FROM_S, by_s=by_s), duration_s=FROM_S + 12.0)
    (told_at_s,) = [at_s for at_s, text in out.warnings(vehicle) if "its clock jumped" in text]
    assert told_at_s < FROM_S + 1.0
    assert out.distrusted(FROM_S) == set()
    assert out.worst_ratio(DENIED, FROM_S) < HONEST
    assert out.share_located(DENIED, FROM_S) > 0.95


@pytest.mark.parametrize(("vehicle", "by_s"), [(DENIED, 1.0), (PEER, 1.0), (DENIED, -0.4), (PEER, -0.3)])
def test_a_clock_that_jumps_by_less_is_followed_accuses_nobody_and_the_bound_stays_true(vehicle, by_s):
    out = fly_through(LOST, fault("clock_jump", vehicle, FROM_S, by_s=by_s), duration_s=FROM_S + 18.0)
    assert out.distrusted(FROM_S) == set()
    assert out.worst_ratio(DENIED, FROM_S) < HONEST
    # Until TIMESYNC has followed the clock the ranges contradict the position, and the protection level withholds the fix.
    assert out.share_located(DENIED, FROM_S) > 0.9
