"""Status texts: what ground tools such as QGroundControl are told of alarms, at a bounded rate."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from gcs_coloc.core.alarms.alarms import Alarm, AlarmKind, AlarmState

SAME_ALARM_EVERY_S = 10.0
"""Chosen: an alarm that comes and goes would else fill the tool's list; one that becomes worse does not wait."""
TEXTS_PER_S = 5
"""Chosen: a radio of 57600 baud carries them in 0.05 s, and 30 vehicles that lose their GPS at once are told in 6 s."""
NOT_READY_AFTER_S = 30.0
"""Each vehicle begins so, until it is known well enough. Chosen: longer than a healthy one takes."""


class TextSeverity(IntEnum):
    """How serious a text is: MAV_SEVERITY (MAVLink common.xml). Tools show and speak WARNING and worse."""

    CRITICAL = 2
    WARNING = 4
    INFO = 6


_SEVERITIES = {"error": TextSeverity.CRITICAL, "warning": TextSeverity.WARNING}


@dataclass(frozen=True, slots=True)
class StatusText:
    """One text for the ground tools; `sysid` None: it is about the whole fleet."""

    sysid: int | None
    severity: TextSeverity
    text: str


@dataclass(frozen=True, slots=True)
class _Sent:
    severity: TextSeverity
    at_s: float


class StatusTexts:
    """The changes of alarms that ground tools are still to be told, of each alarm the newest."""

    def __init__(self) -> None:
        self._waiting: dict[int, Alarm] = {}
        self._sent: dict[int, _Sent] = {}

    def add(self, alarm: Alarm) -> None:
        """Add the change of an alarm."""
        self._waiting[alarm.id] = alarm

    def pop_due(self, now_s: float) -> list[StatusText]:
        """Return what is to be sent in the second from service time `now_s`, the most serious first."""
        due: list[StatusText] = []
        for alarm in sorted(self._waiting.values(), key=lambda alarm: (_severity(alarm), alarm.id)):
            severity, sent = _severity(alarm), self._sent.get(alarm.id)
            if not _must_be_sent(alarm, sent):
                self._forget(alarm)
                continue
            waits = alarm.kind is AlarmKind.NOT_READY and sent is None and now_s - alarm.raised_at_s < NOT_READY_AFTER_S
            is_soon = sent is not None and severity >= sent.severity and now_s - sent.at_s < SAME_ALARM_EVERY_S
            if waits or is_soon or len(due) == TEXTS_PER_S:
                continue
            self._sent[alarm.id] = _Sent(severity, now_s)
            self._forget(alarm)
            due.append(StatusText(alarm.sysid, severity, _text(alarm)))
        return due

    def _forget(self, alarm: Alarm) -> None:
        del self._waiting[alarm.id]
        if alarm.state is AlarmState.CLOSED:  # the next of its kind is another alarm
            self._sent.pop(alarm.id, None)


def _is_over(alarm: Alarm) -> bool:
    """Whether the condition holds no longer; a notice is over at once, and its text is that it was raised."""
    return alarm.state in (AlarmState.OVER, AlarmState.CLOSED) and alarm.kind is not AlarmKind.NOTICE


def _must_be_sent(alarm: Alarm, sent: _Sent | None) -> bool:
    if alarm.kind is AlarmKind.NOTICE:
        # What is about the whole fleet is told in each vehicle's name: only what cannot wait for the page.
        return alarm.state is AlarmState.OVER and (alarm.sysid is not None or alarm.level == "error")
    if _is_over(alarm):
        superseded = alarm.kind is AlarmKind.GPS_SUSPECT and alarm.state is AlarmState.CLOSED
        return sent is not None and sent.severity is not TextSeverity.INFO and not superseded
    return sent is None or sent.severity is not _severity(alarm)


def _severity(alarm: Alarm) -> TextSeverity:
    return TextSeverity.INFO if _is_over(alarm) else _SEVERITIES[alarm.level]


def _text(alarm: Alarm) -> str:
    about = f"UAV{alarm.sysid}: " if alarm.sysid is not None else ""
    return f"{about}{'over: ' if _is_over(alarm) else ''}{alarm.brief}"
