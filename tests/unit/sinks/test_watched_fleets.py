"""Which fleets are live and which silent: what a broker has kept is no sign of life, and nothing past passes for the present."""

from dataclasses import replace

import pytest
from fleet_views import HEALTHY, LOCATED, LOST, fleet_view

from gcs_coloc.sinks.fleet_overview import fleet_overview
from gcs_coloc.sinks.watched_fleets import MAX_FLEETS, Presence, WatchedFleets

UNIX_S = 1.7e9
NORTH = "gcs-coloc/v2/north"


def message(at_s, *vehicles, host="alpha", every_s=1.0, clock_off_s=0.0):
    view = fleet_view(at_s, *(vehicles or (HEALTHY,)), utc_minus_service_s=UNIX_S + clock_off_s)
    return fleet_overview(view, (), host=host, every_s=every_s)


def receive(fleets, at_s, *vehicles, source=NORTH, name="north", sent_at_s=None, **other):
    sent = message(at_s if sent_at_s is None else sent_at_s, *vehicles, **other)
    return fleets.receive(source, name, sent, at_s, UNIX_S + at_s)


def live(*vehicles, until_s=2.0, **other):
    """Fleets of which one was heard each second until a time."""
    fleets = WatchedFleets()
    for second in range(1, int(until_s) + 1):
        receive(fleets, float(second), *vehicles, **other)
    return fleets


def only(fleets, now_s):
    (fleet,) = fleets.shown(now_s)
    return fleet


def test_one_message_is_no_sign_of_life_and_two_are():
    fleets = WatchedFleets()
    receive(fleets, 1.0)
    shown = only(fleets, 1.1)
    assert (shown.presence, shown.light, shown.age_s) == (Presence.KEPT, "unknown", None)
    assert shown.written_unix_s == UNIX_S + 1.0
    receive(fleets, 2.0)
    shown = only(fleets, 2.5)
    assert (shown.presence, shown.light, shown.age_s, shown.host) == (Presence.LIVE, "good", 0.5, "alpha")


def test_the_same_message_again_is_no_sign_of_life():
    fleets = live()
    for second in range(3, 9):
        receive(fleets, float(second), sent_at_s=2.0)  # a bridge that connects again hands on what it has kept
    assert only(fleets, 8.1).presence is Presence.STALE


def test_a_fleet_that_falls_silent_is_stale_and_unknown_and_keeps_its_last_state():
    fleets = live(LOST)
    assert only(fleets, 7.0).light == "bad"
    shown = only(fleets, 7.1)
    assert (shown.presence, shown.light) == (Presence.STALE, "unknown")
    assert shown.text == "not heard for 5 s"
    assert shown.overview is not None
    assert [v.light for v in shown.overview.vehicles] == ["bad"]


def test_after_a_silence_one_message_does_not_make_it_live_again_and_two_do():
    fleets = live()
    receive(fleets, 60.0)
    again = only(fleets, 60.1)
    # Nor is it "kept", which stands below all that is in alarm: its vehicles were in the air.
    assert (again.presence, again.text, again.light) == (Presence.STALE, "heard again, but not steadily yet", "unknown")
    receive(fleets, 61.0)
    assert only(fleets, 61.1).presence is Presence.LIVE


def test_a_service_that_publishes_seldom_may_be_silent_for_longer():
    fleets = WatchedFleets()
    receive(fleets, 10.0, every_s=10.0)
    receive(fleets, 20.0, every_s=10.0)
    assert only(fleets, 50.0).presence is Presence.LIVE
    assert only(fleets, 50.1).presence is Presence.STALE


@pytest.mark.parametrize("said", [Presence.LOST, Presence.ENDED])
def test_what_the_last_will_or_the_goodbye_says_shows_at_once_and_until_two_messages_follow(said):
    fleets = live()
    fleets.receive_connection(NORTH, "north", said, 2.1)
    assert (only(fleets, 2.1).presence, only(fleets, 2.1).light) == (said, "unknown")
    receive(fleets, 3.0)
    assert only(fleets, 3.0).presence is said  # this may be what the broker has kept
    receive(fleets, 4.0)
    assert only(fleets, 4.0).presence is Presence.LIVE


