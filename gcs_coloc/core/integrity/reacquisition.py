"""GNSS reacquisition monitor: a receiver that is back is tested against ranges and estimate before it is believed again.

Spoofing often follows jamming: the fix that comes back is then another place's. While a vehicle recovers, `fix_check` tests its
receiver in every review. The monitor has its own residual buffer and epochs, so that its findings concern no other vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.integrity.epoch import EpochHistory
from gcs_coloc.core.integrity.fix_check import FixCheck, FixConsistency, check_fix, star
from gcs_coloc.core.integrity.range_consistency import ConsistencySettings
from gcs_coloc.core.integrity.range_residuals import RangeResidualBuffer, TrackPoint
from gcs_coloc.core.integrity.report import (
    FaultReason,
    IntegrityReport,
    PositionFault,
    ReacquisitionStatus,
    ReviewedVehicle,
)
from gcs_coloc.core.measurements import Estimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.core.residual_log import CONSISTENT_MEDIAN_NIS

_CONTRADICTS = (FixConsistency.AGAINST_RANGES, FixConsistency.AGAINST_ESTIMATE)
_OLDEST_FIX_S = 1.0  # of a receiver at 1 Hz
_CONFIRM_S = 1.0  # chosen: a finding counts after five reviews in a row
_EPOCHS_FILLED_AFTER_S = 3.0  # an epoch needs 1.6 s of ranges; chosen: twice that, for lost messages
_RESET_EVERY_S = 10.0  # chosen: an estimator needs some seconds of ranges after a reset
_WELL_KNOWN_SHARE = 0.25  # of the offset; chosen: four sigmas tell it from none


@dataclass(slots=True)
class _Reacquisition:
    """The findings about one receiver since it is back.

    `wrong` is the confirmed finding, `offset_m` the size of the contradiction, `was_ranged`: ranges were among what contradicted.
    """

    began_s: float
    finding: FixConsistency = FixConsistency.NOTHING
    wrong: bool = False
    was_ranged: bool = False
    offset_m: float = 0.0
    changed_since_s: float | None = None
    diverged_since_s: float | None = None
    reset_at_s: float = float("-inf")

    def add(self, check: FixCheck, now_s: float) -> bool:
        """Add one finding; True where it confirms just now that the receiver is wrong."""
        contradicts = check.finding in _CONTRADICTS
        # A reference less certain than the offset agrees with anything, unless no ranges are there to make it better.
        inconclusive = self.wrong and self.was_ranged and check.known_m > _WELL_KNOWN_SHARE * self.offset_m
        self.was_ranged = (self.was_ranged and (self.wrong or contradicts)) or (contradicts and check.ranged)
        self.finding = check.finding
        if contradicts and check.offset_m is not None:
            self.offset_m = check.offset_m
        if contradicts == self.wrong or inconclusive:
            self.changed_since_s = None
            return False
        if self.changed_since_s is None:
            self.changed_since_s = now_s
        if now_s - self.changed_since_s < _CONFIRM_S:
            return False
        self.wrong, self.changed_since_s = contradicts, None
        return self.wrong

    def has_diverged(self, check: FixCheck, now_s: float) -> bool:
        """Whether the estimate must be initialised again: the ranges have fitted the receiver, and not it, for a while."""
        if check.finding is not FixConsistency.ESTIMATE_OFF:
            self.diverged_since_s = None
            return False
        if self.diverged_since_s is None:
            self.diverged_since_s = now_s
        if now_s - self.diverged_since_s < _CONFIRM_S or now_s - self.reset_at_s < _RESET_EVERY_S:
            return False
        self.reset_at_s = now_s
        return True

    def status(self, now_s: float) -> ReacquisitionStatus:
        if self.finding in _CONTRADICTS:
            return ReacquisitionStatus.CONTRADICTED
        if self.finding is not FixConsistency.NOTHING:
            return ReacquisitionStatus.CONSISTENT
        has_waited = now_s - self.began_s >= _EPOCHS_FILLED_AFTER_S
        return ReacquisitionStatus.UNTESTED if has_waited else ReacquisitionStatus.PENDING


class ReacquisitionMonitor:
    """The receivers of one fleet that are back."""

    def __init__(self, settings: ConsistencySettings) -> None:
        self._settings = settings
        self._rejected_fixes = 0
        self._receivers: dict[int, _Reacquisition] = {}
        self._clear()

    def add_range(self, measurement: RangeMeasurement) -> None:
        """Add a range between two vehicles."""
        if self._receivers:
            self._residuals.add_range(measurement)

    def review(self, now_s: float, vehicles: Sequence[ReviewedVehicle]) -> IntegrityReport:
        """Test the fixes of the receivers that are back, against estimates with their solution separation."""
        back = {v.sysid: (v, fix) for v in vehicles if (fix := self._fix(v, now_s)) is not None}
        if not back:
            if self._receivers:
                self._receivers = {}
                self._clear()
            return IntegrityReport(rejected_fixes=self._rejected_fixes)
        self._receivers = {sysid: self._receivers.get(sysid) or _Reacquisition(now_s) for sysid in back}
        peers = {v.sysid: v.reported for v in vehicles if v.is_trusted and v.reported is not None}
        for position in (*peers.values(), *(fix for _, fix in back.values())):
            self._add_position(position)
        epoch = self._residuals.epoch(now_s)
        pasts = self._epochs.pasts(epoch.at_s)
        self._epochs.append(epoch)
        diverged = set()
        for sysid, (vehicle, fix) in back.items():
            estimate = vehicle.estimate if vehicle.estimate is not None and _is_reference(vehicle.estimate, vehicle) else None
            own = {interval_s: (star(then, sysid, peers) if then else None, c) for interval_s, (then, c) in pasts.items()}
            check = check_fix(fix, estimate, star(epoch, sysid, peers), own, self._settings.levels)
            receiver = self._receivers[sysid]
            self._rejected_fixes += receiver.add(check, now_s)
            if receiver.has_diverged(check, now_s):
                diverged.add(sysid)
        return IntegrityReport(
            faults={
                sysid: PositionFault(FaultReason.REACQUIRED_ELSEWHERE, receiver.offset_m)
                for sysid, receiver in self._receivers.items()
                if receiver.wrong
            },
            reacquisitions={sysid: receiver.status(now_s) for sysid, receiver in self._receivers.items()},
            diverged=frozenset(diverged),
            rejected_fixes=self._rejected_fixes,
        )

    def _fix(self, vehicle: ReviewedVehicle, now_s: float) -> PositionMeasurement | None:
        """The fix of a receiver that is back: of a recovering vehicle, or of one that failed because it was found wrong."""
        fix, receiver = vehicle.receiver_fix, self._receivers.get(vehicle.sysid)
        was_wrong = receiver is not None and receiver.wrong and vehicle.gps_state is GpsState.FAILED
        if fix is None or not vehicle.is_automatic or not (was_wrong or vehicle.gps_state is GpsState.RECOVERING):
            return None
        return fix if now_s - fix.arrived_at_s <= _OLDEST_FIX_S else None

    def _add_position(self, reported: PositionMeasurement) -> None:
        if reported.velocity_enu_mps is None:
            return
        position, velocity = reported.position_enu_m, reported.velocity_enu_mps
        track = TrackPoint(reported.measured_at_s, position, velocity, reported.sigma_h_m, reported.sigma_v_m, no_prior=False)
        self._residuals.add_position(reported.vehicle, track)

    def _clear(self) -> None:
        s = self._settings
        self._residuals = RangeResidualBuffer(s.residuals)
        self._epochs = EpochHistory(s.intervals_s, s.correlation_time_s, s.period_s)


def _is_reference(estimate: Estimate, vehicle: ReviewedVehicle) -> bool:
    """Whether an estimate comes from ranges that agree with it."""
    agrees = vehicle.median_nis is None or vehicle.median_nis <= CONSISTENT_MEDIAN_NIS
    return estimate.ranges_in_use > 0 and vehicle.range_jump_m is None and agrees
