"""Requests for the messages that the service needs: only what is missing, and ever less often."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from gcs_coloc.core.messages.inbound import (
    Airspeed,
    Attitude,
    EkfStatus,
    FromVehicle,
    GlobalPosition,
    GpsReceiver,
    Heartbeat,
    SystemHealth,
    SystemTime,
)
from gcs_coloc.core.messages.outbound import StreamRequest

WANTED_HZ = {33: 10.0, 24: 5.0, 124: 5.0, 30: 10.0, 74: 5.0, 1: 2.0, 193: 2.0, 2: 1.0}
"""MAVLink message id -> wanted rate: GLOBAL_POSITION_INT, GPS_RAW_INT, GPS2_RAW, ATTITUDE, VFR_HUD, SYS_STATUS,
EKF_STATUS_REPORT, SYSTEM_TIME. At twice the lowest rate that serves; half of it is taken as enough."""

_MESSAGE_IDS = {GlobalPosition: 33, Attitude: 30, Airspeed: 74, SystemHealth: 1, EkfStatus: 193, SystemTime: 2}
_RECEIVER_IDS = (24, 124)  # GPS_RAW_INT, GPS2_RAW
_WINDOW_S = 4.0
_FIRST_RETRY_S = 8.0
_LONGEST_RETRY_S = 120.0


@dataclass(slots=True)
class _Requested:
    window_started_s: float
    received: Counter[int] = field(default_factory=Counter)
    wait_s: float = _FIRST_RETRY_S
    not_before_s: float = float("-inf")


class StreamRequests:
    """Counts what each vehicle sends over a window and asks for what comes at less than half of the wanted rate."""

    def __init__(self) -> None:
        self._requested: dict[int, _Requested] = {}

    def add(self, message: FromVehicle) -> None:
        """Count one message of a vehicle of the fleet, whose size bounds this table.

        A heartbeat alone begins the requests: ArduCopter sends nothing else by default.
        """
        if isinstance(message, Heartbeat):
            self._requested.setdefault(message.sysid, _Requested(message.received_at_s))
            return
        message_id = _MESSAGE_IDS.get(type(message))
        if isinstance(message, GpsReceiver):
            message_id = _RECEIVER_IDS[min(message.receiver, 1)]
        if message_id is not None:
            self.count(message.sysid, message_id, message.received_at_s)

    def count(self, sysid: int, message_id: int, at_s: float) -> None:
        """Count one message by its MAVLink id."""
        record = self._requested.get(sysid)
        if record is None:
            record = self._requested[sysid] = _Requested(at_s)
        record.received[message_id] += 1

    def forget(self, sysid: int) -> None:
        """Forget the requests to a vehicle that has rebooted: it has forgotten them, too."""
        self._requested.pop(sysid, None)

    def due(self, now_s: float) -> list[StreamRequest]:
        """The requests that are due by now."""
        out: list[StreamRequest] = []
        for sysid, record in self._requested.items():
            span_s = now_s - record.window_started_s
            if span_s < _WINDOW_S:
                continue
            missing = [i for i, hz in WANTED_HZ.items() if record.received[i] < 0.5 * hz * span_s]
            record.received.clear()
            record.window_started_s = now_s
            if not missing:
                record.wait_s = _FIRST_RETRY_S
            elif now_s >= record.not_before_s:
                out.extend(StreamRequest(sysid, i, round(1e6 / WANTED_HZ[i])) for i in missing)
                record.not_before_s = now_s + record.wait_s
                record.wait_s = min(2.0 * record.wait_s, _LONGEST_RETRY_S)
        return out
