"""Inhibit reasons: why a vehicle is not aided, is sent no fix or gets no standby; worded here alone."""

from __future__ import annotations

from dataclasses import dataclass

from gcs_coloc.core.aiding.parameters import Parameters
from gcs_coloc.core.aiding.receiver_switch import GPS_PRIMARY
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.messages.control import NO_HEARTBEAT_YET, ForeignGpsInput
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.core.reasons import DOCTOR_NAMES_SETTINGS, DUPLICATE_ID_WORDING, StatedReason, WordedReason
from gcs_coloc.core.telemetry.reported_state import ReportedState


class InhibitReason(WordedReason):
    """Why a vehicle cannot be aided, or may not be sent a fix."""

    # Nothing is sent
    NO_ROUTE = "no_route", "{detail}"
    NO_HEARTBEAT = "no_heartbeat", NO_HEARTBEAT_YET
    DUPLICATE_ID = "duplicate_id", DUPLICATE_ID_WORDING
    HOST_CLOCK = "host_clock", "{detail}"
    UNKNOWN_AUTOPILOT = (
        "unknown_autopilot",
        "its autopilot is neither ArduPilot nor PX4: set its aiding method where you have tried one",
    )
    PX4_TAKES_NO_METHOD = "px4_takes_no_method", f"its EKF2 takes no position; {DOCTOR_NAMES_SETTINGS}"
    PX4_METHOD_UNKNOWN = "px4_method_unknown", "it has not told yet which positions its EKF2 takes"
    PX4_RESETS_BY_EXTERNAL_POSITION = (
        "px4_resets_by_external_position",
        "PX4 takes an external position estimate as a reset and drifts on: set its aiding method to auto",
    )
    PX4_IGNORES_GPS_INPUT = "px4_ignores_gps_input", "PX4 does not take GPS_INPUT: set its aiding method to auto"
    ARDUPILOT_IGNORES_POSITION_SENSOR = (
        "ardupilot_ignores_position_sensor",
        "ArduPilot does not take GLOBAL_POSITION_SENSOR: set its method to auto",
    )
    VISION_IS_FOR_PX4 = "vision_is_for_px4", "vision_position is tried on PX4 alone: set its aiding method to auto"
    RANGING_BEACON_IS_FOR_PX4 = "ranging_beacon_is_for_px4", "ranging_beacon is tried on PX4 alone: set its aiding method to auto"
    FOREIGN_GPS_INPUT = "foreign_gps_input", "system {value:.0f} sends it GPS_INPUT for receiver {limit:.0f}"

    # No fix is stated
    NOT_SENT_YET = "not_sent_yet", "not sent yet"
    NO_ESTIMATE = "no_estimate", "{detail}"
    BEYOND_ALERT_LIMIT = (
        "beyond_alert_limit",
        "protection level {value:.1f} m is beyond the alert limit of {limit:g} m",
    )
    NO_PROTECTION_LEVEL = "no_protection_level", "its position has no protection level"
    UNTESTED = "untested", "its ranges cannot test the position of {detail}, and require_fault_tests is set"
    PREDICTION_ALONE = "prediction_alone", "no range has been in use for {limit:g} s: prediction alone"
    UNDETERMINED = "undetermined", "its ranges, to one peer or along one line, have not fixed its place for {limit:g} s"
    RANGES_INCONSISTENT = "ranges_misfit", "half of its ranges are {value:.1f} sigma or more off where it is held to be"
    RANGES_JUMPED = "ranges_jumped", "all of its ranges jumped by {value:.0f} m"
    REGAINING = "regaining", "good enough again, watched for {limit:g} s"

    # No standby
    STANDBY_UNKNOWN = "standby_unknown", "it has not told its GPS_AUTO_SWITCH and GPS_PRIMARY yet"
    STANDBY_OURS_FIRST = "standby_ours_first", "GPS_PRIMARY={value:g} is our receiver: set it to its own"
    STANDBY_MAY_SWITCH = (
        "standby_may_switch",
        "GPS_AUTO_SWITCH={value:g} could leave its own receiver for ours: set it to 4",
    )


Inhibit = StatedReason[InhibitReason]
"""Why a vehicle is not aided, with the numbers of it."""


@dataclass(slots=True)
class _Other:
    sender: int
    heard_at_s: float
    reported: bool = False


