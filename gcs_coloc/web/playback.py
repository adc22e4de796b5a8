"""A recorded flight on the page: played, paused, sought in. Going back is replaying anew: every answer is the flight's."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

from gcs_coloc.core.outputs import Notice, Outbound, ToOperator
from gcs_coloc.core.view import FleetView
from gcs_coloc.recorder.playhead import Playhead
from gcs_coloc.recorder.replay import Replay
from gcs_coloc.web.story import Story
from gcs_coloc.web.wire import PlaybackCommand, PlaybackState

_SLICE_S = 0.03
"""The event loop is held up for so long at most: the page is to answer while an hour is replayed at full speed."""
_TICK_S = 0.04
_SAMPLE_EVERY_S = 0.5

OnPoll = Callable[[float, list[Outbound]], None]


class Playback:
    """One recording and its page's story. `begin` makes a replay at its beginning, with a fresh engine.

    `damage` says what of the file could not be read so far, by kind; the operator is told at the end.
    """

    def __init__(
        self, begin: Callable[[OnPoll], Replay], head: Playhead, story: Story, damage: Callable[[], Mapping[str, int]] = dict
    ) -> None:
        """Read up to the first message. DataError where the recording is none."""
        self._begin = begin
        self._head = head
        self._story = story
        self._damage = damage
        self._told_damage = False
        self._sample_due_s = float("-inf")
        self._replay = begin(self._polled)

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
        )

    def look(self) -> FleetView:
        """The fleet at the place that was reached."""
        return self._view(max(self._head.at_s, self._replay.now_s))

    def _view(self, at_s: float) -> FleetView:
        through = self._replay
        view = through.engine.view(at_s)
        links = through.decoder.sequences.links({vehicle.sysid for vehicle in view.vehicles})
        return replace(view, refused=view.refused | dict(through.decoder.counts), links=links)

    def obey(self, command: PlaybackCommand) -> None:
        """Do what the page asks for."""
        if command.speed is not None:
            self._head.set_speed(float("inf") if command.speed == "max" else command.speed)
        if command.seek_s is not None:
            self._head.seek(command.seek_s)
        if command.playing is not None:
            (self._head.play if command.playing else self._head.pause)()

    async def run(self) -> None:
        """Go on for ever. DataError where the recording can no longer be read."""
        while True:
            behind = self.go_on(time.monotonic)
            await asyncio.sleep(0.0 if behind else _TICK_S)

    def go_on(self, clock: Callable[[], float]) -> bool:
        """Move for a moment to where the playhead ought to be by `clock` (s); whether it is still behind."""
        head, until_s = self._head, clock() + _SLICE_S
        due_s = head.due_s(until_s - _SLICE_S)
        if due_s < self._replay.now_s:
            self._begin_again()
        while (next_s := self._replay.next_s) is not None and next_s <= due_s:
            self._replay.step()
            if clock() >= until_s:
                break
        if next_s is not None and next_s <= due_s:
            self._reached(next_s, due_s)
            return next_s < due_s
        if next_s is not None:
            self._replay.advance(due_s)
        self._reached(due_s, due_s)
        return False

    def _reached(self, at_s: float, due_s: float) -> None:
        moving = self._head.goal_s is not None
        self._head.reached(at_s, due_s)
        if moving and self._head.goal_s is None:
            # The pages saw little of what lies between.
            self._story.edition += 1
        if self._replay.next_s is None and not self._told_damage:
            self._told_damage = True
            for kind, amount in self._damage().items():
                text = f"the recording is damaged: {kind.replace('_', ' ')}: {amount}; replayed what is whole"
                self._story.take(Notice(at_s, None, "warning", text))

    def _begin_again(self) -> None:
        self._story.reset()
        self._told_damage = False
        self._sample_due_s = float("-inf")
        self._replay = self._begin(self._polled)

    def _polled(self, at_s: float, outputs: list[Outbound]) -> None:
        for output in outputs:
            if isinstance(output, ToOperator):
                self._story.take(output)
        if at_s >= self._sample_due_s:
            self._sample_due_s = at_s + _SAMPLE_EVERY_S
            self._story.take(self._view(at_s))