def test_a_service_that_says_it_is_connected_again_is_live_with_its_second_message():
    fleets = live()
    fleets.receive_connection(NORTH, "north", Presence.LOST, 2.1)
    fleets.receive_connection(NORTH, "north", None, 3.0)
    assert (only(fleets, 3.0).presence, only(fleets, 3.0).text) == (Presence.STALE, "not heard for 1 s")
    receive(fleets, 3.1)
    assert only(fleets, 3.1).presence is Presence.STALE
    receive(fleets, 4.1)
    assert only(fleets, 4.1).presence is Presence.LIVE


def test_a_fleet_whose_service_does_not_tell_is_shown_with_its_vehicles_and_nothing_made_up():
    fleets = WatchedFleets()
    fleets.receive_connection(NORTH, "north", None, 1.0, (4, 7))
    shown = only(fleets, 1.5)
    assert (shown.presence, shown.light, shown.sysids, shown.overview, shown.host) == (
        Presence.UNTOLD,
        "unknown",
        (4, 7),
        None,
        "",
    )


def test_fleets_of_the_same_name_on_two_hosts_are_two_where_they_are_told_of_in_two_places():
    fleets = live()
    for second in (1.0, 2.0):
        receive(fleets, second, LOCATED, source="site-b/v2/north", host="beta")
    shown = fleets.shown(2.1)
    assert [(fleet.name, fleet.host, fleet.light, fleet.problem) for fleet in shown] == [
        ("north", "beta", "caution", None),
        ("north", "alpha", "good", None),
    ]


def test_two_hosts_that_tell_in_one_place_are_both_shown_with_the_remedy():
    fleets = live()
    for second in (1.0, 2.0):
        receive(fleets, second, host="beta")
    assert [(fleet.host, "give each a name of its own" in fleet.problem) for fleet in fleets.shown(2.1)] == [
        ("alpha", True),
        ("beta", True),
    ]
    for second in range(3, 10):
        receive(fleets, float(second))
    assert {fleet.host: fleet.problem for fleet in fleets.shown(9.0)} == {"alpha": None, "beta": None}


@pytest.mark.parametrize(("off_s", "words"), [(90.0, "90 s ahead of"), (-90.0, "90 s behind"), (30.0, None)])
def test_a_host_whose_clock_is_far_off_is_told_of_and_is_live_all_the_same(off_s, words):
    shown = only(live(clock_off_s=off_s), 2.1)
    assert shown.presence is Presence.LIVE
    assert shown.problem is None if words is None else words in shown.problem


def test_the_most_serious_stands_first():
    fleets = WatchedFleets()
    for name, vehicles in {"good": (HEALTHY,), "alarm": (HEALTHY, LOST), "caution": (LOCATED,), "silent": (HEALTHY,)}.items():
        for second in (1.0, 2.0, *((9.0, 10.0) if name != "silent" else ())):
            receive(fleets, second, *vehicles, source=name, name=name)
    receive(fleets, 10.0, source="kept", name="kept")
    fleets.receive_connection("ended", "ended", Presence.ENDED, 10.0)
    fleets.receive_connection("untold", "untold", None, 10.0)
    assert [fleet.name for fleet in fleets.shown(10.1)] == ["alarm", "silent", "caution", "untold", "good", "kept", "ended"]


def test_what_was_deleted_is_forgotten():
    fleets = live()
    fleets.forget(NORTH)
    fleets.forget("nobody")
    assert fleets.shown(2.0) == ()


def test_there_is_a_limit_to_how_many_are_kept():
    fleets = WatchedFleets()
    assert all(receive(fleets, 1.0, source=f"s{n}") for n in range(MAX_FLEETS))
    assert not receive(fleets, 1.0, source="one more")
    assert not fleets.receive_connection("one more", "x", None, 1.0)
    assert receive(fleets, 2.0, source="s0")
    taken = [receive(fleets, 3.0, source="s0", host=f"h{n}") for n in range(20)]
    assert 0 < sum(taken) < 20


def test_a_fleet_without_vehicles_is_unknown_and_live():
    fleets = WatchedFleets()
    for second in (1.0, 2.0):
        empty = replace(fleet_view(second), vehicles=())
        fleets.receive(NORTH, "north", fleet_overview(empty, (), host="alpha", every_s=1.0), second, UNIX_S)
    shown = only(fleets, 2.1)
    assert (shown.presence, shown.light, shown.sysids) == (Presence.LIVE, "unknown", ())
