"""Ranging devices that are off or stuck: whole flights on MAVLink bytes. A bad device must cost the fix, not a peer's good name,
and what is stated meanwhile must hold.
"""

from __future__ import annotations

import pytest

from gcs_coloc.core.messages.outbound import Notice
from tests.hazard_flight import DENIED, FROM_S, HONEST, LOST, PEER, fault, fly_through


@pytest.mark.parametrize("peer", [None, PEER], ids=["all its ranges", "the ranges to one peer"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_biased_ranging_device_costs_the_fix_at_once_and_nobodys_gps_is_failed(peer, seed):
    bias = fault("range_bias", DENIED, FROM_S, bias_m=20.0, **({} if peer is None else {"peer": peer}))
    out = fly_through(LOST, bias, duration_s=FROM_S + 25.0, seed=seed)
    assert out.distrusted(FROM_S) == set()
    assert out.worst_ratio(DENIED, FROM_S) < HONEST
    withdrawn = [(at_s, m.text) for at_s, m in out.said if isinstance(m, Notice) and "sending no fix" in m.text]
    at_s, told = withdrawn[0]
    assert "beyond the alert limit" in told or (peer is None and "all of its ranges jumped by" in told)
    # One pair is held to be off first; a jump of all ranges has no such explanation.
    assert at_s < FROM_S + (1.0 if peer is None else 25.0)


@pytest.mark.parametrize("peer", [None, PEER], ids=["all its ranges", "the ranges to one peer"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_stuck_ranging_device_is_named_within_a_second_and_what_is_stated_stays_within_its_bound(peer, seed):
    stuck = fault("range_stuck", DENIED, FROM_S, **({} if peer is None else {"peer": peer}))
    out = fly_through(LOST, stuck, duration_s=FROM_S + 20.0, seed=seed)
    assert out.distrusted(FROM_S) == set()
    assert out.worst_ratio(DENIED, FROM_S) < HONEST
    named = {
        text.split(" m to ")[1][0] for at_s, text in out.warnings(DENIED) if "repeats one value" in text and at_s < FROM_S + 1.0
    }
    assert named == ({"1", "2", "3"} if peer is None else {str(PEER)})
    assert out.refused["range_repeated"] > 50
    # Without any range the position is dead-reckoned for 10 s, then it is no fix any more.
    assert set(out.fix_types(DENIED, FROM_S + 15.0)) == ({1} if peer is None else {3})


def test_lost_ranges_to_one_peer_are_done_without():
    out = fly_through(LOST, fault("range_dropout", DENIED, FROM_S, peer=PEER), duration_s=FROM_S + 15.0)
    assert out.distrusted(FROM_S) == set()
    assert out.worst_ratio(DENIED, FROM_S) < HONEST


def test_without_any_range_the_fix_is_withdrawn_once_the_prediction_is_too_uncertain():
    out = fly_through(LOST, fault("range_dropout", DENIED, FROM_S), duration_s=FROM_S + 35.0)
    assert out.worst_ratio(DENIED, FROM_S) < HONEST
    assert set(out.fix_types(DENIED, FROM_S + 30.0)) == {1}
    assert any("not located" in words for words in out.words(DENIED))
