"""What a fleet's service could not receive at once, in the order in which it came."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter

from gcs_coloc.links.base import Clock

_AT_ONCE_S = 0.02
"""Chosen: page, log and the other service of a hot standby wait no longer than a person or a vehicle would notice."""


class Backlog:
    """What waits to be received. It is worked off in portions, so that a busy host lets everything else go on between."""

    def __init__(self) -> None:
        self._waiting: list[tuple[float, Callable[[], None]]] = []
        self._rest = 0  # of the last portion

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def oldest_s(self) -> float:
        """When the oldest arrived (service time, s). Only where something waits."""
        return min(at_s for at_s, _ in self._waiting)

    def add(self, at_s: float, receive: Callable[[], None]) -> None:
        """Have `receive` called in its turn for what arrived at service time `at_s` (s)."""
        self._waiting.append((at_s, receive))

    def receive_some(self, clock: Clock) -> None:
        """Receive the oldest for a while, and where some were left the last time as many as came since: it does not grow."""
        waiting, self._waiting = sorted(self._waiting, key=itemgetter(0)), []
        least = len(waiting) - self._rest if self._rest else 0
        ends_s = clock() + _AT_ONCE_S
        received = 0
        try:
            for received, (_, receive) in enumerate(waiting, 1):
                receive()
                if received >= least and clock() > ends_s:
                    break
        finally:
            self._waiting = waiting[received:] + self._waiting
            self._rest = len(self._waiting)
