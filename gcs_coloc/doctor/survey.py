"""Survey of a fleet, sans-IO: datagrams in, requests out, and a summary at the end.

Time is passed in.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.clocks.vehicle_clocks import DuplicateIdDetector
from gcs_coloc.core.deadlines import advance
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import RouteReport
from gcs_coloc.core.messages.inbound import (
    Attitude,
    GlobalPosition,
    GpsReceiver,
    Heartbeat,
    Inbound,
    ParameterValue,
    PeerRange,
    SystemTime,
    TimeSyncAnswer,
)
from gcs_coloc.core.messages.outbound import ParameterRequest, Stream, TimeSyncRequest, ToVehicle
from gcs_coloc.core.stations.stations import Stations
from gcs_coloc.core.telemetry.stream_requests import HeardStreams, StreamRequests
from gcs_coloc.doctor.finding import FleetSurvey, VehicleSurvey
from gcs_coloc.doctor.parameters import ParameterReader
from gcs_coloc.mavlink.decoder import Decoder, Frame
from gcs_coloc.mavlink.encoder import STREAM_IDS
from gcs_coloc.mavlink.framing import GCS_SYSID, MAGIC_V1, RawFrame
from gcs_coloc.mavlink.signing import LinkSigning

MAX_VEHICLES = 250  # chosen: as many as the service takes
LEAST_RANGES = 2  # chosen: one may be a stray
_TIMESYNC_EVERY_S = 1.0  # chosen: some ten answers in a survey
_STREAMS = {number: stream for stream, number in STREAM_IDS.items()}


@dataclass(frozen=True, slots=True)
class Question:
    """A message for the vehicle at `place`; `as_gcs`: under the ground stations' system id and not ours."""

    place: Hashable
    message: ToVehicle
    as_gcs: bool = False


@dataclass(slots=True)
class _Stay:
    """How an autopilot was heard at one place."""

    first_s: float
    last_s: float


@dataclass(slots=True)
class _Vehicle:
    reader: ParameterReader
    first_heard_s: float
    armed: bool = False
    is_signed: bool = False
    magics: set[int] = field(default_factory=set)
    stays: dict[Hashable, _Stay] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    streams: Counter[Stream] = field(default_factory=Counter)
    empty: set[int] = field(default_factory=set)
    receiver: GpsReceiver | None = None
    unstamped_ranges: int = 0
    answers_timesync: bool = False
    utc_minus_host_s: float | None = None
    duplicates: DuplicateIdDetector = field(default_factory=DuplicateIdDetector)
    ask_time_at_s: float = float("-inf")

    @property
    def place(self) -> Hashable:
        """Where it was heard last."""
        return max(self.stays, key=lambda place: self.stays[place].last_s)

    @property
    def is_claimed_twice(self) -> bool:
        """Whether it was heard at two places in turn, and did not just move from one to the other."""
        stays = sorted(self.stays.values(), key=lambda stay: stay.first_s)
        return any(after.first_s < before.last_s for before, after in pairwise(stays))


