"""What ground tools are told of alarms: in few words, the worst first, never a flood."""

from dataclasses import replace

from fleet_views import HEALTHY, LOCATED, LOST, fleet_view

from gcs_coloc.core.alarms.alarms import AlarmList
from gcs_coloc.core.alarms.status_texts import (
    NOT_READY_AFTER_S,
    SAME_ALARM_EVERY_S,
    TEXTS_PER_S,
    StatusTexts,
    TextSeverity,
)
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.core.snapshot import FleetSnapshot

SOUND = replace(HEALTHY, sysid=4)
SUSPECT = replace(SOUND, gps_state="suspect", gps_reason="only 3 satellites")
UNREADY = replace(SOUND, inhibit_reason="GPS2_TYPE is 0")


class Told:
    """Alarms of snapshots, and the texts that come of them."""

    def __init__(self):
        self.alarms, self.texts = AlarmList(), StatusTexts()

    def after(self, fleet: FleetSnapshot):
        for alarm in self.alarms.update(fleet):
            self.texts.add(alarm)
        return self.of(fleet.at_s)

    def of(self, at_s):
        return [(one.sysid, one.severity, one.text) for one in self.texts.pop_due(at_s)]

    def acknowledge(self, alarm_id, at_s):
        for alarm in self.alarms.acknowledge(alarm_id, at_s):
            self.texts.add(alarm)


def test_a_lost_gps_is_told_with_how_well_the_vehicle_is_located_and_so_is_its_end():
    told = Told()
    assert told.after(fleet_view(0.0, LOCATED)) == [(4, TextSeverity.WARNING, "UAV4: GPS lost, located within 7 m")]
    assert told.after(fleet_view(1.0, LOCATED)) == []
    assert told.after(fleet_view(60.0, SOUND)) == [(4, TextSeverity.INFO, "UAV4: over: GPS lost, located within 7 m")]
    assert told.after(fleet_view(61.0, SOUND)) == []


def test_what_needs_an_act_at_once_is_critical():
    silent = replace(LOST, age_s=20.0)
    assert Told().after(fleet_view(0.0, silent)) == [
        (4, TextSeverity.CRITICAL, "UAV4: not heard for 20 s"),
        (4, TextSeverity.CRITICAL, "UAV4: GPS lost, not located"),
    ]
    unfed = replace(LOCATED, aiding_has_fix=False)
    assert Told().after(fleet_view(0.0, unfed)) == [(4, TextSeverity.CRITICAL, "UAV4: GPS lost, located within 7 m, not aided")]


def test_every_text_of_a_lost_gps_fits_one_message():
    worst = replace(LOCATED, sysid=254, bound_95_m=999.0, aiding_has_fix=False, gps_state="recovering")
    [(_, _, text)] = Told().after(fleet_view(0.0, worst))
    assert len(text) <= 50 + len("recovering") - len("lost")
    [(_, _, text)] = Told().after(fleet_view(0.0, replace(worst, gps_state="failed")))
    assert len(text) <= 50


def test_an_alarm_that_comes_and_goes_is_told_seldom_and_worse_at_once():
    told, count = Told(), 0
    for second in range(100):
        count += len(told.after(fleet_view(float(second), LOCATED if second % 2 else SOUND)))
    assert 2 <= count <= 2 * 100 / SAME_ALARM_EVERY_S
    told = Told()
    assert len(told.after(fleet_view(0.0, LOCATED))) == 1
    assert told.after(fleet_view(1.0, LOST)) == [(4, TextSeverity.CRITICAL, "UAV4: GPS lost, not located")]
    assert told.after(fleet_view(2.0, LOCATED)) == []
    assert told.of(1.0 + SAME_ALARM_EVERY_S) == [(4, TextSeverity.WARNING, "UAV4: GPS lost, located within 7 m")]


def test_many_vehicles_at_once_are_told_in_turn_the_worst_first():
    told = Told()
    fleet = [replace(LOST if sysid == 30 else LOCATED, sysid=sysid) for sysid in range(1, 31)]
    texts = [told.after(fleet_view(0.0, *fleet))] + [told.of(float(second)) for second in range(1, 7)]
    assert [len(part) for part in texts] == [TEXTS_PER_S] * 6 + [0]
    assert texts[0][0] == (30, TextSeverity.CRITICAL, "UAV30: GPS lost, not located")
    assert {sysid for part in texts for sysid, _, _ in part} == set(range(1, 31))


def test_a_vehicle_that_begins_is_not_told_of_and_one_that_stays_unready_is():
    told = Told()
    assert told.after(fleet_view(0.0, UNREADY)) == []
    assert told.after(fleet_view(9.0, SOUND)) == []
    assert told.after(fleet_view(20.0, UNREADY)) == []
    assert told.of(20.0 + NOT_READY_AFTER_S) == [(4, TextSeverity.WARNING, "UAV4: GPS healthy, but could not be aided")]


def test_a_suspicion_that_became_certain_does_not_end():
    told = Told()
    assert told.after(fleet_view(0.0, SUSPECT)) == [(4, TextSeverity.WARNING, "UAV4: GPS suspect: only 3 satellites")]
    assert told.after(fleet_view(20.0, LOCATED)) == [(4, TextSeverity.WARNING, "UAV4: GPS lost, located within 7 m")]
    assert told.of(60.0) == []


def test_what_a_person_has_acknowledged_still_ends():
    told = Told()
    told.after(fleet_view(0.0, LOCATED))
    told.acknowledge(1, 5.0)
    assert told.of(5.0) == []
    assert [text for _, _, text in told.after(fleet_view(30.0, SOUND))] == ["UAV4: over: GPS lost, located within 7 m"]


def test_a_notice_is_told_once_and_of_the_whole_fleet_only_an_error():
    told = Told()
    for sysid, level in ((4, "warning"), (None, "warning"), (None, "error")):
        for alarm in told.alarms.add_notice(Notice(3.0, sysid, level, f"{level} of {sysid}")):
            told.texts.add(alarm)
    assert told.of(3.0) == [(None, TextSeverity.CRITICAL, "error of None"), (4, TextSeverity.WARNING, "UAV4: warning of 4")]
    told.acknowledge(1, 9.0)
    assert told.of(9.0) == []
    late = replace(fleet_view(20.0, SOUND), loop_lag_s=1.25)
    assert told.after(late) == [(None, TextSeverity.WARNING, "ground computer runs 1.2 s late")]
