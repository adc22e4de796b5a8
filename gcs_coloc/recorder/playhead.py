"""Where a recording is being looked at: plays, pauses, jumps. The clock is passed in; another drives the engine to the place."""

from __future__ import annotations


class Playhead:
    """A place in a recording of `first_s` to `last_s` (UNIX s) that moves on with a clock. `now_s` is any steady clock, seconds.

    `at_s` is the place that was reached last, `goal_s` where it is being moved to at full speed, or None. `speed` is in
    recorded seconds a second, infinity for as fast as it goes.
    """

    def __init__(self, first_s: float, last_s: float, speed: float) -> None:
        self.first_s = first_s
        self.last_s = max(first_s, last_s)
        self.at_s = first_s
        self.speed = speed
        self.playing = True
        self.goal_s: float | None = None
        self._anchor: tuple[float, float] | None = None

    def play(self) -> None:
        """Go on; from the end, begin again."""
        if self.at_s >= self.last_s and self.goal_s is None:
            self.goal_s = self.first_s
        self.playing = True
        self._anchor = None

    def pause(self) -> None:
        """Stay where it is."""
        self.playing = False

    def set_speed(self, speed: float) -> None:
        """Go on at another speed."""
        self.speed = speed
        self._anchor = None

    def seek(self, to_s: float) -> None:
        """Go to a place (UNIX s) at full speed; beyond the recording is its beginning or its end."""
        self.goal_s = min(max(to_s, self.first_s), self.last_s)

    def halt(self) -> None:
        """Go no further, neither playing nor to a place that was asked for."""
        self.goal_s = None
        self.playing = False

    def due_s(self, now_s: float) -> float:
        """The place where it ought to be now."""
        if self.goal_s is not None:
            return self.goal_s
        if not self.playing:
            return self.at_s
        if self.speed == float("inf"):
            return self.last_s
        if self._anchor is None:
            self._anchor = (now_s, self.at_s)
        return min(self._anchor[1] + (now_s - self._anchor[0]) * self.speed, self.last_s)

    def reached(self, at_s: float, due_s: float) -> None:
        """The place `at_s` was reached on the way to `due_s`."""
        self.at_s = at_s
        if self.goal_s is not None:
            if at_s >= self.goal_s:
                self.goal_s = None
            self._anchor = None
        elif at_s < due_s:
            # Too fast for this machine: what was not managed is not caught up with in a leap.
            self._anchor = None
        if at_s >= self.last_s:
            self.playing = False
