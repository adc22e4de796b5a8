"""Fix acknowledgement: whether a vehicle uses its fix, by the fed receiver or the status of its EKF2."""

from __future__ import annotations

from abc import ABC, abstractmethod
from math import hypot

from gcs_coloc.core.geodesy import horizontal_distance_m
from gcs_coloc.core.messages.inbound import FIX_3D, GpsReceiver
from gcs_coloc.core.messages.outbound import AidingMessage, GpsInput
from gcs_coloc.core.reasons import DOCTOR_NAMES_SETTINGS, StatedReason, WordedReason
from gcs_coloc.core.telemetry.reported_state import ReportedState

_JUDGED_AFTER_S = 5.0  # chosen: an autopilot takes the first fixes within two, and reports at 1 Hz
_SILENCE_S = 3.0  # chosen: three reports at 1 Hz
_LINGERS_S = 6.0  # ArduPilot keeps a fix for 4 s after the last message with one
_NEAR_M = 50.0  # chosen: the alert limit unless set, by which a sound fix may have stepped since the one that is reported
_NEAR_S = 2.0  # chosen: a report at 1 Hz and a slow link are no older
_SENT_WITHIN_S = 2.0  # chosen: below the 5 s after which PX4 gives up an aid
_EKF_FRESH_S = 6.0  # PX4 sends ESTIMATOR_STATUS every 5.5 s on a telemetry radio's default rate


class FixFault(WordedReason):
    """Why our fix counts as not used; `{detail}` is the receiver, or the message that reports it."""

    NOT_REPORTED = "not_reported", "no {detail} is heard from it"
    NO_FIX = "no_fix", "its {detail} says fix type {value:.0f} while positions are sent"
    ANOTHER_FIX = (
        "another_fix",
        "its {detail} is {value:.0f} m off what is sent: is it a receiver of its own, or does somebody else feed it?",
    )
    EKF_UNAIDED = "ekf_unaided", "its EKF2 reports no global position from GNSS or aid"
    EKF_WITHOUT_VISION = "ekf_without_vision", "its EKF2 reports no horizontal aid, though a vision position is sent"
    EKF_WITHOUT_RANGES = "ekf_without_ranges", "its EKF2 reports no horizontal aid, though ranges are sent"
    UNSENT_FIX = (
        "unsent_fix",
        "its {detail} has a fix that was not sent: is it a receiver of its own, or does somebody else feed it?",
    )


class Acknowledgement(ABC):
    """Whether one vehicle uses what it is sent.

    `acknowledged` is None until the vehicle shows it. `fault` says in words why it does not use what it is sent, None otherwise.
    """

    _what: str

    def __init__(self) -> None:
        self.acknowledged: bool | None = None
        self.fault: str | None = None
        self._wrong_since_s: float | None = None
        self._alarmed = False

    @abstractmethod
    def add_sent(self, message: AidingMessage, now_s: float) -> None:
        """Add what was sent."""

    def review(self, vehicle: ReportedState, now_s: float, *, is_held_back: bool = False) -> tuple[str, str] | None:
        """Update the result by what the vehicle reports; return level and text of a notice that is due.

        While what is built `is_held_back`, what the vehicle reports is an answer to somebody else, and nothing is judged. What is
        wrong once it is sent again is told again.
        """
        if is_held_back:
            self.acknowledged, self.fault, self._wrong_since_s, self._alarmed = None, None, None, False
            return None
        fault = self._fault_now(vehicle, now_s)
        if fault is not None:
            self._wrong_since_s = now_s if self._wrong_since_s is None else self._wrong_since_s
            if now_s - self._wrong_since_s < _JUDGED_AFTER_S:
                return None
            self.acknowledged, self.fault = False, fault
            if self._alarmed:
                return None
            self._alarmed = True
            return "error", f"{self._what} is not taken ({DOCTOR_NAMES_SETTINGS}): {fault}"
        self._wrong_since_s, self.fault = None, None
        # A vehicle that reports no fix as we do has shown nothing yet.
        shown = self._is_shown(vehicle, now_s)
        self.acknowledged = True if shown else None if self.acknowledged is False else self.acknowledged
        if not (self._alarmed and self.acknowledged):
            return None
        self._alarmed = False
        return "info", f"{self._what} is taken"

    @abstractmethod
    def _fault_now(self, vehicle: ReportedState, now_s: float) -> str | None: ...

    @abstractmethod
    def _is_shown(self, vehicle: ReportedState, now_s: float) -> bool: ...


