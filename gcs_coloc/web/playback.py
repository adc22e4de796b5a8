"""A recorded flight on the page: played, paused, sought in.

Going to another place is going on from a state that was kept on the way, and computing the rest: every answer is the flight's.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from gcs_coloc.core.messages.outbound import Notice, Outbound, ToOperator
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.recorder.checkpoints import Checkpoints
from gcs_coloc.recorder.freeze import FreezeError, freeze, thaw
from gcs_coloc.recorder.playhead import Playhead
from gcs_coloc.recorder.replay import Replay
from gcs_coloc.web.track_history import TrackHistory
from gcs_coloc.web.wire import PlaybackCommand, PlaybackState

log = logging.getLogger("gcs_coloc")

_SLICE_S = 0.03
"""The event loop is held up for so long at most: the page is to answer while an hour is replayed at full speed."""
_TURNS = 8
"""So many turns of the event loop follow each slice: a request takes five from its arrival to its answer, and waits for one."""
_TICK_S = 0.04
_SAMPLE_EVERY_S = 0.5

OnPoll = Callable[[float, list[Outbound]], None]


class Playback:
    """One recording and its page's story. `begin` makes a replay at its beginning, with a fresh engine."""

    def __init__(
        self,
        begin: Callable[[OnPoll], Replay],
        head: Playhead,
        story: TrackHistory,
        keeping: Callable[[bytes], Checkpoints] = Checkpoints,
    ) -> None:
        """Read up to the first message. DataError where the recording is none. `keeping` makes the store of states."""
        self._begin = begin
        self._head = head
        self._story = story
        self._obeyed = 0
        self._told_damage = False
        self._sample_due_s = float("-inf")
        self._replay = begin(self._polled)
        self._checkpoints: Checkpoints | None = None
        beginning = self._frozen()
        if beginning is not None:
            self._checkpoints = keeping(beginning)

    @property
    def replay(self) -> Replay:
        """The replay as far as it has come."""
        return self._replay

    @property
    def state(self) -> PlaybackState:
        """What the page is told of it."""
        head = self._head
        return PlaybackState(
            first_s=head.first_s,
            last_s=head.last_s,
            at_s=head.at_s,
            playing=head.playing,
            speed=head.speed if head.speed != float("inf") else None,
            goal_s=head.goal_s,
            obeyed=self._obeyed,
        )

    def look(self) -> FleetSnapshot:
        """The fleet at the place that was reached."""
        return self._view(max(self._head.at_s, self._replay.now_s))

    def _view(self, at_s: float) -> FleetSnapshot:
        through = self._replay
        view = through.engine.snapshot(at_s)
        links = through.decoder.sequences.links({vehicle.sysid for vehicle in view.vehicles})
        return replace(view, refused=view.refused | dict(through.decoder.counts), links=links)

    def obey(self, command: PlaybackCommand) -> None:
        """Do what the page asks for."""
        self._obeyed += 1
        before = self._motion
        if command.halt:
            self._head.halt()
        if command.speed is not None:
            self._head.set_speed(float("inf") if command.speed == "max" else command.speed)
        if command.seek_s is not None:
            self._head.seek(command.seek_s)
        if command.playing is not None:
            (self._head.play if command.playing else self._head.pause)()
        self._tell_whole_after(before)

    @property
    def _motion(self) -> tuple[bool, bool]:
        return self._head.playing, self._head.goal_s is not None

    def _tell_whole_after(self, before: tuple[bool, bool]) -> None:
        if any(was and not still for was, still in zip(before, self._motion, strict=True)):
            # The pages saw little of what it moved through.
            self._story.edition += 1

    async def run(self) -> None:
        """Go on for ever. DataError where the recording can no longer be read."""
        while True:
            if self.go_on(time.monotonic):
                for _ in range(_TURNS):
                    await asyncio.sleep(0.0)
            else:
                await asyncio.sleep(_TICK_S)

    def go_on(self, clock: Callable[[], float]) -> bool:
        """Move for a moment to where the playhead ought to be by `clock` (s); whether it is still behind."""
        head, began_s = self._head, clock()
        due_s = head.due_s(began_s)
        if due_s < self._replay.now_s or head.goal_s is not None:
            self._leap(due_s)
        now_s = began_s
        while (next_s := self._replay.next_s) is not None and next_s <= due_s:
            self._replay.step()
            now_s = clock()
            if now_s >= began_s + _SLICE_S:
                break
        self._keep(now_s - began_s, clock)
        if next_s is not None and next_s <= due_s:
            self._reached(next_s, due_s)
            return next_s < due_s
        if next_s is not None:
            self._replay.advance(due_s)
        self._reached(due_s, due_s)
        return False

    def _reached(self, at_s: float, due_s: float) -> None:
        before = self._motion
        self._head.reached(at_s, due_s)
        self._tell_whole_after(before)
        if self._replay.next_s is None and not self._told_damage:
            self._told_damage = True
            for kind, amount in self._replay.log.counts.items():
                text = f"the recording is damaged: {kind.replace('_', ' ')}: {amount}; replayed what is whole"
                self._story.take(Notice(at_s, None, "warning", text))

    def _leap(self, due_s: float) -> None:
        """Go to the kept state that is nearest before a place (UNIX s), unless what is here is nearer."""
        is_back = due_s < self._replay.now_s
        if self._checkpoints is not None:
            nearest = self._checkpoints.nearest(due_s)
            if not is_back and nearest.at_s <= self._replay.now_s:
                return
            try:
                self._restore(thaw(nearest.frozen), is_back=is_back)
            except FreezeError as error:
                self._give_up_keeping(error)
            else:
                return
        if is_back:
            self._story.reset()
            self._told_damage = False
            self._sample_due_s = float("-inf")
            self._replay = self._begin(self._polled)

    def _keep(self, work_s: float, clock: Callable[[], float]) -> None:
        """Keep the state that was reached by `work_s` of work, where it is time for that."""
        if self._checkpoints is None or not self._checkpoints.worked(self._replay.now_s, work_s):
            return
        began_s = clock()
        frozen = self._frozen()
        if frozen is not None:
            self._checkpoints.keep(self._replay.now_s, frozen, clock() - began_s)

    def _frozen(self) -> bytes | None:
        try:
            return freeze((self._replay.state(), self._story.state(), self._sample_due_s, self._told_damage))
        except FreezeError as error:
            self._give_up_keeping(error)
            return None

    def _restore(self, state: Any, *, is_back: bool) -> None:
        replay, story, self._sample_due_s, self._told_damage = state
        self._replay.restore(replay)
        self._story.restore(story, anew=is_back)

    def _give_up_keeping(self, error: FreezeError) -> None:
        self._checkpoints = None
        log.warning(
            "the state of estimator %s cannot be copied (%s): to go back is to compute the flight again from its beginning",
            self._replay.engine.estimator.name,
            error,
        )

    def _polled(self, at_s: float, outputs: list[Outbound]) -> None:
        for output in outputs:
            if isinstance(output, ToOperator):
                self._story.take(output)
        if at_s >= self._sample_due_s:
            self._sample_due_s = at_s + _SAMPLE_EVERY_S
            self._story.take(self._view(at_s))
