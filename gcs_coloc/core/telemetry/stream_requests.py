"""Asks vehicles for the messages that the service lives on, politely: only what is missing, and ever less often."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from gcs_coloc.core.messages.outbound import StreamRequest

WANTED_HZ = {33: 10.0, 24: 5.0, 124: 5.0, 30: 10.0, 74: 5.0, 1: 2.0, 193: 2.0, 2: 1.0}
"""MAVLink message id -> wanted rate: GLOBAL_POSITION_INT, GPS_RAW_INT, GPS2_RAW, ATTITUDE, VFR_HUD, SYS_STATUS,
EKF_STATUS_REPORT, SYSTEM_TIME. At twice the lowest rate that serves; half of it is taken as enough."""

_WINDOW_S = 4.0
_FIRST_RETRY_S = 8.0
_LONGEST_RETRY_S = 120.0


@dataclass(slots=True)
class _Asked:
    window_started_s: float
    heard: Counter[int] = field(default_factory=Counter)
    wait_s: float = _FIRST_RETRY_S
    not_before_s: float = float("-inf")


class StreamRequests:
    """Counts what each vehicle sends over a window and asks for what comes at less than half of the wanted rate."""

    def __init__(self) -> None:
        self._asked: dict[int, _Asked] = {}

    def heard(self, sysid: int, message_id: int, at_s: float) -> None:
        """Note one message of a vehicle (which the fleet registry has taken: it bounds this table)."""
        record = self._asked.get(sysid)
        if record is None:
            record = self._asked[sysid] = _Asked(at_s)
        record.heard[message_id] += 1

    def restarted(self, sysid: int) -> None:
        """A vehicle has rebooted and forgotten what it was asked: ask again without waiting."""
        self._asked.pop(sysid, None)

    def due(self, now_s: float) -> list[StreamRequest]:
        """The requests that are due by now."""
        out: list[StreamRequest] = []
        for sysid, record in self._asked.items():
            span_s = now_s - record.window_started_s
            if span_s < _WINDOW_S:
                continue
            missing = [i for i, hz in WANTED_HZ.items() if record.heard[i] < 0.5 * hz * span_s]
            record.heard.clear()
            record.window_started_s = now_s
            if not missing:
                record.wait_s = _FIRST_RETRY_S
            elif now_s >= record.not_before_s:
                out.extend(StreamRequest(sysid, i, round(1e6 / WANTED_HZ[i])) for i in missing)
                record.not_before_s = now_s + record.wait_s
                record.wait_s = min(2.0 * record.wait_s, _LONGEST_RETRY_S)
        return out
