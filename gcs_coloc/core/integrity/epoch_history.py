"""The scenes of the last seconds, with which the present one is compared."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from math import exp
from operator import attrgetter

from gcs_coloc.core.integrity.adjustment import Past
from gcs_coloc.core.integrity.epoch import Epoch

_APART_S = 0.3
_at_s = attrgetter("at_s")


class EpochHistory:
    """Keeps scenes that are `every_s` apart for as long as the longest of the intervals.

    An honest error wanders between two times as a Gauss-Markov process of `wander_time_s` does.
    """

    def __init__(self, intervals_s: Sequence[float], wander_time_s: float, every_s: float) -> None:
        self._intervals_s = tuple(intervals_s)
        self._wander_time_s = wander_time_s
        self._scenes: deque[Epoch] = deque(maxlen=round(max(intervals_s) / every_s) + 2)

    def append(self, scene: Epoch) -> None:
        """Remember a scene, newer than all before."""
        self._scenes.append(scene)

    def before(self, at_s: float) -> dict[float, Past]:
        """Return what to compare a scene with, by the interval: nothing for 0, then a remembered scene of each interval ago if
        there is one near it.
        """
        pasts: dict[float, Past] = {0.0: (None, 0.0)}
        for interval_s in self._intervals_s:
            then = self._nearest(at_s - interval_s)
            if then is not None:
                pasts[interval_s] = (then, exp(-interval_s / self._wander_time_s))
        return pasts

    def _nearest(self, wanted_s: float) -> Epoch | None:
        later = bisect_left(self._scenes, wanted_s, key=_at_s)
        next_to = [self._scenes[n] for n in (later - 1, later) if 0 <= n < len(self._scenes)]
        then = min(next_to, key=lambda past: abs(past.at_s - wanted_s), default=None)
        return then if then is not None and abs(then.at_s - wanted_s) <= _APART_S else None