class EkfAcknowledgement(Acknowledgement):
    """The acknowledgement of a PX4: its EKF2 reports in ESTIMATOR_STATUS what aids it.

    While the vehicle's own GPS has no fix, the aid that EKF2 reports is ours. A global position shows as such. A vision position
    and ranges show only as a horizontal aid, which may be another sensor of the vehicle. `unused` is the fault that is stated
    while no aid is reported.
    """

    def __init__(self, unused: FixFault) -> None:
        super().__init__()
        self._what = "RANGING_BEACON" if unused is FixFault.EKF_WITHOUT_RANGES else "the position"
        self._unused = unused
        self._sent_at_s = float("-inf")

    def add_sent(self, message: AidingMessage, now_s: float) -> None:
        """As the base class says."""
        del message
        self._sent_at_s = now_s

    def _fault_now(self, vehicle: ReportedState, now_s: float) -> str | None:
        return StatedReason(self._unused).text if self._is_aided(vehicle, now_s) is False else None

    def _is_shown(self, vehicle: ReportedState, now_s: float) -> bool:
        return self._is_aided(vehicle, now_s) is True

    def _is_aided(self, vehicle: ReportedState, now_s: float) -> bool | None:
        """Return whether our positions aid the EKF2; None where that cannot be told.

        It cannot be told where nothing was sent of late, where the vehicle's own receiver has a fix, or where no status is
        heard.
        """
        receiver, ekf = vehicle.receiver, vehicle.ekf
        if now_s - self._sent_at_s > _SENT_WITHIN_S or (receiver is not None and receiver.fix_type >= FIX_3D):
            return None
        if ekf is None or now_s - ekf.received_at_s > _EKF_FRESH_S:
            return None
        return ekf.global_position_aided if self._unused is FixFault.EKF_UNAIDED else ekf.horizontally_aided


class FixAcknowledgement(Acknowledgement):
    """The acknowledgement of GPS_INPUT: GPS2_RAW (GPS_RAW_INT for the first receiver) shows the sent fix."""

    _what = "GPS_INPUT"

    def __init__(self, gps_id: int, began_at_s: float) -> None:
        super().__init__()
        self._gps_id = gps_id
        self._fix: GpsInput | None = None
        self._no_fix_since_s: float | None = began_at_s
        self._heard: GpsReceiver | None = None

    def add_sent(self, message: AidingMessage, now_s: float) -> None:
        """As the base class says."""
        if not isinstance(message, GpsInput):
            return
        if message.fix_type >= FIX_3D:
            self._fix, self._no_fix_since_s = message, None
        else:
            self._fix = None
            self._no_fix_since_s = now_s if self._no_fix_since_s is None else self._no_fix_since_s

    def add_receiver(self, receiver: GpsReceiver) -> None:
        """Add what the vehicle says of the receiver that we feed."""
        self._heard = receiver

    def _fault_now(self, vehicle: ReportedState, now_s: float) -> str | None:
        heard, name = self._heard, f"GPS{self._gps_id + 1}"
        if heard is None or now_s - heard.received_at_s > _SILENCE_S:
            if now_s - vehicle.last_heard_s > _SILENCE_S:
                return None  # its link is silent, which says nothing of its receiver
            message = "GPS_RAW_INT" if self._gps_id == 0 else "GPS2_RAW"
            return StatedReason(FixFault.NOT_REPORTED, detail=message).text
        if self._fix is None:
            since_s = self._no_fix_since_s
            lingered = since_s is not None and now_s - since_s > _LINGERS_S
            return StatedReason(FixFault.UNSENT_FIX, detail=name).text if lingered and heard.fix_type >= FIX_3D else None
        if heard.fix_type < FIX_3D:
            return StatedReason(FixFault.NO_FIX, heard.fix_type, detail=name).text
        off_m = horizontal_distance_m(heard.lat_deg, heard.lon_deg, self._fix.lat_deg, self._fix.lon_deg)
        speed_mps = hypot(self._fix.vn_mps, self._fix.ve_mps)
        if off_m > _NEAR_M + _NEAR_S * speed_mps:
            return StatedReason(FixFault.ANOTHER_FIX, off_m, detail=name).text
        return None

    def _is_shown(self, vehicle: ReportedState, now_s: float) -> bool:
        del vehicle
        return self._fix is not None and self._heard is not None and now_s - self._heard.received_at_s <= _SILENCE_S
