"""One fleet as its observers see it: those who look within a moment of each other share one look."""

from __future__ import annotations

from dataclasses import replace

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.links.forward import Forwarder
from gcs_coloc.mavlink.refusals import Refusals
from gcs_coloc.mavlink.sequence import SequenceTracker
from gcs_coloc.recorder.flight import FlightRecording
from gcs_coloc.recorder.journal import EVERY_S
from gcs_coloc.runtime.clock import ServiceClock

_RECENT_S = 0.1
_RECENT_RECORDED_S = EVERY_S + 0.05


class SnapshotCache:
    """Looks at the fleet of an engine; a look costs as much as estimating. What was recorded a moment ago is one, too.

    `sequences`, `refusals` and `forwarder` count what the engine does not.
    """

    def __init__(
        self,
        clock: ServiceClock,
        engine: Engine,
        recording: FlightRecording,
        sequences: SequenceTracker,
        refusals: Refusals,
        forwarder: Forwarder,
    ) -> None:
        self._clock = clock
        self._engine = engine
        self._recording = recording
        self._sequences = sequences
        self._refusals = refusals
        self._forwarder = forwarder
        self._recent: FleetSnapshot | None = None
        self._counted: tuple[FleetSnapshot, FleetSnapshot] | None = None  # what was seen, and the same with what is counted

    def snapshot(self) -> FleetSnapshot:
        """The fleet as it stands, with all that is counted."""
        view = self.recent_snapshot()
        if self._counted is None or self._counted[0] is not view:
            refused = view.refused | self._refusals.totals()
            links = self._sequences.links({vehicle.sysid for vehicle in view.vehicles})
            self._counted = view, replace(view, refused=refused, links=links, outs=self._forwarder.snapshots())
        return self._counted[1]

    def recent_snapshot(self) -> FleetSnapshot:
        """The fleet as it stands, or stood a moment ago where somebody has just looked.

        What is counted outside of the engine is left out: links, ground tools, and most of what is refused.
        """
        now_s = self._clock()
        recorded = self._recording.newest_view
        if recorded is not None and now_s - recorded.at_s <= _RECENT_RECORDED_S:
            self._recent = recorded
        elif self._recent is None or now_s - self._recent.at_s > _RECENT_S:
            self._recent = self._engine.snapshot(now_s)
        return self._recent
