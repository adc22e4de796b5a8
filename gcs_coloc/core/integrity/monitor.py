"""The integrity monitor of one fleet: it tests reported positions and returns what it found.

A witness, of which nothing bad is known, has its reported position as a prior. Any other vehicle has none: it may echo our fix,
or be the one at fault, so it stands where the estimator has it, free to move horizontally. Its own receiver is tested by itself,
and an identified vehicle is readmitted only after its receiver has agreed with where the ranges put it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import dist, hypot

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.evidence import FaultReason, PositionFault
from gcs_coloc.core.gps_health.gps_health import DISTRUSTED
from gcs_coloc.core.integrity.epoch_tests.epoch import MIN_SIGMA_M, Epoch
from gcs_coloc.core.integrity.epoch_tests.pair_outliers import unordered
from gcs_coloc.core.integrity.other_side import OpenSides
from gcs_coloc.core.integrity.protection_level import (
    Exposure,
    FaultLevel,
    ProtectionSettings,
    fault_level,
    is_tested,
    protection_level,
    ranged_until_s,
)
from gcs_coloc.core.integrity.range_consistency import RangeConsistency
from gcs_coloc.core.integrity.range_residuals import TrackPoint
from gcs_coloc.core.integrity.reacquisition import ReacquisitionMonitor
from gcs_coloc.core.integrity.report import IntegrityReport, ReviewedVehicle
from gcs_coloc.core.integrity.solution_separation import FaultClass, SolutionSeparation, range_excess_m2
from gcs_coloc.core.measurements import (
    Estimate,
    NoEstimate,
    NoEstimateReason,
    PositionMeasurement,
    RangeMeasurement,
    Residual,
    Unlocated,
)

_FLAT_WITHIN_M = 800_000.0
"""Horizontal coordinates in the frame of an estimate, at most. Chosen: 7 degrees off the vertical; at 13 the bounds fail."""
_TESTED_WITHIN_S = 1.0
"""Ranges that have located a vehicle are tested by then, or cannot be. Chosen: two reviews more than ranges at 5 Hz take."""


class IntegrityMonitor:
    """Detects, isolates and bounds faults of reported positions. Call `review` several times a second."""

    def __init__(self, protection: ProtectionSettings | None = None) -> None:
        self._protection = protection if protection is not None else ProtectionSettings()
        self._fault_levels: dict[int, FaultLevel] = {}
        self._untested_until_s: dict[int, float] = {}
        self._open_sides = OpenSides(self._protection.max_acceleration_mps2)
        self._consistency = RangeConsistency()
        self._reacquisition = ReacquisitionMonitor()

    def forget(self, sysid: int) -> None:
        """Forget a vehicle that makes room for another one."""
        self._consistency.forget(sysid)
        self._reacquisition.forget(sysid)
        self._open_sides.forget((sysid,))

    def add_position(self, position: PositionMeasurement) -> None:
        """Add the position that a witness reports.

        A position without a velocity is ignored, and so is that of a vehicle identified as faulty until it is readmitted.
        """
        point = TrackPoint.of_report(position)
        if point is not None and not self.has_identified(position.vehicle):
            self._consistency.residuals.add_position(position.vehicle, point)
            self._open_sides.note_side(position.vehicle, point.at_s, point.position_enu_m, point.velocity_enu_mps)

    def has_identified(self, node: int) -> bool:
        """Return whether the position of a vehicle or station is identified as faulty, and not readmitted yet."""
        return node in self._consistency.identified

    def add_range(self, measurement: RangeMeasurement) -> None:
        """Add a range between two vehicles, or a vehicle and a station."""
        self._consistency.residuals.add_range(measurement)
        self._reacquisition.add_range(measurement)

    def add_residuals(self, residuals: Iterable[Residual]) -> None:
        """Add what the estimator made of ranges: those that it selects are tested before others."""
        for residual in residuals:
            if residual.to_vehicle is not None:
                self._consistency.residuals.add_selected((residual.from_vehicle, residual.to_vehicle), residual.measured_at_s)

    def review(self, now_s: float, vehicles: Sequence[ReviewedVehicle], frame: LocalFrame | None) -> IntegrityReport:
        """Test what was added up to now (service time, s). Without a frame there is no position to test."""
        if frame is None:
            return IntegrityReport()
        for vehicle in vehicles:
            if not vehicle.is_witness or self.has_identified(vehicle.sysid):
                self._place_by_estimate(vehicle, now_s)
        doubtful = frozenset(vehicle.sysid for vehicle in vehicles if vehicle.is_doubtful)
        not_used = frozenset(vehicle.sysid for vehicle in vehicles if not vehicle.is_trusted)
        self._consistency.review(now_s, doubtful, not_used)
        tested = IntegrityReport(separation_m2=dict(self._consistency.separation_m2))
        inflated = [replace(v, estimate=tested.inflate(v.estimate)) if v.estimate is not None else v for v in vehicles]
        self._update_fault_levels(inflated, now_s)
        reacquired = self._reacquisition.review(now_s, inflated, self._consistency.identified)
        self._consistency.readmit(self._reacquisition.right(), now_s)
        return replace(
            reacquired,
            faults={**reacquired.faults, **self._faults(vehicles)},
            separation_m2=tested.separation_m2,
            fault_levels=dict(self._fault_levels),
            untested=frozenset(self._untested_until_s),
            noise=self._consistency.noise,
            range_excess_m2=range_excess_m2(self.stated_epoch, self.epoch),
        )

    @property
    def epoch(self) -> Epoch:
        """The residuals that the last review adjusted, with the noise that it found."""
        return self._consistency.epoch

    @property
    def stated_epoch(self) -> Epoch:
        """The residuals that the last review adjusted, with the noise that ranges and positions state.

        It is the same object as `epoch` where no noise beyond the stated one was found.
        """
        return self._consistency.stated_epoch

    def protect(self, report: IntegrityReport, estimate: Estimate, exposure: Exposure) -> Estimate | NoEstimate:
        """Return the estimate as it may be stated: inflated by a report, with its protection level.

        One that ranges alone have begun is not stated before a review has tested these ranges, and none so far from the frame's
        origin that the frame's vertical is not that of the place.
        """
        from_origin_m = hypot(*estimate.position_enu_m[:2])
        if from_origin_m > _FLAT_WITHIN_M:
            reason = Unlocated(NoEstimateReason.FAR_FROM_ORIGIN, value=from_origin_m / 1000.0)
            return NoEstimate(estimate.vehicle, estimate.at_s, reason)
        if estimate.vehicle in report.untested:
            return NoEstimate(estimate.vehicle, estimate.at_s, Unlocated(NoEstimateReason.UNTESTED))
        inflated = report.inflate(estimate)
        level = protection_level(inflated, report.fault_levels.get(estimate.vehicle), exposure, self._protection)
        return replace(inflated, protection=level)

    def _update_fault_levels(self, vehicles: Sequence[ReviewedVehicle], now_s: float) -> None:
        epoch = self._consistency.epoch
        located = [(vehicle.sysid, vehicle.estimate) for vehicle in vehicles if vehicle.estimate is not None]
        separation = SolutionSeparation(epoch) if located and epoch.residuals else None
        levels: dict[int, FaultLevel] = {}
        also, unisolated = self._consistency.also, self._consistency.unisolated.ranges
        residuals = self._consistency.residuals
        unlocated = [v for v in vehicles if v.estimate is None and v.gps_state in DISTRUSTED and not v.is_witness]
        untested_until_s = {v.sysid: now_s + _TESTED_WITHIN_S for v in unlocated if residuals.is_testable(v.sysid)}
        for sysid, where in located:
            ranges = _newest_ranges(epoch, sysid, residuals.ranged_at_s(sysid))
            if separation is not None and ranges and sysid in separation.vehicles:
                ranged_at_s = ranged_until_s(ranges, now_s)
                level = fault_level(separation.of(sysid), where, ranged_at_s, self._protection, also, unisolated)
                other_side_m = self._open_sides.other_side_m(epoch, sysid, where.velocity_enu_mps.tolist())
                levels[sysid] = replace(level, other_side_m=other_side_m)
            elif now_s < (until_s := self._untested_until_s.get(sysid, now_s)) and residuals.is_testable(sysid):
                untested_until_s[sysid] = until_s
            elif sysid in self._fault_levels or not self.has_identified(sysid):
                # Until it has ranges, its last own position carries it; after them its last level does, which grows with time.
                beginning = FaultLevel(0.0, horizontal_sigma_m(where.protected_covariance), now_s, ())
                levels[sysid] = self._fault_levels.get(sysid, beginning)
        # What it reported has carried it until now, and that is false.
        untested_until_s |= {v: now_s + _TESTED_WITHIN_S for v in self._consistency.identified if v not in levels}
        self._fault_levels, self._untested_until_s = levels, untested_until_s
        if unisolated:
            self._consistency.unisolated.clear(_tested_ranges(epoch) if epoch.residuals else (), now_s)

    def _place_by_estimate(self, vehicle: ReviewedVehicle, now_s: float) -> None:
        """Let a vehicle take part where the estimator has it, without a prior; not at all without an estimate."""
        where = vehicle.estimate
        if where is None:
            self._consistency.residuals.drop(vehicle.sysid)
            return
        point = TrackPoint.of_estimate(where, now_s, 0.0, no_prior=True)
        self._consistency.residuals.add_position(vehicle.sysid, point)

    def _faults(self, vehicles: Sequence[ReviewedVehicle]) -> dict[int, PositionFault]:
        identified, detected = self._consistency.identified, self._consistency.detected
        faults: dict[int, PositionFault] = {}
        for sysid in (vehicle.sysid for vehicle in vehicles):
            if sysid in identified:
                faults[sysid] = identified[sysid]
            elif sysid in detected:
                faults[sysid] = PositionFault(FaultReason.NOT_ISOLATED, others=tuple(sorted(detected - {sysid})))
        return faults


def _newest_ranges(epoch: Epoch, vehicle: int, ranged_at_s: Mapping[int, float]) -> list[tuple[float, float, float]]:
    """Return time, s, and horizontal unit vector (east, north) of the newest range to each neighbour."""
    if vehicle not in epoch.priors:
        return []
    (e, n, u), ranges = epoch.priors[vehicle].position_enu_m, []
    for other, at_s in ranged_at_s.items():
        if other in epoch.priors:
            other_e, other_n, other_u = epoch.priors[other].position_enu_m
            distance_m = max(dist((e, n, u), (other_e, other_n, other_u)), MIN_SIGMA_M)
            ranges.append((at_s, (e - other_e) / distance_m, (n - other_n) / distance_m))
    return ranges


def _tested_ranges(epoch: Epoch) -> set[tuple[int, ...]]:
    """Return the pairs and devices (one vehicle) whose ranges an epoch tests."""
    separation = SolutionSeparation(epoch)
    hypotheses = (each for vehicle in separation.vehicles for each in separation.of(vehicle) if each.fault is FaultClass.RANGES)
    ranged: set[tuple[int, ...]] = {unordered(pair) for pair in epoch.arrays.pairs}
    ranged |= {(vehicle,) for pair in ranged for vehicle in pair}
    return ranged - {each.vehicles for each in hypotheses if not is_tested(each)}
