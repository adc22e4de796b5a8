"""What is taken of a broker's messages: whatever they hold, nothing ends the watch, and every refusal is counted."""

import json
import logging

import pytest
from fleet_views import HEALTHY, fleet_view

from gcs_coloc.config.service_sections import MqttConfig
from gcs_coloc.sinks.fleet_overview import fleet_overview
from gcs_coloc.sinks.mqtt_models import status
from gcs_coloc.sinks.mqtt_watch import MqttWatch
from gcs_coloc.sinks.watched_fleets import MAX_FLEETS, Presence

NORTH = "gcs-coloc/v2/north"


@pytest.fixture
def watch():
    found = MqttWatch(MqttConfig(host="nowhere"), clock=lambda: found.now_s, unix_clock=lambda: 0.0)
    found.now_s = 0.0
    return found


def overview(at_s):
    return fleet_overview(fleet_view(at_s, HEALTHY), (), host="alpha", every_s=1.0).model_dump_json().encode()


def test_a_services_messages_make_a_live_fleet_and_its_goodbye_and_last_will_are_told_apart(watch):
    for second in (1.0, 2.0):
        watch.now_s = second
        watch.receive(f"{NORTH}/status", status(fleet_view(second), online=True).model_dump_json().encode())
        watch.receive(f"{NORTH}/overview", overview(second))
    (fleet,) = watch.shown()
    assert (fleet.source, fleet.name, fleet.host, fleet.presence) == (NORTH, "north", "alpha", Presence.LIVE)
    watch.receive(f"{NORTH}/status", status(fleet_view(3.0), online=False).model_dump_json().encode())
    assert watch.shown()[0].presence is Presence.ENDED
    watch.receive(f"{NORTH}/status", status(None, online=False).model_dump_json().encode())
    assert watch.shown()[0].presence is Presence.LOST
    assert dict(watch.counts) == {}


@pytest.mark.parametrize("payload", [b"\xff", b"[]", b"null", b"{}", b"{" * 10_000, overview(1.0)[:-1], b'{"online": "perhaps"}'])
@pytest.mark.parametrize("what", ["status", "overview"])
def test_what_cannot_be_read_is_counted_and_makes_no_fleet(watch, what, payload):
    watch.receive(f"{NORTH}/{what}", payload)
    assert dict(watch.counts) == {"watch_unreadable": 1}
    assert watch.shown() == ()


def test_what_is_too_long_is_not_even_parsed(watch):
    watch.receive(f"{NORTH}/overview", overview(1.0) + b" " * 600_000)
    assert dict(watch.counts) == {"watch_too_long": 1}


def test_a_status_of_a_later_version_is_read(watch):
    watch.receive(f"{NORTH}/status", json.dumps({"online": True, "estimator": "x", "vehicles": [4], "later": {}}).encode())
    assert (watch.shown()[0].presence, watch.shown()[0].sysids) == (Presence.UNTOLD, (4,))


def test_more_fleets_than_there_is_room_for_are_counted(watch):
    for n in range(MAX_FLEETS + 3):
        watch.receive(f"gcs-coloc/v2/f{n}/overview", overview(1.0))
    assert dict(watch.counts) == {"watch_too_many_fleets": 3}


def test_an_empty_message_forgets_the_fleet(watch):
    watch.receive(f"{NORTH}/overview", overview(1.0))
    watch.receive(f"{NORTH}/overview", b"")
    assert watch.shown() == ()


def test_refusals_are_told_at_most_once_a_minute_with_their_number(watch, caplog):
    with caplog.at_level(logging.WARNING, "gcs_coloc"):
        for second in range(130):
            watch.now_s = float(second)
            watch.receive(f"{NORTH}/overview", b"x")
    lines = [record.getMessage() for record in caplog.records]
    assert len(lines) == 3
    assert "watch_unreadable 60" in lines[1]
    assert f"{NORTH}/overview" in lines[1]


def test_it_says_why_nothing_comes(watch):
    assert watch.problem() == "no connection to the MQTT broker nowhere:1883: not connected yet"
