"""Cache of one fleet's snapshots, for its observers.

Observers share a snapshot where they need it within a moment of each other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import HOST_LATE_S
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.core.standby.standby_snapshot import StandbySnapshot
from gcs_coloc.links.forward import Forwarder
from gcs_coloc.mavlink.decoder import SequenceTracker
from gcs_coloc.mavlink.refusals import Refusals
from gcs_coloc.recorder.flight_recording import FlightRecording
from gcs_coloc.recorder.journal import EVERY_S
from gcs_coloc.runtime.clock import ServiceClock

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
