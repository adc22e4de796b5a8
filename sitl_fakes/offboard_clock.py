"""A sender's clock as ArduPilot takes it (JitterCorrection): found is what a message took longer than the quickest."""

from __future__ import annotations

import math

_LONGEST_LAG_S = 0.5
_CONVERGES_OVER = 100


class OffboardClock:
    """Turns the times in one sender's messages into local ones, up to the shortest delay among them."""

    def __init__(self) -> None:
        self._offset_s = math.inf
        self._least_s = math.inf
        self._samples = 0

    def to_local_s(self, sent_s: float, received_s: float) -> float:
        """The local time (s) of a sender's time (s) in a message that was received just now; never later than now, nor earlier by
        more than 0.5 s.
        """
        difference_s = received_s - sent_s
        self._offset_s = min(self._offset_s, difference_s)
        if sent_s + self._offset_s < received_s - _LONGEST_LAG_S:
            self._offset_s = difference_s - _LONGEST_LAG_S
        self._least_s = min(self._least_s, difference_s)
        self._samples += 1
        local_s = sent_s + self._offset_s
        if self._samples == _CONVERGES_OVER:
            self._offset_s, self._least_s, self._samples = self._least_s, math.inf, 0
        return local_s
