"""What every link is to the rest of the program."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

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
        """Start to receive. Raises LinkError, in words for the operator, where the link cannot work as it was asked for."""
        ...

    def send(self, address: Address, payload: bytes, *, forwarded: bool = False) -> None:
        """Send whole frames to an address that was heard from. Never blocks and never raises; what is not sent is counted.

        What is `forwarded` for others waits behind what is not, where the link is slow.
        """
        ...

    async def close(self) -> None:
        """Stop, and give back sockets and devices. Closing a link that is not open does nothing."""
        ...


DatagramHandler = Callable[[Link, Address, bytes, float], None]
"""Takes link, address, payload (one UDP datagram, or one whole frame of a stream) and arrival time; must not raise."""
