"""An alarm lives as long as its condition and until a person knows; what the light shows is in the list."""

from dataclasses import replace

import pytest
from fleet_views import HEALTHY, LOCATED, LOST, NOT_READY, STANDBY, fleet_view

from gcs_coloc.core.alarms.alarms import Alarm, AlarmKind, AlarmList, AlarmState, conditions
from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.core.snapshot import VehicleSnapshot

SUSPECT = replace(HEALTHY, sysid=4, gps_state="suspect", gps_reason="only 3 satellites")
SOUND = replace(HEALTHY, sysid=4)


def after(alarms: AlarmList, *views: VehicleSnapshot) -> list[Alarm]:
    """What the last of the views, a second apart, has changed."""
    changed: list[Alarm] = []
    for at_s, view in enumerate(views):
        changed = alarms.update(fleet_view(float(at_s), view))
    return changed


def states(alarms: AlarmList) -> list[tuple[int, str, str]]:
    return [(a.id, a.kind, a.state) for a in alarms]


def test_an_alarm_is_active_then_over_then_closed_by_who_acknowledges_it():
    alarms = AlarmList()
    [raised] = after(alarms, LOST)
    assert (raised.state, raised.level, raised.sysid, raised.raised_at_s) == ("active", "error", 4, 0.0)
    [over] = after(alarms, LOST, SOUND)
    assert (over.id, over.state, over.over_at_s) == (raised.id, "over", 1.0)
    [closed] = alarms.acknowledge(raised.id, 9.0)
    assert (closed.state, closed.at_s) == (AlarmState.CLOSED, 9.0)
    assert list(alarms) == []
    assert alarms.acknowledge(raised.id, 9.0) == []


def test_an_alarm_that_is_acknowledged_while_it_lasts_stays_until_it_is_over():
    alarms = AlarmList()
    after(alarms, LOCATED)
    assert [a.state for a in alarms.acknowledge(1, 1.0)] == ["acknowledged"]
    assert after(alarms, LOCATED, replace(LOCATED, bound_95_m=7.5)) == []  # words alone change nothing
    assert "within 8 m" in next(iter(alarms)).text
    assert states(alarms) == [(1, "gps_lost", "acknowledged")]
    assert [a.state for a in after(alarms, SOUND)] == ["closed"]
    assert [a.id for a in after(alarms, LOCATED)] == [2]  # another failure is another alarm


def test_what_becomes_worse_waits_to_be_acknowledged_again_and_what_becomes_better_does_not():
    alarms = AlarmList()
    after(alarms, LOCATED)
    alarms.acknowledge(1, 1.0)
    assert [(a.state, a.level) for a in after(alarms, LOST)] == [("active", "error")]
    alarms.acknowledge(1, 2.0)
    assert [(a.state, a.level) for a in after(alarms, LOCATED)] == [("acknowledged", "warning")]


def test_what_comes_again_before_anybody_has_acknowledged_it_is_one_alarm():
    alarms = AlarmList()
    changed = after(alarms, SUSPECT, SOUND, SUSPECT, SOUND, SUSPECT)
    assert [(a.id, a.state, a.times) for a in changed] == [(1, "active", 3)]


def test_sensors_that_are_worse_than_they_state_are_told_until_they_are_not():
    alarms = AlarmList()
    [raised] = alarms.update(replace(fleet_view(1.0, SOUND), noise=NoiseModel(range_bias_m=4.0)))
    assert (raised.kind, raised.sysid, raised.level) == (AlarmKind.SENSORS_WORSE, None, "warning")
    assert "lasting errors of ranges of about 4 m" in raised.text
    assert "calibrate" in raised.action
    # Pairs that are out of sight for a moment are nothing that a person can remedy.
    [over] = alarms.update(replace(fleet_view(2.0, SOUND), noise=NoiseModel(pairs_off=frozenset({(1, 2)}))))
    assert over.state is AlarmState.OVER


def test_a_link_that_is_late_is_told_until_it_is_not():
    alarms = AlarmList()
    [raised] = after(alarms, replace(SOUND, delay_s=0.6), replace(SOUND, delay_s=0.9))
    assert (raised.kind, raised.level, raised.sysid) == (AlarmKind.LINK_LATE, "warning", 4)
    assert "0.9 s late" in raised.text
    assert "stream rates" in raised.action
    assert [a.state for a in after(alarms, replace(SOUND, delay_s=0.6))] == ["over"]


def test_a_vehicle_that_is_silent_keeps_the_alarm_of_its_gps_and_is_told_first():
    alarms = AlarmList()
    after(alarms, replace(LOST, age_s=9.0))
    assert [(a.kind, a.level) for a in alarms] == [("silent", "error"), ("gps_lost", "error")]


def test_no_vehicle_is_called_silent_or_late_for_what_the_lag_of_the_host_explains():
    """Six seconds of datagrams wait: each vehicle was heard six seconds ago, and its reports are late, for the host is."""
    alarms = AlarmList()
    waiting = replace(SOUND, age_s=6.1, delay_s=0.9)
    [late] = alarms.update(replace(fleet_view(1.0, waiting), loop_lag_s=6.0))
    assert (late.kind, late.sysid) == (AlarmKind.HOST_LATE, None)
    assert {a.kind for a in alarms.update(fleet_view(2.0, waiting)) if a.state is AlarmState.ACTIVE} == {"silent", "link_late"}
    silent = replace(SOUND, age_s=9.1)
    changed = AlarmList().update(replace(fleet_view(1.0, silent), loop_lag_s=6.0))
    assert {a.kind for a in changed} == {"silent", "host_late"}


