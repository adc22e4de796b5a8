"""What the observers of one fleet see: its newest snapshot, and its alarms.

Observers share a snapshot where they need it within a moment of each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

from gcs_coloc.core.alarms.alarms import Alarm, AlarmList
from gcs_coloc.core.alarms.status_texts import StatusTexts
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import HOST_LATE_S
from gcs_coloc.core.messages.outbound import Notice, ToOperator
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.core.standby.standby_snapshot import StandbySnapshot
from gcs_coloc.links.forward import Forwarder
from gcs_coloc.mavlink.decoder import SequenceTracker
from gcs_coloc.mavlink.refusals import Refusals
from gcs_coloc.recorder.flight_recording import FlightRecording
from gcs_coloc.recorder.journal import EVERY_S
from gcs_coloc.runtime.clock import ServiceClock
from gcs_coloc.sinks.event_bus import EventBus

_RECENT_S = 0.1
"""How old a shared snapshot may be. Chosen: less than a person sees, and enough for page, broker and console to share one."""
_RECENT_RECORDED_S = EVERY_S + 0.05
"""How old a recorded one may be: until the next is recorded, with some delay."""


class SnapshotCache:
    """Keeps the newest snapshot of an engine's fleet: making one costs as much as estimating.

    A snapshot that was recorded a moment ago serves, too. `sequences`, `refusals` and `forwarder` count what the engine does
    not; `standby` tells which of two services sends, `lag_s` by how much the engine is behind: who looks on after a pause may
    come before what waited in the sockets, and the engine knows of the pause with that.
    """

    def __init__(
        self,
        clock: ServiceClock,
        engine: Engine,
        recording: FlightRecording,
        sequences: SequenceTracker,
        refusals: Refusals,
        forwarder: Forwarder,
        standby: Callable[[], StandbySnapshot | None] = lambda: None,
        lag_s: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self._clock = clock
        self._engine = engine
        self._recording = recording
        self._sequences = sequences
        self._refusals = refusals
        self._forwarder = forwarder
        self._standby = standby
        self._lag_s = lag_s
        self._recent: FleetSnapshot | None = None
        self._recorded: FleetSnapshot | None = None
        self._counted: tuple[FleetSnapshot, FleetSnapshot] | None = None  # an engine's snapshot, and the same with all counts

    def snapshot(self) -> FleetSnapshot:
        """Return the fleet's present state, with all counts."""
        recent = self.recent_snapshot()
        if self._counted is None or self._counted[0] is not recent:
            refused = recent.refused | self._refusals.totals()
            links = self._sequences.links({vehicle.sysid for vehicle in recent.vehicles})
            self._counted = recent, replace(recent, refused=refused, links=links, outs=self._forwarder.snapshots())
        return self._counted[1]

    def recent_snapshot(self) -> FleetSnapshot:
        """Return the fleet's state of now or of a moment ago.

        Without the counts from outside of the engine: links, ground tools, and most refusals.
        """
        now_s = self._clock()
        recorded = self._recording.newest_snapshot
        if recorded is not None and now_s - recorded.at_s <= _RECENT_RECORDED_S:
            if self._recent is None or self._recorded is not recorded:
                self._recent, self._recorded = self._with_standby(recorded), recorded
        elif self._recent is None or now_s - self._recent.at_s > _RECENT_S:
            self._recent = self._with_standby(self._with_lag(self._engine.snapshot(now_s)))
        return self._recent

    def _with_lag(self, snapshot: FleetSnapshot) -> FleetSnapshot:
        lag_s = self._lag_s()
        return replace(snapshot, loop_lag_s=round(lag_s, 3)) if lag_s > max(snapshot.loop_lag_s, HOST_LATE_S) else snapshot

    def _with_standby(self, snapshot: FleetSnapshot) -> FleetSnapshot:
        standby = self._standby()
        return replace(snapshot, standby=standby) if standby is not None else snapshot


class AlarmDesk:
    """Keeps the list of alarms and passes on what changes in it.

    A change goes to `events` and `record`, and to the ground tools where `tells_ground_tools` is set.
    """

    def __init__(
        self, clock: ServiceClock, events: EventBus, record: Callable[[Alarm], None], *, tells_ground_tools: bool
    ) -> None:
        self._clock = clock
        self._events = events
        self._record = record
        self._alarms = AlarmList()
        self.status_texts = StatusTexts() if tells_ground_tools else None
        """The texts for ground tools; None where these are not told of alarms."""

    def update(self, fleet: FleetSnapshot) -> tuple[Alarm, ...]:
        """Update the alarms from a snapshot of the fleet, and return those in the list."""
        self._publish(self._alarms.update(fleet))
        return tuple(self._alarms)

    def acknowledge(self, alarm_id: int) -> bool:
        """Acknowledge an alarm; False where none of that id waits for it."""
        changed = self._alarms.acknowledge(alarm_id, self._clock())
        self._publish(changed)
        return bool(changed)

    def publish(self, message: ToOperator) -> None:
        """Publish what the operator is to know; a notice is an alarm, too, where it is serious."""
        self._events.publish(message)
        if isinstance(message, Notice):
            self._publish(self._alarms.add_notice(message))

    def _publish(self, changed: Iterable[Alarm]) -> None:
        for alarm in changed:
            self._events.publish(alarm)
            self._record(alarm)
            if self.status_texts is not None:
                self.status_texts.add(alarm)
