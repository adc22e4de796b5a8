"""What TCP and serial links share: a byte stream cut into frames, and when to try a lost one again."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from gcs_coloc.links.base import Address, Clock, DatagramHandler, Link
from gcs_coloc.mavlink.framing import StreamFramer

FIRST_RETRY_S = 1.0
MAX_RETRY_S = 15.0

MAX_UNSENT_BYTES = 1024
"""Some ten frames. What waits longer is old when it arrives, and an old position is a wrong one: better skipped."""

NOT_CONNECTED = "not_connected"
OUTPUT_SKIPPED = "output_skipped"
CONNECTION_LOST = "connection_lost"

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
