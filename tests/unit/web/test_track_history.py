"""What a page that opens late is told is bounded and in order."""

from dataclasses import replace

from fleet_views import HEALTHY, LOST, fleet_view

from gcs_coloc.core.alarms.alarms import AlarmList
from gcs_coloc.core.messages.outbound import HealthChanged, Notice
from gcs_coloc.core.snapshot import LinkSnapshot
from gcs_coloc.web.picture import LinkRates, LiveSource


def a_source():
    return LiveSource(fleet_view, fleet_view, lambda _: ())


def test_an_event_says_whether_an_alarm_was_raised_and_a_notice_is_told_once():
    source, alarms = a_source(), AlarmList()
    source.add(HealthChanged(1.0, 4, "suspect", "failed", "no fix"))
    for notice in (Notice(3.0, None, "warning", "flooded"), Notice(4.0, 2, "info", "heard for the first time")):
        source.add(notice)
        for alarm in alarms.add_notice(notice):
            source.add(alarm)
    for seen in (fleet_view(5.0, LOST), fleet_view(6.0, HEALTHY)):
        for alarm in alarms.update(seen):
            source.add(alarm)
    events = source.events_after(0).events
    assert [(e.id, e.sysid) for e in events] == [(1, 4), (2, None), (3, 2), (4, 4), (5, 4)]
    assert [e.id for e in events if e.alarm] == [2, 4]
    assert events[0].text == "GPS suspect -> failed: no fix"
    assert events[3].text.startswith("alarm active: GPS failed")
    assert events[4].text.startswith("alarm over: GPS failed")
    assert [e.id for e in source.events_after(3).events] == [4, 5]


def test_events_that_were_pushed_out_are_counted_as_missed():
    source = a_source()
    for i in range(700):
        source.add(Notice(float(i), 1, "info", str(i)))
    frame = source.events_after(100)
    assert len(frame.events) == 500
    assert frame.missed == 100
    assert frame.events[-1].id == source.newest_event == 700


def test_the_history_is_one_sample_a_second_for_ten_minutes_and_unknown_is_not_zero():
    source = a_source()
    for i in range(2 * 700):
        source.add(fleet_view(i * 0.5, HEALTHY, LOST))
    known, lost = source.tracks()
    assert len(known.at_s) == len(known.sigma_h_m) == 600
    assert known.at_s[-1] - known.at_s[0] == 599.0
    assert known.sigma_h_m[-1] == 0.8
    assert (lost.sigma_h_m[-1], lost.east_m[-1], lost.ranges_in_use[-1]) == (None, None, 0.0)


def test_a_large_fleet_sends_a_shorter_history():
    source = a_source()
    vehicles = [replace(HEALTHY, sysid=i) for i in range(1, 251)]
    for i in range(120):
        source.add(fleet_view(float(i), *vehicles))
    assert sum(len(one.at_s) for one in source.tracks()) <= 20_000


def test_rate_and_loss_are_of_the_last_seconds():
    rates = LinkRates()
    for i in range(21):
        # 20 frames a second, and none lost until the last five seconds, in which one in five is.
        lost = max(i - 10, 0) * 5
        rates.update(fleet_view(i * 0.5, HEALTHY, links=(LinkSnapshot(1, 10 * i, lost, 0),)))
    (link,) = rates.counts(fleet_view(10.0, HEALTHY, links=(LinkSnapshot(1, 200, 50, 0),))).links
    assert link.rate_hz == 20.0
    assert link.loss_percent == 100.0 * 50 / 150
    assert LinkRates().counts(fleet_view(10.0, HEALTHY)).links[0].rate_hz is None


def test_what_goes_to_a_ground_tool_is_told_with_its_rate_over_the_last_seconds():
    rates = LinkRates()
    for i in range(21):
        rates.update(fleet_view(i * 0.5, HEALTHY))
    (out,) = rates.counts(fleet_view(10.0, HEALTHY)).outs
    assert (out.name, out.tools, out.rate_hz) == ("udpout:127.0.0.1:14551", 1, 40.0)
    assert (out.frames_sent, out.frames_accepted, out.dropped, out.refused) == (400, 12, 3, 2)
    assert LinkRates().counts(fleet_view(10.0, HEALTHY)).outs[0].rate_hz is None
    assert rates.counts(fleet_view(10.0, HEALTHY, outs=())).outs == ()
