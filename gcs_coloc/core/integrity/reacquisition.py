"""GNSS reacquisition monitor: a receiver that is back is tested against ranges and estimate before it is believed again.

Spoofing often follows jamming: the fix that comes back is then another place's. While a vehicle recovers, `check_fix` tests its
receiver in every review. The monitor has its own residual buffer and epochs, so that its findings concern no other vehicle.

The ranges between the vehicle and trusted peers are adjusted with the fix as the vehicle's prior (`adjustment`). What is left
over is explained by a fault of that fix, of a peer's position, of a pair or of a device (`fault_tests`). Either reference may
be wrong itself. An estimate may be a reflection, biased by ranges, or uncertain: it counts with its covariance, and not against
ranges that fit the fix and would not fit if the fix were off by that much.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from math import hypot, inf, sqrt

import numpy as np

from gcs_coloc.core.error_ellipse import eigenvalue_mean_and_radius, horizontal_sigma_m
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.integrity.adjustment import Adjustment, adjust
from gcs_coloc.core.integrity.epoch import MIN_INFORMATION_PER_M2, Epoch, EpochHistory, Past
from gcs_coloc.core.integrity.fault_tests import SignificanceLevels, chi2_limit, run_test
from gcs_coloc.core.integrity.isolation import isolate
from gcs_coloc.core.integrity.range_consistency import ConsistencySettings
from gcs_coloc.core.integrity.range_residuals import RangeResidualBuffer, TrackPoint
from gcs_coloc.core.integrity.report import (
    FaultReason,
    IntegrityReport,
    PositionFault,
    ReacquisitionStatus,
    ReviewedVehicle,
)
from gcs_coloc.core.measurements import Estimate, FloatArray, PositionMeasurement, RangeMeasurement
from gcs_coloc.core.residual_log import CONSISTENT_MEDIAN_NIS

_OLDEST_FIX_S = 1.0  # of a receiver at 1 Hz
_CONFIRM_S = 1.0  # chosen: a finding counts after five reviews in a row
_EPOCHS_FILLED_AFTER_S = 3.0  # an epoch needs 1.6 s of ranges; chosen: twice that, for lost messages
_RESET_EVERY_S = 10.0  # chosen: an estimator needs some seconds of ranges after a reset
_WELL_KNOWN_SHARE = 0.25  # of the offset; chosen: four sigmas tell it from none
_SIGNIFICANCE = 1e-6  # probability that a right fix and a true covariance differ by more
# Noncentrality at which a chi-square with 2 degrees of freedom passes its limit at 1e-3 (13.8) in all but one test of a thousand.
_DETECTABLE_NONCENTRALITY = 50.0
_MIN_RANGES = 2  # with one range half of an estimate is prediction, which has been found off and certain


class FixConsistency(Enum):
    """Result of the check."""

    NOTHING = "nothing to test it against"
    AGREES = "consistent, as far as can be tested"
    AGAINST_RANGES = "the ranges contradict it, and no other fault explains them"
    AGAINST_ESTIMATE = "the estimate contradicts it, and the ranges do not support it"
    UNRESOLVED = "the ranges contradict it or something else"
    ESTIMATE_OFF = "the ranges fit it and not the estimate"


@dataclass(frozen=True, slots=True)
class FixCheck:
    """A finding, and the horizontal distance of the fix from where ranges put the vehicle (m), None where that is unknown.

    `known_m`: horizontal 1-sigma of the best reference that agrees with the fix, m; infinity where there is none.
    `ranged`: there were ranges to test it against. `fits_now`: the ranges of the present epoch alone fit it.
    """

    finding: FixConsistency
    offset_m: float | None
    known_m: float
    ranged: bool
    fits_now: bool


_CONTRADICTS = (FixConsistency.AGAINST_RANGES, FixConsistency.AGAINST_ESTIMATE)


@dataclass(slots=True)
class _Reacquisition:
    """The findings about one receiver since it is back.

    `wrong` is the confirmed finding, `offset_m` the size of the contradiction, `was_ranged`: ranges were among what contradicted.
    `off_at_s`: the last epoch whose ranges did not fit it. Later epochs are not compared with those up to it: a receiver that has
    come to be right is not at fault.
    """

    began_s: float
    off_at_s: float = float("-inf")
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
            # The window of the ranges ends later than the fault: then the distance is nearly none any more.
            self.offset_m = max(self.offset_m, check.offset_m) if self.wrong else check.offset_m
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
        if self.finding in _CONTRADICTS or self.finding is FixConsistency.UNRESOLVED:
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
            receiver = self._receivers[sysid]
            own = {
                interval_s: (star(then, sysid, peers) if then else None, c)
                for interval_s, (then, c) in pasts.items()
                if then is None or then.at_s > receiver.off_at_s
            }
            check = check_fix(fix, estimate, star(epoch, sysid, peers), own, self._settings.levels)
            if check.ranged and not check.fits_now:
                receiver.off_at_s = epoch.at_s
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
        """The fix of a receiver that is back, or of one that failed because it was found wrong."""
        fix, receiver = vehicle.receiver_fix, self._receivers.get(vehicle.sysid)
        was_wrong = receiver is not None and receiver.wrong and vehicle.gps_state is GpsState.FAILED
        if fix is None or not vehicle.is_automatic or not (was_wrong or vehicle.is_returning):
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


def check_fix(
    fix: PositionMeasurement, estimate: Estimate | None, epoch: Epoch, pasts: Mapping[float, Past], levels: SignificanceLevels
) -> FixCheck:
    """Test a fix against both references.

    Args:
        fix: the receiver's position.
        estimate: the vehicle's position from ranges, near the fix in time; None where it is no fit reference.
        epoch: the vehicle with the fix as its prior, and its residuals to trusted peers: its `star`.
        pasts: the earlier epochs to compare it with, by interval; none for 0.
        levels: significance levels of the tests.
    """
    difference_m = _difference_m(fix, estimate) if estimate is not None else None
    offset_m = float(np.hypot(*difference_m)) if difference_m is not None else None
    fits = adjust(epoch, list(pasts.values())) if epoch.residuals else []
    results = [run_test(fit, levels) if fit.residuals else None for fit in fits]
    unresolved = False
    fitting = bool(fits) and results[0] is not None and _agrees(fits[0], fix.vehicle, levels)
    for number, (result, past) in enumerate(zip(results, pasts.values(), strict=False)):
        if result is None or result.is_consistent:
            continue
        isolation = isolate(epoch, past, levels, troubled=(fix.vehicle,))
        is_possible = fix.vehicle in (isolation.possible if isolation.plausible else result.suspects)
        if number == 0:
            fitting = not is_possible
        size_m = isolation.isolated.get(fix.vehicle)
        if size_m is not None:
            return FixCheck(
                FixConsistency.AGAINST_RANGES, offset_m if offset_m is not None else size_m, inf, ranged=True, fits_now=fitting
            )
        unresolved |= is_possible
    information = fits[0].position_information(fix.vehicle) if fitting else np.zeros((2, 2))
    known_m = 1.0 / sqrt(max(_least_information_per_m2(information), MIN_INFORMATION_PER_M2))
    if estimate is not None and difference_m is not None and _is_significant(difference_m, fix, estimate):
        if float(difference_m @ information @ difference_m) >= _DETECTABLE_NONCENTRALITY:
            return FixCheck(FixConsistency.ESTIMATE_OFF, offset_m, known_m, ranged=True, fits_now=fitting)
        if (fits and not fitting) or estimate.ranges_in_use >= _MIN_RANGES:
            return FixCheck(FixConsistency.AGAINST_ESTIMATE, offset_m, inf, ranged=bool(fits), fits_now=fitting)
        return FixCheck(
            FixConsistency.UNRESOLVED if unresolved else FixConsistency.AGREES, offset_m, inf, ranged=bool(fits), fits_now=fitting
        )
    if unresolved:
        return FixCheck(FixConsistency.UNRESOLVED, offset_m, inf, ranged=True, fits_now=fitting)
    if estimate is not None:
        known_m = min(known_m, horizontal_sigma_m(estimate.covariance))
    finding = FixConsistency.NOTHING if estimate is None and not fits else FixConsistency.AGREES
    return FixCheck(finding, offset_m, known_m, ranged=bool(fits), fits_now=fitting)


def star(epoch: Epoch, vehicle: int, peers: Container[int]) -> Epoch:
    """The part of an epoch with the residuals between one vehicle and some peers."""
    residuals = tuple(r for r in epoch.residuals for end, other in (r.pair, r.pair[::-1]) if end == vehicle and other in peers)
    return Epoch(epoch.at_s, {end: epoch.priors[end] for residual in residuals for end in residual.pair}, residuals)


def _difference_m(fix: PositionMeasurement, estimate: Estimate) -> FloatArray:
    """Fix minus estimate (2,), at the time of the fix."""
    at_fix = estimate.position_enu_m[:2] - estimate.velocity_enu_mps[:2] * (estimate.at_s - fix.measured_at_s)
    return np.asarray(np.array(fix.position_enu_m[:2]) - at_fix)


def _least_information_per_m2(information: FloatArray) -> float:
    """Information along the worst direction: the smaller eigenvalue."""
    mean, radius = eigenvalue_mean_and_radius(information.item(0), information.item(1), information.item(3), hypot)
    return mean - radius


def _is_significant(difference_m: FloatArray, fix: PositionMeasurement, estimate: Estimate) -> bool:
    """Whether d' (P + sigma^2 I)^-1 d exceeds its chi-square limit with 2 degrees of freedom."""
    covariance = estimate.covariance[:2, :2] + fix.sigma_h_m**2 * np.eye(2)
    return float(difference_m @ np.linalg.solve(covariance, difference_m)) > chi2_limit(2, _SIGNIFICANCE)


def _agrees(fit: Adjustment, vehicle: int, levels: SignificanceLevels) -> bool:
    """Whether the ranges fit the vehicle's position, where nothing else contradicts them."""
    gain, rank = fit.position_gain(vehicle)
    return not rank or gain <= chi2_limit(rank, levels.rest)
