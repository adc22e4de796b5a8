"""The alarms of a fleet, and the traffic light of each vehicle.

An alarm is raised while a condition holds, over when it ends, and closed once a person has acknowledged it. The traffic light of
a vehicle shows its most serious condition.

The states are those of alarm management (ANSI/ISA-18.2), without shelving.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal

from gcs_coloc.core.messages.control import HOST_LATE_S
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.core.reasons import DOCTOR_NAMES_SETTINGS
from gcs_coloc.core.snapshot import FleetSnapshot, VehicleSnapshot
from gcs_coloc.core.standby.standby_snapshot import StandbySnapshot
from gcs_coloc.core.stations.node_id import untested_text

LightColour = Literal["good", "caution", "bad", "unknown"]
SILENT_AFTER_S = 3.0
"""Chosen: three heartbeats, which every vehicle sends once a second (mavlink.io, heartbeat protocol)."""
_LINK_LATE_S = 0.7
"""Chosen: telemetry radios of 57,600 baud delay by half a second at most; estimators refuse what is a second late."""
_MAX_NOTICES = 50
"""Alarms of notices that wait to be acknowledged; the oldest are closed beyond. Chosen: more than a person reads."""


class AlarmKind(StrEnum):
    """What an alarm is about. Its value stands in MQTT messages and recordings."""

    SILENT = "silent"
    """The vehicle is not heard."""
    GPS_LOST = "gps_lost"
    """Its GPS has failed, or it is aided by the operator's override."""
    GPS_SUSPECT = "gps_suspect"
    """Its GPS may be wrong."""
    LINK_LATE = "link_late"
    """What the vehicle reports arrives late."""
    HOST_LATE = "host_late"
    """The computer of the service falls behind."""
    SENSORS_WORSE = "sensors_worse"
    """Ranges, heights or positions are worse than they state, so that protection levels are larger."""
    NOT_READY = "not_ready"
    """Its GPS is healthy, but it could not be aided, or in flight not be located any more, if it failed."""
    STANDBY = "standby"
    """The hot standby is not what it should be: the other service is lost, or nobody sends."""
    NOTICE = "notice"
    """Something happened that a person should read; it has no duration."""


class AlarmState(StrEnum):
    """The life of an alarm."""

    ACTIVE = "active"
    """The condition holds, and nobody has acknowledged the alarm."""
    ACKNOWLEDGED = "acknowledged"
    """The condition holds, and a person knows."""
    OVER = "over"
    """The condition holds no longer, and nobody has acknowledged the alarm."""
    CLOSED = "closed"
    """Over and acknowledged: it leaves the list."""


@dataclass(frozen=True, slots=True)
class Condition:
    """What is wrong with a vehicle now.

    `level` is `warning` or `error`. `action` is what a person is to do. `brief` is the text for a small display.
    """

    kind: AlarmKind
    level: str
    text: str
    action: str
    brief: str


# Not frozen, as `VehicleSnapshot` is not: each page is sent all of them several times a second.
@dataclass(slots=True)
class Alarm:
    """One alarm. Times are service time, s; `sysid` None: it is about the whole fleet.

    `id` counts from 1 in each run of the service. `at_s` is when it last changed, `times` how often the condition came while
    the alarm was in the list. `level` is `warning` or `error`; `action` is what a person is to do, `brief` the text for a small
    display.
    """

    id: int
    kind: AlarmKind
    sysid: int | None
    state: AlarmState
    level: str
    text: str
    action: str
    raised_at_s: float
    at_s: float
    over_at_s: float | None = None
    times: int = 1
    brief: str = ""


def conditions(v: VehicleSnapshot, loop_lag_s: float) -> list[Condition]:
    """Return what is wrong with a vehicle, the most serious first.

    `loop_lag_s` is by how much the host runs the service late. So long a silence, and the delay, are then the host's.
    """
    gps = _gps_condition(v)
    found = [gps] if gps is not None else []
    if v.delay_s is not None and v.delay_s > _LINK_LATE_S and loop_lag_s <= HOST_LATE_S:
        text = f"its reports arrive {v.delay_s:.1f} s late; what is later than the estimator waits (1 s unless set) is not used"
        action = "Is the queue of its radio full? Lower its stream rates, or use a faster link."
        found.append(Condition(AlarmKind.LINK_LATE, "warning", text, action, f"its reports arrive {v.delay_s:.1f} s late"))
    if v.age_s > SILENT_AFTER_S + loop_lag_s:
        text = f"not heard for {v.age_s:.0f} s; before that: GPS {v.gps_state}, {v.gps_reason}"
        action = "Check its power and its link; the map shows where it was last."
        found.insert(0, Condition(AlarmKind.SILENT, "error", text, action, f"not heard for {v.age_s:.0f} s"))
    return found


def traffic_light(v: VehicleSnapshot, loop_lag_s: float) -> tuple[LightColour, str]:
    """Return the colour of one vehicle's traffic light and the reason, both of its worst condition."""
    found = conditions(v, loop_lag_s)
    if found:
        return ("bad" if found[0].level == "error" else "caution"), found[0].text
    return ("unknown", v.gps_reason) if v.gps_state == "unknown" else ("good", f"GPS healthy: {v.gps_reason}")


