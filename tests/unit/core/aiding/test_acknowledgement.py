"""Whether our stream is taken is told from GPS2_RAW: alarmed once, with what to look at, and cleared."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gcs_coloc.core.aiding.acknowledgement import FixAcknowledgement
from gcs_coloc.core.aiding.methods.gps_input import no_fix
from gcs_coloc.core.messages.inbound import GpsReceiver
from gcs_coloc.core.telemetry.reported_state import ReportedState

FIX = replace(no_fix(4, 1), fix_type=3, lat_deg=47.0, lon_deg=179.9999, vn_mps=20.0)

VEHICLE = ReportedState(4, 0.0, 0.0)


def run(
    acknowledgement: FixAcknowledgement, start_s: float, stop_s: float, sent, heard, last_heard_s=None
) -> list[tuple[float, str, str]]:
    """Send ten times, hear and review five times a second.

    `heard` is a fix type with degrees north, or None where it says nothing of that receiver. Of its link nothing is heard after
    `last_heard_s`.
    """
    changes = []
    for step in range(round(start_s * 10), round(stop_s * 10)):
        now_s = step / 10
        acknowledgement.add_sent(sent, now_s)
        if step % 2 == 0:
            if heard is not None:
                fix_type, lat_deg = heard
                lon_deg = sent.lon_deg if sent.fix_type == 3 else 0.0
                acknowledgement.add_receiver(GpsReceiver(4, now_s, 1, fix_type, lat_deg, lon_deg, 0.0, 7, 1.0, 2.0, 3.0, 0.5))
            vehicle = replace(VEHICLE, last_heard_s=now_s if last_heard_s is None else last_heard_s)
            told = acknowledgement.review(vehicle, now_s)
            if told is not None:
                changes.append((now_s, *told))
    return changes


def test_a_stream_that_is_taken_is_known_to_be_and_raises_nothing():
    acknowledgement = FixAcknowledgement(1, 0.0)
    assert run(acknowledgement, 0.0, 30.0, FIX, (3, 47.0002)) == []
    assert acknowledgement.acknowledged is True


def test_what_is_still_not_taken_after_a_takeover_is_told_again():
    acknowledgement = FixAcknowledgement(1, 0.0)
    assert len(run(acknowledgement, 0.0, 10.0, FIX, (1, 0.0))) == 1
    assert acknowledgement.review(VEHICLE, 10.0, is_held_back=True) is None
    ((_, level, _),) = run(acknowledgement, 10.0, 20.0, FIX, (1, 0.0))
    assert level == "error"


@pytest.mark.parametrize(
    ("sent", "heard", "words"),
    [
        (FIX, None, "no GPS2_RAW is heard"),
        (no_fix(4, 1), None, "no GPS2_RAW is heard"),
        (FIX, (1, 0.0), "its GPS2 says fix type 1 while positions are sent"),
        (FIX, (3, 47.01), "its GPS2 is 1112 m off what is sent"),
        (no_fix(4, 1), (3, 47.0), "its GPS2 has a fix that was not sent"),
    ],
)
def test_what_is_not_taken_raises_one_alarm_after_some_seconds_and_is_cleared_when_it_is(sent, heard, words):
    acknowledgement = FixAcknowledgement(1, 0.0)
    ((at_s, level, text),) = run(acknowledgement, 0.0, 30.0, sent, heard)
    assert 4.9 < at_s < 11.5  # five seconds of it, six more until a fix of ours would no longer linger
    assert level == "error"
    assert words in text
    assert acknowledgement.acknowledged is False
    assert [told[1:] for told in run(acknowledgement, 30.0, 35.0, FIX, (3, 47.0))] == [("info", "GPS_INPUT is taken")]
    assert (acknowledgement.acknowledged, acknowledgement.fault) == (True, None)


@pytest.mark.parametrize(("off_m", "is_told"), [(85.0, False), (95.0, True)])
def test_a_receiver_may_be_fifty_metres_and_two_seconds_of_flight_off_what_is_sent(off_m, is_told):
    """The vehicle flies 20 m/s north: 90 m."""
    assert bool(run(FixAcknowledgement(1, 0.0), 0.0, 30.0, FIX, (3, 47.0 + off_m / 111_320.0))) is is_told


def test_the_fix_that_lingers_for_a_few_seconds_raises_nothing():
    acknowledgement = FixAcknowledgement(1, 0.0)
    run(acknowledgement, 0.0, 10.0, FIX, (3, 47.0))
    assert run(acknowledgement, 10.0, 14.0, no_fix(4, 1), (3, 47.0)) == []
    assert run(acknowledgement, 14.0, 30.0, no_fix(4, 1), (1, 47.0)) == []


def test_a_silent_link_says_nothing_of_what_is_taken():
    """A real copter was silent for 7 s: "not taken" came 0.2 s after its return, and "taken" 20 s later."""
    acknowledgement = FixAcknowledgement(1, 0.0)
    run(acknowledgement, 0.0, 10.0, FIX, (3, 47.0))
    assert run(acknowledgement, 10.0, 25.0, FIX, None, last_heard_s=10.0) == []
    assert acknowledgement.acknowledged is True
    assert run(acknowledgement, 25.0, 29.0, FIX, None) == []
    assert [told[1] for told in run(acknowledgement, 29.0, 35.0, FIX, None)] == ["error"]


def test_that_both_say_there_is_no_fix_shows_nothing():
    acknowledgement = FixAcknowledgement(1, 0.0)
    assert run(acknowledgement, 0.0, 20.0, no_fix(4, 1), (1, 0.0)) == []
    assert acknowledgement.acknowledged is None


def test_the_first_receiver_is_watched_where_it_is_the_one_we_feed():
    ((_, _, text),) = run(FixAcknowledgement(0, 0.0), 0.0, 10.0, FIX, None)
    assert "(gcs-coloc doctor names the settings): no GPS_RAW_INT is heard from it" in text
