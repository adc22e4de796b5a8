"""Two autopilots with one system id, told by their boot times: a reboot changes the clock once, two clocks take turns.

Behind one address (a radio for several, a router) nothing else tells them apart, and what is sent to one reaches both.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

_APART_S = 10.0  # nearer, one sender's frames that waited somewhere would do for a second clock
_SAME_S = 2.0
_FOLLOWS = 0.01  # crystals drift; what was delayed must not draw the clock along
_TURNS = 6
_TURN_S = 1.0  # what waited and is let out among fresh frames has left its place by the next
_TURNS_WITHIN_S = 20.0
_HELD_S = 10.0


@dataclass(slots=True)
class DuplicateIdDetector:
    """Watches the boot times that come under one system id. Two that booted less than 10 s apart are not told apart."""

    _differences_s: list[float] = field(default_factory=list)
    _newest: int = 0
    _turns_s: deque[float] = field(default_factory=lambda: deque(maxlen=_TURNS))

    def add(self, stamp_s: float, received_at_s: float) -> None:
        """Add one boot time (s) and the service time at which it arrived."""
        difference_s = received_at_s - stamp_s
        clocks = self._differences_s
        for number, clock_s in enumerate(clocks):
            if abs(difference_s - clock_s) > _SAME_S:
                continue
            clocks[number] += _FOLLOWS * (difference_s - clock_s)
            if number != self._newest:
                self._newest = number
                is_next = not self._turns_s or received_at_s - self._turns_s[-1] >= _TURN_S
                if is_next and abs(clocks[0] - clocks[1]) >= _APART_S:
                    self._turns_s.append(received_at_s)
            return
        if len(clocks) < 2:
            clocks.append(difference_s)
            self._newest = len(clocks) - 1
        else:
            self._newest = 1 - self._newest
            clocks[self._newest] = difference_s
        self._turns_s.clear()

    def detected(self, now_s: float) -> bool:
        """Whether two clocks take turns: six times, a second or more apart, within 20 s, and once within the last 10 s."""
        turns_s = self._turns_s
        return len(turns_s) == _TURNS and turns_s[-1] - turns_s[0] <= _TURNS_WITHIN_S and now_s - turns_s[-1] <= _HELD_S
