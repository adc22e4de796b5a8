"""One fleet's service: its path from the links through the engine and back to the links.

Its recording, observers and ground tools are attached to that path.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from gcs_coloc.config.settings import Settings
from gcs_coloc.core.deadlines import advance, find_overrun, without_superseded
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import (
    HOST_LATE_S,
    ClockReference,
    CommandSource,
    ForeignGpsInput,
    GpsOverride,
    HoldBack,
    OperatorCommand,
    Override,
    SwitchedByOther,
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
from gcs_coloc.runtime.clock import ServiceClock, Timer
from gcs_coloc.service.fleet_links import FleetLinks, LinkHooks
from gcs_coloc.service.fleet_views import AlarmDesk, SnapshotCache
from gcs_coloc.service.traffic import Backlog
from gcs_coloc.sinks.event_bus import EventBus, IdleScheduler

if TYPE_CHECKING:
    from gcs_coloc.service.hot_standby import HotStandby

log = logging.getLogger("gcs_coloc")

_ENGINE_LATE_S = 2.0
"""Chosen: the engine runs several times a second; so much later the service is not doing its work."""
_HELD_UP_S = 0.02
"""What is read so long after the engine's time may have waited. Chosen: less than the 0.05 s that 1 m at 20 m/s takes."""
_BEHIND_S = 0.5
"""Chosen: two and a half deadlines at 5 Hz. A position so late, or a sign of life, says what is no longer so."""


