"""Which states of a replay are kept, so that to go back is to go on from the nearest: many, but never too much memory."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

EVERY_S = 0.5
"""So much work lies between two of them, seconds: what a seek may take is not noticed as waiting."""
WORK_PER_COST = 25.0
"""Keeping them takes no more than this part of the work between them."""
MOST_BYTES = 128_000_000


@dataclass(slots=True)
class Checkpoint:
    """A frozen state at service time `at_s` (UNIX s), and how much work (s) it took to come to it from the one before."""

    at_s: float
    frozen: bytes
    work_s: float


class Checkpoints:
    """The states kept of one replay, in order of time. Where they become too large, those that save the least go."""

    def __init__(self, beginning: bytes, every_s: float = EVERY_S, most_bytes: int = MOST_BYTES) -> None:
        """`beginning` is the state before anything was done; it is kept always."""
        self._kept = [Checkpoint(float("-inf"), beginning, 0.0)]
        self._every_s = every_s
        self._most_bytes = most_bytes
        self._cost_s = 0.0
        self._from_s = float("-inf")
        self._work_s = 0.0

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def size_bytes(self) -> int:
        """The memory that all of them take."""
        return sum(len(one.frozen) for one in self._kept)

    def nearest(self, at_s: float) -> Checkpoint:
        """The newest that is not after a time (UNIX s)."""
        return self._kept[self._after(at_s) - 1]

    def worked(self, at_s: float, work_s: float) -> bool:
        """Whether the state is to be kept now that `work_s` more was done, and `at_s` (UNIX s) reached."""
        where = self._after(at_s)
        passed = self._kept[where - 1]
        if passed.at_s != self._from_s:
            self._from_s, self._work_s = passed.at_s, 0.0
        else:
            self._work_s += work_s
        enough_s = max(self._every_s, WORK_PER_COST * self._cost_s)
        ahead_s = self._kept[where].work_s - self._work_s if where < len(self._kept) else float("inf")
        return self._work_s >= enough_s and ahead_s >= enough_s

    def keep(self, at_s: float, frozen: bytes, cost_s: float) -> None:
        """Keep a state that `worked` asked for at this time; `cost_s` is how long it took to freeze it."""
        self._cost_s = cost_s
        where = self._after(at_s)
        self._kept.insert(where, Checkpoint(at_s, frozen, self._work_s))
        if where + 1 < len(self._kept):
            following = self._kept[where + 1]
            following.work_s -= self._work_s
        self._from_s, self._work_s = at_s, 0.0
        while self.size_bytes > self._most_bytes and len(self._kept) > 2:
            self._thin()

    def _after(self, at_s: float) -> int:
        return bisect_right(self._kept, at_s, key=lambda one: one.at_s)

    def _thin(self) -> None:
        """Drop the one without which the longest way to go grows the least; the first and the last stay."""
        kept = self._kept
        least = min(range(1, len(kept) - 1), key=lambda i: kept[i].work_s + kept[i + 1].work_s)
        kept[least + 1].work_s += kept[least].work_s
        del kept[least]