def _gps_condition(v: VehicleSnapshot) -> Condition | None:
    if v.gps_state in ("failed", "recovering"):
        why = f": {v.no_estimate_reason}" if v.no_estimate_reason is not None else ""
        located = f"within {v.bound_95_m:.0f} m (95 %)" if v.bound_95_m is not None else f"nowhere{why}"
        if v.hpl_m is not None:
            located += f", protection level {v.hpl_m:.0f} m"
            if v.untested:
                located += f" if {untested_text(v.untested, v.sysid)} {'is' if len(v.untested) == 1 else 'are'} right"
        text = f"GPS {v.gps_state}: {v.gps_reason}. Located {located}; {v.aiding}"
        brief = f"GPS {'lost' if v.gps_state == 'failed' else v.gps_state}, "
        brief += f"located within {v.bound_95_m:.0f} m" if v.bound_95_m is not None else "not located"
        if v.bound_95_m is not None and not _is_aided(v) and not v.aiding_held_back:
            brief += ", not aided"
        return Condition(AlarmKind.GPS_LOST, "warning" if _is_aided(v) else "error", text, _action_without_gps(v), brief)
    if v.gps_state == "suspect":
        action = "Compare it with what you see; declare its GPS failed or healthy where you know better."
        text = f"GPS suspect: {v.gps_reason}"
        return Condition(AlarmKind.GPS_SUSPECT, "warning", text, action, text)
    if v.gps_state == "unknown":
        return None
    if v.aiding_override == "on":
        text = f"aiding switched on by the operator ({v.aiding}); GPS healthy: {v.gps_reason}"
        action = "Set its aiding to automatic when it is no longer needed."
        brief = "aided by the operator's choice; GPS healthy"
        return Condition(AlarmKind.GPS_LOST, "warning" if v.aiding_has_fix else "error", text, action, brief)
    what = v.aiding if v.fix_acknowledged is False else f"it could not be aided: {v.inhibit_reason}" if v.inhibit_reason else None
    if what is None:
        return _readiness_condition(v)
    action = f"Mend it before it is needed: {DOCTOR_NAMES_SETTINGS}."
    text = f"GPS healthy ({v.gps_reason}), but {what}"
    return Condition(AlarmKind.NOT_READY, "warning", text, action, "GPS healthy, but could not be aided")


def _readiness_condition(v: VehicleSnapshot) -> Condition | None:
    found = v.readiness
    if found is None or not found.is_lost:
        return None
    text = f"GPS healthy, but if it failed now the vehicle would be lost: {found.text}"
    action = "Bring it and its peers into a better geometry, or within range; until then rely on no ranges."
    return Condition(AlarmKind.NOT_READY, "warning", text, action, "GPS healthy, but without it the vehicle would be lost")


def _standby_condition(standby: StandbySnapshot) -> Condition:
    is_sent = standby.sends in ("this", "other")
    text = f"hot standby: {standby.problem}"
    action = "Bring the other service back: until then nobody takes over." if is_sent else "See to it that one of the two sends."
    brief = "no second service stands by" if is_sent else "hot standby: it is not known that anybody sends"
    return Condition(AlarmKind.STANDBY, "warning" if is_sent else "error", text, action, brief)


def _is_aided(v: VehicleSnapshot) -> bool:
    return v.aiding_has_fix and v.fix_acknowledged is not False


def _action_without_gps(v: VehicleSnapshot) -> str:
    if v.aiding_held_back:
        return "This service holds back: the page of the other service says what it is sent, and what to do."
    if v.aiding_override == "off":
        return "Its aiding is switched off: fly it by hand, or set its aiding to automatic."
    if v.fix_acknowledged is False:
        return f"Its autopilot does not use what it is sent: fly it by hand; {DOCTOR_NAMES_SETTINGS}."
    if v.bound_95_m is None:
        return "Fly it by hand: it is located again with ranges to vehicles that are located."
    if not v.aiding_has_fix:
        return "It is not sent its position: fly it by hand, and remove the reason."
    if v.ranges_in_use == 0:
        return "Its ranges have ceased: take it over or land it now; what it is sent ends within seconds."
    return "It flies by its ranges: bring it home or land it while the protection level is small."


