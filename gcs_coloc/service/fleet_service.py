"""One fleet's straight path: links, intake, decoder, routes, engine, encoder, links; with its recording and its refusals."""

from __future__ import annotations

import logging
from dataclasses import replace

from gcs_coloc.config.settings import Settings
from gcs_coloc.core.advance import CATCH_UP_S, advance, find_overrun, without_superseded
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.aiding import ForeignGpsInput, ParameterSet
from gcs_coloc.core.messages.control import ClockReference, GpsOverride, OperatorCommand, Override, RouteReport
from gcs_coloc.core.messages.inbound import PeerRange
from gcs_coloc.core.messages.outbound import GpsInput, Notice, Outbound, ToVehicle
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.links.base import Address, Link, Route
from gcs_coloc.links.forward import Forwarder
from gcs_coloc.links.rate_limiter import RateLimiter
from gcs_coloc.links.registry import check_outs, parse
from gcs_coloc.links.routes import Blocked, RouteTable
from gcs_coloc.links.signed_links import SignedLinks
from gcs_coloc.mavlink.aiding_inbound import foreign_gps_input
from gcs_coloc.mavlink.decoder import Decoder, Frame
from gcs_coloc.mavlink.encoder import Encoder
from gcs_coloc.mavlink.framing import RawFrame
from gcs_coloc.mavlink.refusals import Counts, Refusal, Refusals
from gcs_coloc.mavlink.signing import Stamp
from gcs_coloc.mavlink.truth import TRUTH_IDS, HeardTruth, truth_of
from gcs_coloc.recorder.flight import FlightRecording
from gcs_coloc.recorder.side_channel import FlownWith
from gcs_coloc.runtime.clock import ServiceClock, Timer
from gcs_coloc.service.snapshot_cache import SnapshotCache
from gcs_coloc.sinks.event_bus import EventBus
from gcs_coloc.sinks.idle_scheduler import IdleScheduler

log = logging.getLogger("gcs_coloc")

_ENGINE_LATE_S = 2.0


