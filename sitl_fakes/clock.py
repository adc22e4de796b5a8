"""Clocks: a vehicle's own since boot, and ArduPilot's correction of a sender's clock (JitterCorrection)."""

from __future__ import annotations

import math


class BootClock:
    """A vehicle's time since boot: it has an offset and a drift, and may jump."""

    def __init__(self, offset_s: float, drift_ppm: float) -> None:
        self._zero_at_s = 0.0
        self._offset_s = offset_s
        self._rate = 1.0 + drift_ppm * 1e-6

    def boot_s(self, at_s: float) -> float:
        """Boot time (s) at a time of the simulation (s)."""
        return self._offset_s + (at_s - self._zero_at_s) * self._rate

    def jump(self, by_s: float) -> None:
        """Step by a time (s), forwards or back, as a clock does that is set."""
        self._offset_s += by_s

    def restart(self, at_s: float) -> None:
        """Count from zero from a time of the simulation (s) on."""
        self._zero_at_s = at_s
        self._offset_s = 0.0


_MAX_LAG_S = 0.5
_CONVERGES_OVER = 100


class OffboardClock:
    """Converts the times in one sender's messages to local ones, as if its shortest delay were none (JitterCorrection)."""

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
        if sent_s + self._offset_s < received_s - _MAX_LAG_S:
            self._offset_s = difference_s - _MAX_LAG_S
        self._least_s = min(self._least_s, difference_s)
        self._samples += 1
        local_s = sent_s + self._offset_s
        if self._samples == _CONVERGES_OVER:
            self._offset_s, self._least_s, self._samples = self._least_s, math.inf, 0
        return local_s
