"""Playback of a recorded flight on the page: it looks up pictures by their time.

One pass through the recording computes all pictures.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from gcs_coloc.core.alarms.alarms import Alarm, AlarmList
from gcs_coloc.core.errors import DataError
from gcs_coloc.core.messages.outbound import Notice, Outbound, ToOperator
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.mavlink.decoder import HeardTruth
from gcs_coloc.mavlink.refusals import Counts
from gcs_coloc.recorder.replay import Replay
from gcs_coloc.web.pages import PageSource
from gcs_coloc.web.picture import LinkRates, fleet_frame, sample
from gcs_coloc.web.picture_store import PictureStore, StoredPicture
from gcs_coloc.web.wire import EventsFrame, PlaybackCommand, PlaybackState, VehicleHistory, fleet_json

_MAX_GAP_S = 600.0
"""A longer gap has no pictures beyond this, as the replay leaves out the engine's deadlines there."""
_COUNTS_PERIOD_S = 1.0  # as on the live page

OnPoll = Callable[[float, list[Outbound]], None]


class Playback(PageSource):
    """Plays, pauses and seeks in the pictures that a pass has computed so far; a `PageSource`.

    A place that is not computed yet is waited for: until then the newest picture that is there is shown.
    """

    def __init__(self, store: PictureStore, speed: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Start to play from the beginning of the recording.

        `speed` is in recorded seconds a second; infinity is as fast as the pass. `clock` is any steady clock, seconds.
        """
        super().__init__()
        self._store = store
        self._clock = clock
        self._speed = speed
        self._at_s = store.first_s
        self._goal_s: float | None = None
        self._playing = True
        self._anchor: tuple[float, float] | None = None  # clock and place from which it plays on
        self._command_count = 0
        self._picture: StoredPicture | None = None

    @property
    def state(self) -> PlaybackState:
        """Where it is."""
        self._update()
        store = self._store
        return PlaybackState(
            first_s=store.first_s,
            last_s=store.last_s,
            at_s=self._at_s,
            computed_s=store.computed_s,
            playing=self._playing,
            speed=self._speed if self._speed != float("inf") else None,
            goal_s=self._goal_s,
            command_count=self._command_count,
        )

    def apply_command(self, command: PlaybackCommand) -> None:
        """Do what the page requests."""
        self._update()
        self._command_count += 1
        before = self._is_moving
        if command.halt:
            self._goal_s = None
            self._playing = False
        if command.speed is not None:
            self._speed = float("inf") if command.speed == "max" else command.speed
        if command.seek_s is not None:
            self._seek(command.seek_s)
        if command.playing is not None:
            if command.playing and self._at_s >= self._store.last_s and self._goal_s is None:
                self._seek(self._store.first_s)
            self._playing = command.playing
        self._anchor = None
        self._redraw_after(before)
        self._update()

    @property
    def newest_event(self) -> int:
        """The number of the newest event at the place; 0 where there is none."""
        return self._picture.newest_event if self._picture is not None else 0

    @property
    def utc_minus_service_s(self) -> float | None:
        """UTC minus the service's clock at the place; None where it is not known."""
        return self._picture.utc_minus_service_s if self._picture is not None else None

    def events_after(self, number: int) -> EventsFrame:
        """The events with a higher number up to the place, and how many are left out."""
        return self._store.events(number, self.newest_event)

    def tracks(self) -> tuple[VehicleHistory, ...]:
        """The last minutes of each vehicle up to the place."""
        return self._store.tracks(self._picture.at_s) if self._picture is not None else ()

    def messages(self, *, with_counts: bool) -> list[str]:
        """What each page is sent now, as JSON; nothing before the first picture is computed."""
        state = self.state
        if self._picture is None:
            return []
        fleet, counts = self._picture.read()
        return [state.model_dump_json(), fleet, *([counts] if with_counts else [])]

    def _seek(self, to_s: float) -> None:
        goal_s = min(max(to_s, self._store.first_s), self._store.last_s)
        if goal_s < self._at_s:
            self.instance = secrets.token_hex(8)  # what the pages know of later times has not happened yet
            self.edition = 0
        self._goal_s = goal_s
        self._at_s = min(goal_s, self._store.computed_s)

    def _update(self) -> None:
        """Move to where it ought to be by now."""
        before, now_s, store = self._is_moving, self._clock(), self._store
        computed_s = store.computed_s
        if self._goal_s is not None:
            self._at_s = min(self._goal_s, computed_s)
            if self._goal_s <= computed_s:
                self._goal_s = None
            self._anchor = (now_s, self._at_s)
        elif self._playing:
            from_s, from_place_s = self._anchor = self._anchor or (now_s, self._at_s)
            due_s = store.last_s
            if self._speed != float("inf"):
                due_s = min(from_place_s + (now_s - from_s) * self._speed, due_s)
            self._at_s = min(due_s, computed_s)
            if self._at_s < due_s:
                self._anchor = (now_s, self._at_s)  # what is not computed in time is not caught up with in a leap
        if self._at_s >= store.last_s:
            self._playing = False
        self._picture = store.picture_at(self._at_s)
        self._redraw_after(before)

    @property
    def _is_moving(self) -> tuple[bool, bool]:
        return self._playing, self._goal_s is not None

    def _redraw_after(self, before: tuple[bool, bool]) -> None:
        """Have the pages draw the tracks anew where a movement has ended.

        The pages saw only a few pictures of it.
        """
        if any(was and not still for was, still in zip(before, self._is_moving, strict=True)):
            self.edition += 1


class ReplayPass:
    """Replays a recording once and fills a `PictureStore`.

    `run` is for a thread of its own; `stop` ends it early.
    """

    def __init__(
        self, make_replay: Callable[[OnPoll], Replay], truths_at: Callable[[float], dict[int, HeardTruth]], store: PictureStore
    ) -> None:
        """Read up to the first message.

        Args:
            make_replay: makes the replay at its beginning, with a fresh engine, which calls the function given at each deadline.
            truths_at: true positions beside the recording at a time (UNIX s), by system id.
            store: where everything goes.

        Raises:
            DataError: the recording cannot be read or is none.
        """
        self._store = store
        self._truths_at = truths_at
        self._rates = LinkRates()
        self._alarms = AlarmList()
        self._counts = b""
        self._counts_due_s = float("-inf")
        self._stopped = threading.Event()
        self._replay = make_replay(self._add_events)

    @property
    def damage(self) -> Counts:
        """What of the recording could not be read so far, by kind."""
        return self._replay.messages.log.counts

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
        end_s = max(store.last_s, replay.now_s)
        for kind, amount in self.damage.items():
            text = f"the recording is damaged: {kind.replace('_', ' ')}: {amount}; replayed what is whole"
            store.add_event(Notice(end_s, None, "warning", text))
        self._add_picture(end_s)
        store.finish(end_s)

    def _add_events(self, at_s: float, outputs: list[Outbound]) -> None:
        del at_s
        for output in outputs:
            if isinstance(output, ToOperator):
                self._store.add_event(output)
            if isinstance(output, Notice):
                self._add_alarms(self._alarms.add_notice(output))

    def _add_alarms(self, changed: list[Alarm]) -> None:
        for alarm in changed:
            self._store.add_event(alarm)

    def _add_picture(self, at_s: float) -> None:
        fleet = self._snapshot(at_s)
        self._add_alarms(self._alarms.update(fleet))
        if at_s >= self._counts_due_s:
            self._counts_due_s = at_s + _COUNTS_PERIOD_S
            self._rates.update(fleet)
            self._counts = self._rates.counts(fleet).model_dump_json().encode()
        truths = (self._replay.messages.truths | self._truths_at(at_s)).values()
        self._store.add_samples(at_s, [(v.sysid, sample(v, at_s)) for v in fleet.vehicles])
        self._store.add_picture(
            at_s, fleet_json(fleet_frame(fleet, self._alarms, truths)), self._counts, fleet.utc_minus_service_s
        )

    def _snapshot(self, at_s: float) -> FleetSnapshot:
        replay = self._replay
        fleet = replay.engine.snapshot(at_s)
        links = replay.messages.decoder.sequences.links({vehicle.sysid for vehicle in fleet.vehicles})
        return replace(fleet, refused=fleet.refused | dict(replay.messages.decoder.counts), links=links)