class FleetService:
    """One fleet on its links. Every call returns at once; whoever holds it calls `each_second` and the other periodic ones.

    `events` tells its observers what happens, `snapshots` how the fleet stands, `idle` when they have time, `counts` takes
    what they refuse. `truths` is where a simulation says that vehicles truly are, by system id: for showing alone, the engine
    never hears of it.
    """

    def __init__(self, settings: Settings, clock: ServiceClock, host: ClockReference) -> None:
        """Build everything; no link is open yet. `host` is the host's time now."""
        self.events = EventBus()
        self.idle = IdleScheduler()
        self.counts = Counts()
        self.truths: dict[int, HeardTruth] = {}
        self._clock = clock
        ids = settings.mavlink
        self._decoder = Decoder(own_sysid=ids.system_id, own_compid=ids.component_id)
        self._encoder = Encoder(sysid=ids.system_id, compid=ids.component_id)
        senders = settings.senders
        self._rate_limiter = RateLimiter(senders.bytes_per_s)
        check_outs(settings.out, settings.links)
        self._routes = RouteTable(rebind_after_s=senders.rebind_after_s, companions_elsewhere=senders.companions_elsewhere)
        self._signed = SignedLinks(settings.signing, settings.links, settings.out)
        self._signed.set_clock(host.utc_minus_service_s)  # before the first frame: a recorded frame is known by its old time
        self._forwarder = Forwarder(
            settings.out,
            self._routes,
            self._signed,
            clock,
            own=(ids.system_id, ids.component_id),
            bytes_per_s=senders.bytes_per_s,
            is_aided=lambda sysid: self._engine.aiding.streams(sysid),
            forwarded=lambda raw: self._recording.forwarded(self._engine_at_s, raw),
            foreign_gps_input=lambda raw, sysid: self._apply(foreign_gps_input(raw, self._clock(), sysid)),
        )
        self._echoes_gps_input = settings.forward.echo_gps_input
        addresses = [parse(text) for text in settings.links]
        self._links = [address.make_link(self._on_datagram, clock) for address in addresses]
        self._openings = [address.opening for address in addresses]
        self._engine = Engine(load_estimator(settings.estimator.name, settings.estimator.settings), settings.engine())
        self._refusals = Refusals(
            [
                self._decoder.counts,
                self._rate_limiter.counts,
                self._routes.counts,
                self.counts,
                *(link.counts for link in self._links),
                *self._forwarder.refusals,
            ]
        )
        self._recording = FlightRecording(settings.record, ids, self._engine)
        self.snapshots = SnapshotCache(
            clock, self._engine, self._recording, self._decoder.sequences, self._refusals, self._forwarder
        )
        self._keeps_frames = bool(settings.record.directory or settings.out)
        self._deadline = Timer(clock, self._poll)
        self._engine_at_s = clock()
        self._recording.told(FlownWith(settings.fingerprint(), self._engine_at_s))
        self._is_ending = False
        self._overrides = [
            *((sysid, GpsOverride.FAILED) for sysid in settings.fleet.failed),
            *((sysid, GpsOverride.HEALTHY) for sysid in settings.fleet.healthy),
        ]

    async def open(self) -> None:
        """Open the links, one after the other, then the recording. LinkError, RecordError where one cannot be opened."""
        await self._forwarder.open()  # first, so that what is heard can be handed on
        for link, opening in zip(self._links, self._openings, strict=True):
            await link.open()
            log.info("%s", opening)
        self._recording.open()

    def start(self) -> None:
        """Tell the engine the operator's words from the settings."""
        for sysid, override in self._overrides:
            self.apply_command(sysid, override)

    def stop(self) -> None:
        """Look at nothing that arrives from now on: what a busy service has waiting must not hold up its end."""
        self._is_ending = True

    async def close(self) -> None:
        """Tell every aided vehicle that its fix has ended, close the links and end the recording."""
        self._deadline.cancel()
        aided = sorted(vehicle.sysid for vehicle in self._engine.fleet if self._engine.aiding.streams(vehicle.sysid))
        for last in self._engine.close():
            self._send(last)
            if isinstance(last, ParameterSet):
                # No time is left to wait for the answer and try again.
                self._send(last)
                self._send(last)
                log.warning("vehicle %d: %s set back to %g, unconfirmed: the service ends", last.sysid, last.name, last.value)
        if aided:
            log.info("aid of vehicle %s ended: the service ends", ", ".join(map(str, aided)))
        refused = self._refusals.pending_warning()
        if refused is not None:
            log.warning("%s", refused)
        for link in self._links:
            await link.close()
        await self._forwarder.close()
        self._recording.close()

    def known_sysids(self) -> list[int]:
        """The system ids of the vehicles heard so far."""
        return [vehicle.sysid for vehicle in self._engine.fleet]

    def apply_command(self, sysid: int, override: Override) -> None:
        """Take the operator's word on one vehicle."""
        self._apply(OperatorCommand(sysid, self._clock(), override))

    def add_range(self, message: PeerRange) -> None:
        """Take a range that did not come over a link."""
        self._apply(message)

    def fault(self) -> str | None:
        """Why the fleet's path does not do its work, None where it does."""
        late_s = self._clock() - self._engine_at_s
        return f"the engine was last run {late_s:.1f} s ago" if late_s > _ENGINE_LATE_S else None

    def publish_snapshot(self) -> None:
        """Show the fleet to the observers."""
        self.events.publish(self.snapshots.snapshot())

    def publish_refusals(self) -> None:
        """Tell the observers what has been refused since the last call."""
        text = self._refusals.pending_warning()
        if text is not None:
            self.events.publish(Notice(self._clock(), None, "warning", text))

    def each_second(self, host: ClockReference) -> None:
        """Take the host's time, tell what the recorder and the routes have to tell, and greet with our heartbeat."""
        now_s = host.received_at_s
        self._signed.set_clock(host.utc_minus_service_s)
        self._apply(host)
        recording = self._recording.news()
        if recording is not None:
            self.events.publish(Notice(now_s, None, *recording))
        ahead = self._signed.pending_warning(now_s)
        if ahead is not None:
            self.events.publish(Notice(now_s, None, "warning", ahead))
        for sysid, text in (*self._routes.conflicts.pending_warnings(now_s), *self._forwarder.pending_warnings(now_s)):
            self.events.publish(Notice(now_s, sysid, "warning", text))
        routes = (self._routes.route(vehicle.sysid, now_s) for vehicle in self._engine.fleet)
        # A vehicle or router may wait for our first frame before it sends any, hence the links' peers.
        greeted = {route for route in routes if isinstance(route, Route)}
        greeted |= {Route(link, peer) for link in self._links for peer in link.peers}
        # Who signs with the key, but behind our time, is refused until it has heard a frame of ours.
        greeted |= {Route(*source) for source in self._decoder.pop_behind() if isinstance(source, tuple)}
        for route in greeted:
            payload = self._encoder.heartbeat(route, self._stamp(route))
            route.link.send(route.address, payload)
            self._recording.sent(self._engine_at_s, payload)

    def _on_datagram(self, link: Link, address: Address, payload: bytes, received_at_s: float) -> None:
        source = (link, address)
        if self._is_ending or not self._rate_limiter.admits(source, len(payload), received_at_s):
            return
        # The timer fires no later than the engine's next deadline, and most datagrams come before that.
        if received_at_s > self._deadline.at_s:
            self._advance(received_at_s)
        self._engine_at_s = received_at_s
        good: list[RawFrame] = []
        refused: list[Frame] = []
        frames = self._decoder.decode(payload, received_at_s, source, self._signed.of(link.name), good)
        for frame in frames:
            if isinstance(frame.message, ForeignGpsInput):
                self._apply_foreign_gps_input(frame.message, link, address)
            if not self._learn_route(frame, link, address, received_at_s):
                refused.append(frame)
            elif frame.message is not None:
                self._engine.receive(frame.message)
                if frame.is_autopilot_heartbeat:
                    self._rate_limiter.add_source(source, received_at_s)
                    route = self._routes.route(frame.sysid, received_at_s)
                    blocked = (route.reason, route.shared_with) if isinstance(route, Blocked) else (None,)
                    report = RouteReport(frame.sysid, received_at_s, *blocked)
                    self._engine.receive(report)
                    self._recording.told(report)
        for raw in good:
            if raw.message_id in TRUTH_IDS:
                self._record_truth(raw, link, address, received_at_s)
        if self._keeps_frames:
            self._recording.heard(received_at_s, good, refused)
            self._forwarder.from_vehicle(good, link, address, received_at_s)
        if frames:  # by what the engine has not received no deadline comes sooner
            self._wake()

    def _record_truth(self, raw: RawFrame, link: Link, address: Address, now_s: float) -> None:
        truth = truth_of(raw, now_s)
        if truth is not None and self._learn_route(raw, link, address, now_s):
            self.truths[raw.sysid] = truth

    def _apply_foreign_gps_input(self, message: ForeignGpsInput, link: Link, address: Address) -> None:
        """Tell the engine of somebody else's GPS_INPUT, whoever sends it: every vehicle at the address it came from takes it."""
        for sysid in self._routes.autopilots_at(link, address, message.received_at_s):
            reached = replace(message, vehicle=sysid)
            self._engine.receive(reached)
            self._recording.told(reached)

    def _learn_route(self, frame: Frame | RawFrame, link: Link, address: Address, now_s: float) -> bool:
        heartbeat = isinstance(frame, Frame) and frame.is_autopilot_heartbeat
        return self._routes.learn(frame.sysid, frame.compid, link, address, is_autopilot_heartbeat=heartbeat, now_s=now_s)

    def _wake(self) -> None:
        """Make sure that the engine is polled when it next wants to be."""
        self._deadline.by(self._engine.next_deadline())

    def _poll(self) -> None:
        self._advance(self._clock())
        self._wake()

    def _advance(self, to_s: float) -> None:
        """Bring the engine to `to_s`, before anything that arrived then is given to it, and pass on what comes of it."""
        self._engine_at_s = to_s
        if self._engine.next_deadline() >= to_s:
            return
        overrun = find_overrun(self._engine, to_s)
        if overrun is not None:
            self._recording.told(overrun)
        unsent: list[Outbound] = []
        is_idle = False
        for at_s, outputs in advance(self._engine, to_s, catch_up_s=CATCH_UP_S):
            unsent.extend(outputs)
            if self._engine.next_aid_s() >= to_s:
                # Before the fleet is reviewed and the journal looks at it: that takes longer than estimating, and vehicles wait.
                self._emit(without_superseded(unsent))
                unsent = []
                is_idle = self._engine.next_deadline() >= to_s
            self._recording.polled(at_s, outputs)
        if is_idle:
            self.idle.start_slots()

    def _emit(self, outputs: list[Outbound]) -> None:
        for output in outputs:
            if isinstance(output, ToVehicle):
                self._send(output)
            else:
                self.events.publish(output)

    def _apply(self, message: ClockReference | OperatorCommand | PeerRange | ForeignGpsInput) -> None:
        self._advance(message.received_at_s)
        self._engine.receive(message)
        self._recording.told(message)
        self._wake()

    def _send(self, output: ToVehicle) -> None:
        route = self._routes.route(output.sysid, self._clock())
        # Asked again for every message: an address that came to be shared a moment ago must get nothing.
        if isinstance(route, Blocked):
            return
        try:
            payload = self._encoder.encode(output, route, self._stamp(route))
        except ValueError:
            self.counts.add(Refusal.NOT_ENCODABLE)
            return
        route.link.send(route.address, payload)
        self._recording.sent(self._engine_at_s, payload)
        if self._echoes_gps_input and isinstance(output, GpsInput):
            self._forwarder.echo(payload)

    def _stamp(self, route: Route) -> Stamp | None:
        signing = self._signed.of(route.link.name)
        return signing.stamp(self._clock()) if signing is not None else None
