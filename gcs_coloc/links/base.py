"""Base of all links: a parsed connection string, and the link that it makes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Protocol, Self

from gcs_coloc.mavlink.refusals import Counts

Address = tuple[Any, ...]
"""Where bytes came from and can be sent back to: a UDP socket address, or the identity of a stream's connection."""

Clock = Callable[[], float]
"""The service's clock in seconds; each link stamps what arrives with it."""


class Link(Protocol):
    """A way to vehicles. It delivers what arrives to the handler it was built with, and sends without ever blocking."""

    @property
    def name(self) -> str:
        """Its connection string."""
        ...

    @property
    def counts(self) -> Counts:
        """What could not be received or sent, by reason."""
        ...

    @property
    def peers(self) -> tuple[Address, ...]:
        """Where to send before anyone was heard (a vehicle may wait for our first frame); empty where we can only wait."""
        ...

    async def open(self) -> None:
        """Start to receive. Raises LinkError, in words for the operator, where the link cannot be opened."""
        ...

    def send(self, address: Address, payload: bytes, *, forwarded: bool = False) -> None:
        """Send whole frames to an address that was heard from. Never blocks and never raises; what is not sent is counted.

        Payloads that are `forwarded` for others wait behind those that are not, where the link is slow.
        """
        ...

    async def close(self) -> None:
        """Stop, and give back sockets and devices. Closing a link that is not open does nothing."""
        ...


DatagramHandler = Callable[[Link, Address, bytes, float], None]
"""Called with link, address, payload (one UDP datagram, or one whole frame of a stream) and arrival time; must not raise."""

MAX_UNSENT_BYTES = 1024
"""How much a stream keeps for a vehicle that is slow to receive: some ten frames.

Chosen: an old position is a wrong one, so what waits longer is better dropped.
"""


class Route(NamedTuple):
    """Where to send what is meant for one vehicle."""

    link: Link
    address: Address

    def __str__(self) -> str:
        return f"{':'.join(str(part) for part in self.address[:2])} on {self.link.name}"


class MalformedAddressError(Exception):
    """A text is no connection string of its scheme. Its own text says why; empty: its form is wrong."""


class LinkAddress(ABC):
    """A parsed connection string of one scheme. `str` gives the text back in its full form; equal texts are equal addresses."""

    FORM: ClassVar[str]
    """How it is written, as error messages show it."""
    LEARNS_PEERS: ClassVar[bool] = False
    """Whether its link learns where to send from what it hears alone."""

    @classmethod
    @abstractmethod
    def parse(cls, text: str) -> Self:
        """Read what follows the scheme and its colon. Raises MalformedAddressError."""

    @property
    @abstractmethod
    def opening(self) -> str:
        """What the link does once it is open, in words for the operator."""

    @abstractmethod
    def is_same_place(self, other: LinkAddress) -> bool:
        """Whether links of both addresses would be in each other's way."""

    @abstractmethod
    def leads_to(self, link: LinkAddress) -> bool:
        """Whether what is sent here, to a ground tool, would come in again over `link`."""

    @abstractmethod
    def make_link(self, handler: DatagramHandler, clock: Clock, *, most_unsent_bytes: int = MAX_UNSENT_BYTES) -> Link:
        """Make the link; it is not open yet. A stream keeps up to `most_unsent_bytes` of what the peer is slow to receive."""
