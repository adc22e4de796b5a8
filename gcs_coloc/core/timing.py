"""A sender's clock mapped to the service's clock from one-way stamps.

The smallest difference between arrival and stamp over the last minute belongs to the message that waited least: offset
plus the link's least delay. Latency that varies from message to message therefore drops out; a constant part of it stays.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

_BUCKET_S = 10.0
_BUCKETS = 6
_JUMP_S = 2.0
_JUMPS_TO_BELIEVE = 3


@dataclass(slots=True)
class SenderClock:
    """One clock of one sender: learns from each stamped message, refuses stamps that jump until they are borne out.

    A jump is a stamp more than 2 s ahead of what the least delay allows, or more than 2 s behind the newest stamp.
    Three of them in a row that agree with each other are a new clock (a reboot), and the old one is forgotten.
    """

    resets: int = 0
    _buckets: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=_BUCKETS))
    _newest_stamp_s: float = float("-inf")
    _jumps: list[float] = field(default_factory=list)

    def learn(self, stamp_s: float, received_at_s: float) -> bool:
        """Take one stamp; False where it jumps and must not be used."""
        difference_s = received_at_s - stamp_s
        while self._buckets and received_at_s - self._buckets[0][0] > _BUCKETS * _BUCKET_S:
            self._buckets.popleft()
        if self._buckets and self._jumped(stamp_s, difference_s):
            self._jumps = [j for j in self._jumps if abs(j - difference_s) < _JUMP_S]
            self._jumps.append(difference_s)
            if len(self._jumps) < _JUMPS_TO_BELIEVE:
                return False
            self.resets += 1
            self._buckets.clear()
            self._newest_stamp_s = float("-inf")
        self._jumps.clear()
        self._newest_stamp_s = max(self._newest_stamp_s, stamp_s)
        if self._buckets and received_at_s - self._buckets[-1][0] < _BUCKET_S:
            started_s, least_s = self._buckets[-1]
            self._buckets[-1] = (started_s, min(least_s, difference_s))
        else:
            self._buckets.append((received_at_s, difference_s))
        return True

    def to_service(self, stamp_s: float) -> float:
        """The service time of a stamp (seconds). Only valid after `learn` has taken one."""
        return stamp_s + min(least_s for _, least_s in self._buckets)

    def _jumped(self, stamp_s: float, difference_s: float) -> bool:
        least_s = min(least_s for _, least_s in self._buckets)
        return difference_s < least_s - _JUMP_S or stamp_s < self._newest_stamp_s - _JUMP_S
