"""The engine: messages in, outputs out, time passed by hand. It has no socket, no clock and no thread.

Use: `receive` each message as it arrives, `poll` whenever `next_deadline` is due and send what it returns. Times never
decrease from call to call.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from gcs_coloc.core.aiding.aiding import Aiding
from gcs_coloc.core.aiding.inhibit import InhibitReason
from gcs_coloc.core.aiding.methods.ranging_beacon import VettedRanges
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.aiding.stream import AidingDecision
from gcs_coloc.core.clocks.fleet_clocks import FleetClocks
from gcs_coloc.core.clocks.vehicle_clocks import TimeSettings
from gcs_coloc.core.dispatch import MessageDispatch, Stages
from gcs_coloc.core.estimator import Estimator, GuardedEstimator
from gcs_coloc.core.fleet_review import FleetReview
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.gps_health import FleetGpsHealth, GpsHealthSettings, GpsState
from gcs_coloc.core.integrity.monitor import IntegrityMonitor
from gcs_coloc.core.integrity.protection_level import ProtectionSettings
from gcs_coloc.core.measurements import Estimate, NoEstimate
from gcs_coloc.core.messages.control import (
    ClockReference,
    ControlInput,
    ForeignGpsInput,
    HoldBack,
    OperatorCommand,
    RouteReport,
    SwitchedByOther,
    TransmitDisabled,
)
from gcs_coloc.core.messages.inbound import Inbound
from gcs_coloc.core.messages.outbound import ChangesVehicle, Notice, Outbound, ToVehicle
from gcs_coloc.core.operator_overrides import OperatorOverrides
from gcs_coloc.core.readiness.vehicle_readiness import VehicleReadiness
from gcs_coloc.core.reasons import CoreRefusal, StatedReason
from gcs_coloc.core.schedule import TickSchedule
from gcs_coloc.core.snapshot import FleetSnapshot, vehicle_snapshot
from gcs_coloc.core.stations.station_survey import StationSurvey
from gcs_coloc.core.stations.stations import Station, Stations
from gcs_coloc.core.telemetry.measurement_builder import MeasurementBuilder
from gcs_coloc.core.telemetry.measurement_settings import MeasurementSettings
from gcs_coloc.core.telemetry.proven_vehicles import ProvenVehicles
from gcs_coloc.core.telemetry.reported_state import ReportedState, Telemetry
from gcs_coloc.core.telemetry.stream_requests import StreamRequests

REVIEWED_EVERY_S = 0.2
"""Chosen: a fifth of a second is short against what GPS health waits for, and a fleet's review takes a few milliseconds."""


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """Settings of one fleet.

    `max_vehicles` bounds every table of vehicles, but for what operators decided of them; `request_streams` asks vehicles for
    missing messages.

    `stations` are the fixed stations whose position is known. `names` is what people call the vehicles, by system id.
    """

    gps_health: GpsHealthSettings = field(default_factory=GpsHealthSettings)
    measurements: MeasurementSettings = field(default_factory=MeasurementSettings)
    aiding: AidingSettings = field(default_factory=AidingSettings)
    time: TimeSettings = field(default_factory=TimeSettings)
    integrity: ProtectionSettings = field(default_factory=ProtectionSettings)
    request_streams: bool = True
    max_vehicles: int = 250
    stations: tuple[Station, ...] = ()
    names: Mapping[int, str] = field(default_factory=dict)


