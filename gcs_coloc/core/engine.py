"""The engine: messages in, outputs out, time passed by hand. It has no socket, no clock and no thread.

Use: `receive` each message as it arrives, `poll` whenever `next_deadline` is due and send what it returns. Times never
decrease from call to call.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from gcs_coloc.core.aiding.aiding import Aiding
from gcs_coloc.core.aiding.inhibit import InhibitReason
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.aiding.stream import AidingDecision, FixInputs
from gcs_coloc.core.clocks.fleet_clocks import FleetClocks
from gcs_coloc.core.clocks.utc import Utc
from gcs_coloc.core.clocks.vehicle_clocks import TimeSettings
from gcs_coloc.core.estimator import Estimator, GuardedEstimator
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.gps_health import (
    DISTRUSTED,
    FleetGpsHealth,
    GpsEvidence,
    GpsHealthSettings,
    GpsState,
    RangeContradiction,
)
from gcs_coloc.core.integrity.monitor import PLACED_BY_ESTIMATE, IntegrityMonitor
from gcs_coloc.core.integrity.report import IntegrityReport, ReacquisitionStatus, ReviewedVehicle
from gcs_coloc.core.measurements import Estimate, NoEstimate
from gcs_coloc.core.messages.control import (
    AidingOverride,
    ClockReference,
    ControlInput,
    ForeignGpsInput,
    GpsOverride,
    OperatorCommand,
    PrimaryOverride,
    RouteReport,
    TransmitDisabled,
)
from gcs_coloc.core.messages.inbound import (
    Attitude,
    CommandResult,
    GlobalPosition,
    GpsReceiver,
    Inbound,
    ParameterValue,
    PeerRange,
    SystemTime,
    TimeSyncAnswer,
)
from gcs_coloc.core.messages.outbound import AidingMessage, Notice, Outbound, ParameterSet
from gcs_coloc.core.reasons import CoreRefusal, StatedReason
from gcs_coloc.core.residual_log import RangeJumps, ResidualLog
from gcs_coloc.core.schedule import TickSchedule
from gcs_coloc.core.snapshot import FleetSnapshot, vehicle_snapshot
from gcs_coloc.core.telemetry.measurement_builder import MeasurementBuilder, MeasurementSettings
from gcs_coloc.core.telemetry.reported_state import ReportedState, Telemetry
from gcs_coloc.core.telemetry.stream_requests import StreamRequests

REVIEWED_EVERY_S = 0.2
"""Chosen: a fifth of a second is short against what GPS health waits for, and a fleet's review takes a few milliseconds."""

_NO_AIDING = AidingDecision()


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """Settings of one fleet. `max_vehicles` bounds every table; `request_streams` asks vehicles for missing messages."""

    gps_health: GpsHealthSettings = field(default_factory=GpsHealthSettings)
    measurements: MeasurementSettings = field(default_factory=MeasurementSettings)
    aiding: AidingSettings = field(default_factory=AidingSettings)
    time: TimeSettings = field(default_factory=TimeSettings)
    request_streams: bool = True
    max_vehicles: int = 250


