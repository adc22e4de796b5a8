"""What TCP and serial links share: a byte stream cut into frames, its outbox, and when to retry a lost one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

from gcs_coloc.links.base import Address, Clock, DatagramHandler, Link
from gcs_coloc.mavlink.framing import StreamFramer
from gcs_coloc.mavlink.refusals import Counts, Refusal

FIRST_RETRY_S = 1.0
"""Chosen: a hiccup is over by then."""
MAX_RETRY_S = 15.0
"""Chosen: a vehicle that comes back is heard within this time, and an absent one costs next to nothing."""

MAX_FORWARDED_BYTES = 8192
"""Ground tools' frames that wait for a slow vehicle. Chosen: five bursts of RTCM corrections of some 1,500 bytes."""


class Queue:
    """Whole payloads that wait; beyond `most_bytes` the oldest are dropped and counted."""

    def __init__(self, counts: Counts, most_bytes: int) -> None:
        self._counts = counts
        self._most_bytes = most_bytes
        self._waiting: deque[bytes] = deque()
        self._bytes = 0

    @property
    def size(self) -> int:
        """How many bytes wait."""
        return self._bytes

    def put(self, payload: bytes) -> None:
        """Append one payload."""
        self._waiting.append(payload)
        self._bytes += len(payload)
        while self._bytes > self._most_bytes:
            self._bytes -= len(self._waiting.popleft())
            self._counts.add(Refusal.OUTPUT_SKIPPED)

    def pop(self) -> bytes | None:
        """Remove and return the payload that has waited longest; None where there is none."""
        if not self._waiting:
            return None
        payload = self._waiting.popleft()
        self._bytes -= len(payload)
        return payload


class Outbox:
    """Payloads that a stream has not accepted yet. Forwarded ones wait until no other waits, and push no other out."""

    def __init__(self, counts: Counts, most_bytes: int) -> None:
        self._bounds = (counts, most_bytes)
        self.clear()

    @property
    def size(self) -> int:
        """How many bytes wait."""
        return self._first.size + self._forwarded.size

    def put(self, payload: bytes, *, forwarded: bool = False) -> None:
        """Append one payload."""
        (self._forwarded if forwarded else self._first).put(payload)

    def pop(self) -> bytes | None:
        """Remove and return the next payload; None where there is none."""
        return self._first.pop() or self._forwarded.pop()

    def clear(self) -> None:
        """Drop what waits: the connection it was meant for is gone."""
        counts, most_bytes = self._bounds
        self._first = Queue(counts, most_bytes)
        self._forwarded = Queue(counts, max(most_bytes, MAX_FORWARDED_BYTES))


RetryDelays = Callable[[], Iterator[float]]


def retry_delays() -> Iterator[float]:
    """Seconds to wait before each next attempt: soon after a hiccup, seldom when the other end stays away."""
    delay_s = FIRST_RETRY_S
    while True:
        yield delay_s
        delay_s = min(2.0 * delay_s, MAX_RETRY_S)


class FrameSource:
    """Delivers the whole frames of one byte stream to a link's handler, each stamped with its arrival."""

    def __init__(self, link: Link, address: Address, handler: DatagramHandler, clock: Clock) -> None:
        self._link = link
        self._address = address
        self._handler = handler
        self._clock = clock
        self._framer = StreamFramer(link.counts)

    def feed(self, data: bytes) -> None:
        """Add the next bytes of the stream."""
        now_s = self._clock()
        for frame in self._framer.feed(data):
            self._handler(self._link, self._address, frame, now_s)
