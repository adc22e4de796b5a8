"""Evidence for the GPS health of a vehicle: what its autopilot and receiver say, and what the service finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeGuard

from gcs_coloc.core.gps_health.reasons import GpsReason
from gcs_coloc.core.messages.control import GpsOverride
from gcs_coloc.core.messages.inbound import EkfStatus, GpsReceiver, Interference, ReceiverIntegrity, SystemHealth

_INTEGRITY_FRESH_S = 5.0  # chosen: five periods of GNSS_INTEGRITY, which PX4 sends once a second


@dataclass(frozen=True, slots=True)
class RangeContradiction:
    """What the ranges say against a vehicle's GPS position, in words; `is_identified`: it, and nobody else, is at fault."""

    text: str
    is_identified: bool


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
    contradiction: RangeContradiction | None = None
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
    """Return what the receiver says against its fix. Jamming that it masters is no fault: the fix is as good as it states."""
    if not is_fresh(integrity, now_s):
        return None
    if integrity.spoofing is Interference.DETECTED:
        return GpsReason.SPOOFING_REPORTED
    if integrity.spoofing is Interference.MITIGATED:
        return GpsReason.SPOOFING_INDICATED
    if integrity.jamming is Interference.DETECTED:
        return GpsReason.JAMMING_REPORTED
    return GpsReason.RAIM_FAILED if integrity.raim_failed else None
