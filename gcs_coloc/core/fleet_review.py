"""The review of a fleet: runs the stages that follow the estimator, and hands their results on.

Order: estimates -> integrity report -> GPS health -> aiding decision.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import inf

from gcs_coloc.core.aiding.methods.method import FixInputs
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.aiding.stream import AidingDecision, AidingView
from gcs_coloc.core.dispatch import LastRound, Stages
from gcs_coloc.core.gps_health.evidence import GpsEvidence
from gcs_coloc.core.gps_health.gps_health import DISTRUSTED, GpsState
from gcs_coloc.core.integrity.protection_level import Exposure, ProtectionSettings
from gcs_coloc.core.integrity.report import IntegrityReport, ReacquisitionStatus, ReviewedVehicle
from gcs_coloc.core.measurements import Estimate, NoEstimate, PositionMeasurement, Residual
from gcs_coloc.core.messages.control import GpsOverride
from gcs_coloc.core.messages.outbound import HealthChanged, Notice, Outbound
from gcs_coloc.core.operator_overrides import OperatorOverrides
from gcs_coloc.core.readiness.readiness_review import ReadinessInputs, ReadinessReview
from gcs_coloc.core.residual_log import RangeJumps, ResidualLog
from gcs_coloc.core.station_review import StationReview
from gcs_coloc.core.stations.node_id import is_station
from gcs_coloc.core.telemetry.proven_vehicles import STEADY_S
from gcs_coloc.core.telemetry.reported_state import AIR_DATA_FRESH_S, ReportedState

_AIR_DATA_REFUSED = "its airspeed and heading contradict its way over ground: not used; is its pitot tube clear?"
_AIR_DATA_USED = "its airspeed and heading agree with its way over ground again: used"
_REPORT_SHOWS_S = 3.0  # chosen: a vehicle can have moved by 44 m since then, at 1 g from its course; later it shows nothing
_WITNESS_AFTER_S = STEADY_S  # a vehicle that has just appeared has shown nothing yet; a window of ranges takes 1.4 s


@dataclass(slots=True)
class _Vehicle:
    """What was decided last about the aiding of one vehicle, and where it is located (east, north).

    `reported_at_s`: when it last said how it moves while it was trusted, service time in s; None where its state is newer.
    """

    decision: AidingDecision = field(default_factory=AidingDecision)
    reported_at_s: float | None = None
    located_enu_m: tuple[float, float] | None = None


_NOT_REVIEWED = _Vehicle()  # what is kept of a vehicle that was not reviewed: read, never written


class FleetReview:
    """Hands the results of the later stages to each other, and to the earlier ones in the next round.

    `report` is what integrity returned last. `residuals` is what the estimator made of the ranges of late. `stations` is the
    review of the fixed stations. `readiness` is whether healthy vehicles would be located without GPS.
    """

    def __init__(
        self, stages: Stages, aiding: AidingSettings, protection: ProtectionSettings, overrides: OperatorOverrides
    ) -> None:
        self.report = IntegrityReport()
        self.residuals = ResidualLog()
        self.stations = StationReview(stages)
        self.readiness = ReadinessReview(stages.estimator, aiding, protection)
        self._stages = stages
        self._jumps = RangeJumps()
        self._overrides = overrides
        self._vehicles: defaultdict[int, _Vehicle] = defaultdict(_Vehicle)
        self._denied: frozenset[int] = frozenset()
        self._witnesses: frozenset[int] = frozenset()
        self._median_nis: dict[int, float] = {}
        self._jumps_m: dict[int, float] = {}
        self._air_data_refused: frozenset[int] = frozenset()
        self._knows_delays = True

    def forget(self, sysid: int, now_s: float) -> None:
        """Forget a vehicle that makes room for another one, but for what the operator decided of it."""
        self.readiness.forget(sysid)
        self._jumps.forget(sysid)
        self._vehicles.pop(sysid, None)
        self._air_data_refused -= {sysid}
        if sysid in self._denied:
            self._denied -= {sysid}
            self._stages.estimator.set_denied(self._denied, now_s)

    def decision(self, sysid: int) -> AidingDecision:
        """Return what aiding decided last about a vehicle."""
        return self._vehicles.get(sysid, _NOT_REVIEWED).decision

    def estimate(self, sysid: int, at_s: float) -> Estimate | NoEstimate:
        """Return the estimate of one vehicle at one service time, with its protection level."""
        where, s = self._stages.estimator.estimate(sysid, at_s), self._stages
        if isinstance(where, NoEstimate):
            return where
        return s.integrity.protect(self.report, where, Exposure(self._knows_delays, self._shown_until_s(where)))

    def _shown_until_s(self, where: Estimate) -> float | None:
        """Return until when it is shown how a vehicle has moved, s; None where nothing shows it.

        Attitude with airspeed that the estimator has used shows it, and so do the reported positions of a trusted vehicle: the
        last of them after its loss as well, until ranges show its motion. The time is service time.
        """
        s, times_s = self._stages, []
        vehicle, attitude_at_s = s.telemetry.get(where.vehicle), s.measurements.attitude_at_s(where.vehicle)
        has_air_data = vehicle is not None and vehicle.has_air_data(where.at_s) and not where.refuses_air_data
        if has_air_data and attitude_at_s is not None:
            used_at_s = min(attitude_at_s, where.air_data_at_s)
            if where.at_s - used_at_s <= AIR_DATA_FRESH_S:
                times_s.append(used_at_s)
        reported = s.measurements.reported(where.vehicle)
        kept_at_s = self._vehicles.get(where.vehicle, _NOT_REVIEWED).reported_at_s
        if reported is not None and self._is_trusted(where.vehicle):
            times_s.append(reported.measured_at_s)
        elif kept_at_s is not None and where.at_s - kept_at_s <= _REPORT_SHOWS_S:
            times_s.append(kept_at_s)
        return max(times_s, default=None)

    def add_residuals(self, residuals: Iterable[Residual], now_s: float) -> None:
        """Add what the estimator made of ranges since the last call."""
        residuals = list(residuals)
        self._stages.integrity.add_residuals(residuals)
        self._stages.vetted.add_residuals(residuals, self._is_trusted_node)
        self.residuals.add(residuals, now_s)
        self._jumps.add(residuals, now_s)
        self._jumps_m = self._jumps.sizes_m(now_s)

    def last_round(self, sysid: int) -> LastRound:
        """Return what the later stages found of a vehicle last."""
        return LastRound(
            is_trusted=self._is_trusted(sysid),
            is_witness=sysid in self._witnesses,
            is_aided=self.decision(sysid).is_aided,
            sent_fix=self._stages.aiding.sent_fix(sysid),
            located_enu_m=self._vehicles.get(sysid, _NOT_REVIEWED).located_enu_m,
        )

    def fix_inputs(self, sysid: int, now_s: float) -> FixInputs:
        """Return what earlier stages know of a vehicle for its next fix."""
        vehicle, clock = self._stages.telemetry.get(sysid), self._stages.clocks.boot_clock(sysid)
        return FixInputs(
            is_trusted=self._is_trusted(sysid),
            has_air_data=vehicle is not None and vehicle.has_air_data(now_s),
            is_aligned=vehicle is not None and vehicle.has_absolute_position(now_s),
            one_way_delay_s=clock.one_way_delay_s(now_s),
            range_sigma_m=self._stages.measurements.range_sigma_m(sysid),
            median_nis=self._median_nis.get(sysid),
            range_jump_m=self._jumps_m.get(sysid),
            ranges=self._stages.vetted.drain(sysid),
            locate_node=self.estimate,
            boot_s=lambda at_s: clock.from_service(at_s, now_s),
        )

    def estimate_to_send(self, sysid: int, at_s: float) -> Estimate | NoEstimate:
        """Return the estimate for a fix, and keep its horizontal position.

        An altitude that is measured without GPS becomes an up coordinate over that place.
        """
        where = self.estimate(sysid, at_s)
        self._set_located(sysid, where)
        return where

    def _set_located(self, sysid: int, where: Estimate | NoEstimate) -> None:
        self._vehicles[sysid].located_enu_m = (
            (float(where.position_enu_m[0]), float(where.position_enu_m[1])) if isinstance(where, Estimate) else None
        )

    def review_integrity(self, now_s: float) -> list[Outbound]:
        """Test positions and ranges of the fleet against each other."""
        vouched = [command.sysid for command in self._overrides.in_force() if command.override is GpsOverride.HEALTHY]
        out: list[Outbound] = list(self._stages.proven.review(tuple(self._stages.telemetry), vouched, now_s))
        self._witnesses = self._find_witnesses(now_s)
        self._knows_delays = all(self._stages.clocks.knows_delay(vehicle.sysid, now_s) for vehicle in self._stages.telemetry)
        stations = self.stations.witnesses(now_s)
        reviewed = [*(self._reviewed(vehicle, now_s) for vehicle in self._stages.telemetry), *stations]
        before, self.report = self.report, self._stages.integrity.review(now_s, reviewed, self._stages.measurements.frame)
        for sysid in self.report.diverged:
            self._reset(sysid, now_s)
        text = "its GPS is back and fits the ranges, our position did not: located anew"
        diverged = [Notice(now_s, sysid, "warning", text) for sysid in self.report.diverged]
        return [*out, *diverged, *self._air_data_notices(reviewed, now_s), *self.stations.update(before, self.report, now_s)]

    def _air_data_notices(self, reviewed: Iterable[ReviewedVehicle], now_s: float) -> list[Notice]:
        refused = {v.sysid for v in reviewed if v.estimate is not None and v.estimate.refuses_air_data}
        used = {v.sysid for v in reviewed if v.is_trusted or (v.estimate is not None and not v.estimate.refuses_air_data)}
        before, self._air_data_refused = self._air_data_refused, (self._air_data_refused | refused) - used
        return [
            *(Notice(now_s, sysid, "warning", _AIR_DATA_REFUSED) for sysid in sorted(refused - before)),
            *(Notice(now_s, sysid, "info", _AIR_DATA_USED) for sysid in sorted(before & used)),
        ]

    def review_vehicle(self, vehicle: ReportedState, now_s: float) -> list[Outbound]:
        """Run the stages from GPS health on for one vehicle; return what is to be sent and shown."""
        sysid = vehicle.sysid
        notice = self._stages.clocks.review_duplicate_id(sysid, now_s)
        out: list[Outbound] = [notice] if notice is not None else []
        health = self._stages.gps_health[sysid]
        before = health.state
        if health.update(self._gps_evidence(vehicle), now_s):
            out.append(HealthChanged(now_s, sysid, before.value, health.state.value, health.reason.text))
        reported = self._stages.measurements.reported(sysid)
        if reported is not None and self._is_trusted(sysid):
            self._vehicles[sysid].reported_at_s = reported.measured_at_s
        out += self.decide_aiding(vehicle, now_s)
        self._update_denied(sysid, now_s)
        return out

    def decide_aiding(self, vehicle: ReportedState, now_s: float) -> tuple[Outbound, ...]:
        """Decide on the aiding of one vehicle; return what is to be sent and shown."""
        sysid, s = vehicle.sysid, self._stages
        decision = self._vehicles[sysid].decision = s.aiding.review(
            vehicle,
            s.gps_health[sysid].state,
            now_s,
            has_duplicate_id=s.clocks.has_duplicate_id(sysid),
            reports_false_fix=s.gps_health[sysid].reports_false_fix,
        )
        return decision.outputs

    def aiding_view(self, vehicle: ReportedState) -> AidingView:
        """Return the aiding of one vehicle as observers see it."""
        sysid, s = vehicle.sysid, self._stages
        return s.aiding.view(vehicle, s.gps_health[sysid].state, has_duplicate_id=s.clocks.has_duplicate_id(sysid))

    def review_readiness(self, now_s: float) -> None:
        """Predict one healthy vehicle without its GPS, where one is due; residuals must have been drained."""
        s = self._stages
        vehicle = self.readiness.due(s.telemetry, self._is_trusted, now_s)
        if vehicle is None:
            return
        inputs = ReadinessInputs(
            ranges=s.ranges.of(vehicle.sysid, now_s),
            epoch=s.integrity.epoch,
            stated_epoch=s.integrity.stated_epoch,
            node=lambda node: self._trusted_position(node, now_s),
            exposure=Exposure(self._knows_delays, inf if vehicle.has_air_data(now_s) else None),
            height_sigma_m=s.measurements.height_sigma_m(vehicle.sysid, now_s),
            not_aided=self.aiding_view(vehicle).inhibit_reason,
        )
        self.readiness.review(vehicle, now_s, inputs)

    def _trusted_position(self, node: int, now_s: float) -> PositionMeasurement | None:
        """Return where a vehicle or station says that it is; None where that is no evidence."""
        if not self._is_trusted_node(node):
            return None
        frame, station = self._stages.measurements.frame, self._stages.stations.get(node) if is_station(node) else None
        if station is None:
            return self._stages.measurements.reported(node)
        return station.measurement(frame, now_s) if frame is not None else None

    def end_round(self) -> None:
        """Keep what the next round is to know of this one's ranges."""
        self._median_nis = self.residuals.median_nis(self.report.range_excess_m2)

    def _reviewed(self, vehicle: ReportedState, now_s: float) -> ReviewedVehicle:
        sysid = vehicle.sysid
        gps_state = self._stages.gps_health[sysid].state
        is_placed_by_ranges = gps_state in DISTRUSTED and sysid not in self._witnesses
        where = self._stages.estimator.estimate(sysid, now_s) if is_placed_by_ranges else None
        if where is not None:
            self._set_located(sysid, where)
        return ReviewedVehicle(
            sysid,
            gps_state,
            is_trusted=self._is_trusted(sysid),
            is_witness=sysid in self._witnesses,
            is_automatic=self._overrides.of(sysid, GpsOverride) is GpsOverride.AUTO,
            is_doubtful=self._stages.gps_health[sysid].is_doubtful(now_s),
            is_returning=self._stages.gps_health[sysid].is_returning,
            reported=self._stages.measurements.reported(sysid),
            receiver_fix=self._stages.measurements.receiver_fix(sysid),
            estimate=where if isinstance(where, Estimate) else None,
            median_nis=self._median_nis.get(sysid),
            range_jump_m=self._jumps_m.get(sysid),
        )

    def _gps_evidence(self, vehicle: ReportedState) -> GpsEvidence:
        sysid = vehicle.sysid
        report = self.report
        status = report.reacquisitions.get(sysid)
        return GpsEvidence(
            receiver=vehicle.receiver,
            integrity=vehicle.integrity,
            system=vehicle.system,
            ekf=vehicle.ekf,
            contradiction=report.faults.get(sysid),
            is_return_contradicted=status is ReacquisitionStatus.CONTRADICTED,
            is_return_untested=status is ReacquisitionStatus.UNTESTED,
            is_aided=self.decision(sysid).is_aided,
            has_duplicate_id=self._stages.clocks.has_duplicate_id(sysid),
            host_lag_s=self._stages.clocks.host_lag_s,
            override=self._overrides.of(sysid, GpsOverride),
        )

    def _find_witnesses(self, now_s: float) -> frozenset[int]:
        """Return the witnesses, of which nothing bad is known: their positions are tested against each other."""
        return frozenset(
            vehicle.sysid
            for vehicle in self._stages.telemetry
            if now_s - vehicle.first_heard_s >= _WITNESS_AFTER_S
            and self._stages.proven.is_proven(vehicle.sysid)
            and self._stages.gps_health[vehicle.sysid].may_witness
            and not self.decision(vehicle.sysid).is_aided
            and not self.decision(vehicle.sysid).is_self_fed
        )

    def _update_denied(self, sysid: int, now_s: float) -> None:
        is_denied = self._stages.gps_health[sysid].state in DISTRUSTED or self.decision(sysid).is_self_fed
        if is_denied == (sysid in self._denied):
            return
        self._denied = self._denied ^ {sysid}
        self._stages.estimator.set_denied(self._denied, now_s)
        if is_denied and sysid in self.report.faults:
            # What it reported of late is in its state: it must start anew, from the ranges alone.
            self._reset(sysid, now_s)

    def _reset(self, sysid: int, now_s: float) -> None:
        self._stages.estimator.reset(sysid, now_s)
        self._vehicles[sysid].reported_at_s = None

    def _is_trusted_node(self, node: int) -> bool:
        """Return whether the position of a vehicle or station is evidence, and nothing contradicts it."""
        return node not in self.report.faults and (is_station(node) or self._is_trusted(node))

    def _is_trusted(self, sysid: int) -> bool:
        """Return whether what a vehicle reports of its own position is evidence."""
        is_healthy = self._stages.gps_health[sysid].state is GpsState.HEALTHY
        return is_healthy and not self.decision(sysid).is_self_fed and self._stages.proven.is_proven(sysid)
