"""Whether a vehicle acknowledges our GPS_INPUT: what it says of the receiver that we feed (GPS2_RAW) against what was sent."""

from __future__ import annotations

from math import hypot

from gcs_coloc.core.geodesy import horizontal_distance_m
from gcs_coloc.core.messages.inbound import GpsReceiver
from gcs_coloc.core.messages.outbound import GpsInput
from gcs_coloc.core.reasons import StatedReason, WordedReason

_JUDGED_AFTER_S = 5.0
_SILENCE_S = 3.0
_LINGERS_S = 6.0  # ArduPilot keeps a fix for 4 s after the last message with one
_NEAR_M, _NEAR_S = 50.0, 2.0
_HAS_FIX = 3


class FixFault(WordedReason):
    """Why our fix counts as not used; `{detail}` is the receiver, or the message that reports it."""

    NOT_REPORTED = "not_reported", "no {detail} is heard from it"
    NO_FIX = "no_fix", "its {detail} says fix type {value:.0f} while positions are sent"
    ANOTHER_FIX = (
        "another_fix",
        "its {detail} is {value:.0f} m off what is sent: is it a receiver of its own, or does somebody else feed it?",
    )
    UNSENT_FIX = (
        "unsent_fix",
        "its {detail} has a fix that was not sent: is it a receiver of its own, or does somebody else feed it?",
    )


class FixAcknowledgement:
    """One stream of GPS_INPUT to one vehicle. `acknowledged` is None until it shows; `fault` says why it is not."""

    def __init__(self, gps_id: int, began_at_s: float) -> None:
        self.acknowledged: bool | None = None
        self.fault: str | None = None
        self._gps_id = gps_id
        self._fix: GpsInput | None = None
        self._no_fix_since_s: float | None = began_at_s
        self._heard: GpsReceiver | None = None
        self._wrong_since_s: float | None = None
        self._alarmed = False

    def add_sent(self, message: GpsInput, now_s: float) -> None:
        """Add what was sent."""
        if message.fix_type >= _HAS_FIX:
            self._fix, self._no_fix_since_s = message, None
        else:
            self._fix = None
            self._no_fix_since_s = now_s if self._no_fix_since_s is None else self._no_fix_since_s

    def add_receiver(self, receiver: GpsReceiver) -> None:
        """Add what the vehicle says of the receiver that we feed."""
        self._heard = receiver

    def review(self, now_s: float) -> tuple[str, str] | None:
        """Judge; level and text of what is to be told, where it has changed."""
        fault = self._fault_now(now_s)
        if fault is not None:
            self._wrong_since_s = now_s if self._wrong_since_s is None else self._wrong_since_s
            if now_s - self._wrong_since_s < _JUDGED_AFTER_S:
                return None
            self.acknowledged, self.fault = False, fault
            if self._alarmed:
                return None
            self._alarmed = True
            return "error", f"GPS_INPUT is not taken: {fault}"
        self._wrong_since_s, self.fault = None, None
        # A vehicle that says as we do that there is no fix has shown nothing yet.
        self.acknowledged = True if self._fix is not None else None if self.acknowledged is False else self.acknowledged
        if not (self._alarmed and self.acknowledged):
            return None
        self._alarmed = False
        return "info", "GPS_INPUT is taken"

    def _fault_now(self, now_s: float) -> str | None:
        heard, name = self._heard, f"GPS{self._gps_id + 1}"
        remedy = f"; are {name}_TYPE=14, gps_id={self._gps_id} and MAV_OPTIONS right?"
        if heard is None or now_s - heard.received_at_s > _SILENCE_S:
            message = "GPS_RAW_INT" if self._gps_id == 0 else "GPS2_RAW"
            return StatedReason(FixFault.NOT_REPORTED, detail=message).text + remedy
        if self._fix is None:
            since_s = self._no_fix_since_s
            lingered = since_s is not None and now_s - since_s > _LINGERS_S
            return StatedReason(FixFault.UNSENT_FIX, detail=name).text if lingered and heard.fix_type >= _HAS_FIX else None
        if heard.fix_type < _HAS_FIX:
            return StatedReason(FixFault.NO_FIX, heard.fix_type, detail=name).text + remedy
        off_m = horizontal_distance_m(heard.lat_deg, heard.lon_deg, self._fix.lat_deg, self._fix.lon_deg)
        speed_mps = hypot(self._fix.vn_mps, self._fix.ve_mps)
        if off_m > _NEAR_M + _NEAR_S * speed_mps:
            return StatedReason(FixFault.ANOTHER_FIX, off_m, detail=name).text
        return None