class AlarmList:
    """The alarms of one fleet, one for each vehicle and kind. Its methods return those that have changed."""

    def __init__(self) -> None:
        self._alarms: dict[tuple[int | None, AlarmKind, str], Alarm] = {}
        self._newest_id = 0

    def __iter__(self) -> Iterator[Alarm]:
        """Iterate over the alarms that are not closed, in the order in which they were first raised."""
        return iter(self._alarms.values())

    def update(self, fleet: FleetSnapshot) -> list[Alarm]:
        """Raise, change and end alarms by how the fleet stands."""
        changed: list[Alarm] = []
        holding: set[tuple[int | None, AlarmKind, str]] = set()
        found: list[tuple[int | None, Condition]] = [
            (v.sysid, condition) for v in fleet.vehicles for condition in conditions(v, fleet.loop_lag_s)
        ]
        if fleet.loop_lag_s > HOST_LATE_S:
            text = f"this computer falls behind: it ran the service {fleet.loop_lag_s:.1f} s late"
            action = "Stop what else runs on it: positions are sent late, and of a silent vehicle you are told late."
            brief = f"ground computer runs {fleet.loop_lag_s:.1f} s late"
            found.append((None, Condition(AlarmKind.HOST_LATE, "warning", text, action, brief)))
        if not fleet.noise.is_as_stated:
            text = f"ranges and positions contradict each other by more than they state: {fleet.noise.text}"
            action = "Protection levels are larger; calibrate the ranging devices (gcs-coloc calibrate), check the barometers."
            brief = "ranges or positions are worse than they state"
            found.append((None, Condition(AlarmKind.SENSORS_WORSE, "warning", text, action, brief)))
        if fleet.standby is not None and fleet.standby.problem is not None:
            found.append((None, _standby_condition(fleet.standby)))
        for sysid, condition in found:
            key = (sysid, condition.kind, "")
            holding.add(key)
            changed += self._hold(key, condition, fleet.at_s)
        for key, alarm in list(self._alarms.items()):
            if key not in holding and alarm.state in (AlarmState.ACTIVE, AlarmState.ACKNOWLEDGED):
                needs_nobody = (
                    alarm.state is AlarmState.ACKNOWLEDGED
                    or alarm.kind is AlarmKind.NOT_READY  # so each vehicle begins, until it is known well enough
                    or (alarm.kind is AlarmKind.GPS_SUSPECT and (alarm.sysid, AlarmKind.GPS_LOST, "") in holding)
                )
                state = AlarmState.CLOSED if needs_nobody else AlarmState.OVER
                changed.append(self._put(key, replace(alarm, state=state, at_s=fleet.at_s, over_at_s=fleet.at_s)))
        return changed

    def add_notice(self, notice: Notice) -> list[Alarm]:
        """Raise an alarm for a notice of level `warning` or `error`; it is over at once.

        Notices that differ in their numbers alone share one alarm.
        """
        if notice.level == "info":
            return []
        key = (notice.sysid, AlarmKind.NOTICE, re.sub(r"[\d.]+", "#", notice.text))
        action = "Mend its cause, then acknowledge it." if notice.level == "error" else "Acknowledge it once it is understood."
        condition = Condition(AlarmKind.NOTICE, notice.level, notice.text, action, notice.text)
        [alarm] = self._hold(key, condition, notice.at_s)
        changed = [self._put(key, replace(alarm, state=AlarmState.OVER, over_at_s=notice.at_s))]
        waiting = [(k, one) for k, one in self._alarms.items() if one.kind is AlarmKind.NOTICE]
        if len(waiting) > _MAX_NOTICES:
            oldest, one = min(waiting, key=lambda item: item[1].at_s)
            changed.append(self._put(oldest, replace(one, state=AlarmState.CLOSED, at_s=notice.at_s)))
        return changed

    def acknowledge(self, alarm_id: int, at_s: float) -> list[Alarm]:
        """Record that a person knows of an alarm; empty where there is none of that id that waits for it."""
        for key, alarm in self._alarms.items():
            if alarm.id == alarm_id and alarm.state in (AlarmState.ACTIVE, AlarmState.OVER):
                state = AlarmState.ACKNOWLEDGED if alarm.state is AlarmState.ACTIVE else AlarmState.CLOSED
                return [self._put(key, replace(alarm, state=state, at_s=at_s))]
        return []

    def _hold(self, key: tuple[int | None, AlarmKind, str], condition: Condition, at_s: float) -> list[Alarm]:
        """Raise the alarm of a condition that holds at `at_s`, or bring it up to date.

        Return it where it has changed. A change of words alone is no change.
        """
        alarm = self._alarms.get(key)
        if alarm is None:
            self._newest_id += 1
            about = (condition.level, condition.text, condition.action)
            alarm = Alarm(self._newest_id, condition.kind, key[0], AlarmState.ACTIVE, *about, at_s, at_s, brief=condition.brief)
            return [self._put(key, alarm)]
        is_again, is_worse = alarm.state is AlarmState.OVER, condition.level == "error" and alarm.level != "error"
        is_changed = is_again or condition.level != alarm.level
        alarm = replace(
            alarm,
            # Whoever has acknowledged a warning does not know of the error.
            state=AlarmState.ACTIVE if is_again or is_worse else alarm.state,
            level=condition.level,
            text=condition.text,
            action=condition.action,
            brief=condition.brief,
            at_s=at_s if is_changed else alarm.at_s,
            over_at_s=None,
            times=alarm.times + is_again,
        )
        self._put(key, alarm)
        return [alarm] if is_changed else []

    def _put(self, key: tuple[int | None, AlarmKind, str], alarm: Alarm) -> Alarm:
        if alarm.state is AlarmState.CLOSED:
            del self._alarms[key]
        else:
            self._alarms[key] = alarm
        return alarm
