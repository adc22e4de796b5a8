"""Receivers that are back: each is held against the ranges and our estimate before its vehicle is healthy again.

Jamming is often followed by spoofing: the fix that comes back is then another place's. So while a vehicle recovers, what its
receiver says is checked five times a second (`fix_check`), with a memory of its own: what is found here moves nobody else.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from gcs_coloc.core.aiding.fix_policy import MOST_MISFIT
from gcs_coloc.core.gps_health.gps_health import Contradiction, GpsState
from gcs_coloc.core.integrity.epoch_history import EpochHistory
from gcs_coloc.core.integrity.fix_check import FixCheck, FixConsistency, check_fix, star
from gcs_coloc.core.integrity.range_consistency import ConsistencySettings
from gcs_coloc.core.integrity.range_residuals import RangeResidualBuffer, ReportedTrack
from gcs_coloc.core.measurements import Estimate, NoEstimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.core.messages.control import GpsOverride
from gcs_coloc.core.telemetry.vehicles import Vehicle, VehicleRegistry

COUNTED = "GPS: back, but contradicted by ranges"
_CONTRADICTS = (FixConsistency.AGAINST_RANGES, FixConsistency.AGAINST_ESTIMATE)
_FRESH_S = 1.0
_SURE_S = 1.0
_ROWS_KNOWN_S = 3.0  # a second and a half and what is lost of it
_ANEW_EVERY_S = 10.0
_WELL_KNOWN_SHARE = 0.25

Answer = Callable[[int, float], Estimate | NoEstimate]


@dataclass(slots=True)
class _Case:
    """One receiver since it has been back.

    `wrong` is what has been found of it, `offset_m` how far it was off; `ranged`: there were ranges then that could speak for it.
    """

    began_s: float
    finding: FixConsistency = FixConsistency.NOTHING
    wrong: bool = False
    ranged: bool = False
    offset_m: float = 0.0
    other_since_s: float | None = None
    off_since_s: float | None = None
    anew_at_s: float = float("-inf")

    def take(self, check: FixCheck, now_s: float) -> bool:
        """Take one finding; True where the receiver has just been found wrong."""
        contradicts = check.finding in _CONTRADICTS
        # What is less well known than it was off would agree with anything; where nobody can be ranged, no more is to be had.
        silent = self.wrong and self.ranged and check.known_m > _WELL_KNOWN_SHARE * self.offset_m
        self.ranged = (self.ranged and (self.wrong or contradicts)) or (contradicts and check.ranged)
        self.finding = check.finding
        if contradicts and check.offset_m is not None:
            self.offset_m = check.offset_m
        if contradicts == self.wrong or silent:
            self.other_since_s = None
            return False
        if self.other_since_s is None:
            self.other_since_s = now_s
        if now_s - self.other_since_s < _SURE_S:
            return False
        self.wrong, self.other_since_s = contradicts, None
        return self.wrong

    def estimate_is_off(self, check: FixCheck, now_s: float) -> bool:
        """Whether the estimate is to be begun anew, as the ranges have fitted the receiver and not it for a while."""
        if check.finding is not FixConsistency.ESTIMATE_OFF:
            self.off_since_s = None
            return False
        if self.off_since_s is None:
            self.off_since_s = now_s
        if now_s - self.off_since_s < _SURE_S or now_s - self.anew_at_s < _ANEW_EVERY_S:
            return False
        self.anew_at_s = now_s
        return True


class ReacquisitionMonitor:
    """One fleet. Feed it ranges, call `review` several times a second.

    `misplaced` has after a review the vehicles whose position is to be found anew. `refused` counts the receivers found wrong.
    """

    def __init__(self, settings: ConsistencySettings) -> None:
        self.misplaced: frozenset[int] = frozenset()
        self.refused: Counter[str] = Counter()
        self._settings = settings
        self._cases: dict[int, _Case] = {}
        self._forget()

    def range(self, measurement: RangeMeasurement) -> None:
        """Take a range between two vehicles."""
        if self._cases:
            self._rows.range(measurement)

    def review(self, now_s: float, fleet: VehicleRegistry, answer: Answer) -> None:
        """Check the fixes of those who are back. `answer`: the estimator's, with what a liar may have done in its covariance."""
        back = {v.sysid: (v, fix) for v in fleet if (fix := self._fix(v, now_s)) is not None}
        self.misplaced = frozenset()
        if not back:
            if self._cases:
                self._cases = {}
                self._forget()
            return
        self._cases = {sysid: self._cases.get(sysid) or _Case(now_s) for sysid in back}
        peers = {v.sysid: v.claim for v in fleet if v.health.trusted and v.claim is not None}
        for claim in (*peers.values(), *(fix for _, fix in back.values())):
            self._place(claim)
        scene = self._rows.scene(now_s)
        pasts = self._scenes.before(scene.at_s)
        self._scenes.append(scene)
        misplaced = set()
        for sysid, (vehicle, fix) in back.items():
            where = answer(sysid, now_s)
            estimate = where if isinstance(where, Estimate) and _is_witness(where, vehicle) else None
            own = {interval_s: (star(then, sysid, peers) if then else None, c) for interval_s, (then, c) in pasts.items()}
            check = check_fix(fix, estimate, star(scene, sysid, peers), own, self._settings.levels)
            case = self._cases[sysid]
            if case.take(check, now_s):
                self.refused[COUNTED] += 1
            if case.estimate_is_off(check, now_s):
                misplaced.add(sysid)
        self.misplaced = frozenset(misplaced)

    def contradiction(self, sysid: int) -> Contradiction | None:
        """Say why a receiver that is back is not believed; None where it may be."""
        case = self._cases.get(sysid)
        if case is None or not case.wrong:
            return None
        return Contradiction(f"its GPS is back but {case.offset_m:.0f} m from where the ranges put it", identified=True)

    def doubted(self, sysid: int) -> bool:
        """Whether a receiver is contradicted at the moment, be it for too short a time to call it wrong."""
        case = self._cases.get(sysid)
        return case is not None and case.finding in _CONTRADICTS

    def untested(self, sysid: int, now_s: float) -> bool:
        """Whether there has been time to hold a receiver against something, and there is nothing."""
        case = self._cases.get(sysid)
        return case is not None and case.finding is FixConsistency.NOTHING and now_s - case.began_s >= _ROWS_KNOWN_S

    def _fix(self, vehicle: Vehicle, now_s: float) -> PositionMeasurement | None:
        """What a receiver says that is back: of a vehicle that is recovering, or would be if it had not been found wrong."""
        fix, health = vehicle.receiver_fix, vehicle.health
        case = self._cases.get(vehicle.sysid)
        wrong = case is not None and case.wrong and health.state is GpsState.FAILED
        if fix is None or health.word is not GpsOverride.AUTO or not (wrong or health.state is GpsState.RECOVERING):
            return None
        return fix if now_s - fix.arrived_at_s <= _FRESH_S else None

    def _place(self, claim: PositionMeasurement) -> None:
        if claim.velocity_enu_mps is None:
            return
        position, velocity = claim.position_enu_m, claim.velocity_enu_mps
        track = ReportedTrack(claim.measured_at_s, position, velocity, claim.sigma_h_m, claim.sigma_v_m, free=False)
        self._rows.place(claim.vehicle, track)

    def _forget(self) -> None:
        s = self._settings
        self._rows = RangeResidualBuffer(s.rows)
        self._scenes = EpochHistory(s.intervals_s, s.wander_time_s, s.every_s)


def _is_witness(where: Estimate, vehicle: Vehicle) -> bool:
    """Whether an estimate is one of ranges, and these agree with it."""
    misfit = vehicle.range_misfit
    return where.ranges_in_use > 0 and vehicle.range_jump_m is None and (misfit is None or misfit <= MOST_MISFIT)
