"""Why a vehicle is not aided, or is sent no fix: reasons to branch on, worded here alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum


class InhibitReason(Enum):
    """Why a vehicle cannot be aided, or may not be sent a fix."""

    # Nothing is sent
    NO_ROUTE = "no_route"
    NO_HEARTBEAT = "no_heartbeat"
    DUPLICATE_ID = "duplicate_id"
    HOST_CLOCK = "host_clock"
    UNKNOWN_AUTOPILOT = "unknown_autopilot"
    PX4_IGNORES_GPS_INPUT = "px4_ignores_gps_input"
    ARDUPILOT_IGNORES_POSITION_SENSOR = "ardupilot_ignores_position_sensor"
    FOREIGN_GPS_INPUT = "foreign_gps_input"

    # No fix is claimed
    NOT_SENT_YET = "not_sent_yet"
    NO_ESTIMATE = "no_estimate"
    BEYOND_ALERT_LIMIT = "beyond_alert_limit"
    PREDICTION_ALONE = "prediction_alone"
    UNDETERMINED = "undetermined"
    RANGES_INCONSISTENT = "ranges_misfit"
    RANGES_JUMPED = "ranges_jumped"
    REGAINING = "regaining"


# `{value}` is what was found, `{limit}` what is allowed, `{detail}` words from elsewhere.
_WORDING: Mapping[InhibitReason, str] = {
    InhibitReason.NO_ROUTE: "{detail}",
    InhibitReason.NO_HEARTBEAT: "no heartbeat of an autopilot heard yet",
    InhibitReason.DUPLICATE_ID: "two autopilots use its system id; give each its own",
    InhibitReason.HOST_CLOCK: "{detail}",
    InhibitReason.UNKNOWN_AUTOPILOT: "its autopilot is neither ArduPilot nor PX4: set its aiding method where you have tried one",
    InhibitReason.PX4_IGNORES_GPS_INPUT: "PX4 does not take GPS_INPUT: set its aiding method to auto",
    InhibitReason.ARDUPILOT_IGNORES_POSITION_SENSOR: "ArduPilot does not take GLOBAL_POSITION_SENSOR: set its method to auto",
    InhibitReason.FOREIGN_GPS_INPUT: "system {value:.0f} sends it GPS_INPUT for receiver {limit:.0f}",
    InhibitReason.NOT_SENT_YET: "not sent yet",
    InhibitReason.NO_ESTIMATE: "{detail}",
    InhibitReason.BEYOND_ALERT_LIMIT: "95 % horizontal bound {value:.0f} m is beyond the alert limit of {limit:g} m",
    InhibitReason.PREDICTION_ALONE: "no range has been in use for {limit:g} s: prediction alone",
    InhibitReason.UNDETERMINED: "its ranges, to one peer or along one line, have not fixed its place for {limit:g} s",
    InhibitReason.RANGES_INCONSISTENT: "half of its ranges are {value:.1f} sigma or more off where it is held to be",
    InhibitReason.RANGES_JUMPED: "all of its ranges jumped by {value:.0f} m",
    InhibitReason.REGAINING: "good enough again, watched for {limit:g} s",
}


@dataclass(frozen=True, slots=True)
class Inhibit:
    """A reason with its numbers: what was found, the limit for it, and words from elsewhere."""

    reason: InhibitReason
    value: float = 0.0
    limit: float = 0.0
    detail: str = ""

    @property
    def text(self) -> str:
        """The reason in words."""
        return _WORDING[self.reason].format(value=self.value, limit=self.limit, detail=self.detail)
