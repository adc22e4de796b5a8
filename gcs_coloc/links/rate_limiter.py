"""Rate limiter of what links receive: how much each address may send before anything is decoded."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field
from itertools import chain, takewhile
from typing import TypeVar

from gcs_coloc.mavlink.refusals import Counts, Refusal

Key = TypeVar("Key")


def find_evicted(
    by_age: Iterable[Key], *, is_silent: Callable[[Key], bool], is_proven: Callable[[Key], bool], for_proven: bool
) -> Key | None:
    """Return the entry that makes room for a new one; None where none does.

    `by_age` has the keys, that of the longest silent first. Silent entries go first, among them the unproven ones.
    An entry that is not silent goes only if it is unproven, and only for a proven vehicle (`for_proven`).
    So a flood of new senders keeps no known vehicle out.
    """
    keys = list(by_age)
    silent = list(takewhile(is_silent, keys))
    rest = keys[len(silent) :] if for_proven else []
    candidates = chain((key for key in silent if not is_proven(key)), silent, (key for key in rest if not is_proven(key)))
    return next(candidates, None)


BURST_S = 0.25
"""A source may send the bytes of this time at once. Chosen: what a radio buffers, and more than the largest datagram needs."""
LEAST_COST_BYTES = 64
"""A smaller datagram counts as this many. Chosen: receiving costs about as much as decoding so many bytes."""
KEPT_S = 10.0
"""A source that was silent for so long makes room for a new one. Chosen: longer than an outage of a radio link."""
MAX_SOURCES = 256
"""Chosen: more than a fleet may have vehicles (`max_vehicles`)."""


@dataclass(slots=True)
class _TokenBucket:
    """The token bucket of one source; times are service times in s.

    `full_at_s` is when it will be full again, `heard_at_s` when the source was last heard.
    `proven` has the system ids of the proven vehicles that were heard from there last.
    """

    full_at_s: float
    heard_at_s: float
    proven: set[int] = field(default_factory=set)


class RateLimiter:
    """Limits the bytes that each source may send, before anything is decoded.

    Each added source may send up to `bytes_per_s`, and all others together as much.
    Each has a token bucket, kept as the one time at which it will be full again (the generic cell rate algorithm of ITU-T I.371).

    A flood, from however many addresses, takes nothing from the sources that were added before it, and a new vehicle still
    gets through to be added. At most `max_sources` are kept.
    """

    def __init__(self, bytes_per_s: float, *, max_sources: int = MAX_SOURCES) -> None:
        self.counts = Counts()
        self._bytes_per_s = bytes_per_s
        self._max_sources = max_sources
        self._sources: dict[Hashable, _TokenBucket] = {}
        self._source_of: dict[int, Hashable] = {}
        self._shared_full_at_s = float("-inf")

    @property
    def sources(self) -> int:
        """How many sources have a bucket of their own."""
        return len(self._sources)

    def add_source(self, source: Hashable, now_s: float, proven_vehicle: int | None = None) -> None:
        """Add a vehicle's source, with a bucket of its own, at service time `now_s`, if there is room.

        `proven_vehicle` is its system id where it has been known for some time: it takes the bucket of a source without such a
        vehicle. When it moves, the source that it leaves is one without it.
        """
        left = self._source_of.get(proven_vehicle, source) if proven_vehicle is not None else source
        if left != source and left in self._sources:
            self._sources[left].proven.discard(proven_vehicle)
        if source not in self._sources:
            if not self._has_room(now_s, proven_vehicle is not None):
                return
            self._sources[source] = _TokenBucket(now_s, now_s)
        if proven_vehicle is not None:
            self._sources[source].proven.add(proven_vehicle)
            self._source_of[proven_vehicle] = source

    def admits(self, source: Hashable, size: int, now_s: float) -> bool:
        """Whether a datagram of `size` bytes that came from `source` at service time `now_s` is to be decoded."""
        own = self._sources.get(source)
        full_at_s = self._shared_full_at_s if own is None else own.full_at_s
        if full_at_s < now_s:
            full_at_s = now_s
        cost_s = (size if size > LEAST_COST_BYTES else LEAST_COST_BYTES) / self._bytes_per_s
        # Not whether this one still fits: in a flood of small datagrams a larger one never would.
        admitted = full_at_s - now_s < BURST_S and cost_s <= BURST_S
        if admitted:
            full_at_s += cost_s
        else:
            self.counts.add(Refusal.RATE_LIMITED)
        if own is None:
            self._shared_full_at_s = full_at_s
        else:
            own.full_at_s, own.heard_at_s = full_at_s, now_s
        return admitted

    def _has_room(self, now_s: float, for_proven: bool) -> bool:
        if len(self._sources) < self._max_sources:
            return True
        evicted = find_evicted(
            sorted(self._sources, key=lambda source: self._sources[source].heard_at_s),
            is_silent=lambda source: now_s - self._sources[source].heard_at_s >= KEPT_S,
            is_proven=lambda source: bool(self._sources[source].proven),
            for_proven=for_proven,
        )
        if evicted is None:
            return False
        del self._sources[evicted]
        return True
