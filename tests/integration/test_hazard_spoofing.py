"""Receivers that are drawn off, step, or come back elsewhere, of the denied vehicle and of peers: flights on MAVLink bytes."""

from __future__ import annotations

import pytest

from tests.hazard_flight import DENIED, FROM_S, HONEST, LOST, OTHERS, PEER, SOUND_M, fault, fly_through


@pytest.mark.parametrize(
    ("speed_mps", "mutual"),
    [(0.5, True), (2.0, True), (10.0, True), (2.0, False)],
    ids=["0.5 m/s", "2 m/s", "10 m/s", "2 m/s, the denied vehicle's ranges only"],
)
def test_a_peer_drawn_off_is_found_and_what_the_denied_vehicle_is_told_meanwhile_is_within_its_bound(speed_mps, mutual):
    # Half a metre a second hides in a receiver's own slow errors for a long time; the bound grows meanwhile.
    lasts_s = 65.0 if speed_mps < 1.0 else 25.0
    walked_off = fault("gps_spoofed", PEER, FROM_S, speed_mps=speed_mps)
    out = fly_through(LOST, walked_off, duration_s=FROM_S + lasts_s, mutual=mutual)
    assert out.first(PEER, "suspect", "failed", after_s=FROM_S) < FROM_S + 0.8 * lasts_s
    assert out.first(PEER, "healthy", after_s=FROM_S + 0.8 * lasts_s) == float("inf")
    assert not out.distrusted(FROM_S) & OTHERS
    assert out.worst_ratio(DENIED, FROM_S) < HONEST


@pytest.mark.parametrize("reported", [True, False])
def test_a_walked_off_receiver_that_notices_is_suspected_at_once_and_one_that_does_not_later(reported):
    walked_off = fault("gps_spoofed", DENIED, FROM_S, speed_mps=0.5, reported=reported)
    out = fly_through(walked_off, duration_s=FROM_S + 5.0, autopilot="px4")
    assert (out.first(DENIED, "suspect", after_s=FROM_S) < FROM_S + 1.5) == reported
    assert ("reports spoofing" in out.gps_reasons[DENIED]) == reported
    assert not out.distrusted(0.0) & {PEER, *OTHERS}


def test_a_peer_whose_position_steps_is_suspected_at_once_and_harms_nobody():
    step = fault("gps_spoofed", PEER, FROM_S, speed_mps=0.0, offset_m=100.0)
    out = fly_through(LOST, step, duration_s=FROM_S + 20.0, mutual=True)
    assert out.first(PEER, "suspect", "failed", after_s=FROM_S) < FROM_S + 2.0
    assert out.first(PEER, "failed", after_s=FROM_S) < FROM_S + 20.0
    assert not out.distrusted(FROM_S) & OTHERS
    assert out.worst_stated_m(DENIED, FROM_S) < SOUND_M
    assert out.worst_ratio(DENIED, FROM_S) < HONEST


@pytest.mark.parametrize(("speed_mps", "within_s"), [(0.5, 35.0), (2.0, 12.0), (10.0, 3.0)], ids=["0.5 m/s", "2 m/s", "10 m/s"])
def test_a_denied_vehicle_drawn_off_is_found_by_the_ranges_and_not_believed_again_meanwhile(speed_mps, within_s):
    walked_off = fault("gps_spoofed", DENIED, FROM_S, speed_mps=speed_mps)
    out = fly_through(walked_off, duration_s=FROM_S + within_s + 12.0, mutual=True)
    found_s = out.first(DENIED, "suspect", "failed", after_s=FROM_S)
    assert found_s < FROM_S + within_s
    failed_s = out.first(DENIED, "failed", after_s=FROM_S)
    assert out.first(DENIED, "healthy", after_s=failed_s) == float("inf")
    assert not out.distrusted(FROM_S) & {PEER, *OTHERS}
    assert out.worst_ratio(DENIED, failed_s) < HONEST


def test_one_whose_velocity_stays_true_is_named_where_its_own_ranges_leave_it_open():
    """East of it the offset of two peers the other way explains its three ranges nearly as well."""
    walked_off = fault("gps_spoofed", DENIED, FROM_S, speed_mps=2.0, direction_deg=90.0, velocity_follows=False)
    out = fly_through(walked_off, duration_s=FROM_S + 12.0)
    assert out.first(DENIED, "failed", after_s=FROM_S) < FROM_S + 8.0
    assert [c.sysid for c in out.flight.changes if c.at_s >= FROM_S and c.after == "suspect"] == []
    assert not out.distrusted(FROM_S) - {DENIED}


RETURNS_S, WATCHED_S = 27.0, 18.0


def elsewhere(vehicle: int) -> list[dict[str, object]]:
    """A receiver that is lost for 12 s and comes back, 200 m off. One that is right is healthy ten seconds later."""
    lost = fault("gps_lost", vehicle, RETURNS_S - 12.0, until_s=RETURNS_S)
    return [lost, fault("gps_spoofed", vehicle, RETURNS_S, speed_mps=0.0, offset_m=200.0)]


@pytest.mark.parametrize("primary", [0, 1])
def test_a_receiver_that_comes_back_elsewhere_is_not_believed_and_gps_primary_decides_whether_the_aircraft_is_saved(primary):
    out = fly_through(*elsewhere(DENIED), duration_s=RETURNS_S + WATCHED_S, params={"GPS_PRIMARY": primary})
    assert out.first(DENIED, "recovering", "healthy", after_s=RETURNS_S) == float("inf")
    assert "its GPS is back but" in out.gps_reasons[DENIED]
    assert out.distrusted(0.0) == {DENIED}
    assert out.share_located(DENIED, RETURNS_S + 1.0) > 0.98
    assert out.worst_stated_m(DENIED, RETURNS_S) < SOUND_M
    assert out.worst_ratio(DENIED, RETURNS_S) < HONEST
    believed_m = out.worst_belief_m(DENIED, RETURNS_S + 5.0)
    assert believed_m < 1.5 * SOUND_M if primary else believed_m > 150.0


def test_two_that_come_back_off_by_the_same_are_neither_believed():
    out = fly_through(*elsewhere(4), *elsewhere(5), duration_s=RETURNS_S + WATCHED_S, scenario="two-failed")
    for sysid in (4, 5):
        assert out.first(sysid, "healthy", after_s=RETURNS_S) == float("inf")
        assert out.share_located(sysid, RETURNS_S + 1.0) > 0.95
        assert out.worst_ratio(sysid, RETURNS_S) < HONEST
    assert out.distrusted(0.0) == {4, 5}


def test_three_of_four_that_come_back_off_by_the_same_are_not_believed_while_one_healthy_peer_is_ranged():
    out = fly_through(*elsewhere(1), *elsewhere(2), *elsewhere(4), duration_s=RETURNS_S + WATCHED_S, mutual=True)
    for sysid in (1, 2, 4):
        assert out.first(sysid, "healthy", after_s=RETURNS_S) == float("inf")
    assert out.distrusted(0.0) == {1, 2, 4}
