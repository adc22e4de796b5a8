"""The aiding stage: decides which vehicle is aided, by which method, and why one is not."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field

from gcs_coloc.core.aiding.acknowledgement import FixAcknowledgement
from gcs_coloc.core.aiding.inhibit import Inhibit, InhibitReason, VehicleInhibits
from gcs_coloc.core.aiding.methods.method import FixInputs, MethodContext
from gcs_coloc.core.aiding.methods.px4_positions import LocalOrigin, Px4Methods
from gcs_coloc.core.aiding.methods.registry import METHODS, method_for, mismatch
from gcs_coloc.core.aiding.parameters import Parameters
from gcs_coloc.core.aiding.receiver_switch import ReceiverSwitch
from gcs_coloc.core.aiding.settings import AidingMethodName, AidingSettings
from gcs_coloc.core.aiding.stream import AidingDecision, AidingStream, AidingView, EstimateAt, Purpose
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.messages.control import (
    AidingOverride,
    ForeignGpsInput,
    PrimaryOverride,
    RouteBlock,
    SwitchedByOther,
    SwitchedReceiver,
)
from gcs_coloc.core.messages.inbound import Autopilot, CommandResult, GlobalOrigin, GpsReceiver, ParameterValue
from gcs_coloc.core.messages.outbound import Notice, Outbound, ParameterRequest, ToVehicle
from gcs_coloc.core.operator_overrides import OperatorOverrides
from gcs_coloc.core.reasons import CoreRefusal, StatedReason
from gcs_coloc.core.schedule import TickSchedule
from gcs_coloc.core.telemetry.altitude_builder import SentFix
from gcs_coloc.core.telemetry.reported_state import ReportedState

_AIDED_STATES = (GpsState.FAILED, GpsState.RECOVERING)
_STANDBY_STATES = (GpsState.HEALTHY, GpsState.SUSPECT)


@dataclass(slots=True)
class _Vehicle:
    """What is kept of one vehicle, whether it has a stream or not. `sent_fix` is the last one."""

    inhibits: VehicleInhibits = field(default_factory=VehicleInhibits)
    origin: LocalOrigin = field(default_factory=LocalOrigin)
    sent_fix: SentFix | None = None


class Aiding:
    """Decides on the aiding of each vehicle, and keeps one stream for each to which it sends positions.

    `review` returns each decision. `refused` counts what vehicles refuse. `next_due_s`: when the next message is due; infinity
    where nobody is aided. `transmits`, `is_held_back`: as `disable_transmit` and `hold_back` set them.
    """

    def __init__(self, settings: AidingSettings, overrides: OperatorOverrides) -> None:
        self.refused: Counter[CoreRefusal] = Counter()
        self._settings = settings
        self._overrides = overrides
        self._host_inhibit: Inhibit | None = None
        self.transmits = True
        self.is_held_back = False
        self._tick_schedule = TickSchedule(0.0)
        self._parameters = Parameters()
        self._px4 = Px4Methods(self._parameters)
        self._switch = ReceiverSwitch(settings.gps_id)
        self._streams: dict[int, AidingStream] = {}
        self._vehicles: defaultdict[int, _Vehicle] = defaultdict(_Vehicle)
        self.next_due_s = float("inf")

    def set_schedule(self, schedule: TickSchedule) -> None:
        """Set the times that streams keep."""
        self._tick_schedule = schedule

    def disable_transmit(self) -> None:
        """From now on nothing that is built is sent: vehicles cannot be expected to use it."""
        self.transmits = False

    def hold_back(self, *, held: bool) -> None:
        """Set whether what is built is held back, as the other service of a hot standby sends and tells of it.

        Aiding decides and builds as ever then, but starts no receiver switch.
        """
        if self.is_held_back and not held:
            for kept in self._vehicles.values():
                kept.inhibits.restart_alarm()
        self.is_held_back = held

    def add_switched(self, message: SwitchedByOther) -> None:
        """Add what the other service has switched, so that we can restore it."""
        self._switch.adopt(message.receiver, message.received_at_s, held=message.held)

    def switched(self) -> tuple[SwitchedReceiver, ...]:
        """Return the vehicles whose own receiver is out of use by us, or may be, with what restores it."""
        return self._switch.held()

    def to_change(self) -> frozenset[int]:
        """Return the vehicles to which something is to be sent that changes what they do."""
        return frozenset(self._streams) | {receiver.sysid for receiver in self._switch.held()}

    def set_host_inhibit(self, inhibit: Inhibit | None) -> bool:
        """Set why nobody may be aided, None where vehicles may; True where that has changed."""
        changed = inhibit != self._host_inhibit
        self._host_inhibit = inhibit
        return changed

    def review(
        self, vehicle: ReportedState, gps_state: GpsState, now_s: float, *, has_duplicate_id: bool, reports_false_fix: bool
    ) -> AidingDecision:
        """Decide on the aiding of one vehicle: begin, change or end its stream.

        `reports_false_fix`: its own receiver has failed and reports a fix all the same, or one that came and went.
        """
        sysid, stream, held = vehicle.sysid, self._streams.get(vehicle.sysid), self.is_held_back
        kept = self._vehicles[sysid]
        out: list[Outbound] = list(kept.inhibits.review_foreign(sysid, self._settings.stand_down_s, now_s))
        if vehicle.autopilot is Autopilot.PX4:
            if self._settings.method_of(sysid) == "auto":
                self._px4.request(sysid, now_s)
            if self._method(vehicle) == "vision_position":
                out.extend(kept.origin.request(sysid, now_s))
        if stream is not None and stream.purpose is Purpose.HAND_BACK and gps_state is not GpsState.HEALTHY:
            # It is handed back only to a receiver that has been healthy all the while.
            stream.restart_purpose(now_s)
        purpose = self._purpose(vehicle, gps_state, stream, now_s)
        inhibit = self._inhibit(vehicle, has_duplicate_id=has_duplicate_id)
        if purpose is Purpose.STANDBY and inhibit is None:
            out.extend(kept.inhibits.review_standby(sysid, self._parameters, self._settings.gps_id, now_s))
            purpose = None if kept.inhibits.obstacle is not None else purpose
        name = self._method(vehicle)
        if stream is not None and (purpose is None or inhibit is not None or stream.name != name):
            out.extend(self._end(sysid, stream, inhibit, gps_state, now_s))
            stream = None
        if stream is None and purpose is not None and inhibit is None:
            stream = self._streams[sysid] = self._open_stream(vehicle, name, purpose, now_s)
            self._update_due()
        elif stream is not None and purpose is not None:
            stream.set_purpose(purpose, now_s)
        if stream is not None and stream.acknowledgement is not None:
            change = stream.acknowledgement.review(vehicle, now_s, is_held_back=held)
            if change is not None:
                out.append(Notice(now_s, sysid, *change))
        is_lost = reports_false_fix or (gps_state is GpsState.FAILED and vehicle.autopilot is not Autopilot.PX4)
        primary, is_switching = self._overrides.of(sysid, PrimaryOverride), self._switch.switching(sysid)
        wanted = stream is not None and stream.wants_switch(primary, is_switching=is_switching, is_lost=is_lost)
        if not held:
            out.extend(self._switch.review(sysid, vehicle.autopilot, now_s, wanted=wanted))
        is_self_fed = self._override(sysid) is AidingOverride.ON or self._switch.holds(sysid)
        is_aided = stream is not None and (gps_state in _AIDED_STATES or is_self_fed)
        needs_aid = purpose is Purpose.AID
        out.extend(kept.inhibits.review_alarm(vehicle, inhibit, now_s, needs_aid=needs_aid, is_held_back=held))
        return AidingDecision(stream.name if stream is not None else None, purpose, inhibit, is_aided, is_self_fed, tuple(out))

    def add_result(self, result: CommandResult) -> list[Outbound]:
        """Add a vehicle's answer to a command."""
        stream, switched = self._streams.get(result.sysid), [] if self.is_held_back else self._switch.add_answer(result)
        return [*switched, *(stream.method.add_result(result) if stream is not None else [])]

    def add_parameter(self, value: ParameterValue) -> list[Outbound]:
        """Add what a vehicle reports of a parameter."""
        self._parameters.add(value)
        return [] if self.is_held_back else list(self._switch.add_answer(value))

    def add_origin(self, origin: GlobalOrigin) -> None:
        """Add the origin of a vehicle's local frame."""
        self._vehicles[origin.sysid].origin.reported = origin

    def add_fed_receiver(self, receiver: GpsReceiver) -> None:
        """Add what a vehicle reports of the receiver that we feed."""
        stream = self._streams.get(receiver.sysid)
        acknowledgement = stream.acknowledgement if stream is not None else None
        if receiver.receiver == self._settings.gps_id and isinstance(acknowledgement, FixAcknowledgement):
            acknowledgement.add_receiver(receiver)

    def add_foreign(self, message: ForeignGpsInput) -> None:
        """Add somebody else's GPS_INPUT; what is for another receiver of the vehicle does not matter."""
        if message.vehicle is not None and message.gps_id == self._settings.gps_id:
            self._vehicles[message.vehicle].inhibits.add_foreign(message)

    def forget(self, sysid: int) -> None:
        """Forget a vehicle that makes room for another one, but for what the operator decided of it."""
        self._parameters.forget(sysid)
        self._switch.forget(sysid)
        self._vehicles.pop(sysid, None)

    def forget_parameters(self, sysid: int) -> None:
        """Forget parameters and origin of a vehicle that was rebooted: they may have changed."""
        self._parameters.forget(sysid)
        self._vehicles[sysid].origin = LocalOrigin()

    def parameter_requests(self, now_s: float) -> list[ParameterRequest]:
        """Return the requests for parameters that are due."""
        return self._parameters.due(now_s)

    def poll(
        self,
        now_s: float,
        inputs: Callable[[int, float], FixInputs],
        frame: LocalFrame | None,
        utc_minus_service_s: float | None,
        estimate_at: EstimateAt,
    ) -> list[Outbound]:
        """Build the messages due by `now_s`, from what earlier stages know of a vehicle and its estimates."""
        out: list[Outbound] = []
        if now_s < self.next_due_s:
            return out
        for sysid, stream in self._streams.items():
            if now_s >= stream.due_s:
                held = self.is_held_back
                out.extend(stream.poll(now_s, inputs(sysid, now_s), frame, utc_minus_service_s, estimate_at, is_held_back=held))
                if stream.sent_fix is not None:
                    self._vehicles[sysid].sent_fix = stream.sent_fix
        self._update_due()
        return out

    def sent_fix(self, sysid: int) -> SentFix | None:
        """Return the last fix that a vehicle was sent."""
        return self._vehicles[sysid].sent_fix

    def has_stream(self, sysid: int) -> bool:
        """Return whether a vehicle has a stream from us, with a fix or without."""
        return sysid in self._streams

    def view(self, vehicle: ReportedState, gps_state: GpsState, *, has_duplicate_id: bool) -> AidingView:
        """Return the aiding of one vehicle as observers see it."""
        sysid, stream = vehicle.sysid, self._streams.get(vehicle.sysid)
        inhibit = self._inhibit(vehicle, has_duplicate_id=has_duplicate_id)
        acknowledgement = stream.acknowledgement if stream is not None else None
        status = self._status(sysid, gps_state, stream, inhibit)
        return AidingView(
            status=f"by the other service; here {status}" if self.is_held_back and stream is not None else status,
            is_held_back=self.is_held_back,
            has_fix=stream is not None and stream.inhibit is None,
            fix_acknowledged=acknowledgement.acknowledged if acknowledgement is not None else None,
            gps_primary=self._switch.status(sysid),
            inhibit_reason=inhibit.text if inhibit is not None else None,
        )

    def close(self) -> list[ToVehicle]:
        """End every stream, with fix_type 1 where the method has it, and restore the parameters that were set."""
        last: list[ToVehicle] = [message for stream in self._streams.values() for message in stream.method.build_last_messages()]
        self._streams.clear()
        self._update_due()
        return [*last, *self._switch.close()]

    def _inhibit(self, vehicle: ReportedState, *, has_duplicate_id: bool) -> Inhibit | None:
        """Return why a vehicle cannot be aided even if it should be; None where it can."""
        sysid = vehicle.sysid
        if vehicle.blocked is RouteBlock.NO_HEARTBEAT:
            return StatedReason(InhibitReason.NO_HEARTBEAT)
        if vehicle.blocked is not None and not METHODS[self._method(vehicle)].heeds_target:
            return StatedReason(InhibitReason.NO_ROUTE, detail=vehicle.blocked_wording or "")
        if has_duplicate_id:
            return StatedReason(InhibitReason.DUPLICATE_ID)
        no_method = mismatch(self._method(vehicle), vehicle.autopilot)
        if no_method is not None and no_method.reason is InhibitReason.PX4_TAKES_NO_METHOD and not self._px4.is_settled(sysid):
            no_method = StatedReason(InhibitReason.PX4_METHOD_UNKNOWN)
        return self._host_inhibit or no_method or self._vehicles[sysid].inhibits.foreign

    def _status(self, sysid: int, gps_state: GpsState, stream: AidingStream | None, inhibit: Inhibit | None) -> str:
        if stream is not None:
            return stream.status()
        if self._needs_aid(sysid, gps_state):
            by_whom = "not by this service" if self.is_held_back else "NOT SENT"
            # Without an inhibit the next review opens its stream.
            return f"{by_whom}: {inhibit.text}" if inhibit is not None else InhibitReason.NOT_SENT_YET.wording
        if self._override(sysid) is AidingOverride.OFF:
            return "off by the operator's override"
        obstacle = self._vehicles[sysid].inhibits.obstacle
        return f"no standby: {obstacle.text}" if obstacle is not None else "off"

    def _update_due(self) -> None:
        # Read with every datagram, it changes with every message that is sent.
        self.next_due_s = min((stream.due_s for stream in self._streams.values()), default=float("inf"))

    def _open_stream(self, vehicle: ReportedState, name: AidingMethodName, purpose: Purpose, now_s: float) -> AidingStream:
        sysid, settings, schedule = vehicle.sysid, self._settings, self._tick_schedule
        context = MethodContext(
            sysid, vehicle.first_heard_s, settings, self._parameters, self.refused, lambda: self._vehicles[sysid].origin.reported
        )
        method = METHODS[name].make(context)
        return AidingStream(sysid, name, method, settings, now_s, purpose, schedule, transmits=self.transmits)

    def _end(
        self, sysid: int, stream: AidingStream, inhibit: Inhibit | None, gps_state: GpsState, now_s: float
    ) -> list[Outbound]:
        del self._streams[sysid]
        self._update_due()
        if self.is_held_back:
            return []
        why = "the operator's override" if self._override(sysid) is AidingOverride.OFF else f"GPS {gps_state.value}"
        notice = Notice(now_s, sysid, "info", f"aiding ended: {inhibit.text if inhibit is not None else why}")
        # Who else feeds the same receiver is not interrupted by our last message.
        return [notice] if self._vehicles[sysid].inhibits.foreign is not None else [*stream.method.build_last_messages(), notice]

    def _method(self, vehicle: ReportedState) -> AidingMethodName:
        return method_for(vehicle.sysid, vehicle.autopilot, self._settings, self._px4.method)

    def _override(self, sysid: int) -> AidingOverride:
        return self._overrides.of(sysid, AidingOverride)

    def _needs_aid(self, sysid: int, gps_state: GpsState) -> bool:
        override = self._override(sysid)
        return override is AidingOverride.ON or (override is AidingOverride.AUTO and gps_state in _AIDED_STATES)

    def _purpose(self, vehicle: ReportedState, gps_state: GpsState, stream: AidingStream | None, now_s: float) -> Purpose | None:
        """Return why a vehicle is to have a stream now; None where it is to have none."""
        sysid = vehicle.sysid
        if self._needs_aid(sysid, gps_state):
            return Purpose.AID
        if self._override(sysid) is AidingOverride.OFF:
            return None
        if stream is not None and stream.purpose is not Purpose.STANDBY:
            if stream.purpose is Purpose.AID:
                return Purpose.HAND_BACK
            if stream.purpose_for_s(now_s) < self._settings.hand_back_s or self._switch.switching(sysid):
                return Purpose.HAND_BACK
        # Any other method than GPS_INPUT would be fused at once.
        feeds = METHODS[self._method(vehicle)].feeds_receiver
        return Purpose.STANDBY if self._settings.standby and feeds and gps_state in _STANDBY_STATES else None
