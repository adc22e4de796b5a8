"""Out-of-sequence measurements (OOSM): a buffer that applies events in the order of measuring.

The buffer keeps the events of the last window and copies of the model within it. An event that belongs before applied ones
restores the copy before it; the events after it are applied again. That waits until an estimate is wanted, so a burst of late
events costs one replay. The result is bit for bit that of arrival in order (compare Bar-Shalom, Li, Kirubarajan 2001, section
12.3.2, which updates with a late measurement instead of replaying).
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

Key = tuple[float, ...]
Event = TypeVar("Event")
_COPY_EVERY_S = 0.1
"""Chosen: a copy costs about as much as two updates, a replay at most 0.1 s of measurements."""
_COPY_SOONER_S = 0.05  # chosen: the same where the newest event does not wait for the copy
_CLOSE_COPIES = 4  # chosen: so many of the newest copies stand close together: most late events are late by little


class Replayable(Protocol):
    """The model that the buffer drives."""

    def copy(self) -> Replayable:
        """Return an independent copy."""
        ...


Model = TypeVar("Model", bound=Replayable)


class Entry(Generic[Event]):
    """One event: `outcome` of its last application; `reported`: its residual was handed out."""

    __slots__ = ("event", "key", "outcome", "reported")

    def __init__(self, key: Key, event: Event) -> None:
        self.key = key
        self.event = event
        self.outcome: str | None = None
        self.reported = False


class OosmBuffer(Generic[Model, Event]):
    """Applies events to a model in the order of their keys, whose first element is the time in seconds.

    `outcomes` counts the outcomes of the last application of each event, which `apply` returns. An event may arrive `window_s`
    after its time.
    """

    def __init__(self, model: Model, apply: Callable[[Model, Entry[Event]], str], window_s: float) -> None:
        self.model = model
        self.outcomes: Counter[str] = Counter()
        self._apply = apply
        self._window_s = window_s
        self._entries: list[Entry[Event]] = []
        self._applied = 0
        # (index of the first entry not in the copy, copy); the oldest holds all that is committed.
        self._copies: list[tuple[int, Model]] = [(0, self._copy(model))]
        self._copied_at_s = -math.inf

    def insert(self, key: Key, event: Event) -> bool:
        """Insert an event; False if its key is there already."""
        entries = self._entries
        if not entries or entries[-1].key < key:
            entries.append(Entry(key, event))
            return True
        at = bisect_left(entries, key, key=_key_of)
        if entries[at].key == key:
            return False
        entries.insert(at, Entry(key, event))
        if at < self._applied:
            self._restore(at)
        return True

    def process(self) -> Model:
        """Apply all events that are not applied yet; return the model."""
        while self._applied < len(self._entries):
            entry = self._entries[self._applied]
            at_s = entry.key[0]
            since_s = at_s - self._copied_at_s
            if since_s >= _COPY_EVERY_S or (since_s >= _COPY_SOONER_S and self._applied < len(self._entries) - 1):
                self._copies.append((self._applied, self._copy(self.model)))
                self._copied_at_s = at_s
                self._prune_copies()
            if entry.outcome is not None:
                self.outcomes[entry.outcome] -= 1
            entry.outcome = self._apply(self.model, entry)
            self.outcomes[entry.outcome] += 1
            self._applied += 1
        return self.model

    def _prune_copies(self) -> None:
        """Drop a copy behind the newest few that is close to the one before it."""
        copies = self._copies
        if len(copies) > _CLOSE_COPIES + 2:
            before, after = self._entry_time(copies[-_CLOSE_COPIES - 2][0]), self._entry_time(copies[-_CLOSE_COPIES][0])
            if after - before <= _COPY_EVERY_S + _COPY_SOONER_S:
                del copies[-_CLOSE_COPIES - 1]

    def commit(self, now_s: float) -> None:
        """Commit events older than the window: drop them and the copies before them."""
        oldest_s = now_s - self._window_s
        if len(self._copies) < 2 and self._entry_time(0) < oldest_s:
            self.process()
        # Events before a copy are in it; those after it may still be followed by late ones.
        if len(self._copies) < 2 or self._entry_time(self._copies[1][0]) >= oldest_s:
            return
        keep = 0
        while keep + 1 < len(self._copies) and self._entry_time(self._copies[keep + 1][0]) < oldest_s:
            keep += 1
        cut = self._copies[keep][0]
        del self._entries[:cut]
        self._applied -= cut
        self._copies = [(index - cut, copy) for index, copy in self._copies[keep:]]

    def _restore(self, at: int) -> None:
        while len(self._copies) > 1 and self._copies[-1][0] > at:
            self._copies.pop()
        index, copy = self._copies[-1]
        self.model = self._copy(copy)
        self._applied = index
        self._copied_at_s = self._entry_time(index) if len(self._copies) > 1 else -math.inf

    def _entry_time(self, index: int) -> float:
        return self._entries[index].key[0] if index < len(self._entries) else math.inf

    @staticmethod
    def _copy(model: Model) -> Model:
        return model.copy()  # type: ignore[return-value]


def _key_of(entry: Entry[Event]) -> Key:
    return entry.key