class Engine:
    """One fleet, as a pipeline of stages. Deterministic: the same calls give the same outputs.

    telemetry -> clocks -> measurements -> estimator -> integrity -> GPS health -> aiding

    Each stage returns values and keeps the rest private. The engine alone hands a stage's result to the next one, and what a
    later stage found in the last round to an earlier one. `reviewed_at_s` is the service time of the last review of all vehicles.
    """

    def __init__(self, estimator: Estimator, settings: EngineSettings | None = None) -> None:
        self.settings = settings if settings is not None else EngineSettings()
        s = self.settings
        # The receiver that we feed never counts as evidence of a vehicle's own GPS.
        self.telemetry = Telemetry(s.max_vehicles, own_receiver=1 if s.aiding.gps_id == 0 else 0)
        self.clocks = FleetClocks(s.time, s.measurements.max_age_s)
        self.measurements = MeasurementBuilder(s.measurements, self.clocks)
        self.estimator: Estimator = GuardedEstimator(estimator, self._report_estimator)
        self.integrity = IntegrityMonitor()
        self.gps_health = FleetGpsHealth(s.gps_health)
        self.aiding = Aiding(s.aiding)
        self.reviewed_at_s = float("-inf")
        self._streams = StreamRequests()
        self._residuals = ResidualLog()
        self._jumps = RangeJumps()
        self._utc = Utc(required=s.time.require_synchronised_clock)
        self._refused: Counter[CoreRefusal] = Counter()
        self._outbox: list[Outbound] = []
        self._now_s = float("-inf")
        self._review_due_s = float("inf")
        self._review_schedule = TickSchedule(0.0)
        self._transmits = True
        self._gps_overrides: dict[int, GpsOverride] = {}
        # What the stages returned last; a later stage's result is an argument of an earlier one in the next round.
        self._integrity_report = IntegrityReport()
        self._decisions: dict[int, AidingDecision] = {}
        self._duplicate_ids: frozenset[int] = frozenset()
        self._denied: frozenset[int] = frozenset()
        self._located_enu_m: dict[int, tuple[float, float]] = {}
        self._median_nis: dict[int, float] = {}
        self._jumps_m: dict[int, float] = {}
        self._update_host_inhibit()
        self._handlers: dict[type[Any], Callable[[Any, ReportedState], None]] = {
            GlobalPosition: self._add_position,
            Attitude: self._add_attitude,
            PeerRange: self._add_range,
            GpsReceiver: self._add_receiver,
            SystemTime: self._add_system_time,
            TimeSyncAnswer: self._add_time_answer,
            CommandResult: self._add_command_result,
            ParameterValue: self._add_parameter,
        }

    def receive(self, message: Inbound) -> None:
        """Receive one message. Never raises for its content: what cannot be used is counted by reason."""
        at_s = self._now_s = message.received_at_s
        if self._review_due_s == float("inf"):
            # The first message sets the schedule of deadlines, so that a recording of the messages holds it.
            self._review_due_s = at_s
            self._review_schedule = TickSchedule(at_s)
            self.aiding.begin(self._review_schedule)
        if isinstance(message, ControlInput):
            self._control(message)
            return
        sysid = message.sysid
        vehicle = self.telemetry.get(sysid)
        if vehicle is None and (vehicle := self._add_vehicle(sysid, at_s)) is None:
            return
        resets = self.clocks.resets(sysid)
        needs_review = self.telemetry.update(message)
        handler = self._handlers.get(type(message))
        if handler is not None:
            handler(message, vehicle)
        if needs_review:
            self._review_vehicle(vehicle, at_s)
        if self.clocks.resets(sysid) != resets and sysid not in self._duplicate_ids:
            self._streams.forget(sysid)
            self.aiding.forget_parameters(sysid)
            self._notify(at_s, sysid, "warning", "its clock jumped: taken as a reboot")
        self._streams.add(message)

    def poll(self, now_s: float) -> list[Outbound]:
        """Run the stages that look at the whole fleet where they are due, and return all that is to be sent or shown by now."""
        self._now_s = now_s
        if now_s >= self._review_due_s:
            self._review_due_s = self._review_schedule.after(now_s, REVIEWED_EVERY_S)
            self.reviewed_at_s = now_s
            self._review_integrity(now_s)
            for vehicle in self.telemetry:
                self._review_vehicle(vehicle, now_s)
                self._request_time(vehicle, now_s)
            self._median_nis = self._residuals.median_nis()
            self._outbox.extend(self.aiding.parameter_requests(now_s))
            if self.settings.request_streams:
                self._outbox.extend(self._streams.due(now_s))
        return self.serve(now_s)

    def serve(self, now_s: float) -> list[Outbound]:
        """Return what aided vehicles are to be sent by now, and what is to be shown: `poll` without its review of the fleet."""
        self._now_s = now_s
        residuals = self.estimator.drain_residuals()
        self._residuals.add(residuals, now_s)
        self._jumps.add(residuals, now_s)
        self._jumps_m = self._jumps.sizes_m(now_s)
        out, self._outbox = self._outbox, []
        out.extend(self.aiding.poll(now_s, self._fix_inputs, self.frame, self._utc_minus_service_s(), self._estimate_to_send))
        return out

    def next_deadline(self) -> float:
        """Return the service time at which `poll` is to be called at the latest; infinity before the first message."""
        review_s, aiding_s = self._review_due_s, self.aiding.next_due_s()
        return review_s if review_s < aiding_s else aiding_s

    def next_aid_s(self) -> float:
        """Return the service time at which the next aiding message is due; infinity where nobody is aided."""
        return self.aiding.next_due_s()

    def close(self) -> list[AidingMessage | ParameterSet]:
        """Return the last messages before the service ends: fix_type 1 to everyone who is aided, and restored parameters."""
        return self.aiding.close()

    def refused(self) -> dict[str, int]:
        """Return how often what was refused since the start, by the value of `CoreRefusal`."""
        total = self._refused.copy()
        for counts in (self.clocks.refused, self.measurements.refused, self.aiding.refused):
            total.update(counts)
        if self._integrity_report.rejected_fixes:
            total[CoreRefusal.REACQUIRED_FIX_REJECTED] += self._integrity_report.rejected_fixes
        return {reason.value: count for reason, count in total.items()}

    @property
    def frame(self) -> LocalFrame | None:
        """The fleet's frame; None until a vehicle with healthy GPS has set its origin."""
        return self.measurements.frame

    def sysids(self) -> list[int]:
        """Return the system ids of the vehicles heard so far."""
        return [vehicle.sysid for vehicle in self.telemetry]

    def gps_state(self, sysid: int) -> GpsState:
        """Return the state of a vehicle's GPS health; UNKNOWN for a vehicle that was never heard."""
        return self.gps_health.state(sysid)

    def decision(self, sysid: int) -> AidingDecision:
        """Return what aiding decided last about a vehicle."""
        return self._decisions.get(sysid, _NO_AIDING)

    def estimate(self, sysid: int, at_s: float) -> Estimate | NoEstimate:
        """Return the estimate of one vehicle at one service time, its covariance inflated by the solution separation."""
        where = self.estimator.estimate(sysid, at_s)
        return self._integrity_report.inflate(where) if isinstance(where, Estimate) else where

    def snapshot(self, now_s: float) -> FleetSnapshot:
        """Return the fleet as it stands, for observers."""
        consistency, frame = self._residuals.consistency(), self.frame
        vehicles = []
        for vehicle in sorted(self.telemetry, key=lambda v: v.sysid):
            sysid = vehicle.sysid
            gps_state = self.gps_health.state(sysid)
            vehicles.append(
                vehicle_snapshot(
                    vehicle,
                    self.estimate(sysid, now_s),
                    frame,
                    gps_state=gps_state,
                    gps_reason=self.gps_health.reason(sysid),
                    gps_override=self._gps_overrides.get(sysid, GpsOverride.AUTO),
                    aiding=self.aiding.view(vehicle, gps_state, has_duplicate_id=sysid in self._duplicate_ids),
                    delay_s=self.measurements.delay_s(sysid),
                    clock=self.clocks.quality(sysid, now_s),
                    consistency=consistency.get(sysid),
                    now_s=now_s,
                )
            )
        return FleetSnapshot(
            at_s=now_s,
            estimator=self.estimator.name,
            vehicles=tuple(vehicles),
            refused=self.refused(),
            estimator_counts=dict(self.estimator.counts()),
            ranges=self._residuals.ranges(now_s),
            utc_minus_service_s=self._utc_minus_service_s(),
            origin=(frame.lat_deg, frame.lon_deg, frame.height_m) if frame is not None else None,
        )

    # One message: telemetry -> measurement -> estimator, integrity, GPS health

    def _add_vehicle(self, sysid: int, at_s: float) -> ReportedState | None:
        vehicle = self.telemetry.add(sysid, at_s)
        if vehicle is None:
            self._refused[CoreRefusal.FLEET_FULL] += 1
            return None
        self._notify(at_s, sysid, "info", "heard for the first time")
        return vehicle

    def _add_position(self, message: GlobalPosition, vehicle: ReportedState) -> None:
        sysid = vehicle.sysid
        built = self.measurements.position(
            message,
            vehicle,
            is_trusted=self._is_trusted(sysid),
            sent_fix=self.aiding.sent_fix(sysid),
            located_enu_m=self._located_enu_m.get(sysid),
        )
        if built is None:
            return
        is_aided = self.decision(sysid).is_aided
        self.gps_health.add_position(built.reported, own=not is_aided)
        self.integrity.add_position(built.reported, self.gps_health.state(sysid), is_aided=is_aided)
        self.estimator.add(built.measurement)

    def _add_attitude(self, message: Attitude, vehicle: ReportedState) -> None:
        measurement = self.measurements.attitude(message, vehicle)
        if measurement is not None:
            self.estimator.add(measurement)

    def _add_range(self, message: PeerRange, vehicle: ReportedState) -> None:
        built = self.measurements.range(message, vehicle, self.telemetry.get(message.peer_sysid))
        if built.notice is not None:
            self._outbox.append(built.notice)
        if built.measurement is not None:
            self.integrity.add_range(built.measurement)
            self.estimator.add(built.measurement)

    def _add_receiver(self, message: GpsReceiver, vehicle: ReportedState) -> None:
        if message.receiver == self.telemetry.own_receiver:
            self.measurements.add_receiver(message, vehicle, is_trusted=self._is_trusted(vehicle.sysid))
            self.gps_health.add_receiver(message, vehicle.position)
        else:
            self.aiding.add_fed_receiver(message)

    def _add_system_time(self, message: SystemTime, vehicle: ReportedState) -> None:
        self.clocks.add_system_time(message, gps_is_trusted=self._is_trusted(vehicle.sysid))

    def _add_time_answer(self, message: TimeSyncAnswer, vehicle: ReportedState) -> None:
        del vehicle
        self.clocks.add_answer(message)

    def _add_command_result(self, message: CommandResult, vehicle: ReportedState) -> None:
        del vehicle
        self._outbox.extend(self.aiding.add_result(message))

    def _add_parameter(self, message: ParameterValue, vehicle: ReportedState) -> None:
        del vehicle
        self._outbox.extend(self.aiding.add_parameter(message))

    # The fleet: estimates -> integrity report -> GPS health -> aiding decision

    def _review_integrity(self, now_s: float) -> None:
        reviewed = [self._reviewed(vehicle, now_s) for vehicle in self.telemetry]
        self._integrity_report = self.integrity.review(now_s, reviewed, self.frame)
        for sysid in self._integrity_report.diverged:
            self.estimator.reset(sysid, now_s)
            self._notify(now_s, sysid, "warning", "its GPS is back and fits the ranges, our position did not: located anew")

    def _reviewed(self, vehicle: ReportedState, now_s: float) -> ReviewedVehicle:
        sysid = vehicle.sysid
        gps_state = self.gps_health.state(sysid)
        where = self.estimator.estimate(sysid, now_s) if gps_state in PLACED_BY_ESTIMATE else None
        return ReviewedVehicle(
            sysid,
            gps_state,
            is_trusted=self._is_trusted(sysid),
            is_automatic=self._gps_overrides.get(sysid, GpsOverride.AUTO) is GpsOverride.AUTO,
            reported=self.measurements.reported(sysid),
            receiver=vehicle.receiver,
            receiver_fix=self.measurements.receiver_fix(sysid),
            estimate=where if isinstance(where, Estimate) else None,
            median_nis=self._median_nis.get(sysid),
            range_jump_m=self._jumps_m.get(sysid),
        )

    def _review_vehicle(self, vehicle: ReportedState, now_s: float) -> None:
        sysid = vehicle.sysid
        self._update_duplicate_id(sysid, now_s)
        change = self.gps_health.update(sysid, self._gps_evidence(vehicle), now_s)
        if change is not None:
            self._outbox.append(change)
        self._decide_aiding(vehicle, now_s)
        self._update_denied(sysid, now_s)

    def _gps_evidence(self, vehicle: ReportedState) -> GpsEvidence:
        sysid = vehicle.sysid
        report = self._integrity_report
        fault, status = report.faults.get(sysid), report.reacquisitions.get(sysid)
        return GpsEvidence(
            receiver=vehicle.receiver,
            system=vehicle.system,
            ekf=vehicle.ekf,
            contradiction=RangeContradiction(fault.text, fault.is_identified) if fault is not None else None,
            is_return_contradicted=status is ReacquisitionStatus.CONTRADICTED,
            is_return_untested=status is ReacquisitionStatus.UNTESTED,
            is_aided=self.decision(sysid).is_aided,
            has_duplicate_id=sysid in self._duplicate_ids,
            override=self._gps_overrides.get(sysid, GpsOverride.AUTO),
        )

    def _decide_aiding(self, vehicle: ReportedState, now_s: float) -> None:
        sysid = vehicle.sysid
        gps_state = self.gps_health.state(sysid)
        decision = self.aiding.review(vehicle, gps_state, now_s, has_duplicate_id=sysid in self._duplicate_ids)
        self._decisions[sysid] = decision
        self._outbox.extend(decision.outputs)

    def _update_denied(self, sysid: int, now_s: float) -> None:
        is_denied = self.gps_health.state(sysid) in DISTRUSTED or self.decision(sysid).is_self_fed
        if is_denied == (sysid in self._denied):
            return
        self._denied = self._denied ^ {sysid}
        self.estimator.set_denied(self._denied, now_s)
        if is_denied and sysid in self._integrity_report.faults:
            # What it reported of late is in its state: it must start anew, from the ranges alone.
            self.estimator.reset(sysid, now_s)

    def _update_duplicate_id(self, sysid: int, now_s: float) -> None:
        has_duplicate = self.clocks.has_duplicate_id(sysid, now_s)
        if has_duplicate == (sysid in self._duplicate_ids):
            return
        self._duplicate_ids = self._duplicate_ids ^ {sysid}
        if has_duplicate:
            text = StatedReason(InhibitReason.DUPLICATE_ID).text
            self._notify(now_s, sysid, "error", f"{text}; nothing is sent to them, and no position of theirs is used")
        else:
            self._notify(now_s, sysid, "info", "only one autopilot uses its system id any more")

    def _request_time(self, vehicle: ReportedState, now_s: float) -> None:
        if self._transmits:
            notice = self.clocks.report_unanswered(vehicle.sysid, vehicle.first_heard_s, now_s)
            if notice is not None:
                self._outbox.append(notice)
        if vehicle.blocked is not None or vehicle.autopilot is None:
            return
        request = self.clocks.request(vehicle.sysid, now_s)
        if request is not None:
            self._outbox.append(request)

    def _is_trusted(self, sysid: int) -> bool:
        """Return whether what a vehicle reports of its own position is evidence."""
        return self.gps_health.state(sysid) is GpsState.HEALTHY and not self.decision(sysid).is_self_fed

    def _fix_inputs(self, sysid: int, now_s: float) -> FixInputs:
        vehicle = self.telemetry.get(sysid)
        return FixInputs(
            is_trusted=self._is_trusted(sysid),
            has_air_data=vehicle is not None and vehicle.has_air_data(now_s),
            one_way_delay_s=self.clocks.one_way_delay_s(sysid, now_s),
            range_sigma_m=self.measurements.range_sigma_m(sysid),
            median_nis=self._median_nis.get(sysid),
            range_jump_m=self._jumps_m.get(sysid),
        )

    def _estimate_to_send(self, sysid: int, at_s: float) -> Estimate | NoEstimate:
        where = self.estimate(sysid, at_s)
        if isinstance(where, Estimate):
            self._located_enu_m[sysid] = (float(where.position_enu_m[0]), float(where.position_enu_m[1]))
        return where

    def _utc_minus_service_s(self) -> float | None:
        healthy = (v.sysid for v in self.telemetry if self.gps_health.state(v.sysid) is GpsState.HEALTHY)
        return self._utc.minus_service_s(utc for s in healthy if (utc := self.clocks.utc_minus_service_s(s)) is not None)

    # What the host, the operator and the links say

    def _control(self, message: ControlInput) -> None:
        at_s = message.received_at_s
        match message:
            case ClockReference():
                self._outbox.extend(self._utc.update(message))
                self.clocks.set_host_utc(message.utc_minus_service_s if message.synchronised else None)
                if self._update_host_inhibit():
                    for vehicle in self.telemetry:
                        self._decide_aiding(vehicle, at_s)
            case TransmitDisabled():
                self._transmits = False
                self.aiding.disable_transmit()
            case RouteReport():
                self._update_route(message)
            case OperatorCommand():
                self._apply_command(message)
            case ForeignGpsInput():
                reached = self.telemetry.get(message.vehicle) if message.vehicle is not None else None
                if reached is not None:
                    self.aiding.add_foreign(message)
                    self._review_vehicle(reached, at_s)

    def _update_host_inhibit(self) -> bool:
        fault = self._utc.fault()
        return self.aiding.set_host_inhibit(
            StatedReason(InhibitReason.HOST_CLOCK, detail=fault.value) if fault is not None else None
        )

    def _update_route(self, message: RouteReport) -> None:
        vehicle = self.telemetry.get(message.sysid)
        if vehicle is None or not self.telemetry.set_route(message):
            return
        if message.wording is not None:
            self._notify(message.received_at_s, message.sysid, "warning", f"nothing can be sent to it: {message.wording}")
        self._decide_aiding(vehicle, message.received_at_s)

    def _apply_command(self, message: OperatorCommand) -> None:
        override, sysid, at_s = message.override, message.sysid, message.received_at_s
        if isinstance(override, GpsOverride):
            self._gps_overrides[sysid] = override
        else:
            self.aiding.set_override(sysid, override)
        what = {GpsOverride: "GPS", AidingOverride: "aiding", PrimaryOverride: "GPS_PRIMARY"}[type(override)]
        self._notify(at_s, sysid, "info", f"operator: {what} {override.value}")
        vehicle = self.telemetry.get(sysid)
        if vehicle is not None:
            self._review_vehicle(vehicle, at_s)

    def _report_estimator(self, text: str) -> None:
        self._notify(self._now_s, None, "error", text)

    def _notify(self, at_s: float, sysid: int | None, level: str, text: str) -> None:
        self._outbox.append(Notice(at_s, sysid, level, text))
