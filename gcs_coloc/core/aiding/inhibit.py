"""Inhibit reasons: why a vehicle is not aided, is sent no fix or gets no standby; worded here alone."""

from __future__ import annotations

from dataclasses import dataclass

from gcs_coloc.core.aiding.parameters import Parameters
from gcs_coloc.core.aiding.receiver_switch import GPS_PRIMARY
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
    BEYOND_ALERT_LIMIT = ("beyond_alert_limit", "protection level {value:.1f} m is beyond the alert limit of {limit:g} m")
    NO_PROTECTION_LEVEL = "no_protection_level", "its position has no protection level"
    UNTESTED = "untested", "its ranges cannot test {detail}, and require_fault_tests is set"
    PREDICTION_ALONE = "prediction_alone", "no range has been in use for {limit:g} s: prediction alone"
    UNDETERMINED = "undetermined", "its ranges, to one peer or along one line, have not fixed its place for {limit:g} s"
    RANGES_INCONSISTENT = "ranges_misfit", "half of its ranges are {value:.1f} sigma or more off where it is held to be"
    RANGES_JUMPED = "ranges_jumped", "all of its ranges jumped by {value:.0f} m"
    REGAINING = "regaining", "good enough again, watched for {limit:g} s"

    # No standby
    STANDBY_UNKNOWN = "standby_unknown", "it has not told its GPS_AUTO_SWITCH and GPS_PRIMARY yet"
    STANDBY_OURS_FIRST = "standby_ours_first", "GPS_PRIMARY={value:g} is our receiver: set it to its own"
    STANDBY_MAY_SWITCH = ("standby_may_switch", "GPS_AUTO_SWITCH={value:g} could leave its own receiver for ours: set it to 4")


Inhibit = StatedReason[InhibitReason]
"""Why a vehicle is not aided, with the numbers of it."""


_HEARTBEAT_WITHIN_S = 3.0  # autopilots send one each second
_AUTO_SWITCH = "GPS_AUTO_SWITCH"
_STAYS_WITH_ITS_OWN = (0.0, 4.0)  # the primary receiver only; the primary one while it has a 3D fix


@dataclass(slots=True)
class VehicleInhibits:
    """Why one vehicle is not aided or gets no standby, as its last reviews found and told it.

    `obstacle`: why it got no stream on standby. Standby is safe only while the autopilot stays with its own receiver. One that
    may change over to ours would report our estimate as its own position, and the estimate would then confirm itself.
    """

    obstacle: Inhibit | None = None
    _foreign: ForeignGpsInput | None = None
    _is_foreign_told: bool = False
    _alarm: Inhibit | None = None

    def add_foreign(self, message: ForeignGpsInput) -> None:
        """Add GPS_INPUT from another sender for the receiver that we feed."""
        self._foreign = message

    @property
    def foreign(self) -> Inhibit | None:
        """Why it is not aided while somebody else feeds it; None where nobody does."""
        other = self._foreign
        return Inhibit(InhibitReason.FOREIGN_GPS_INPUT, other.sysid, other.gps_id) if other is not None else None

    def review_foreign(self, sysid: int, stand_down_s: float, now_s: float) -> list[Notice]:
        """Return the notice that is due about another sender of GPS_INPUT.

        One is due when the sender is heard first, and one when it has been silent for `stand_down_s`.
        """
        if self._foreign is None:
            return []
        if now_s - self._foreign.received_at_s > stand_down_s:
            self._foreign, self._is_foreign_told = None, False
            return [Notice(now_s, sysid, "info", f"nobody else has sent it GPS_INPUT for {stand_down_s:g} s")]
        if self._is_foreign_told or self.foreign is None:
            return []
        self._is_foreign_told = True
        return [Notice(now_s, sysid, "error", f"{self.foreign.text}: ours stands down")]

    def review_standby(self, sysid: int, parameters: Parameters, gps_id: int, now_s: float) -> list[Notice]:
        """Review `obstacle` by the vehicle's parameters; return its notice, once for each reason."""
        for name in (_AUTO_SWITCH, GPS_PRIMARY):
            parameters.request(sysid, name, now_s)
        before, self.obstacle = self.obstacle, _standby_obstacle(sysid, parameters, gps_id)
        if self.obstacle in (None, before) or self.obstacle.reason is InhibitReason.STANDBY_UNKNOWN:
            return []
        return [Notice(now_s, sysid, "warning", f"no standby: {self.obstacle.text}")]

    def restart_alarm(self) -> None:
        """Raise the alarm again where it still holds."""
        self._alarm = None

    def review_alarm(
        self, vehicle: ReportedState, inhibit: Inhibit | None, now_s: float, *, needs_aid: bool, is_held_back: bool
    ) -> list[Notice]:
        """Return the alarm that is due: the vehicle needs aiding and cannot have it, once for each reason.

        A vehicle is given the time for its heartbeat, and to tell its parameters.

        `is_held_back`: the other service of a hot standby sends, and may be able to.
        """
        if not needs_aid:
            self._alarm = None
            return []
        if inhibit is not None and (
            inhibit.reason is InhibitReason.PX4_METHOD_UNKNOWN
            or (inhibit.reason is InhibitReason.NO_HEARTBEAT and now_s - vehicle.first_heard_s < _HEARTBEAT_WITHIN_S)
        ):
            return []
        before, self._alarm = self._alarm, inhibit
        if inhibit is None or inhibit == before:
            return []
        if is_held_back:
            return [Notice(now_s, vehicle.sysid, "warning", f"needs aid, and this service could not aid it: {inhibit.text}")]
        return [Notice(now_s, vehicle.sysid, "error", f"needs aid and cannot be aided: {inhibit.text}")]


def _standby_obstacle(sysid: int, parameters: Parameters, gps_id: int) -> Inhibit | None:
    switching, primary = (parameters.value(sysid, name) for name in (_AUTO_SWITCH, GPS_PRIMARY))
    if switching is None or primary is None:
        return Inhibit(InhibitReason.STANDBY_UNKNOWN)
    if primary == gps_id:
        return Inhibit(InhibitReason.STANDBY_OURS_FIRST, primary)
    return Inhibit(InhibitReason.STANDBY_MAY_SWITCH, switching) if switching not in _STAYS_WITH_ITS_OWN else None
