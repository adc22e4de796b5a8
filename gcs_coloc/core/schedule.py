"""The schedule of a fleet's work: what is due in whole periods after its start."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor

SAME_S = 1e-3
"""Times that are as close as this are meant to be the same: what is due each 0.2 s is due at a deadline a little before, too."""


@dataclass(frozen=True, slots=True)
class TickSchedule:
    """Times that lie whole periods after `start_s` (service time, s).

    They are in whole microseconds, as the service's clock has them. Where several periods have a time in common it is the same
    number, to the last bit.
    """

    start_s: float

    def after(self, now_s: float, period_s: float) -> float:
        """Return the first time after `now_s` that lies whole periods of `period_s` after the start."""
        periods = floor((now_s - self.start_s) / period_s)
        while (at_s := round(self.start_s + periods * period_s, 6)) <= now_s:
            periods += 1
        return at_s
