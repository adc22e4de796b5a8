"""Who is aided and when: the policy, with one stream of aid per vehicle. What is sent, the stream and its way know."""

from __future__ import annotations

from collections import Counter

from gcs_coloc.core.aiding.foreign_gps_input import ForeignGpsInputMonitor
from gcs_coloc.core.aiding.method_choice import feeds_receiver, make_method, method_name, mismatch
from gcs_coloc.core.aiding.parameters import Parameters
from gcs_coloc.core.aiding.primary_switch import PrimarySwitch
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.aiding.standby import Standby
from gcs_coloc.core.aiding.stream import AidingStream, Answer, Purpose
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.messages.aiding import CommandResult, ForeignGpsInput, ParameterSet, ParameterValue
from gcs_coloc.core.messages.control import NO_HEARTBEAT_YET, AidingOverride, PrimaryOverride
from gcs_coloc.core.messages.inbound import GpsReceiver
from gcs_coloc.core.messages.outbound import AidingMessage, Notice, Outbound
from gcs_coloc.core.telemetry.vehicles import Vehicle
from gcs_coloc.core.tick_schedule import TickSchedule

_AIDED_STATES = (GpsState.FAILED, GpsState.RECOVERING)
_FRESH_S = 3.0
_HEARTBEAT_WITHIN_S = 3.0  # autopilots send one each second


