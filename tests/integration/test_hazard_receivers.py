"""Receivers that fail, freeze, are jammed or walked off, on the denied vehicle and on a peer: whole flights on MAVLink bytes.

The four-ship of sitl_fakes/scenarios/uwb.toml: GPS of 1.5 m with errors that last a minute, ranges of 0.5 m with 3 % outliers,
telemetry up to 0.15 s late. Undisturbed, over seeds 1 to 8, the vehicle is located to 4.0 m at the worst (`SOUND_M` is half as
much again) and to 1.5 times its 95 % bound at the worst, as the peers' slow errors last a whole flight; with the seed of these
flights to 0.7 times, so that `HONEST` leaves room for as much again and nothing for a fault.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.hazard_flight import DENIED, fault, fly_through

SOUND_M = 6.0
HONEST = 1.5
PEER = 1
OTHERS = {2, 3}
"""Peers that nothing befalls."""
LOST = fault("gps_lost")
FROM_S = 25.0
"""When a hazard of these flights begins; the denied vehicle has been located by then."""


def test_a_lost_gps_is_failed_at_once_and_the_aircraft_flies_on_what_it_is_sent():
    out = fly_through(fault("gps_lost", at_s=20.0), duration_s=40.0)
    assert out.first(DENIED, "failed") < 22.0
    assert out.distrusted(0.0) == {DENIED}
    assert out.share_located(DENIED, 25.0) > 0.98
    assert out.worst_stated_m(DENIED, 25.0) < SOUND_M
    assert out.worst_ratio(DENIED, 25.0) < HONEST
    assert out.worst_belief_m(DENIED, 25.0) < 1.5 * SOUND_M
    assert not out.fix_types(PEER, 0.0)


def test_a_px4_that_loses_its_gps_flies_on_global_position_sensor():
    out = fly_through(LOST, duration_s=30.0, autopilot="px4")
    assert {s.truth.source for s in out.flight.samples[DENIED] if s.at_s > 20.0} == {"aux global position"}
    assert out.worst_belief_m(DENIED, 20.0) < 1.5 * SOUND_M
    assert not out.fix_types(DENIED, 0.0)


def test_a_px4_that_has_never_had_gps_is_located_by_ranges_and_its_barometer_and_flies_on_that():
    """It reports no position of its own, so no height, until it is aided."""
    out = fly_through(fault("gps_lost", at_s=0.0), duration_s=25.0, autopilot="px4")
    began = [s for s in out.flight.samples[DENIED] if s.at_s <= 1.0]
    assert {s.truth.source for s in began} == {"none"}
    flown = [s for s in out.flight.samples[DENIED] if s.at_s > 10.0]
    assert all(s.error_enu_m is not None for s in flown)
    assert {s.truth.source for s in flown} == {"aux global position"}
    assert max(np.hypot(*s.error_enu_m[:2]) for s in flown) < SOUND_M
    assert out.worst_belief_m(DENIED, 10.0) < 1.5 * SOUND_M
    assert out.distrusted(0.0) == {DENIED}


def test_the_height_of_a_px4_that_has_never_had_gps_is_stated_as_open_as_its_side_of_the_peers_is():
    """With this seed the filter comes to the side above them; it was 20 m off at a stated 4 m until the end."""
    out = fly_through(fault("gps_lost", at_s=0.0), duration_s=20.0, seed=2, autopilot="px4")
    late = [s for s in out.flight.samples[DENIED] if s.at_s > 5.0 and s.error_enu_m is not None and s.covariance is not None]
    assert len(late) > 50
    assert max(abs(s.error_enu_m[2]) / np.sqrt(s.covariance[2, 2]) for s in late) < 3.0


def test_a_px4_without_an_auxiliary_position_flies_on_vision_position_estimate():
    """As PX4 1.14 to 1.17, which have no other way in."""
    out = fly_through(LOST, duration_s=45.0, autopilot="px4", params={"EKF2_AGP0_CTRL": 0.0, "EKF2_EV_CTRL": 1.0})
    assert {s.truth.source for s in out.flight.samples[DENIED] if s.at_s > 20.0} == {"vision position"}
    assert out.worst_belief_m(DENIED, 20.0) < 1.5 * SOUND_M
    assert not any("not taken" in said for said in out.words(DENIED))


@pytest.mark.parametrize("switch_primary", ["off", "auto"])
def test_a_px4_goes_on_with_a_faulty_receiver_unless_it_is_switched_off(switch_primary):
    walked_off = fault("gps_spoofed", at_s=20.0, speed_mps=5.0)
    out = fly_through(walked_off, duration_s=44.0, mutual=True, autopilot="px4", switch_primary=switch_primary)
    assert out.first(DENIED, "failed") < 25.0
    assert ("its own GPS is switched off: it flies on the position that it is sent" in out.words(DENIED)) == (
        switch_primary == "auto"
    )
    # EKF2 follows its receiver and refuses ours; without its receiver it takes ours after seven seconds.
    believed_m = out.worst_belief_m(DENIED, 40.0)
    assert believed_m < 1.5 * SOUND_M if switch_primary == "auto" else believed_m > 100.0


def test_a_frozen_receiver_is_failed_though_it_calls_itself_healthy():
    out = fly_through(fault("gps_frozen", at_s=20.0), duration_s=34.0)
    assert out.first(DENIED, "failed") < 26.0
    assert "position" in out.reason(DENIED, "failed")
    assert out.distrusted(0.0) == {DENIED}
    assert out.worst_stated_m(DENIED, 20.0) < SOUND_M


@pytest.mark.parametrize("primary", [0, 1])
def test_a_jammed_receiver_is_never_believed_and_gps_primary_decides_whether_the_aircraft_is_saved(primary):
    out = fly_through(fault("gps_jammed", at_s=20.0), duration_s=36.0, params={"GPS_PRIMARY": primary})
    assert out.first(DENIED, "failed") < 23.0
    assert out.first(DENIED, "healthy", after_s=20.0) == float("inf")
    assert out.distrusted(0.0) == {DENIED}
    assert out.worst_stated_m(DENIED, 24.0) < SOUND_M
    # With the jammed receiver as primary the autopilot goes back to it whenever it has a fix: the service cannot help that.
    believed_m = out.worst_belief_m(DENIED, 25.0)
    assert believed_m < 1.5 * SOUND_M if primary else believed_m > 50.0


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


def test_a_peer_that_is_jammed_is_located_as_well_and_the_first_is_not_harmed():
    out = fly_through(LOST, fault("gps_jammed", PEER, FROM_S), duration_s=FROM_S + 20.0, mutual=True)
    assert out.first(PEER, "failed", after_s=FROM_S) < FROM_S + 6.0
    assert not out.distrusted(FROM_S) & OTHERS
    assert out.share_located(PEER, FROM_S + 8.0) > 0.9
    for sysid in (DENIED, PEER):
        assert out.worst_stated_m(sysid, FROM_S + 8.0) < SOUND_M
        assert out.worst_ratio(sysid, FROM_S + 8.0) < HONEST


def test_a_jam_that_ends_while_no_range_supports_the_receiver_states_no_fix_beyond_its_bound():
    """Ranges cease two seconds before the jam ends, for 14 s: the receiver is back, its velocity has jumped, nothing tests it."""
    jammed, unsupported = fault("gps_jammed", until_s=35.0), fault("range_dropout", at_s=33.0, until_s=47.0)
    out = fly_through(jammed, unsupported, duration_s=55.0)
    assert out.first(DENIED, "healthy", after_s=15.0) > 35.0
    assert out.worst_ratio(DENIED, 15.0) < HONEST
    assert out.worst_belief_m(DENIED, 50.0) < 1.5 * SOUND_M
    assert not out.distrusted(0.0) & {PEER, *OTHERS}


def test_two_that_fail_at_once_are_both_located_from_three():
    out = fly_through(fault("gps_lost", 4, 20.0), fault("gps_lost", 5, 20.0), duration_s=50.0, scenario="two-failed")
    assert out.distrusted(0.0) == {4, 5}
    for sysid in (4, 5):
        assert out.share_located(sysid, 30.0) > 0.95
        assert out.worst_ratio(sysid, 30.0) < HONEST
        assert out.worst_stated_m(sysid, 30.0) < 2.0 * SOUND_M
        late = [s for s in out.flight.samples[sysid] if s.at_s >= 40.0]
        assert np.sqrt(np.mean([np.sum(s.error_enu_m[:2] ** 2) for s in late])) < 4.5
        assert {s.truth.source for s in late} == {"gps2 injected"}


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
