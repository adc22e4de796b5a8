"""What TCP and serial links share: a byte stream cut into frames, and when to try a lost one again."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

from gcs_coloc.links.base import Address, Clock, DatagramHandler, Link
from gcs_coloc.mavlink.framing import StreamFramer
from gcs_coloc.mavlink.refusals import Counts, Refusal

FIRST_RETRY_S = 1.0
MAX_RETRY_S = 15.0

MAX_FORWARDED_BYTES = 8192
"""What ground tools say to a vehicle and it is slow to take: a burst of RTCM corrections is some 1,500 bytes."""


class Queue:
    """Whole payloads that wait; the oldest are dropped and counted beyond `most_bytes`."""

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

    def take(self) -> bytes | None:
        """The payload that has waited longest, None where there is none."""
        if not self._waiting:
            return None
        payload = self._waiting.popleft()
        self._bytes -= len(payload)
        return payload


class Outbox:
    """What a stream has not taken yet. What is forwarded waits until nothing else does, and pushes nothing else out."""

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

    def take(self) -> bytes | None:
        """The payload whose turn it is, None where there is none."""
        return self._first.take() or self._forwarded.take()

    def clear(self) -> None:
        """Forget what waits: the connection it was meant for is gone."""
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
        """Take the next bytes of the stream."""
        now_s = self._clock()
        for frame in self._framer.feed(data):
            self._handler(self._link, self._address, frame, now_s)
