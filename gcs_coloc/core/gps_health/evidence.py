"""The evidence for the GPS health of a vehicle: what it reports, and what the service finds."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TypeGuard

from gcs_coloc.core.messages.control import GpsOverride
from gcs_coloc.core.messages.inbound import EkfStatus, GpsReceiver, Interference, ReceiverIntegrity, SystemHealth
from gcs_coloc.core.reasons import DUPLICATE_ID_WORDING, WordedReason
from gcs_coloc.core.stations.node_id import node_name

_INTEGRITY_FRESH_S = 5.0  # chosen: five periods of GNSS_INTEGRITY, which PX4 sends once a second


class GpsReason(WordedReason):
    """What speaks for a state of GPS health, worded here alone."""

    # Faults, the worst first
    DUPLICATE_ID = "duplicate_id", DUPLICATE_ID_WORDING
    NO_FIX = "no_fix", "no 3D fix: fix type {value:.0f}"
    FEW_SATELLITES = "few_satellites", "only {value:.0f} satellites"
    POOR_ACCURACY = "poor_accuracy", "horizontal accuracy {value:.0f} m is worse than {limit:g} m"
    FROZEN = "frozen", "its receiver repeats one position while the vehicle moved {value:.0f} m"
    SPOOFING_REPORTED = "spoofing_reported", "its receiver reports spoofing"
    SPOOFING_INDICATED = "spoofing_indicated", "its receiver reports signs of spoofing"
    JAMMING_REPORTED = "jamming_reported", "its receiver reports jamming"
    RAIM_FAILED = "raim_failed", "its receiver's own integrity test (RAIM) failed"
    SILENT = "silent", "no GPS_RAW_INT for more than {limit:g} s"
    CONTRADICTED_BY_RANGES = "contradicted_by_ranges", "{detail}"
    IMPLAUSIBLE_MOTION = "implausible_motion", "its position moved {value:.0f} m other than its velocity within {limit:g} s"
    OFF_ITS_RECEIVER = "off_its_receiver", "the position that it reports is {value:.0f} m off its own receiver's"
    SYSTEM_UNHEALTHY = "system_unhealthy", "SYS_STATUS: GPS not healthy"
    EKF_GLITCH = "ekf_glitch", "the autopilot's EKF reports a GPS glitch"
    EKF_NOT_ABSOLUTE = "ekf_not_absolute", "the autopilot's EKF has no absolute position"

    # No faults
    NOTHING_HEARD = "nothing_heard", "nothing heard from its GPS receiver yet"
    OVERRIDDEN = "overridden", "declared {detail} by the operator"
    FIX = "fix", "{detail}"
    RETURNING = "returning", "{detail}: back, not for {limit:g} s without a break yet"
    RETURNED = "returned", "{detail}: back, watched for {limit:g} s"
    RETURNED_UNTESTED = "returned_untested", "{detail}: back, watched for {limit:g} s; nothing to hold it against"
    RETURN_CONTRADICTED = "return_contradicted", "{detail}: back, but ranges to it do not fit"
    RECOVERED_UNTESTED = "recovered_untested", "{detail}; nothing to hold it against"


class FaultReason(Enum):
    """Why a vehicle's GPS position is not believed; the value is the wording for people."""

    CONTRADICTS_RANGES = "its GPS position contradicts the ranges to {others} by {size_m:.0f} m"
    NOT_ISOLATED = "GPS positions and ranges contradict each other; the fault is in it or in {others}"
    REACQUIRED_ELSEWHERE = "its GPS is back but {size_m:.0f} m from where the ranges put it"


@dataclass(frozen=True, slots=True)
class PositionFault:
    """A fault of a vehicle's reported position.

    `size_m` is its size in m. `others` are the vehicles whose ranges show it, or that may have it too.
    """

    reason: FaultReason
    size_m: float = 0.0
    others: tuple[int, ...] = ()

    @property
    def is_identified(self) -> bool:
        """Whether the fault is isolated to this vehicle, and not only detected."""
        return self.reason is not FaultReason.NOT_ISOLATED

    @property
    def text(self) -> str:
        """The fault in words."""
        return self.reason.value.format(others=", ".join(map(node_name, self.others)) or "its ranges", size_m=self.size_m)


@dataclass(frozen=True, slots=True)
class GpsEvidence:
    """All that speaks for or against a vehicle's GPS now, besides the motion and receiver checks.

    `receiver`, `integrity`, `system`, `ekf`: the newest messages of its own receiver, SYS_STATUS and EKF flags.
    `contradiction`: what the last integrity review found. `is_return_contradicted`: its receiver is back, but contradicted at the
    moment; `is_return_untested`: there is nothing to test it against. `is_aided`: it may fly on our fix, so that its own reports
    are an echo. `host_lag_s`: by how much the service runs late: so long a silence is its own, as a contradiction may be from
    HOST_LATE_S on.
    """

    receiver: GpsReceiver | None = None
    integrity: ReceiverIntegrity | None = None
    system: SystemHealth | None = None
    ekf: EkfStatus | None = None
    contradiction: PositionFault | None = None
    is_return_contradicted: bool = False
    is_return_untested: bool = False
    is_aided: bool = False
    has_duplicate_id: bool = False
    host_lag_s: float = 0.0
    override: GpsOverride = GpsOverride.AUTO


def is_fresh(integrity: ReceiverIntegrity | None, now_s: float) -> TypeGuard[ReceiverIntegrity]:
    """Return whether a report of the receiver's own integrity is young enough to count."""
    return integrity is not None and now_s - integrity.received_at_s <= _INTEGRITY_FRESH_S


def reported_interference(integrity: ReceiverIntegrity | None, now_s: float) -> GpsReason | None:
    """Return what the receiver reports against its fix; jamming that it mitigates is no fault."""
    if not is_fresh(integrity, now_s):
        return None
    if integrity.spoofing is Interference.DETECTED:
        return GpsReason.SPOOFING_REPORTED
    if integrity.spoofing is Interference.MITIGATED:
        return GpsReason.SPOOFING_INDICATED
    if integrity.jamming is Interference.DETECTED:
        return GpsReason.JAMMING_REPORTED
    return GpsReason.RAIM_FAILED if integrity.raim_failed else None