class ForeignGpsInputMonitor:
    """Which vehicles get GPS_INPUT from another sender for the receiver that we feed.

    A sender that feeds another receiver of the vehicle does not matter.
    """

    def __init__(self, settings: AidingSettings) -> None:
        self._gps_id = settings.gps_id
        self._stand_down_s = settings.stand_down_s
        self._others: dict[int, _Other] = {}

    def forget(self, sysid: int) -> None:
        """Forget who else feeds a vehicle."""
        self._others.pop(sysid, None)

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
        """Return the notice that is due about another sender of GPS_INPUT to a vehicle.

        One is due when the sender is heard first, and one when it has been silent for `stand_down_s`.
        """
        other = self._others.get(sysid)
        if other is None:
            return []
        if now_s - other.heard_at_s > self._stand_down_s:
            del self._others[sysid]
            return [Notice(now_s, sysid, "info", f"nobody else has sent it GPS_INPUT for {self._stand_down_s:g} s")]
        if other.reported:
            return []
        other.reported = True
        inhibit = Inhibit(InhibitReason.FOREIGN_GPS_INPUT, other.sender, self._gps_id)
        return [Notice(now_s, sysid, "error", f"{inhibit.text}: ours stands down")]

    def inhibit(self, sysid: int) -> Inhibit | None:
        """Return why a vehicle is not aided; None where nobody else feeds it."""
        other = self._others.get(sysid)
        return Inhibit(InhibitReason.FOREIGN_GPS_INPUT, other.sender, self._gps_id) if other is not None else None


_HEARTBEAT_WITHIN_S = 3.0  # autopilots send one each second
_AUTO_SWITCH = "GPS_AUTO_SWITCH"
_STAYS_WITH_ITS_OWN = (0.0, 4.0)  # the primary receiver only; the primary one while it has a 3D fix


class Standby:
    """Which healthy vehicles may be streamed their own estimate (standby).

    They then arm with the receiver that we feed, and fail over to it without a gap.

    Standby is safe only while the autopilot stays with its own receiver. One that may change over to ours would report our
    estimate as its own position, and the estimate would then confirm itself. So the parameters of the vehicle are read first.
    """

    def __init__(self, gps_id: int, parameters: Parameters) -> None:
        self._gps_id = gps_id
        self._parameters = parameters
        self._obstacles: dict[int, Inhibit] = {}

    def forget(self, sysid: int) -> None:
        """Forget why a vehicle got no stream."""
        self._obstacles.pop(sysid, None)

    def review(self, sysid: int, now_s: float) -> tuple[Inhibit | None, list[Notice]]:
        """Return why a vehicle gets no stream on standby, and the notice of that.

        None where it may have one. The notice comes once for each reason.
        """
        for name in (_AUTO_SWITCH, GPS_PRIMARY):
            self._parameters.request(sysid, name, now_s)
        obstacle, before = self._obstacle(sysid), self._obstacles.pop(sysid, None)
        if obstacle is None:
            return None, []
        self._obstacles[sysid] = obstacle
        if obstacle == before or obstacle.reason is InhibitReason.STANDBY_UNKNOWN:
            return obstacle, []
        return obstacle, [Notice(now_s, sysid, "warning", f"no standby: {obstacle.text}")]

    def obstacle(self, sysid: int) -> Inhibit | None:
        """Return why a vehicle got no stream on standby at its last review; None where it might."""
        return self._obstacles.get(sysid)

    def _obstacle(self, sysid: int) -> Inhibit | None:
        switching, primary = (self._parameters.value(sysid, name) for name in (_AUTO_SWITCH, GPS_PRIMARY))
        if switching is None or primary is None:
            return Inhibit(InhibitReason.STANDBY_UNKNOWN)
        if primary == self._gps_id:
            return Inhibit(InhibitReason.STANDBY_OURS_FIRST, primary)
        return Inhibit(InhibitReason.STANDBY_MAY_SWITCH, switching) if switching not in _STAYS_WITH_ITS_OWN else None


class InhibitAlarms:
    """The alarms that a vehicle needs aiding and cannot have it, one for each reason.

    A service that takes over raises them again.
    """

    def __init__(self) -> None:
        self._reported: dict[int, Inhibit | None] = {}

    def forget(self, sysid: int) -> None:
        """Forget what was told of a vehicle."""
        self._reported.pop(sysid, None)

    def restart(self) -> None:
        """Tell again what holds."""
        self._reported.clear()

    def review(
        self, vehicle: ReportedState, inhibit: Inhibit | None, now_s: float, *, needs_aid: bool, is_held_back: bool
    ) -> list[Notice]:
        """Return the alarm that is due.

        A vehicle is given the time for its heartbeat, and to tell its parameters.

        `is_held_back`: the other service of a hot standby sends, and may be able to.
        """
        sysid, before = vehicle.sysid, self._reported.get(vehicle.sysid)
        is_new = inhibit is not None and inhibit.reason is InhibitReason.NO_HEARTBEAT
        is_new = is_new and now_s - vehicle.first_heard_s < _HEARTBEAT_WITHIN_S
        is_asked = inhibit is not None and inhibit.reason is InhibitReason.PX4_METHOD_UNKNOWN
        if not needs_aid:
            self._reported.pop(sysid, None)
        elif inhibit != before and not is_new and not is_asked:
            self._reported[sysid] = inhibit
            if inhibit is not None and is_held_back:
                return [Notice(now_s, sysid, "warning", f"needs aid, and this service could not aid it: {inhibit.text}")]
            if inhibit is not None:
                return [Notice(now_s, sysid, "error", f"needs aid and cannot be aided: {inhibit.text}")]
        return []
