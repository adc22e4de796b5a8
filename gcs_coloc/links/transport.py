"""Transport of links: network addresses, and what byte streams share.

A byte stream has a queue of unsent payloads, delays between attempts to connect, and a source of whole frames.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import re
import socket
from collections import deque
from collections.abc import Callable, Coroutine, Iterator
from dataclasses import dataclass
from typing import ClassVar, Self

from gcs_coloc.core.errors import LinkError
from gcs_coloc.links.base import MAX_UNSENT_BYTES, Address, Clock, DatagramHandler, Link, LinkAddress, MalformedAddressError
from gcs_coloc.mavlink.framing import StreamFramer
from gcs_coloc.mavlink.refusals import Counts, Refusal

DEFAULT_BIND_HOST = "0.0.0.0"  # noqa: S104 - vehicles are on the network, listening there is the purpose
MAX_PORT = 65535
"""Ports are 16 bits; 0 is none (RFC 768, RFC 9293)."""

_LOCAL_HOSTS = frozenset({"127.0.0.1", "localhost", "::1"})
_HOST_PORT = re.compile(r"(?:\[(?P<ipv6>[0-9A-Fa-f:.]+(?:%[\w.-]+)?)\]|(?P<host>[^\[\]:/\s]+)):(?P<port>[0-9]{1,5})", re.ASCII)
_PORT = re.compile(r"[0-9]{1,5}", re.ASCII)
FIRST_RETRY_S = 1.0
"""Chosen: a hiccup is over by then."""
MAX_RETRY_S = 15.0
"""Chosen: a vehicle that comes back is heard within this time, and an absent one costs next to nothing."""
MAX_FORWARDED_BYTES = 8192
"""Ground tools' frames that wait for a slow vehicle. Chosen: five bursts of RTCM corrections of some 1,500 bytes."""
RetryDelays = Callable[[], Iterator[float]]


@dataclass(frozen=True)
class NetworkAddress(LinkAddress):
    """A host and a port, of a scheme that listens there or one that sends there."""

    SCHEME: ClassVar[str]
    LISTENS: ClassVar[bool]

    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.SCHEME}:[{self.host}]:{self.port}" if ":" in self.host else f"{self.SCHEME}:{self.host}:{self.port}"

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read HOST:PORT, an IPv6 address in brackets; of a scheme that listens, PORT too."""
        if cls.LISTENS and _PORT.fullmatch(text):
            return cls(DEFAULT_BIND_HOST, _port(text))
        matched = _HOST_PORT.fullmatch(text)
        if matched is None:
            raise MalformedAddressError
        host = matched["ipv6"] or matched["host"]
        try:
            host.encode("idna")
        except UnicodeError:
            raise MalformedAddressError from None
        return cls(host, _port(matched["port"]))

    @property
    def opening(self) -> str:
        """Listening, or connecting."""
        return f"listening on {self}" if self.LISTENS else f"connecting to {self}"

    def is_same_place(self, other: LinkAddress) -> bool:
        """Same scheme, port and host; listening on all IPv4 addresses is listening on each."""
        if not isinstance(other, NetworkAddress) or type(self) is not type(other) or self.port != other.port:
            return False
        hosts = {self.host, other.host}
        return len(hosts) == 1 or (self.LISTENS and DEFAULT_BIND_HOST in hosts and not any(":" in host for host in hosts))

    def leads_to(self, link: LinkAddress) -> bool:
        """Same scheme, port and host; or the one listens where the other sends to, on this machine."""
        if not isinstance(link, NetworkAddress) or self.port != link.port:
            return False
        if type(self) is type(link):
            return self.host == link.host
        return self.sends_to(link) and self.host in {*_LOCAL_HOSTS, link.host}

    def sends_to(self, link: LinkAddress) -> bool:  # noqa: ARG002 - the listening schemes send to nobody by themselves
        """Whether this scheme sends to what the scheme of `link` listens to."""
        return False


def _port(digits: str) -> int:
    port = int(digits)
    if not 1 <= port <= MAX_PORT:
        raise MalformedAddressError(f"port {port} does not exist, ports are 1 to {MAX_PORT}")
    return port


def reason(error: OSError) -> str:
    """Return the system's words for an error.

    asyncio replaces them by its own words and the address.
    """
    return os.strerror(error.errno) if error.errno is not None and error.errno > 0 else error.strerror or str(error)


def network_error(address: NetworkAddress, error: OSError) -> LinkError:
    """Make the LinkError, in words for the operator, of a host or port that cannot be used.

    `error` is the system's: the host cannot be resolved, or the port cannot be bound.
    """
    if isinstance(error, socket.gaierror):
        return LinkError(f"{address}: host {address.host!r} is not found ({error.strerror})")
    if error.errno == errno.EADDRINUSE:
        return LinkError(
            f"{address}: port {address.port} is in use by another program (QGroundControl and MAVProxy listen on 14550 too); "
            "stop it, or have it forward to another port and listen there; or start gcs-coloc first, with --out "
            "udp:127.0.0.1:14551, and have that program listen on 14551"
        )
    if error.errno == errno.EADDRNOTAVAIL:
        return LinkError(f"{address}: {address.host} is no address of this machine; use 0.0.0.0 to listen on all of them")
    if error.errno == errno.EACCES:
        return LinkError(f"{address}: no permission to listen on port {address.port}; take one above 1023")
    if error.errno == errno.EINVAL and address.host.lower().startswith("fe80:") and "%" not in address.host:
        return LinkError(f"{address}: a link-local address needs its interface, as [{address.host}%eth0]")
    return LinkError(f"{address}: cannot be opened: {reason(error)}")


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
    """Payloads that a stream has not accepted yet.

    Forwarded ones wait until no other waits, and push no other out.
    """

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


def retry_delays() -> Iterator[float]:
    """Seconds to wait before each next attempt: soon after a hiccup, seldom when the other end stays away."""
    delay_s = FIRST_RETRY_S
    while True:
        yield delay_s
        delay_s = min(2.0 * delay_s, MAX_RETRY_S)


class StreamLink:
    """What links share that carry a byte stream: settings, counts, and a task that keeps the stream open."""

    is_late = False

    def __init__(
        self,
        address: LinkAddress,
        handler: DatagramHandler,
        clock: Clock,
        delays: RetryDelays = retry_delays,
        most_unsent_bytes: int = MAX_UNSENT_BYTES,
    ) -> None:
        self.name = str(address)
        self.counts = Counts()
        self.handler = handler
        self.clock = clock
        self.delays = delays
        self.most_unsent_bytes = most_unsent_bytes
        self._task: asyncio.Task[None] | None = None

    def receive_waiting(self, most: int) -> None:
        """Do nothing: the event loop's next turn reads the stream."""

    def _keep(self, open_for_ever: Coroutine[None, None, None]) -> None:
        self._task = asyncio.get_running_loop().create_task(open_for_ever, name=self.name)

    async def _keep_no_longer(self) -> None:
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
            self._task = None


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
