"""One fleet's service: its path from the links through the engine and back to the links.

Its recording, observers and ground tools are attached to that path.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from gcs_coloc.config.settings import Settings
from gcs_coloc.core.deadlines import without_superseded
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import (
    ClockReference,
    CommandSource,
    GpsOverride,
    OperatorCommand,
    Override,
)
from gcs_coloc.core.messages.inbound import PeerRange
from gcs_coloc.core.messages.outbound import Notice, Outbound, ParameterSet, ToVehicle
from gcs_coloc.core.standby.sign_of_life import StandbyOrder
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.links.base import Address, Link
from gcs_coloc.mavlink.answers import foreign_gps_input
from gcs_coloc.mavlink.decoder import HeardTruth
from gcs_coloc.mavlink.refusals import Counts, Refusals
from gcs_coloc.recorder.flight_recording import FlightRecording
from gcs_coloc.recorder.side_channel import FlownWith
from gcs_coloc.runtime.clock import ServiceClock
from gcs_coloc.service.engine_loop import EngineLoop, LoopHooks
from gcs_coloc.service.fleet_links import FleetLinks, LinkHooks
from gcs_coloc.service.fleet_views import AlarmDesk, SnapshotCache
from gcs_coloc.sinks.event_bus import EventBus, IdleScheduler

if TYPE_CHECKING:
    from gcs_coloc.service.hot_standby import HotStandby

log = logging.getLogger("gcs_coloc")

_ENGINE_LATE_S = 2.0
"""Chosen: the engine runs several times a second; so much later the service is not doing its work."""


class FleetService:
    """One fleet on its links.

    Every call returns at once; the caller calls `each_second` and the `publish_` methods.
    `events` passes on what happens, `alarms` is what is wrong, `snapshots` how the fleet stands, `idle` when observers have time,
    `counts` what the observers refuse. `truths` is where a simulation says that vehicles truly are, by system id: for display
    only, the engine never gets it.
    """

    def __init__(
        self, settings: Settings, clock: ServiceClock, host: ClockReference, flagged: frozenset[str] = frozenset()
    ) -> None:
        """Build everything; no link is open yet.

        `host` is the host's time now, `flagged` the keys of `[fleet]` set by flags.
        """
        self.events = EventBus()
        self.idle = IdleScheduler()
        self.counts = Counts()
        self.alarms = AlarmDesk(
            clock,
            self.events,
            lambda alarm: self._recording.record_alarm(alarm),
            tells_ground_tools=bool(settings.out) and settings.forward.alarms,
        )
        self.truths: dict[int, HeardTruth] = {}
        self._clock = clock
        self._is_ending = False
        self._engine = Engine(load_estimator(settings.estimator.name, settings.estimator.settings), settings.engine())
        loop_hooks = LoopHooks(
            read_waiting=lambda: self._links.receive_waiting(),
            emit=self._emit,
            record=lambda record: self._recording.record_side_channel(record),
            record_outputs=lambda at_s, outputs: self._recording.record_outputs(at_s, outputs),
            on_idle=self.idle.start_slots,
        )
        self._loop = EngineLoop(self._engine, clock, host, loop_hooks)
        self._standby: HotStandby | None = None
        if settings.standby.peer:
            from gcs_coloc.service.hot_standby import HotStandby  # a service that is alone starts without it

            self._standby = HotStandby(settings, clock, self._engine, self._loop.apply, self.alarms.publish, self._loop.is_behind)
        standby = self._standby
        hooks = LinkHooks(
            on_datagram=self._on_datagram,
            on_sent=lambda frame: self._recording.record_sent(self._loop.at_s, frame),
            on_forwarded=lambda raw: self._recording.record_forwarded(self._loop.at_s, raw),
            on_foreign_gps_input=lambda raw, sysid: self._loop.apply(foreign_gps_input(raw, self._clock(), sysid)),
            is_aided=lambda sysid: self._engine.aiding.has_stream(sysid),
            may_send=standby.may_send if standby is not None else lambda _: True,
            is_other_service=standby.is_other_service if standby is not None else None,
        )
        self._links = FleetLinks(settings, clock, host.utc_minus_service_s, hooks)
        self._recording = FlightRecording(settings.record, settings.mavlink, self._engine)
        self._recording.record_side_channel(FlownWith(settings.fingerprint(), self._loop.at_s))
        self._keeps_frames = bool(settings.record.directory or settings.out)
        at_standby = standby.refusals if standby is not None else []
        self._refusals = Refusals([*self._links.refusals, self.counts, *at_standby])
        self.snapshots = SnapshotCache(
            clock,
            self._engine,
            self._recording,
            self._links.receiver.sequences,
            self._refusals,
            self._links.forwarder,
            standby.snapshot if standby is not None else lambda: None,
            self._loop.behind_s,
        )
        self._overrides = [
            (sysid, override, CommandSource.FLAG if key in flagged else CommandSource.CONFIGURATION)
            for key, override in (("failed", GpsOverride.FAILED), ("healthy", GpsOverride.HEALTHY))
            for sysid in getattr(settings.fleet, key)
        ]

    # From the beginning to the end

    async def open(self) -> None:
        """Open the links, one after the other, then the recording.

        LinkError, RecordError where one cannot be opened.
        """
        await self._links.open()
        if self._standby is not None:
            await self._standby.open()
        self._recording.open()

    def start(self) -> None:
        """Apply the operator's overrides of the settings."""
        if self._standby is not None:
            self._standby.start()
        for command in self._overrides:
            self.apply_command(*command)

    def stop(self) -> None:
        """Ignore what arrives from now on: what a busy service has waiting must not delay its end."""
        self._is_ending = True

    async def close(self) -> None:
        """End the fix of every aided vehicle, close the links and end the recording."""
        self._loop.stop()
        if self._standby is not None:
            self._standby.give_way()
        aided = sorted(sysid for sysid in self._engine.sysids() if self._engine.aiding.has_stream(sysid))
        for last in self._engine.close():
            self._links.sender.send(last)
            if isinstance(last, ParameterSet):
                # No time is left to wait for the answer and try again.
                self._links.sender.send(last)
                self._links.sender.send(last)
                log.warning("vehicle %d: %s set back to %g, unconfirmed: the service ends", last.sysid, last.name, last.value)
        if aided and not self.is_held_back:
            log.info("aiding of vehicle %s ended: the service ends", ", ".join(map(str, aided)))
        refused = self._refusals.pending_warning()
        if refused is not None:
            log.warning("%s", refused)
        await self._links.close()
        if self._standby is not None:
            await self._standby.close()
        self._recording.close()

    # The straight path: a datagram in, the engine's deadlines (`EngineLoop`), outputs out

    def _on_datagram(self, link: Link, address: Address, payload: bytes, received_at_s: float) -> None:
        receive = partial(self._receive, link, address, payload, received_at_s)
        self._loop.add(received_at_s, receive, is_late=link.is_late)

    def _receive(self, link: Link, address: Address, payload: bytes, received_at_s: float) -> None:
        received_at_s = max(received_at_s, self._loop.at_s)  # the engine's time never runs back
        if self._is_ending or not self._links.receiver.admits(link, address, len(payload), received_at_s):
            return
        self._loop.advance_for(received_at_s)
        received = self._links.receiver.receive(payload, link, address, received_at_s)
        for message in received.messages:
            self._engine.receive(message)
        if self._standby is not None:
            self._standby.watch(received, received_at_s)
        for report in received.link_reports:
            self._recording.record_side_channel(report)
        for truth in received.truths:
            self.truths[truth.sysid] = truth
        if self._keeps_frames:
            self._recording.record_received(received_at_s, received.frames, received.refused)
            self._links.forwarder.from_vehicle(received.frames, link, address, received_at_s)
        if received.messages:  # without a message to the engine no deadline comes sooner
            self._loop.wake()

    def _emit(self, outputs: list[Outbound]) -> None:
        for output in without_superseded(outputs):
            if isinstance(output, ToVehicle):
                self._links.sender.send(output)
            else:
                self.alarms.publish(output)
        if outputs and self._standby is not None:
            self._standby.tell_after_sending()

    # What comes from elsewhere than the links

    def apply_command(self, sysid: int, override: Override, source: CommandSource) -> None:
        """Apply an operator's override to one vehicle."""
        self._loop.apply(OperatorCommand(sysid, self._clock(), override, source))

    @property
    def is_held_back(self) -> bool:
        """Whether the other service of a hot standby sends, or is to send."""
        return self._standby is not None and self._standby.is_held_back

    def command_refusal(self) -> str | None:
        """Return why this service accepts no operator's override; None where it does."""
        return self._standby.command_refusal() if self._standby is not None else None

    @property
    def order_standby(self) -> Callable[[StandbyOrder], str | None] | None:
        """The function that carries out an operator's order on the hot standby.

        It returns why the order is not carried out, None where it is. None where there is no hot standby.
        """
        return self._standby.order if self._standby is not None else None

    def add_range(self, message: PeerRange) -> None:
        """Add a range that did not come over a link."""
        self._loop.apply(message)

    def each_second(self, host: ClockReference) -> None:
        """Do what is due each second, with the host's time.

        The time goes to signatures and engine. Pending warnings are published, our heartbeat is sent, and the ground tools are
        sent the alarms.
        """
        self._links.signed.set_clock(host.utc_minus_service_s)
        self._loop.set_host(host)
        self._publish_warnings(host.received_at_s)
        self.alarms.update(self.snapshots.recent_snapshot())
        self._links.send_heartbeat(self._engine.sysids(), host.received_at_s)
        if (texts := self.alarms.status_texts) is not None:
            self._links.forwarder.send_status(texts.pop_due(host.received_at_s), self._engine.sysids())

    # What observers get

    def known_sysids(self) -> list[int]:
        """The system ids of the vehicles heard so far."""
        return self._engine.sysids()

    def fault(self) -> str | None:
        """Why the fleet's path does not do its work, None where it does."""
        late_s = self._clock() - self._loop.at_s
        return f"the engine was last run {late_s:.1f} s ago" if late_s > _ENGINE_LATE_S else None

    def publish_snapshot(self) -> None:
        """Publish the fleet as it stands."""
        self.events.publish(self.snapshots.snapshot())

    def publish_refusals(self) -> None:
        """Publish what has been refused since the last call."""
        text = self._refusals.pending_warning()
        if text is not None:
            self.alarms.publish(Notice(self._clock(), None, "warning", text))

    def _publish_warnings(self, now_s: float) -> None:
        """Publish what the recorder and the links have to warn of."""
        recording = self._recording.pending_warning()
        if recording is not None:
            self.alarms.publish(Notice(now_s, None, *recording))
        for sysid, text in self._links.pending_warnings(now_s):
            self.alarms.publish(Notice(now_s, sysid, "warning", text))
