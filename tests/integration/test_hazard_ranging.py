"""Ranging devices that are off or stuck: whole flights on MAVLink bytes. A bad device must cost the fix, not a peer's good name.

A position may be wrong beyond its bound for as long as the fault cannot be told from honest noise: SLOW_S for a bias of 20 m
(40 sigma), much longer for a device that repeats its last value, which is no more wrong than the aircraft have moved since.
"""

from __future__ import annotations

import pytest

from tests.hazard_flight import SUBJECT, fault, fly_through

HONEST = 1.5
FROM_S = 25.0
LOST = fault("gps_lost")
PEER = 1
SLOW_S = 4.0


@pytest.mark.parametrize("peer", [None, PEER], ids=["all its ranges", "the ranges to one peer"])
def test_a_biased_ranging_device_costs_the_fix_and_nobodys_gps_is_accused(peer):
    bias = fault("range_bias", SUBJECT, FROM_S, bias_m=20.0, **({} if peer is None else {"peer": peer}))
    out = fly_through(LOST, bias, duration_s=FROM_S + 25.0)
    assert out.distrusted(FROM_S) == set()
    assert out.worst_ratio(SUBJECT, FROM_S + SLOW_S) < HONEST
    told = " ".join(out.words(SUBJECT))
    assert "beyond the alert limit" in told or out.worst_stated_m(SUBJECT, FROM_S) < 20.0


@pytest.mark.parametrize(("peer", "within_m"), [(None, 40.0), (PEER, 20.0)], ids=["all its ranges", "the ranges to one peer"])
def test_a_stuck_ranging_device_is_found_before_it_has_led_far_and_nobodys_gps_is_accused(peer, within_m):
    stuck = fault("range_stuck", SUBJECT, FROM_S, **({} if peer is None else {"peer": peer}))
    out = fly_through(LOST, stuck, duration_s=FROM_S + 35.0)
    assert out.distrusted(FROM_S) == set()
    # Twice what was measured with this seed. Beyond its 95 % bound all the same: the aircraft fly in formation, ranges change
    # slowly, and a value that stays the same is not wrong by much at first.
    assert out.worst_stated_m(SUBJECT, FROM_S) < within_m
    assert out.worst_ratio(SUBJECT, FROM_S + 33.0) < HONEST


def test_lost_ranges_to_one_peer_are_done_without():
    out = fly_through(LOST, fault("range_dropout", SUBJECT, FROM_S, peer=PEER), duration_s=FROM_S + 20.0)
    assert out.distrusted(FROM_S) == set()
    assert out.worst_ratio(SUBJECT, FROM_S) < HONEST


def test_without_any_range_the_fix_is_withdrawn_once_the_prediction_is_too_uncertain():
    out = fly_through(LOST, fault("range_dropout", SUBJECT, FROM_S), duration_s=FROM_S + 35.0)
    assert out.worst_ratio(SUBJECT, FROM_S) < HONEST
    assert set(out.fix_types(SUBJECT, FROM_S + 30.0)) == {1}
    assert any("not located" in words for words in out.words(SUBJECT))