def test_a_suspicion_that_turns_out_right_is_one_alarm_and_one_that_does_not_waits_to_be_read():
    alarms = AlarmList()
    after(alarms, SUSPECT, LOCATED)
    assert states(alarms) == [(2, "gps_lost", "active")]
    alarms = AlarmList()
    after(alarms, SUSPECT, SOUND)
    assert states(alarms) == [(1, "gps_suspect", "over")]


def test_a_vehicle_that_was_not_ready_and_is_now_needs_nobodys_attention():
    alarms = AlarmList()
    assert [a.kind for a in after(alarms, replace(HEALTHY, inhibit_reason="no heartbeat"))] == ["not_ready"]
    assert [a.state for a in after(alarms, HEALTHY)] == ["closed"]


def test_alike_notices_are_one_alarm_and_their_number_is_bounded():
    alarms = AlarmList()
    assert alarms.add_notice(Notice(0.0, None, "info", "heard for the first time")) == []
    for i in range(3):
        alarms.add_notice(Notice(float(i), None, "warning", f"{9 + i}.5 frames refused"))
    assert [(a.text, a.times, a.state, a.over_at_s) for a in alarms] == [("11.5 frames refused", 3, "over", 2.0)]
    for i in range(80):
        changed = alarms.add_notice(Notice(10.0 + i, None, "error", f"fault {'x' * i}"))
    assert [a.state for a in changed] == ["over", "closed"]
    assert len(list(alarms)) == 50


@pytest.mark.parametrize(
    "vehicle",
    [
        LOCATED,
        LOST,
        SUSPECT,
        replace(LOCATED, fix_acknowledged=False),
        replace(LOCATED, aiding_has_fix=False),
        replace(LOST, aiding_override="off"),
        replace(HEALTHY, aiding_override="on"),
        replace(HEALTHY, inhibit_reason="one address"),
        replace(HEALTHY, age_s=4.0),
    ],
)
def test_each_alarm_ends_with_what_to_do(vehicle):
    [found, *_] = conditions(vehicle, 0.0)
    assert found.action.endswith(".")
    assert len(found.action) > 20


@pytest.mark.parametrize(
    ("untested", "assumption"),
    [
        ((), ";"),
        ((2,), " if the position of 2 is right;"),
        ((2, -4), " if the positions of 2 and station 3 are right;"),
        ((LOCATED.sysid,), " if its ranging device is right;"),
    ],
)
def test_the_alarm_of_a_located_vehicle_states_its_protection_level_and_what_no_range_tests(untested, assumption):
    [condition] = conditions(replace(LOCATED, hpl_m=14.4, vpl_m=20.0, untested=untested), 0.0)
    assert f"within 7 m (95 %), protection level 14 m{assumption}" in condition.text


def test_readiness_that_is_lost_in_flight_is_an_alarm_that_ends_by_itself():
    alarms = AlarmList()
    assert after(alarms, replace(SOUND, readiness=NOT_READY)) == []
    [raised] = after(alarms, replace(SOUND, readiness=replace(NOT_READY, is_lost=True)))
    assert (raised.kind, raised.state, raised.level) == (AlarmKind.NOT_READY, "active", "warning")
    assert raised.text == (
        "GPS healthy, but if it failed now the vehicle would be lost: peers 2 and 3 in one line with it: HDOP 9"
    )
    assert raised.action
    [over] = after(alarms, SOUND)
    assert (over.id, over.state) == (raised.id, "closed")


def test_a_loss_of_gps_takes_the_place_of_lost_readiness():
    alarms = AlarmList()
    after(alarms, replace(SOUND, readiness=replace(NOT_READY, is_lost=True)))
    assert {(a.kind, a.state) for a in after(alarms, LOST)} == {(AlarmKind.GPS_LOST, "active"), (AlarmKind.NOT_READY, "closed")}


def test_a_hot_standby_that_is_not_what_it_should_be_is_told_until_it_is():
    alarms = AlarmList()
    lost = replace(STANDBY, sends="this", problem="the other service gives no sign of life")
    [raised] = alarms.update(fleet_view(1.0, SOUND, standby=lost))
    assert (raised.kind, raised.sysid, raised.level) == (AlarmKind.STANDBY, None, "warning")
    assert "no sign of life" in raised.text
    [worse] = alarms.update(fleet_view(2.0, SOUND, standby=replace(lost, sends="nobody", problem="neither service sends")))
    assert worse.level == "error"
    assert [a.state for a in alarms.update(fleet_view(3.0, SOUND, standby=STANDBY))] == ["over"]


@pytest.mark.parametrize("view", [LOST, LOCATED, replace(LOCATED, fix_acknowledged=False), replace(LOST, aiding_override="off")])
def test_a_service_that_holds_back_sends_nobody_to_the_stick(view):
    [held] = conditions(replace(view, aiding_held_back=True), 0.0)
    assert held.action == "This service holds back: the page of the other service says what it is sent, and what to do."
    assert "not aided" not in held.brief
