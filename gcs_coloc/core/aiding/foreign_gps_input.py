"""Somebody else who sends a vehicle GPS_INPUT: two senders for one receiver would be taken in turns, so ours stands down."""

from __future__ import annotations

from dataclasses import dataclass

from gcs_coloc.core.aiding.inhibit import Inhibit, InhibitReason
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.messages.control import ForeignGpsInput
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.core.reasons import StatedReason


@dataclass(slots=True)
class _Other:
    sender: int
    heard_at_s: float
    reported: bool = False


class ForeignGpsInputMonitor:
    """Which vehicles somebody else feeds on the receiver instance that we feed; what feeds another one is no rival."""

    def __init__(self, settings: AidingSettings) -> None:
        self._gps_id = settings.gps_id
        self._stand_down_s = settings.stand_down_s
        self._others: dict[int, _Other] = {}

    def add(self, message: ForeignGpsInput) -> None:
        """Add one message."""
        if message.vehicle is None or message.gps_id != self._gps_id:
            return
        other = self._others.get(message.vehicle)
        if other is None:
            self._others[message.vehicle] = _Other(message.sysid, message.received_at_s)
        else:
            other.sender, other.heard_at_s = message.sysid, message.received_at_s

    def review(self, sysid: int, now_s: float) -> list[Notice]:
        """What is to be told of a vehicle's other sender: once when it is there, and when it has been gone for a while."""
        other = self._others.get(sysid)
        if other is None:
            return []
        if now_s - other.heard_at_s > self._stand_down_s:
            del self._others[sysid]
            return [Notice(now_s, sysid, "info", f"nobody else has sent it GPS_INPUT for {self._stand_down_s:g} s")]
        if other.reported:
            return []
        other.reported = True
        inhibit = StatedReason(InhibitReason.FOREIGN_GPS_INPUT, other.sender, self._gps_id)
        return [Notice(now_s, sysid, "error", f"{inhibit.text}: ours stands down")]

    def inhibit(self, sysid: int) -> Inhibit | None:
        """Return why a vehicle is not aided; None where nobody else feeds it."""
        other = self._others.get(sysid)
        return StatedReason(InhibitReason.FOREIGN_GPS_INPUT, other.sender, self._gps_id) if other is not None else None
