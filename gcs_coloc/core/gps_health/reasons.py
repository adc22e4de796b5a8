"""Why the service holds a vehicle's GPS to be as it is: reasons with their numbers, worded here alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum


class GpsReason(Enum):
    """What speaks for a state of GPS health."""

    # Faults, the worst first
    DUPLICATE_ID = "duplicate_id"
    NO_FIX = "no_fix"
    FEW_SATELLITES = "few_satellites"
    POOR_ACCURACY = "poor_accuracy"
    FROZEN = "frozen"
    SILENT = "silent"
    CONTRADICTED_BY_RANGES = "contradicted_by_ranges"
    IMPLAUSIBLE_MOTION = "implausible_motion"
    OFF_ITS_RECEIVER = "off_its_receiver"
    SYSTEM_UNHEALTHY = "system_unhealthy"
    EKF_GLITCH = "ekf_glitch"
    EKF_NOT_ABSOLUTE = "ekf_not_absolute"

    # No faults
    NOTHING_HEARD = "nothing_heard"
    OVERRIDDEN = "overridden"
    FIX = "fix"
    RETURNED = "returned"
    RETURNED_UNTESTED = "returned_untested"
    RECOVERED_UNTESTED = "recovered_untested"


# `{value}` is what was found, `{limit}` what is allowed, `{detail}` words from elsewhere.
_WORDING: Mapping[GpsReason, str] = {
    GpsReason.DUPLICATE_ID: "two autopilots use its system id; give each its own",
    GpsReason.NO_FIX: "no 3D fix: fix type {value:.0f}",
    GpsReason.FEW_SATELLITES: "only {value:.0f} satellites",
    GpsReason.POOR_ACCURACY: "horizontal accuracy {value:.0f} m is worse than {limit:g} m",
    GpsReason.FROZEN: "its receiver repeats one position while the vehicle moved {value:.0f} m",
    GpsReason.SILENT: "no GPS_RAW_INT for more than {limit:g} s",
    GpsReason.CONTRADICTED_BY_RANGES: "{detail}",
    GpsReason.IMPLAUSIBLE_MOTION: "its position moved {value:.0f} m other than its velocity within {limit:g} s",
    GpsReason.OFF_ITS_RECEIVER: "the position that it reports is {value:.0f} m off its own receiver's",
    GpsReason.SYSTEM_UNHEALTHY: "SYS_STATUS: GPS not healthy",
    GpsReason.EKF_GLITCH: "the autopilot's EKF reports a GPS glitch",
    GpsReason.EKF_NOT_ABSOLUTE: "the autopilot's EKF has no absolute position",
    GpsReason.NOTHING_HEARD: "nothing heard from its GPS receiver yet",
    GpsReason.OVERRIDDEN: "declared {detail} by the operator",
    GpsReason.FIX: "{detail}",
    GpsReason.RETURNED: "{detail}: back, watched for {limit:g} s",
    GpsReason.RETURNED_UNTESTED: "{detail}: back, watched for {limit:g} s; nothing to hold it against",
    GpsReason.RECOVERED_UNTESTED: "{detail}; nothing to hold it against",
}


@dataclass(frozen=True, slots=True)
class StatedGpsReason:
    """A reason with its numbers: what was found, the limit for it, and words from elsewhere."""

    reason: GpsReason
    value: float = 0.0
    limit: float = 0.0
    detail: str = ""

    @property
    def text(self) -> str:
        """The reason in words."""
        return _WORDING[self.reason].format(value=self.value, limit=self.limit, detail=self.detail)
