"""How much each address may send us, sans-IO: what is beyond it is dropped before it costs more than a look at its sender.

A bucket that drains at a fixed rate for each source, kept as the one time at which it will have drained (the generic cell
rate algorithm of ITU-T I.371).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable

from gcs_coloc.mavlink.counts import Counts

RATE_LIMITED = "rate_limited"
BURST_S = 0.25
"""A source may send the bytes of this time at once, such as what a radio held back. It bounds a single datagram, too."""
LEAST_COST_BYTES = 64
"""A datagram counts for as much however small it is: receiving it costs as well."""
KEPT_S = 10.0
"""A source that was silent for so long makes room for a new one."""
MAX_SOURCES = 1024


class Intake:
    """Admits up to `bytes_per_s` from each source.

    At most `max_sources` have a share of their own. While the table is full of sources that were heard lately, all others
    together have one share: so many made-up addresses take as little room as one, and take nothing from those known before.
    """

    def __init__(self, bytes_per_s: float, *, max_sources: int = MAX_SOURCES) -> None:
        self.counts = Counts()
        self._bytes_per_s = bytes_per_s
        self._max_sources = max_sources
        # When each source's bucket will have drained, in the order of last hearing.
        self._drained_at_s: OrderedDict[Hashable, float] = OrderedDict()
        self._heard_at_s: dict[Hashable, float] = {}
        self._others_drained_at_s = float("-inf")

    @property
    def sources(self) -> int:
        """How many sources have a share of their own."""
        return len(self._drained_at_s)

    def admits(self, source: Hashable, size: int, now_s: float) -> bool:
        """Whether a datagram of `size` bytes that came from `source` at service time `now_s` is to be looked at."""
        drained_at_s = self._drained_at_s.get(source)
        own_share = drained_at_s is not None or self._has_room(now_s)
        if drained_at_s is None:
            drained_at_s = now_s if own_share else self._others_drained_at_s
        drained_at_s = max(drained_at_s, now_s)
        would_drain_at_s = drained_at_s + max(size, LEAST_COST_BYTES) / self._bytes_per_s
        admitted = would_drain_at_s - now_s <= BURST_S
        if admitted:
            drained_at_s = would_drain_at_s
        else:
            self.counts.add(RATE_LIMITED)
        if own_share:
            self._drained_at_s[source] = drained_at_s
            self._drained_at_s.move_to_end(source)
            self._heard_at_s[source] = now_s
        else:
            self._others_drained_at_s = drained_at_s
        return admitted

    def _has_room(self, now_s: float) -> bool:
        if len(self._drained_at_s) < self._max_sources:
            return True
        stalest = next(iter(self._drained_at_s))
        if now_s - self._heard_at_s[stalest] < KEPT_S:
            return False
        del self._drained_at_s[stalest], self._heard_at_s[stalest]
        return True