class Survey:
    """A survey of a fleet from `start_s` on, for `seconds`.

    The rates are counted in its second half, when stream requests have taken effect.
    `engine` is that of the flight; it receives all messages and sends nothing. Its readiness of each vehicle is what is used.
    """

    def __init__(
        self,
        own: tuple[int, int],
        start_s: float,
        seconds: float,
        *,
        utc_minus_service_s: float | None,
        asks_for_streams: bool,
        stations: Stations | None = None,
        engine: Engine | None = None,
    ) -> None:
        self._engine = engine
        self._stations = stations if stations is not None else Stations()
        self._decoder = Decoder(own_sysid=own[0], own_compid=own[1])
        self._half_s, self._end_s = start_s + seconds / 2.0, start_s + seconds
        self._seconds = seconds
        self._utc_minus_service_s = utc_minus_service_s
        self._streams = StreamRequests() if asks_for_streams else None
        self._vehicles: dict[int, _Vehicle] = {}
        self._ranges: Counter[frozenset[int]] = Counter()

    @property
    def refused(self) -> Mapping[str, int]:
        """What was refused, by reason."""
        return Counter(self._decoder.counts) + Counter({reason.value: n for reason, n in self._stations.refused.items()})

    def receive(self, datagram: bytes, place: Hashable, at_s: float, signing: LinkSigning | None = None) -> None:
        """Receive a datagram from an address. No content makes it raise."""
        good: list[RawFrame] = []
        for frame in self._decoder.decode(datagram, at_s, place, signing, good):
            if frame.message is not None:
                self._note(frame, frame.message, place, at_s)
                self._tell_engine(frame.message, at_s)
            elif frame.sysid in self._vehicles and at_s >= self._half_s:
                self._vehicles[frame.sysid].empty.add(frame.message_id)
        for raw in good:
            vehicle = self._vehicles.get(raw.sysid)
            if vehicle is not None:
                vehicle.is_signed = vehicle.is_signed or raw.is_signed
                if at_s >= self._half_s and raw.compid == mavlink.MAV_COMP_ID_AUTOPILOT1:
                    vehicle.magics.add(raw.frame[0])

    def _tell_engine(self, message: Inbound, at_s: float) -> None:
        if self._engine is None:
            return
        for _ in advance(self._engine, at_s):
            pass
        self._engine.receive(message)
        if isinstance(message, Heartbeat):
            # Whether it can be reached, the checks of its address tell.
            self._engine.receive(RouteReport(message.sysid, at_s, None))

    def questions(self, now_s: float) -> list[Question]:
        """Return the requests that are due."""
        out = []
        for sysid, vehicle in self._vehicles.items():
            as_gcs = vehicle.reader.requests_as_gcs
            out += [Question(vehicle.place, ParameterRequest(sysid, name), as_gcs) for name in vehicle.reader.due(now_s)]
            if now_s >= vehicle.ask_time_at_s:
                vehicle.ask_time_at_s = now_s + _TIMESYNC_EVERY_S
                out.append(Question(vehicle.place, TimeSyncRequest(sysid, max(1, round(now_s * 1e9))), as_gcs))
        heard = (HeardStreams(sysid, vehicle.reader.autopilot, vehicle.streams) for sysid, vehicle in self._vehicles.items())
        for request in self._streams.due(now_s, heard) if self._streams is not None else []:
            vehicle = self._vehicles[request.sysid]
            out.append(Question(vehicle.place, request, vehicle.reader.requests_as_gcs))
        return out

    def findings(self, names: Mapping[Hashable, str], *, host_is_synchronised: bool | None) -> FleetSurvey:
        """Return the results of the survey; `names` are the addresses in words."""
        there: dict[Hashable, set[int]] = {}
        for sysid, vehicle in self._vehicles.items():
            for place in vehicle.stays:
                there.setdefault(place, set()).add(sysid)
        seen = self._engine.snapshot(self._end_s).vehicles if self._engine is not None else ()
        readiness = {vehicle.sysid: vehicle.readiness for vehicle in seen}
        vehicles = tuple(
            replace(self._findings_of(sysid, there, names), readiness=readiness.get(sysid)) for sysid in sorted(self._vehicles)
        )
        stations = frozenset(station.node for station in self._stations if station.position is not None)
        return FleetSurvey(self._seconds, vehicles, dict(self.refused), host_is_synchronised, stations)

    def _findings_of(self, sysid: int, there: Mapping[Hashable, set[int]], names: Mapping[Hashable, str]) -> VehicleSurvey:
        vehicle = self._vehicles[sysid]
        counted_s = self._end_s - max(self._half_s, vehicle.first_heard_s)
        others = set().union(*(there[place] for place in vehicle.stays)) - {sysid}
        return VehicleSurvey(
            sysid=sysid,
            autopilot=vehicle.reader.autopilot,
            armed=vehicle.armed,
            addresses=tuple(names[place] for place in vehicle.stays),
            is_claimed_twice=vehicle.is_claimed_twice,
            has_two_clocks=vehicle.duplicates.detected(self._end_s),
            others_there=tuple(sorted(others)),
            is_signed=vehicle.is_signed,
            is_mavlink_1=vehicle.magics == {MAGIC_V1},
            parameters=dict(vehicle.reader.told),
            parameter_kinds=dict(vehicle.reader.kinds),
            answers_only_to=GCS_SYSID if vehicle.reader.answers_as_gcs_only else None,
            rates_hz={number: count / counted_s for number, count in vehicle.counts.items()} if counted_s > 0.0 else {},
            empty=frozenset(vehicle.empty - vehicle.counts.keys()),
            receiver=vehicle.receiver,
            peers=frozenset(
                other
                for pair, times in self._ranges.items()
                if sysid in pair and times >= LEAST_RANGES
                for other in pair - {sysid}
            ),
            has_unstamped_ranges=vehicle.unstamped_ranges >= LEAST_RANGES,
            answers_timesync=vehicle.answers_timesync,
            utc_minus_host_s=vehicle.utc_minus_host_s,
        )

    def _note(self, frame: Frame, message: Inbound, place: Hashable, at_s: float) -> None:
        if isinstance(message, Heartbeat):
            self._note_autopilot(message, place, at_s)
        vehicle = self._vehicles.get(frame.sysid)
        if vehicle is None:
            return
        if at_s >= self._half_s:
            vehicle.counts[frame.message_id] += 1
        stream = _STREAMS.get(frame.message_id)
        if stream is not None:
            vehicle.streams[stream] += 1
        if isinstance(message, GlobalPosition | Attitude | SystemTime):
            vehicle.duplicates.add(message.boot_s, at_s)
        match message:
            case GpsReceiver(receiver=0):
                vehicle.receiver = message
                self._stations.add_receiver(message)
            case PeerRange():
                vehicle.unstamped_ranges += message.measured_at_s is None
                resolved = self._stations.resolve(message).message
                self._ranges[frozenset((message.sysid, resolved.peer if resolved is not None else message.peer))] += 1
            case ParameterValue():
                vehicle.reader.add(message.name, message.value, message.kind)
            case TimeSyncAnswer():
                vehicle.answers_timesync = True
            case SystemTime() if message.unix_s is not None and self._utc_minus_service_s is not None:
                vehicle.utc_minus_host_s = message.unix_s - (at_s + self._utc_minus_service_s)
            case _:
                pass

    def _note_autopilot(self, message: Heartbeat, place: Hashable, at_s: float) -> None:
        vehicle = self._vehicles.get(message.sysid)
        if vehicle is None:
            if len(self._vehicles) >= MAX_VEHICLES:
                return
            vehicle = self._vehicles[message.sysid] = _Vehicle(ParameterReader(message.autopilot), at_s)
        vehicle.armed = message.armed
        if place in vehicle.stays:
            vehicle.stays[place].last_s = at_s
        elif len(vehicle.stays) < MAX_VEHICLES:
            vehicle.stays[place] = _Stay(at_s, at_s)