class Aiding:
    """Keeps one stream of aid for each vehicle that is to have one and can be reached.

    `withheld` says why nobody may be aided at all, or is None. `words` and `primary_words` are what the operator decided, by
    system id. `on_air`: what is to be sent is sent, so that vehicles can be expected to take it. `grid`: the times of the
    streams that begin from now on. `refused` counts what vehicles refuse, by reason.
    """

    def __init__(self, settings: AidingSettings) -> None:
        self.settings = settings
        self.withheld: str | None = None
        self.on_air = True
        self.grid = TickSchedule(0.0)
        self.words: dict[int, AidingOverride] = {}
        self.primary_words: dict[int, PrimaryOverride] = {}
        self.parameters = Parameters()
        self.primary = PrimarySwitch(settings.gps_id)
        self.refused: Counter[str] = Counter()
        self._others = ForeignGpsInputMonitor(settings)
        self._standby = Standby(settings, self.parameters)
        self._streams: dict[int, AidingStream] = {}
        self._next_due_s = float("inf")
        self._told: dict[int, str | None] = {}

    def review(self, vehicle: Vehicle, now_s: float) -> list[Outbound]:
        """Begin, change or end the stream of one vehicle by its health, autopilot, route and the operator's word.

        Also sets `aided` and `self_fed` of its health.
        """
        out: list[Outbound] = list(self._others.review(vehicle.sysid, now_s))
        sysid, stream = vehicle.sysid, self._streams.get(vehicle.sysid)
        if stream is not None and stream.purpose is Purpose.HAND_BACK and vehicle.health.state is not GpsState.HEALTHY:
            # It is handed back only to a receiver that has been healthy all the while.
            stream.purpose_since_s = now_s
        purpose, inhibit_reason = self._purpose(vehicle, stream, now_s), self.inhibit_reason(vehicle)
        if purpose is Purpose.STANDBY and inhibit_reason is None:
            obstacle, news = self._standby.obstacle(vehicle, now_s)
            purpose = None if obstacle is not None else purpose
            out.extend(news)
        if stream is not None and (
            purpose is None or inhibit_reason is not None or stream.name != method_name(vehicle, self.settings)
        ):
            out.extend(self._end(stream, inhibit_reason, now_s))
            stream = None
        if stream is None and purpose is not None and inhibit_reason is None:
            stream = self._streams[sysid] = self._begin(vehicle, purpose, now_s)
            self._schedule()
        elif stream is not None and purpose is not None and purpose is not stream.purpose:
            stream.purpose, stream.purpose_since_s = purpose, now_s
        if (
            stream is not None
            and stream.acknowledgement is not None
            and (told := stream.acknowledgement.review(now_s)) is not None
        ):
            out.append(Notice(now_s, sysid, *told))
        out.extend(self.primary.review(sysid, now_s, wanted=self._primary_wanted(vehicle, stream, now_s)))
        # A vehicle that may fly on what we send though its receiver is good: its claims must not come back as evidence.
        vehicle.health.self_fed = self._word(vehicle) is AidingOverride.ON or self.primary.holds(sysid)
        vehicle.health.aided = stream is not None and (vehicle.health.state in _AIDED_STATES or vehicle.health.self_fed)
        is_new = inhibit_reason == NO_HEARTBEAT_YET and now_s - vehicle.first_heard_s < _HEARTBEAT_WITHIN_S
        if purpose is not Purpose.AID:
            self._told.pop(sysid, None)
        elif inhibit_reason != self._told.get(sysid) and not is_new:
            self._told[sysid] = inhibit_reason
            if inhibit_reason is not None:
                out.append(Notice(now_s, sysid, "error", f"needs aid and cannot be aided: {inhibit_reason}"))
        return out

    def inhibit_reason(self, vehicle: Vehicle) -> str | None:
        """Why a vehicle cannot be aided even if it should be, in words for the operator; None where it can."""
        return (
            vehicle.blocked
            or vehicle.health.duplicate_id
            or self.withheld
            or mismatch(method_name(vehicle, self.settings), vehicle.autopilot)
            or self._others.inhibit_reason(vehicle.sysid)
        )

    def answered(self, result: CommandResult) -> list[Outbound]:
        """Take a vehicle's answer to a command."""
        stream = self._streams.get(result.sysid)
        return list(stream.way.answered(result)) if stream is not None else []

    def parameter(self, value: ParameterValue) -> list[Outbound]:
        """Take what a vehicle tells of a parameter."""
        self.parameters.heard(value)
        return list(self.primary.heard(value))

    def fed(self, receiver: GpsReceiver) -> None:
        """Take what a vehicle says of the receiver that we feed."""
        stream = self._streams.get(receiver.sysid)
        if stream is not None and stream.acknowledgement is not None:
            stream.acknowledgement.heard(receiver)

    def heard_other(self, message: ForeignGpsInput) -> None:
        """Take note of somebody else's GPS_INPUT."""
        self._others.heard(message)

    def restarted(self, sysid: int) -> None:
        """A vehicle was rebooted: its parameters may have changed."""
        self.parameters.forget(sysid)

    def due(self, now_s: float, frame: LocalFrame | None, utc_minus_service_s: float | None, answer: Answer) -> list[Outbound]:
        """What is due by `now_s`. `answer` is the estimator's: where a vehicle is at a service time."""
        out: list[Outbound] = []
        if now_s < self._next_due_s:
            return out
        for stream in self._streams.values():
            out.extend(stream.tick(now_s, frame, utc_minus_service_s, answer))
        self._schedule()
        return out

    def next_due_s(self) -> float:
        """When the next message is due; infinity where nobody is aided."""
        return self._next_due_s

    def status(self, vehicle: Vehicle) -> str:
        """The state of a vehicle's aid in a few words, for the operator."""
        stream = self._streams.get(vehicle.sysid)
        if stream is not None:
            return stream.status()
        if self._needs_aid(vehicle):
            return f"NOT SENT: {self.inhibit_reason(vehicle)}"
        if self._word(vehicle) is AidingOverride.OFF:
            return "off by the operator's word"
        return self._standby.status(vehicle.sysid) or "off"

    def streams(self, sysid: int) -> bool:
        """Whether a vehicle has a stream from us, with a fix or without."""
        return sysid in self._streams

    def sends_fix(self, sysid: int) -> bool:
        """Whether a vehicle is being sent a position, and not only the word that there is none."""
        stream = self._streams.get(sysid)
        return stream is not None and stream.fix_inhibit_reason is None

    def taken(self, sysid: int) -> bool | None:
        """Whether the vehicle's receiver takes our stream; None where that cannot be told."""
        stream = self._streams.get(sysid)
        return stream.acknowledgement.taken if stream is not None and stream.acknowledgement is not None else None

    def close(self) -> list[AidingMessage | ParameterSet]:
        """End every stream, with fix_type 1 where the way can say so, and restore what was set."""
        last = [message for stream in self._streams.values() for message in stream.way.end()]
        self._streams.clear()
        self._schedule()
        return [*last, *self.primary.close()]

    def _schedule(self) -> None:
        # Asked for with every datagram, it changes with every message that is sent.
        self._next_due_s = min((stream.due_s for stream in self._streams.values()), default=float("inf"))

    def _begin(self, vehicle: Vehicle, purpose: Purpose, now_s: float) -> AidingStream:
        name = method_name(vehicle, self.settings)
        way = make_method(name, vehicle, self.settings, self.parameters, self.refused)
        return AidingStream(vehicle, name, way, self.settings, now_s, purpose, self.grid, on_air=self.on_air)

    def _end(self, stream: AidingStream, inhibit_reason: str | None, now_s: float) -> list[Outbound]:
        vehicle = stream.vehicle
        del self._streams[vehicle.sysid]
        self._schedule()
        why = "the operator's word" if self._word(vehicle) is AidingOverride.OFF else f"GPS {vehicle.health.state.value}"
        notice = Notice(now_s, vehicle.sysid, "info", f"aid ended: {inhibit_reason or why}")
        # Who else feeds the same receiver is not interrupted by our last word.
        return [notice] if self._others.inhibit_reason(vehicle.sysid) is not None else [*stream.way.end(), notice]

    def _word(self, vehicle: Vehicle) -> AidingOverride:
        return self.words.get(vehicle.sysid, AidingOverride.AUTO)

    def _needs_aid(self, vehicle: Vehicle) -> bool:
        word = self._word(vehicle)
        return word is AidingOverride.ON or (word is AidingOverride.AUTO and vehicle.health.state in _AIDED_STATES)

    def _purpose(self, vehicle: Vehicle, stream: AidingStream | None, now_s: float) -> Purpose | None:
        """Why a vehicle is to have a stream now; None where it is to have none."""
        if self._needs_aid(vehicle):
            return Purpose.AID
        if self._word(vehicle) is AidingOverride.OFF:
            return None
        if stream is not None and stream.purpose is not Purpose.STANDBY:
            if stream.purpose is Purpose.AID:
                return Purpose.HAND_BACK
            if now_s - stream.purpose_since_s < self.settings.hand_back_s or self.primary.switching(vehicle.sysid):
                return Purpose.HAND_BACK
        return Purpose.STANDBY if self._standby.is_for(vehicle) else None

    def _primary_wanted(self, vehicle: Vehicle, stream: AidingStream | None, now_s: float) -> bool:
        """Whether GPS_PRIMARY is to be our receiver: begun only where that is seen to take what is sent, kept while aid lasts."""
        word = self.primary_words.get(vehicle.sysid, PrimaryOverride.AUTO)
        if stream is None or stream.purpose is not Purpose.AID or not feeds_receiver(stream.name) or word is PrimaryOverride.OWN:
            return False
        if self.primary.switching(vehicle.sysid):
            return word is PrimaryOverride.OURS or self.settings.switch_primary == "auto"
        if stream.fix_inhibit_reason is not None or stream.acknowledgement is None or not stream.acknowledgement.taken:
            return False
        return word is PrimaryOverride.OURS or (self.settings.switch_primary == "auto" and self._lies(vehicle, stream, now_s))

    def _lies(self, vehicle: Vehicle, stream: AidingStream, now_s: float) -> bool:
        """Whether its own receiver, held to have failed, claims a fix all the same, or did in between (jamming flickers)."""
        receiver, state = vehicle.receiver, vehicle.health.state
        claims = receiver is not None and receiver.fix_type >= 3 and now_s - receiver.received_at_s <= _FRESH_S
        stream.flickered = stream.flickered or state is GpsState.RECOVERING
        return state is GpsState.FAILED and (claims or stream.flickered)