class Engine:
    """One fleet, as a pipeline of stages. Deterministic: the same calls give the same outputs.

    telemetry -> clocks -> measurements -> estimator -> integrity -> GPS health -> aiding

    Each stage returns values and keeps the rest private. Dispatch and review alone hand a stage's result to the next one, and
    what a later stage found in the last round to an earlier one.

    `reviewed_at_s` is the service time of the last review of all vehicles.
    """

    def __init__(self, estimator: Estimator, settings: EngineSettings | None = None) -> None:
        self.settings = s = settings if settings is not None else EngineSettings()
        # The receiver that we feed never counts as evidence of a vehicle's own GPS.
        self.telemetry = Telemetry(s.max_vehicles, own_receiver=1 if s.aiding.gps_id == 0 else 0)
        self.proven = ProvenVehicles()
        self.clocks = FleetClocks(s.time, s.measurements.max_age_s)
        sigmas_m = s.measurements.position_sigma_h_m, s.measurements.position_sigma_v_m
        self.stations = Stations(s.stations, s.measurements.ranging_beacon_ids, sigmas_m)
        self.measurements = MeasurementBuilder(s.measurements, self.clocks)
        self.estimator = GuardedEstimator(estimator, self._report_estimator)
        self.integrity = IntegrityMonitor(s.integrity)
        self.gps_health = FleetGpsHealth(s.gps_health)
        self._overrides = OperatorOverrides()
        self.aiding = Aiding(s.aiding, self._overrides)
        stages = Stages(
            self.telemetry,
            self.proven,
            self.clocks,
            self.stations,
            self.measurements,
            self.estimator,
            self.integrity,
            self.gps_health,
            self.aiding,
            VettedRanges(s.aiding.hands_over_ranges),
            StationSurvey(),
        )
        self._dispatch = MessageDispatch(stages)
        self._review = FleetReview(stages, s.aiding, s.integrity, self._overrides)
        self.reviewed_at_s = float("-inf")
        self._streams = StreamRequests()
        self._refused: Counter[CoreRefusal] = Counter()
        self._outbox: list[Outbound] = []
        self._now_s = float("-inf")
        self._review_due_s = float("inf")
        self._review_schedule = TickSchedule(0.0)
        self._update_host_inhibit()

    def receive(self, message: Inbound) -> None:
        """Receive one message. Never raises for its content: what cannot be used is counted by reason."""
        at_s = self._now_s = message.received_at_s
        if self._review_due_s == float("inf"):
            # The first message sets the schedule of deadlines, so that a recording of the messages holds it.
            self._review_due_s = at_s
            self._review_schedule = TickSchedule(at_s)
            self.aiding.set_schedule(self._review_schedule)
        if isinstance(message, ControlInput):
            self._control(message)
            return
        sysid = message.sysid
        vehicle = self.telemetry.get(sysid)
        if vehicle is None and (vehicle := self._add_vehicle(sysid, at_s)) is None:
            return
        self.proven.update(vehicle, at_s)
        clock = self.clocks.boot_clock(sysid)
        resets = clock.resets
        needs_review = self.telemetry.update(message)
        self._outbox.extend(self._dispatch.add(message, vehicle, self._review.last_round))
        if needs_review:
            self._outbox.extend(self._review.review_vehicle(vehicle, at_s))
        if clock.resets != resets and not self.clocks.has_duplicate_id(sysid):
            self._streams.forget(sysid)
            self.aiding.forget_parameters(sysid)
            self._notify(at_s, sysid, "warning", "its clock jumped: taken as a reboot")

    def poll(self, now_s: float) -> list[Outbound]:
        """Run the stages that are due, and return all that is to be sent or shown by now."""
        self._now_s = now_s
        is_review_due = now_s >= self._review_due_s
        if is_review_due:
            self._review_fleet(now_s)
        out = self.serve(now_s)
        if is_review_due:
            # After the residuals: to predict must not bring them forward.
            self._review.review_readiness(now_s)
        return out

    def _review_fleet(self, now_s: float) -> None:
        """Run integrity, and for each vehicle the stages from GPS health on; ask vehicles for what is missing."""
        self._review_due_s = self._review_schedule.after(now_s, REVIEWED_EVERY_S)
        self.reviewed_at_s = now_s
        self._outbox.extend(self._review.review_integrity(now_s))
        for vehicle in self.telemetry:
            self._outbox.extend(self._review.review_vehicle(vehicle, now_s))
            self._request_time(vehicle, now_s)
        self._review.end_round()
        self._outbox.extend(self.aiding.parameter_requests(now_s))
        if self.settings.request_streams:
            self._outbox.extend(self._streams.due(now_s, self.telemetry.heard_streams()))

    def serve(self, now_s: float) -> list[Outbound]:
        """Return what is to be sent and shown by now: `poll` without its review of the fleet."""
        self._now_s = now_s
        review = self._review
        review.add_residuals(self.estimator.drain_residuals(), now_s)
        out, self._outbox = self._outbox, []
        utc_minus_service_s = self._utc_minus_service_s()
        out.extend(self.aiding.poll(now_s, review.fix_inputs, self.frame, utc_minus_service_s, review.estimate_to_send))
        return [output for output in out if not isinstance(output, ChangesVehicle)] if self.aiding.is_held_back else out

    def next_deadline(self) -> float:
        """Return the service time by which `poll` is to be called; infinity before the first message."""
        review_s, aiding_s = self._review_due_s, self.aiding.next_due_s
        return review_s if review_s < aiding_s else aiding_s

    def next_aid_s(self) -> float:
        """Return the service time at which the next aiding message is due; infinity where nobody is aided."""
        return self.aiding.next_due_s

    def close(self) -> list[ToVehicle]:
        """Return the last messages: fix_type 1 to everyone who is aided, and restored parameters."""
        last = self.aiding.close()
        return [] if self.aiding.is_held_back else last

    def refused(self) -> dict[str, int]:
        """Return how often what was refused since the start, by the value of `CoreRefusal`."""
        total = self._refused.copy()
        for counts in (self.clocks.refused, self.stations.refused, self.measurements.refused, self.aiding.refused):
            total.update(counts)
        if self._review.report.rejected_fixes:
            total[CoreRefusal.REACQUIRED_FIX_REJECTED] += self._review.report.rejected_fixes
        return {reason.value: count for reason, count in total.items()}

    @property
    def frame(self) -> LocalFrame | None:
        """The fleet's frame; None until a vehicle with healthy GPS, or a station, has set its origin."""
        return self.measurements.frame

    def sysids(self) -> list[int]:
        """Return the system ids of the vehicles heard so far."""
        return [vehicle.sysid for vehicle in self.telemetry]

    def gps_state(self, sysid: int) -> GpsState:
        """Return the state of a vehicle's GPS health; UNKNOWN for a vehicle that was never heard."""
        return self.gps_health[sysid].state

    def decision(self, sysid: int) -> AidingDecision:
        """Return what aiding decided last about a vehicle."""
        return self._review.decision(sysid)

    def readiness(self, sysid: int) -> VehicleReadiness | None:
        """Return whether a vehicle would be located without GPS; None if it is not healthy or not predicted."""
        return self._review.readiness.of(sysid)

    def estimate(self, sysid: int, at_s: float) -> Estimate | NoEstimate:
        """Return the estimate of a vehicle at a service time, with its protection level."""
        return self._review.estimate(sysid, at_s)

    def snapshot(self, now_s: float) -> FleetSnapshot:
        """Return the fleet as it stands, for observers."""
        review, frame = self._review, self.frame
        consistency = review.residuals.consistency()
        vehicles = [
            vehicle_snapshot(
                vehicle,
                review.estimate(vehicle.sysid, now_s),
                frame,
                name=self.settings.names.get(vehicle.sysid, ""),
                gps_health=self.gps_health[vehicle.sysid],
                overrides=self._overrides,
                aiding=review.aiding_view(vehicle),
                delay_s=self.measurements.delay_s(vehicle.sysid),
                clock=self.clocks.boot_clock(vehicle.sysid).quality(now_s),
                consistency=consistency.get(vehicle.sysid),
                readiness=review.readiness.of(vehicle.sysid),
                now_s=now_s,
            )
            for vehicle in sorted(self.telemetry, key=lambda v: v.sysid)
        ]
        return FleetSnapshot(
            at_s=now_s,
            estimator=self.estimator.name,
            vehicles=tuple(vehicles),
            refused=self.refused(),
            estimator_counts=dict(self.estimator.counts()),
            ranges=review.residuals.ranges(now_s),
            utc_minus_service_s=self._utc_minus_service_s(),
            origin=(frame.lat_deg, frame.lon_deg, frame.height_m) if frame is not None else None,
            loop_lag_s=self.clocks.host_lag_s,
            stations=review.stations.snapshots(review.report, now_s),
            noise=review.report.noise,
            alert_limit_m=self.settings.aiding.alert_limit_m,
        )

    def _add_vehicle(self, sysid: int, at_s: float) -> ReportedState | None:
        if self.telemetry.is_full:
            self._make_room(at_s)
        vehicle = self.telemetry.add(sysid, at_s)
        if vehicle is None:
            self._refused[CoreRefusal.FLEET_FULL] += 1
            return None
        self.proven.add(sysid, at_s)
        self._notify(at_s, sysid, "info", "heard for the first time")
        return vehicle

    def _make_room(self, now_s: float) -> None:
        """Forget a vehicle, where one was never proven, is sent nothing and has nothing to be restored."""
        for sysid in self.proven.replaceable(tuple(self.telemetry), now_s):
            if sysid not in self.aiding.to_change():
                self._dispatch.forget(sysid)
                self._review.forget(sysid, now_s)
                self._streams.forget(sysid)
                return

    def _request_time(self, vehicle: ReportedState, now_s: float) -> None:
        if self.aiding.transmits:
            notice = self.clocks.report_unanswered(vehicle.sysid, vehicle.first_heard_s, now_s)
            if notice is not None:
                self._outbox.append(notice)
        if vehicle.blocked is not None or vehicle.autopilot is None:
            return
        request = self.clocks.request(vehicle.sysid, now_s)
        if request is not None:
            self._outbox.append(request)

    def _utc_minus_service_s(self) -> float | None:
        return self.clocks.utc_minus_service_s(
            vehicle.sysid for vehicle in self.telemetry if self.gps_health[vehicle.sysid].state is GpsState.HEALTHY
        )

    def _control(self, message: ControlInput) -> None:
        at_s = message.received_at_s
        match message:
            case ClockReference():
                self._outbox.extend(self.clocks.set_host_clock(message))
                if self._update_host_inhibit():
                    for vehicle in self.telemetry:
                        self._outbox.extend(self._review.decide_aiding(vehicle, at_s))
            case TransmitDisabled():
                self.aiding.disable_transmit()
            case HoldBack():
                self.aiding.hold_back(held=message.held)
            case SwitchedByOther():
                self.aiding.add_switched(message)
            case RouteReport():
                self._update_route(message)
            case OperatorCommand():
                self._apply_command(message)
            case ForeignGpsInput():
                reached = self.telemetry.get(message.vehicle) if message.vehicle is not None else None
                if reached is not None:
                    self.aiding.add_foreign(message)
                    self._outbox.extend(self._review.review_vehicle(reached, at_s))

    def _update_host_inhibit(self) -> bool:
        fault = self.clocks.host_fault()
        inhibit = StatedReason(InhibitReason.HOST_CLOCK, detail=fault.value) if fault is not None else None
        return self.aiding.set_host_inhibit(inhibit)

    def _update_route(self, message: RouteReport) -> None:
        vehicle = self.telemetry.get(message.sysid)
        if vehicle is None or not self.telemetry.set_route(message):
            return
        if message.wording is not None:
            self._notify(message.received_at_s, message.sysid, "warning", f"nothing can be sent to it: {message.wording}")
        self._outbox.extend(self._review.decide_aiding(vehicle, message.received_at_s))

    def _apply_command(self, message: OperatorCommand) -> None:
        self._outbox.append(self._overrides.add(message))
        vehicle = self.telemetry.get(message.sysid)
        if vehicle is not None:
            self._outbox.extend(self._review.review_vehicle(vehicle, message.received_at_s))

    def overrides(self) -> tuple[OperatorCommand, ...]:
        """Return the operator's overrides that are in force, those that are automatic left out."""
        return self._overrides.in_force()

    def _report_estimator(self, text: str) -> None:
        self._notify(self._now_s, None, "error", text)

    def _notify(self, at_s: float, sysid: int | None, level: str, text: str) -> None:
        self._outbox.append(Notice(at_s, sysid, level, text))