_Control = ClockReference | OperatorCommand | PeerRange | ForeignGpsInput | HoldBack | SwitchedByOther


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
        self._engine_at_s = clock()
        self._host = host
        self._lag_s = 0.0  # the worst since the host's last report
        self._is_ending = False
        self._backlog = Backlog()
        self._is_reading = self._is_catching_up = False
        self._held_up_until_s = float("-inf")
        self._unsent: list[Outbound] = []
        self._engine = Engine(load_estimator(settings.estimator.name, settings.estimator.settings), settings.engine())
        self._deadline = Timer(clock, self._poll)
        self._standby: HotStandby | None = None
        if settings.standby.peer:
            from gcs_coloc.service.hot_standby import HotStandby  # a service that is alone starts without it

            self._standby = HotStandby(settings, clock, self._engine, self._apply, self.alarms.publish, self._is_behind)
        standby = self._standby
        hooks = LinkHooks(
            on_datagram=self._on_datagram,
            on_sent=lambda frame: self._recording.record_sent(self._engine_at_s, frame),
            on_forwarded=lambda raw: self._recording.record_forwarded(self._engine_at_s, raw),
            on_foreign_gps_input=lambda raw, sysid: self._apply(foreign_gps_input(raw, self._clock(), sysid)),
            is_aided=lambda sysid: self._engine.aiding.has_stream(sysid),
            may_send=standby.may_send if standby is not None else lambda _: True,
            is_other_service=standby.is_other_service if standby is not None else None,
        )
        self._links = FleetLinks(settings, clock, host.utc_minus_service_s, hooks)
        self._recording = FlightRecording(settings.record, settings.mavlink, self._engine)
        self._recording.record_side_channel(FlownWith(settings.fingerprint(), self._engine_at_s))
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
            self._behind_s,
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
        self._deadline.cancel()
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

    # The straight path: a datagram in, the engine's deadlines, outputs out

    def _on_datagram(self, link: Link, address: Address, payload: bytes, received_at_s: float) -> None:
        has_waited = link.is_late or received_at_s - self._engine_at_s > _HELD_UP_S
        if not (has_waited or self._is_reading or self._backlog):
            self._receive(link, address, payload, received_at_s)
            return
        starts = not (self._is_reading or self._backlog)
        self._backlog.add(received_at_s, partial(self._receive, link, address, payload, received_at_s))
        if starts:
            self._read_waiting()
            self._receive_some()

    def _receive(self, link: Link, address: Address, payload: bytes, received_at_s: float) -> None:
        if received_at_s < self._engine_at_s:
            received_at_s = self._engine_at_s  # its time never runs back
        if self._is_ending or not self._links.receiver.admits(link, address, len(payload), received_at_s):
            return
        # The timer fires no later than the engine's next deadline, and most datagrams come before that.
        if received_at_s > self._deadline.at_s or self._is_catching_up:
            self._advance(received_at_s)
        self._engine_at_s = received_at_s
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
            self._wake()

    def _read_waiting(self) -> None:
        """Read what waits at all links into the backlog.

        It can then be received in the order in which it came, so that no link's datagrams are taken for late.
        """
        self._is_reading = True
        try:
            self._links.receive_waiting()
        finally:
            self._is_reading = False

    def _receive_some(self) -> None:
        """Receive the backlog, or its oldest part.

        The timer goes on with the rest, so that the event loop runs before.
        """
        now_s = self._clock()
        if self._backlog:
            self._add_lag(now_s - self._backlog.oldest_s)
        overrun = find_overrun(self._engine, self._engine_at_s, now_s)
        if overrun is not None and self._engine_at_s >= self._held_up_until_s:
            self._held_up_until_s = overrun.until_s
            self._recording.record_side_channel(overrun)
        self._is_catching_up = True
        try:
            self._backlog.receive_some(self._clock)
        finally:
            self._is_catching_up = False
        self._emit_unsent()
        self._wake()

    def _behind_s(self) -> float:
        """How long what is to be done next has been due: the oldest of what waits, or the engine's deadline."""
        return self._clock() - (self._backlog.oldest_s if self._backlog else self._engine.next_deadline())

    def _is_behind(self) -> bool:
        """Whether what is received now is too old for its answer to be sent."""
        return bool(self._backlog) and self._clock() - self._backlog.oldest_s > _BEHIND_S

    def _add_lag(self, lag_s: float) -> None:
        """Have the engine know of a lag before it gets what came meanwhile: no vehicle is to blame for it."""
        self._lag_s = max(self._lag_s, lag_s)
        if lag_s > HOST_LATE_S:
            late = replace(self._host, received_at_s=self._engine_at_s, lag_s=round(lag_s, 3))
            self._engine.receive(late)
            self._recording.record_side_channel(late)

    def _wake(self) -> None:
        """Set the timer for the rest of the backlog or, without one, for the engine's next deadline."""
        self._deadline.by(self._backlog.oldest_s if self._backlog else self._engine.next_deadline())

    def _poll(self) -> None:
        if not self._backlog:
            self._add_lag(self._clock() - self._engine.next_deadline())
            self._read_waiting()
        self._receive_some()
        if not self._backlog:
            self._advance(max(self._clock(), self._engine_at_s))
            self._emit_unsent()
            self._wake()

    def _advance(self, to_s: float) -> None:
        """Run the engine's deadlines before `to_s` and emit its outputs.

        This comes before the engine gets what arrived at `to_s`.
        """
        self._engine_at_s = to_s
        if self._engine.next_deadline() >= to_s:
            return
        is_idle = False
        for at_s, outputs in advance(self._engine, to_s, self._held_up_until_s):
            self._unsent.extend(outputs)
            if self._engine.next_aid_s() >= to_s and not self._is_catching_up:
                # Before the fleet is reviewed and the journal written: that takes longer than estimating, and vehicles wait.
                self._emit_unsent()
                is_idle = self._engine.next_deadline() >= to_s
            self._recording.record_outputs(at_s, outputs)
        if is_idle:
            self.idle.start_slots()

    def _emit_unsent(self) -> None:
        if self._is_behind():
            return
        unsent, self._unsent = self._unsent, []
        for output in without_superseded(unsent):
            if isinstance(output, ToVehicle):
                self._links.sender.send(output)
            else:
                self.alarms.publish(output)
        if unsent and self._standby is not None:
            self._standby.tell_after_sending()

    # What comes from elsewhere than the links

    def apply_command(self, sysid: int, override: Override, source: CommandSource) -> None:
        """Apply an operator's override to one vehicle."""
        self._apply(OperatorCommand(sysid, self._clock(), override, source))

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
        self._apply(message)

    def each_second(self, host: ClockReference) -> None:
        """Do what is due each second, with the host's time.

        The time goes to signatures and engine. Pending warnings are published, our heartbeat is sent, and the ground tools are
        sent the alarms.
        """
        self._links.signed.set_clock(host.utc_minus_service_s)
        self._host, self._lag_s = replace(host, lag_s=round(self._lag_s, 3)), 0.0
        self._apply(self._host)
        self._publish_warnings(host.received_at_s)
        self.alarms.update(self.snapshots.recent_snapshot())
        self._links.send_heartbeat(self._engine.sysids(), host.received_at_s)
        if self.alarms.tells_ground_tools:
            self._links.forwarder.send_status(self.alarms.pop_status_texts(host.received_at_s), self._engine.sysids())

    def _apply(self, message: _Control) -> None:
        if not (self._backlog or self._is_catching_up):
            self._read_waiting()
            self._receive_some()
        if self._backlog or self._is_catching_up:
            self._backlog.add(message.received_at_s, partial(self._receive_control, message))
        else:
            self._receive_control(message)

    def _receive_control(self, message: _Control) -> None:
        message = replace(message, received_at_s=max(message.received_at_s, self._engine_at_s))
        self._advance(message.received_at_s)
        if not self._is_catching_up:
            self._emit_unsent()
        self._engine.receive(message)
        self._recording.record_side_channel(message)
        self._wake()

    # What observers get

    def known_sysids(self) -> list[int]:
        """The system ids of the vehicles heard so far."""
        return self._engine.sysids()

    def fault(self) -> str | None:
        """Why the fleet's path does not do its work, None where it does."""
        late_s = self._clock() - self._engine_at_s
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
