"""GNSS reacquisition monitor: tests a receiver that is back before it is believed again.

Spoofing often follows jamming: the fix that comes back is then another place's. While a vehicle recovers, `check_fix` tests its
receiver in every review. The monitor has its own residual buffer and epochs, so that its findings concern no other vehicle.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from math import inf

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.gps_health.evidence import FaultReason, PositionFault
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, EpochHistory
from gcs_coloc.core.integrity.fix_check import FixCheck, FixConsistency, check_fix, fits_alone, star
from gcs_coloc.core.integrity.range_residuals import RangeResidualBuffer, TrackPoint
from gcs_coloc.core.integrity.report import IntegrityReport, ReacquisitionStatus, ReviewedVehicle
from gcs_coloc.core.measurements import PositionMeasurement, RangeMeasurement
from gcs_coloc.core.residual_log import CONSISTENT_MEDIAN_NIS

_OLDEST_FIX_S = 1.0  # chosen: of a receiver at 1 Hz; a turn at 1 g since an older one is off by more than receivers are
_SILENCE_S = 3.0
"""A receiver is remembered for so long after its last fix. Chosen: two fixes of a receiver at 1 Hz are late or lost."""
_CONFIRM_S = 1.0  # chosen: a finding counts after five reviews in a row
_EPOCHS_FILLED_AFTER_S = 3.0  # an epoch needs 1.6 s of ranges; chosen: twice that, for lost messages
_RESET_EVERY_S = 10.0  # chosen: an estimator needs some seconds of ranges after a reset
_WELL_KNOWN_SHARE = 0.25  # of the offset; chosen: four sigmas tell it from none
_AGREES_FOR_S = 3.2  # chosen: two epochs that share no range; one may fit by chance
_LONGEST_HELD_S = 60.0  # chosen: within a minute vehicles move so far that another direction is tested
_CONTRADICTS = (FixConsistency.AGAINST_RANGES, FixConsistency.AGAINST_ESTIMATE)


@dataclass(frozen=True, slots=True)
class _LocatedEvidence:
    """Since when and until when ranges to located vehicles without GPS contradict a receiver.

    A false position fits a range wherever it is off across it. So it is held against it for as long again as it was contradicted.
    """

    since_s: float = inf
    until_s: float = -inf

    def after(self, tested: Epoch, vehicle: int, now_s: float) -> _LocatedEvidence:
        """Return the evidence after an epoch of the vehicle and the located ones."""
        if fits_alone(tested, vehicle):
            return self
        return _LocatedEvidence(min(self.since_s, now_s), now_s)

    def is_open(self, now_s: float) -> bool:
        return now_s - self.until_s < min(self.until_s - self.since_s, _LONGEST_HELD_S)


@dataclass(slots=True)
class _Reacquisition:
    """The findings about one receiver since its tests began.

    `is_back`: it is tested because it has a fix again, and not because its vehicle reports trouble or was identified. `wrong` is
    the confirmed finding, `offset_m` the size of the contradiction, `was_ranged`: ranges were among what contradicted.
    `off_at_s`: the last epoch whose ranges did not fit it. Later epochs are not compared with those up to it: a receiver that has
    come to be right is not at fault. `disagreed_at_s`: the last time that something spoke
    against it. `peers` are those whose ranges tested it last. `known_since_s`: since when the ranges of witnesses alone fit it
    and know its place, in every direction, to a share of the contradiction.
    """

    began_s: float
    is_back: bool = True
    peers: tuple[int, ...] = ()
    off_at_s: float = float("-inf")
    disagreed_at_s: float = float("-inf")
    known_since_s: float = inf
    finding: FixConsistency = FixConsistency.NOTHING
    wrong: bool = False
    was_ranged: bool = False
    offset_m: float = 0.0
    changed_since_s: float | None = None
    diverged_since_s: float | None = None
    reset_at_s: float = float("-inf")
    by_located: _LocatedEvidence = _LocatedEvidence()

    def add(self, check: FixCheck, now_s: float) -> bool:
        """Add one finding; return True where it has just confirmed that the receiver is wrong."""
        contradicts = check.finding in _CONTRADICTS
        # A reference less certain than the offset agrees with anything, unless no ranges are there to make it better.
        uncertain = self.was_ranged and check.known_m > _WELL_KNOWN_SHARE * self.offset_m
        inconclusive = self.wrong and (uncertain or check.finding is FixConsistency.UNRESOLVED)
        self.was_ranged = (self.was_ranged and (self.wrong or contradicts)) or (contradicts and check.ranged)
        self.finding = check.finding
        if contradicts or check.finding is FixConsistency.UNRESOLVED:
            self.disagreed_at_s = now_s
        if contradicts and check.offset_m is not None:
            # The window of the ranges ends later than the fault: then the distance is nearly none any more.
            self.offset_m = max(self.offset_m, check.offset_m) if self.wrong else check.offset_m
        if check.ranges_know_m > _WELL_KNOWN_SHARE * self.offset_m:
            self.known_since_s = inf
        else:
            self.known_since_s = min(self.known_since_s, now_s)
        if contradicts == self.wrong or inconclusive:
            self.changed_since_s = None
            return False
        if self.changed_since_s is None:
            self.changed_since_s = now_s
        if now_s - self.changed_since_s < _CONFIRM_S:
            return False
        self.wrong, self.changed_since_s = contradicts, None
        return self.wrong

    @property
    def fault(self) -> PositionFault:
        """The fault, where it is wrong."""
        if self.is_back:
            return PositionFault(FaultReason.REACQUIRED_ELSEWHERE, self.offset_m)
        return PositionFault(FaultReason.CONTRADICTS_RANGES, self.offset_m, self.peers)

    def has_diverged(self, check: FixCheck, now_s: float) -> bool:
        """Return whether the estimate must start anew: ranges have long fitted the receiver and not it."""
        if check.finding is not FixConsistency.ESTIMATE_OFF:
            self.diverged_since_s = None
            return False
        if self.diverged_since_s is None:
            self.diverged_since_s = now_s
        if now_s - self.diverged_since_s < _CONFIRM_S or now_s - self.reset_at_s < _RESET_EVERY_S:
            return False
        self.reset_at_s = now_s
        return True

    def wait(self, since_s: float) -> None:
        """Let no time pass where there is no fresh fix to test: silence is no agreement."""
        self.disagreed_at_s += since_s
        self.known_since_s += since_s
        if self.changed_since_s is not None:
            self.changed_since_s += since_s

    def status(self, now_s: float) -> ReacquisitionStatus:
        # Ranges to located vehicles may test one direction: those of witnesses that test both decide.
        is_held = self.by_located.is_open(now_s) and now_s - self.known_since_s < _AGREES_FOR_S
        if now_s - self.disagreed_at_s < _AGREES_FOR_S or is_held:
            return ReacquisitionStatus.CONTRADICTED
        if self.finding is not FixConsistency.NOTHING:
            return ReacquisitionStatus.CONSISTENT
        has_waited = now_s - self.began_s >= _EPOCHS_FILLED_AFTER_S
        return ReacquisitionStatus.UNTESTED if has_waited else ReacquisitionStatus.PENDING


class ReacquisitionMonitor:
    """The GNSS reacquisition monitor of one fleet.

    It tests the receivers that are back, and those whose vehicles report trouble or were identified as faulty.
    """

    def __init__(self) -> None:
        self._rejected_fixes = 0
        self._reviewed_s = inf
        self._receivers: dict[int, _Reacquisition] = {}
        self._clear()

    def forget(self, sysid: int) -> None:
        """Forget the receiver of a vehicle that makes room for another one."""
        self._receivers.pop(sysid, None)
        self._residuals.drop(sysid)

    def add_range(self, measurement: RangeMeasurement) -> None:
        """Add a range between two vehicles, or a vehicle and a station."""
        if self._receivers:
            self._residuals.add_range(measurement)

    def right(self) -> frozenset[int]:
        """Return the receivers that are tested and are not, or no longer, found wrong."""
        return frozenset(sysid for sysid, receiver in self._receivers.items() if not receiver.wrong)

    def review(
        self, now_s: float, vehicles: Sequence[ReviewedVehicle], identified: Mapping[int, PositionFault]
    ) -> IntegrityReport:
        """Test the fixes in question against ranges and inflated estimates; return what was found."""
        since_s, self._reviewed_s = max(now_s - self._reviewed_s, 0.0), now_s
        back = {v.sysid: (v, fix) for v in vehicles if (fix := self._fix(v, now_s, identified)) is not None}
        if not back:
            if self._receivers:
                self._receivers = {}
                self._clear()
            return IntegrityReport(rejected_fixes=self._rejected_fixes)
        self._receivers = {sysid: self._receivers.get(sysid) or _begin(v, identified, now_s) for sysid, (v, _) in back.items()}
        peers = {v.sysid: v.reported for v in vehicles if v.is_witness and v.reported is not None and v.sysid not in back}
        # Where ranges come from denied vehicles only, their estimates are all there is to hold a peer's receiver against.
        located = set()
        for v in vehicles:
            if v.estimate is not None and v.gps_state is GpsState.FAILED and v.sysid not in back and _is_reference(v):
                located.add(v.sysid)
                sigma_h_m = horizontal_sigma_m(v.estimate.protected_covariance)
                self._residuals.add_position(v.sysid, TrackPoint.of_estimate(v.estimate, now_s, sigma_h_m, no_prior=False))
        suspects = frozenset(v.sysid for v in vehicles if not v.is_trusted)
        for position in (*peers.values(), *(fix for _, fix in back.values())):
            if (point := TrackPoint.of_report(position)) is not None:
                self._residuals.add_position(position.vehicle, point)
        epoch = self._residuals.epoch(now_s)
        pasts = self._epochs.pasts(epoch.at_s)
        self._epochs.append(epoch)
        diverged = set()
        for sysid, (vehicle, fix) in back.items():
            receiver = self._receivers[sysid]
            if now_s - fix.arrived_at_s > _OLDEST_FIX_S:
                receiver.wait(since_s)
                continue
            # A vehicle that has just become suspect is still where its doubtful position has put it.
            is_reference = vehicle.gps_state is not GpsState.SUSPECT and _is_reference(vehicle)
            estimate = vehicle.estimate if is_reference else None
            own = {
                interval_s: (star(then, sysid, peers) if then else None, c)
                for interval_s, (then, c) in pasts.items()
                if then is None or then.at_s > receiver.off_at_s
            }
            tested = star(epoch, sysid, peers)
            receiver.peers = tuple(sorted(tested.priors.keys() - {sysid}))
            check = check_fix(fix, estimate, tested, own, suspects)
            receiver.by_located = receiver.by_located.after(star(epoch, sysid, located), sysid, now_s)
            if check.ranged and not check.fits_now:
                receiver.off_at_s = epoch.at_s
            if receiver.add(check, now_s):
                self._rejected_fixes += receiver.is_back
            if receiver.has_diverged(check, now_s):
                diverged.add(sysid)
        return IntegrityReport(
            faults={sysid: receiver.fault for sysid, receiver in self._receivers.items() if receiver.wrong},
            reacquisitions={sysid: receiver.status(now_s) for sysid, receiver in self._receivers.items()},
            diverged=frozenset(diverged),
            rejected_fixes=self._rejected_fixes,
        )

    def _fix(self, vehicle: ReviewedVehicle, now_s: float, identified: Container[int]) -> PositionMeasurement | None:
        """Return the fix of a receiver that must be tested now; None where there is none.

        A receiver is tested that is back, whose vehicle reports trouble, or that failed because it was found wrong.
        """
        fix, receiver, state = vehicle.receiver_fix, self._receivers.get(vehicle.sysid), vehicle.gps_state
        was_wrong = state is GpsState.FAILED and (vehicle.sysid in identified or (receiver is not None and receiver.wrong))
        in_question = vehicle.is_returning or (state is GpsState.SUSPECT and not vehicle.is_witness)
        if fix is None or not vehicle.is_automatic or not (was_wrong or in_question):
            return None
        return fix if now_s - fix.arrived_at_s <= (_SILENCE_S if receiver is not None else _OLDEST_FIX_S) else None

    def _clear(self) -> None:
        self._residuals = RangeResidualBuffer()
        self._epochs = EpochHistory()


def _begin(vehicle: ReviewedVehicle, identified: Mapping[int, PositionFault], now_s: float) -> _Reacquisition:
    fault = identified.get(vehicle.sysid)
    if fault is not None:
        return _Reacquisition(now_s, is_back=False, wrong=True, was_ranged=True, offset_m=fault.size_m)
    return _Reacquisition(now_s, is_back=vehicle.is_returning)


def _is_reference(vehicle: ReviewedVehicle) -> bool:
    """Return whether the estimate of a vehicle comes from ranges that agree with it."""
    agrees = vehicle.median_nis is None or vehicle.median_nis <= CONSISTENT_MEDIAN_NIS
    return vehicle.estimate is not None and vehicle.estimate.ranges_in_use > 0 and vehicle.range_jump_m is None and agrees
