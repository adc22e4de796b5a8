"""One pass through a recording, as fast as the machine can: every picture of the page is computed once and kept."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

from gcs_coloc.core.errors import DataError
from gcs_coloc.core.messages.outbound import Notice, Outbound, ToOperator
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.mavlink.decoder import HeardTruth
from gcs_coloc.mavlink.refusals import Counts
from gcs_coloc.recorder.replay import Replay
from gcs_coloc.web.picture import fleet_frame
from gcs_coloc.web.picture_store import PictureStore
from gcs_coloc.web.track_history import LinkRates, sample
from gcs_coloc.web.wire import fleet_json

_MAX_GAP_S = 600.0
"""A longer gap has no pictures beyond this, as the replay leaves out the engine's deadlines there."""
_COUNTS_PERIOD_S = 1.0

OnPoll = Callable[[float, list[Outbound]], None]


class ReplayPass:
    """Replays a recording once and fills a `PictureStore`. `run` is for a thread of its own; `stop` ends it early."""

    def __init__(
        self, begin: Callable[[OnPoll], Replay], truths_at: Callable[[float], dict[int, HeardTruth]], store: PictureStore
    ) -> None:
        """Read up to the first message.

        Args:
            begin: makes the replay at its beginning, with a fresh engine, which calls the function given at each deadline.
            truths_at: true positions beside the recording at a time (UNIX s), by system id.
            store: where everything goes.

        Raises:
            DataError: the recording cannot be read or is none.
        """
        self._store = store
        self._truths_at = truths_at
        self._rates = LinkRates()
        self._counts = b""
        self._counts_due_s = float("-inf")
        self._stopped = threading.Event()
        self._replay = begin(self._add_events)

    @property
    def damage(self) -> Counts:
        """What of the recording could not be read so far, by kind."""
        return self._replay.log.counts

    def stop(self) -> None:
        """End `run` at the next message."""
        self._stopped.set()

    def run(self) -> None:
        """Go through the recording.

        Raises:
            DataError: the recording can no longer be read, or the pictures cannot be kept; the text says why.
        """
        try:
            self._run()
        except OSError as error:
            raise DataError(
                f"the pictures of the replay cannot be kept in the directory for temporary files: {error.strerror}; "
                "make room there, or set TMPDIR to another directory"
            ) from error

    def _run(self) -> None:
        replay, store = self._replay, self._store
        due_s = received_s = store.first_s
        while (next_s := replay.next_s) is not None:
            if self._stopped.is_set():
                return
            while due_s < next_s:
                if due_s > received_s + _MAX_GAP_S:
                    due_s = next_s
                    break
                replay.advance(due_s)
                self._add_picture(due_s)
                due_s += store.picture_period_s
            replay.step()
            received_s = next_s
        for kind, amount in self.damage.items():
            text = f"the recording is damaged: {kind.replace('_', ' ')}: {amount}; replayed what is whole"
            store.add_event(Notice(store.last_s, None, "warning", text))
        self._add_picture(max(store.last_s, replay.now_s))
        store.finish()

    def _add_events(self, at_s: float, outputs: list[Outbound]) -> None:
        del at_s
        for output in outputs:
            if isinstance(output, ToOperator):
                self._store.add_event(output)

    def _add_picture(self, at_s: float) -> None:
        fleet = self._snapshot(at_s)
        if at_s >= self._counts_due_s:
            self._counts_due_s = at_s + _COUNTS_PERIOD_S
            self._rates.update(fleet)
            self._counts = self._rates.counts(fleet).model_dump_json().encode()
        truths = (self._replay.truths | self._truths_at(at_s)).values()
        self._store.add_samples(at_s, [(v.sysid, sample(v, at_s)) for v in fleet.vehicles])
        self._store.add_picture(at_s, fleet_json(fleet_frame(fleet, truths)), self._counts, fleet.utc_minus_service_s)

    def _snapshot(self, at_s: float) -> FleetSnapshot:
        replay = self._replay
        fleet = replay.engine.snapshot(at_s)
        links = replay.decoder.sequences.links({vehicle.sysid for vehicle in fleet.vehicles})
        return replace(fleet, refused=fleet.refused | dict(replay.decoder.counts), links=links)
