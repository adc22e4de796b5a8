"""How much each address may send us, sans-IO: what is beyond it is dropped before it costs more than a look at its sender.

A bucket that drains at a fixed rate for each source, kept as the one time at which it will have drained (the generic cell
rate algorithm of ITU-T I.371).
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

from gcs_coloc.mavlink.refusals import Counts, Refusal

BURST_S = 0.25
"""A source may send the bytes of this time at once, such as what a radio held back. It bounds a single datagram, too."""
LEAST_COST_BYTES = 64
"""A datagram counts for as much however small it is: receiving it costs as well."""
KEPT_S = 10.0
"""A known source that was silent for so long makes room for a new one."""
MAX_SOURCES = 256
"""More than a fleet can have vehicles."""


@dataclass(slots=True)
class _TokenBucket:
    """One known source: when its bucket will have drained, and when it was last heard; service times, s."""

    drained_at_s: float
    heard_at_s: float


class RateLimiter:
    """Admits up to `bytes_per_s` from each known source, and as much from all others together.

    So a flood takes nothing from those known before it, from however many addresses it comes, and a vehicle that turns up
    meanwhile gets through to become known. At most `max_sources` are kept.
    """

    def __init__(self, bytes_per_s: float, *, max_sources: int = MAX_SOURCES) -> None:
        self.counts = Counts()
        self._bytes_per_s = bytes_per_s
        self._max_sources = max_sources
        self._sources: dict[Hashable, _TokenBucket] = {}
        self._shared_drained_at_s = float("-inf")

    @property
    def sources(self) -> int:
        """How many sources have a share of their own."""
        return len(self._sources)

    def add_source(self, source: Hashable, now_s: float) -> None:
        """Give a source, shown at service time `now_s` to be a vehicle's, a share of its own, if there is room."""
        if source not in self._sources and self._has_room(now_s):
            self._sources[source] = _TokenBucket(now_s, now_s)

    def admits(self, source: Hashable, size: int, now_s: float) -> bool:
        """Whether a datagram of `size` bytes that came from `source` at service time `now_s` is to be looked at."""
        own = self._sources.get(source)
        drained_at_s = self._shared_drained_at_s if own is None else own.drained_at_s
        if drained_at_s < now_s:
            drained_at_s = now_s
        cost_s = (size if size > LEAST_COST_BYTES else LEAST_COST_BYTES) / self._bytes_per_s
        # Not whether this one still fits in: in a flood of small datagrams a larger one never would.
        admitted = drained_at_s - now_s < BURST_S and cost_s <= BURST_S
        if admitted:
            drained_at_s += cost_s
        else:
            self.counts.add(Refusal.RATE_LIMITED)
        if own is None:
            self._shared_drained_at_s = drained_at_s
        else:
            own.drained_at_s, own.heard_at_s = drained_at_s, now_s
        return admitted

    def _has_room(self, now_s: float) -> bool:
        if len(self._sources) < self._max_sources:
            return True
        stalest = min(self._sources, key=lambda source: self._sources[source].heard_at_s)
        if now_s - self._sources[stalest].heard_at_s < KEPT_S:
            return False
        del self._sources[stalest]
        return True
