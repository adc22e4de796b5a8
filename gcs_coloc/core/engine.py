"""The engine: messages in, outputs out, time passed by hand. It has no socket, no clock and no thread.

Use: `receive` each message as it arrives, `poll` whenever `next_deadline` is due and send what it returns. Times never
decrease from call to call.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from gcs_coloc.core.aiding.aiding import Aiding
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.clocks.unanswered_timesync import UnansweredTimesync
from gcs_coloc.core.clocks.vehicle_clocks import TimeSettings
from gcs_coloc.core.estimator import Estimator
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.gps_health import DISTRUSTED, Contradiction, GpsHealthSettings
from gcs_coloc.core.guarded_estimator import GuardedEstimator
from gcs_coloc.core.integrity.monitor import PLACED_BY_ESTIMATE, IntegrityMonitor
from gcs_coloc.core.integrity.report import IntegrityReport, ReacquisitionStatus, ReviewedVehicle
from gcs_coloc.core.measurements import Estimate, NoEstimate
from gcs_coloc.core.messages.aiding import ForeignGpsInput, ParameterSet
from gcs_coloc.core.messages.control import (
    AidingOverride,
    ClockReference,
    ControlInput,
    GpsOverride,
    OperatorCommand,
    PrimaryOverride,
    RouteReport,
    TransmitDisabled,
)
from gcs_coloc.core.messages.inbound import (
    Airspeed,
    Attitude,
    EkfStatus,
    GlobalPosition,
    GpsReceiver,
    Inbound,
    SystemHealth,
    SystemTime,
)
from gcs_coloc.core.messages.outbound import AidingMessage, HealthChanged, Notice, Outbound, TimeSyncRequest
from gcs_coloc.core.range_jumps import RangeJumps
from gcs_coloc.core.residual_log import ResidualLog
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.core.telemetry.measurement_builder import MeasurementBuilder, MeasurementSettings
from gcs_coloc.core.telemetry.stream_requests import StreamRequests
from gcs_coloc.core.telemetry.vehicles import Vehicle, VehicleRegistry
from gcs_coloc.core.telemetry_router import Telemetry
from gcs_coloc.core.tick_schedule import TickSchedule
from gcs_coloc.core.utc import Utc
from gcs_coloc.core.vehicle_snapshot import vehicle_snapshot

REVIEWED_EVERY_S = 0.2
_REJECTED_FIXES = "GPS: back, but contradicted by ranges"
_DOUBLED = (
    "two autopilots use its system id; give each its own (MAV_SYSID, SYSID_THISMAV before ArduPilot 4.7; MAV_SYS_ID on PX4)"
)
_MESSAGE_IDS = {GlobalPosition: 33, Attitude: 30, Airspeed: 74, SystemHealth: 1, EkfStatus: 193, SystemTime: 2}


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
    """One fleet: registry, GPS health, estimator and aid. Deterministic: the same calls give the same outputs.

    `reviewed_at_s` is the deadline (service time) at which every vehicle was reviewed last, five times a second.
    """

    def __init__(self, estimator: Estimator, settings: EngineSettings | None = None) -> None:
        self.settings = settings if settings is not None else EngineSettings()
        self.estimator: Estimator = GuardedEstimator(estimator, self._tell_of_estimator)
        # The receiver that we feed never counts as evidence of a vehicle's own GPS.
        own_receiver = 1 if self.settings.aiding.gps_id == 0 else 0
        self.fleet = VehicleRegistry(self.settings.gps_health, self.settings.max_vehicles, own_receiver)
        self.feed = MeasurementBuilder(self.settings.measurements, self.settings.time)
        self.aiding = Aiding(self.settings.aiding)
        self.integrity = IntegrityMonitor()
        self._integrity_report = IntegrityReport()
        self._streams = StreamRequests()
        self._residuals = ResidualLog()
        self._jumps = RangeJumps()
        self._jumps_m: dict[int, float] = {}
        self._outbox: list[Outbound] = []
        self._refused: Counter[str] = Counter()
        self._now_s = float("-inf")
        self._unanswered = UnansweredTimesync(self.settings.time)
        self._utc = Utc(required=self.settings.time.require_synchronised_clock)
        self.aiding.withheld = self._utc.withheld()
        self._denied: frozenset[int] = frozenset()
        self._gps_words: dict[int, GpsOverride] = {}
        self._housekeeping_due_s = float("inf")
        self.reviewed_at_s = float("-inf")
        self._telemetry = Telemetry(self.fleet, self.feed, self.aiding, self.integrity, self.estimator, self._tell)

    def receive(self, message: Inbound) -> None:
        """Take one message. Never raises for its content: what cannot be used is counted by reason."""
        at_s = self._now_s = message.received_at_s
        if self._housekeeping_due_s == float("inf"):
            # The first message sets the grid of deadlines, so that a recording of the messages holds it.
            self._housekeeping_due_s = at_s
            self.aiding.grid = TickSchedule(at_s)
        if isinstance(message, ControlInput):
            self._note(message)
            return
        vehicle = self.fleet.get(message.sysid)
        if vehicle is not None:
            vehicle.last_heard_s = at_s
        elif (vehicle := self._first_heard(message.sysid, at_s)) is None:
            return
        resets = vehicle.clock.resets
        if self._telemetry.take(message, vehicle):
            self._review(vehicle, at_s)
        if vehicle.clock.resets != resets and vehicle.health.duplicate_id is None:
            self._streams.restarted(vehicle.sysid)
            self.aiding.restarted(vehicle.sysid)
            self._say(at_s, vehicle.sysid, "warning", "its clock jumped: taken as a reboot")
        message_id = _MESSAGE_IDS.get(type(message))
        if message_id is None and isinstance(message, GpsReceiver):
            message_id = 24 if message.receiver == 0 else 124
        if message_id is not None:
            self._streams.heard(vehicle.sysid, message_id, at_s)

    def poll(self, now_s: float) -> list[Outbound]:
        """Everything that is to be sent or told by now."""
        self._now_s = now_s
        if now_s >= self._housekeeping_due_s:
            self._housekeeping_due_s = self.aiding.grid.after(now_s, REVIEWED_EVERY_S)
            self.reviewed_at_s = now_s
            self._review_integrity(now_s)
            for sysid in self._integrity_report.diverged:
                self.estimator.reset(sysid, now_s)
                self._say(now_s, sysid, "warning", "its GPS is back and fits the ranges, our position did not: located anew")
            for vehicle in self.fleet:
                self._review(vehicle, now_s)
                self._ask_time(vehicle, now_s)
            misfit = self._residuals.misfit()
            for vehicle in self.fleet:
                vehicle.range_misfit = misfit.get(vehicle.sysid)
            self._outbox.extend(self.aiding.parameters.due(now_s))
            if self.settings.request_streams:
                self._outbox.extend(self._streams.due(now_s))
        return self.serve(now_s)

    def serve(self, now_s: float) -> list[Outbound]:
        """What aided vehicles are to be sent by now, and what there was to tell: `poll` without its review of the fleet."""
        self._now_s = now_s
        self._note_residuals(now_s)
        out, self._outbox = self._outbox, []
        out.extend(self.aiding.due(now_s, self.feed.frame, self._utc.minus_service_s(self.fleet), self._answer))
        return out

    def _note_residuals(self, now_s: float) -> None:
        residuals = self.estimator.drain_residuals()
        self._residuals.take(residuals, now_s)
        self._jumps.take(residuals, now_s)
        sizes_m = self._jumps.sizes_m(now_s)
        if sizes_m != self._jumps_m:
            self._jumps_m = sizes_m
            for vehicle in self.fleet:
                vehicle.range_jump_m = sizes_m.get(vehicle.sysid)

    def next_deadline(self) -> float:
        """The service time at which `poll` is to be called at the latest; infinity before the first message."""
        housekeeping_s, aid_s = self._housekeeping_due_s, self.aiding.next_due_s()
        return housekeeping_s if housekeeping_s < aid_s else aid_s

    def next_aid_s(self) -> float:
        """The service time at which the next vehicle is to be sent its aid; infinity where nobody is aided."""
        return self.aiding.next_due_s()

    def close(self) -> list[AidingMessage | ParameterSet]:
        """The last messages before the service ends: fix_type 1 to everyone who is being aided, and what was set is restored."""
        return self.aiding.close()

    def refused(self) -> dict[str, int]:
        """How often what was refused, by reason, since the start."""
        total = self._refused.copy()
        for counts in (self._telemetry.refused, self.feed.refused, self.aiding.refused):
            total.update(counts)
        if self._integrity_report.rejected_fixes:
            total[_REJECTED_FIXES] += self._integrity_report.rejected_fixes
        return dict(total)

    def snapshot(self, now_s: float) -> FleetSnapshot:
        """The fleet as it stands, for observers."""
        consistency = self._residuals.consistency()
        frame, time = self.feed.frame, self.settings.time
        vehicles = tuple(
            vehicle_snapshot(v, self.estimate(v.sysid, now_s), frame, self.aiding, consistency.get(v.sysid), time, now_s)
            for v in sorted(self.fleet, key=lambda v: v.sysid)
        )
        return FleetSnapshot(
            at_s=now_s,
            estimator=self.estimator.name,
            vehicles=vehicles,
            refused=self.refused(),
            estimator_counts=dict(self.estimator.counts()),
            ranges=self._residuals.ranges(now_s),
            utc_minus_service_s=self._utc.minus_service_s(self.fleet),
            origin=(frame.lat_deg, frame.lon_deg, frame.height_m) if frame is not None else None,
        )

    def estimate(self, sysid: int, at_s: float) -> Estimate | NoEstimate:
        """The estimator's answer for one vehicle at one service time, its covariance inflated by the solution separation."""
        where = self.estimator.estimate(sysid, at_s)
        return self._integrity_report.inflate(where) if isinstance(where, Estimate) else where

    def _review_integrity(self, now_s: float) -> None:
        vehicles = [self._reviewed(vehicle, now_s) for vehicle in self.fleet]
        report = self._integrity_report = self.integrity.review(now_s, vehicles, self.feed.frame)
        for vehicle in self.fleet:
            fault, status = report.faults.get(vehicle.sysid), report.reacquisitions.get(vehicle.sysid)
            vehicle.health.contradiction = Contradiction(fault.text, fault.is_identified) if fault is not None else None
            vehicle.health.return_doubted = status is ReacquisitionStatus.CONTRADICTED
            vehicle.health.return_untested = status is ReacquisitionStatus.UNTESTED

    def _reviewed(self, vehicle: Vehicle, now_s: float) -> ReviewedVehicle:
        health = vehicle.health
        where = self.estimator.estimate(vehicle.sysid, now_s) if health.state in PLACED_BY_ESTIMATE else None
        return ReviewedVehicle(
            vehicle.sysid,
            health.state,
            is_trusted=health.trusted,
            is_automatic=health.word is GpsOverride.AUTO,
            reported=vehicle.claim,
            receiver=vehicle.receiver,
            receiver_fix=vehicle.receiver_fix,
            estimate=where if isinstance(where, Estimate) else None,
            median_nis=vehicle.range_misfit,
            range_jump_m=vehicle.range_jump_m,
        )

    @property
    def frame(self) -> LocalFrame | None:
        """The fleet's frame; None until a vehicle with healthy GPS has set its origin."""
        return self.feed.frame

    def _first_heard(self, sysid: int, at_s: float) -> Vehicle | None:
        vehicle = self.fleet.add(sysid, at_s)
        if vehicle is None:
            self._refused["more vehicles than the fleet may have"] += 1
            return None
        self._say(at_s, sysid, "info", "heard for the first time")
        vehicle.health.word = self._gps_words.get(sysid, GpsOverride.AUTO)
        return vehicle

    def _note(self, message: ControlInput) -> None:
        match message:
            case ClockReference():
                self._host_time(message)
            case TransmitDisabled():
                self.aiding.on_air = False
            case RouteReport():
                self._reroute(message)
            case OperatorCommand():
                self._apply_command(message)
            case ForeignGpsInput():
                self._note_other(message)

    def _reroute(self, message: RouteReport) -> None:
        vehicle = self.fleet.get(message.sysid)
        if vehicle is None or vehicle.blocked == message.wording:
            return
        vehicle.blocked = message.wording
        if message.wording is not None:
            self._say(message.received_at_s, vehicle.sysid, "warning", f"nothing can be sent to it: {message.wording}")
        self._outbox.extend(self.aiding.review(vehicle, message.received_at_s))

    def _apply_command(self, message: OperatorCommand) -> None:
        override, sysid = message.override, message.sysid
        vehicle = self.fleet.get(sysid)
        if isinstance(override, AidingOverride):
            self.aiding.words[sysid] = override
            self._say(message.received_at_s, sysid, "info", f"operator: aid {override.value}")
        elif isinstance(override, PrimaryOverride):
            self.aiding.primary_words[sysid] = override
            self._say(message.received_at_s, sysid, "info", f"operator: GPS_PRIMARY {override.value}")
        else:
            self._gps_words[sysid] = override
            self._say(message.received_at_s, sysid, "info", f"operator: GPS {override.value}")
            if vehicle is not None:
                vehicle.health.word = override
        if vehicle is not None:
            self._review(vehicle, message.received_at_s)

    def _note_other(self, message: ForeignGpsInput) -> None:
        vehicle = self.fleet.get(message.vehicle) if message.vehicle is not None else None
        if vehicle is not None:
            self.aiding.heard_other(message)
            self._review(vehicle, message.received_at_s)

    def _review(self, vehicle: Vehicle, now_s: float) -> None:
        self._look_for_twins(vehicle, now_s)
        before = vehicle.health.state
        if vehicle.health.update(now_s):
            after = vehicle.health.state
            self._outbox.append(HealthChanged(now_s, vehicle.sysid, before.value, after.value, vehicle.health.reason))
        self._outbox.extend(self.aiding.review(vehicle, now_s))
        if _is_denied(vehicle) == (vehicle.sysid in self._denied):
            return
        self._denied = denied = self._denied ^ {vehicle.sysid}
        self.estimator.set_denied(denied, now_s)
        if vehicle.health.contradiction is not None and vehicle.sysid in denied:
            # What it said of late is in its state: it must start anew, from the ranges alone.
            self.estimator.reset(vehicle.sysid, now_s)

    def _look_for_twins(self, vehicle: Vehicle, now_s: float) -> None:
        duplicate_id = _DOUBLED if vehicle.clock.twins.seen(now_s) else None
        if duplicate_id == vehicle.health.duplicate_id:
            return
        vehicle.health.duplicate_id = duplicate_id
        if duplicate_id is not None:
            self._say(
                now_s, vehicle.sysid, "error", f"{duplicate_id}; nothing is sent to them, and no position of theirs is used"
            )
        else:
            self._say(now_s, vehicle.sysid, "info", "only one autopilot uses its system id any more")

    def _ask_time(self, vehicle: Vehicle, now_s: float) -> None:
        if self.aiding.on_air:
            unanswered = self._unanswered.news(vehicle.sysid, vehicle.clock, vehicle.first_heard_s, now_s)
            if unanswered is not None:
                self._say(now_s, vehicle.sysid, *unanswered)
        if vehicle.blocked is not None or vehicle.autopilot is None:
            return
        ts1_ns = vehicle.clock.round_trips.ask(vehicle.sysid, now_s, self.settings.time.timesync_period_s)
        if ts1_ns is not None:
            self._outbox.append(TimeSyncRequest(vehicle.sysid, ts1_ns))

    def _answer(self, sysid: int, at_s: float) -> Estimate | NoEstimate:
        where = self.estimate(sysid, at_s)
        vehicle = self.fleet.get(sysid)
        if vehicle is not None and isinstance(where, Estimate):
            vehicle.last_known_enu_m = (float(where.position_enu_m[0]), float(where.position_enu_m[1]))
        return where

    def _host_time(self, message: ClockReference) -> None:
        self._outbox.extend(self._utc.take(message))
        self.feed.host_utc_minus_service_s = message.utc_minus_service_s if message.synchronised else None
        if self.aiding.withheld != self._utc.withheld():
            self.aiding.withheld = self._utc.withheld()
            for vehicle in self.fleet:
                self._outbox.extend(self.aiding.review(vehicle, message.received_at_s))

    def _tell_of_estimator(self, text: str) -> None:
        self._say(self._now_s, None, "error", text)

    def _tell(self, output: Outbound) -> None:
        self._outbox.append(output)

    def _say(self, at_s: float, sysid: int | None, level: str, text: str) -> None:
        self._outbox.append(Notice(at_s, sysid, level, text))


def _is_denied(vehicle: Vehicle) -> bool:
    return vehicle.health.state in DISTRUSTED or vehicle.health.self_fed
