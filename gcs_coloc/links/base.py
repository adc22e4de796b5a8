"""Base of all links: the link, its address, and the registry of connection string schemes.

The connection strings have the forms of MAVProxy.
A link scheme is one module and one line in `SCHEMES`: the module holds a class that implements `LinkAddress`, and the link
that this class makes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from itertools import combinations
from typing import Any, ClassVar, NamedTuple, Protocol, Self, cast

from gcs_coloc.core.errors import UsageError
from gcs_coloc.mavlink.refusals import Counts

Address = tuple[Any, ...]
"""Where bytes came from and can be sent back to: a UDP socket address, or the identity of a stream's connection."""

Clock = Callable[[], float]
"""The service's clock in seconds; each link stamps what arrives by it."""


class Link(Protocol):
    """A way to vehicles.

    It delivers what arrives to the handler it was built with, and sends without ever blocking.
    """

    @property
    def name(self) -> str:
        """Its connection string."""

    @property
    def counts(self) -> Counts:
        """What could not be received or sent, by reason."""

    @property
    def peers(self) -> tuple[Address, ...]:
        """The addresses to send to before anyone was heard.

        A vehicle may wait for our first frame. Empty where the link can only wait for the vehicles.
        """

    @property
    def is_late(self) -> bool:
        """Whether the data that it delivers may have waited before.

        Datagrams wait in the system while the event loop is held up.
        """

    async def open(self) -> None:
        """Start to receive. Raises LinkError, in words for the operator, where the link cannot be opened."""

    def receive_waiting(self, most: int) -> None:
        """Deliver up to `most` of what the system has received already, where the link has to fetch it."""

    def send(self, address: Address, payload: bytes, *, forwarded: bool = False) -> None:
        """Send whole frames to an address that was heard from.

        Never blocks and never raises: what is not sent is counted.
        Payloads that are `forwarded` for others wait behind those that are not, where the link is slow.
        """

    async def close(self) -> None:
        """Stop, and give back sockets and devices. Closing a link that is not open does nothing."""


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
    """A text is no connection string of its scheme.

    The exception's text says why; it is empty where the form is wrong.
    """


class LinkAddress(ABC):
    """A parsed connection string of one scheme.

    `str` gives the text back in its full form; equal texts are equal addresses.
    """

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
        """Make the link; it is not open yet.

        A stream keeps up to `most_unsent_bytes` of what the peer is slow to receive.
        """


SCHEMES: dict[str, tuple[str, str]] = {
    "udpin": ("gcs_coloc.links.udp", "UdpIn"),
    "udpout": ("gcs_coloc.links.udp", "UdpOut"),
    "tcp": ("gcs_coloc.links.tcp", "TcpClient"),
    "tcpin": ("gcs_coloc.links.tcp", "TcpServer"),
    "serial": ("gcs_coloc.links.serial", "SerialDevice"),
}
"""Module and address class of each scheme. A module is imported when its scheme is first used."""


def parse(text: str) -> LinkAddress:
    """Read a connection string of a vehicles' link.

    Raises UsageError that quotes it and shows the right forms.
    """
    return _parse(text, "udpin", "14550, HOST:PORT", "udpin:[::]:14550")


def parse_out(text: str) -> LinkAddress:
    """Read a ground tool's connection string.

    As `parse`, but `udp:` and a bare HOST:PORT are addresses to send to, as in MAVProxy.
    """
    return _parse(text, "udpout", "HOST:PORT or udp:HOST:PORT (sent to that address)", "udp:[::1]:14551")


def parse_links(texts: Iterable[str]) -> list[LinkAddress]:
    """Read the connection strings of the vehicles' links.

    Raises UsageError where one is malformed, or two are the same place.
    """
    links = [parse(text) for text in texts]
    for one, other in combinations(links, 2):
        if one.is_same_place(other):
            both = f"{one} is given twice" if one == other else f"{one} and {other} are the same place"
            raise UsageError(f"{both}; leave one out")
    return links


def check_outs(outs: Sequence[str], links: Sequence[str]) -> None:
    """Check the connection strings of ground tools, and of the vehicles' links, before anything is opened.

    Raises:
        UsageError: one is malformed, given twice, or a tool's leads back to one of `links`, the vehicles'.
    """
    vehicles = parse_links(links)
    seen: set[LinkAddress] = set()
    for text in outs:
        out = parse_out(text)
        if out in seen:
            raise UsageError(f"out {text}: is given twice")
        seen.add(out)
        for link in vehicles:
            if out.leads_to(link):
                raise UsageError(
                    f"out {text}: leads back to the vehicles' link {link}; give the address where the ground tool is"
                )


def _parse(text: str, udp_scheme: str, bare_forms: str, ipv6_example: str) -> LinkAddress:
    """Read the connection string `text`.

    `udp_scheme` is the scheme of `udp:` and of a text without a scheme.
    `bare_forms` and `ipv6_example` are for the message of the UsageError where `text` is malformed.
    """
    stripped = text.strip()
    scheme, colon, rest = stripped.partition(":")
    if stripped.startswith("/"):
        scheme, rest = "serial", stripped
    elif colon and scheme == "udp":
        scheme = udp_scheme
    elif not colon or scheme not in SCHEMES:
        scheme, rest = udp_scheme, stripped
    try:
        return _address_class(scheme).parse(rest)
    except MalformedAddressError as error:
        if error.args:
            raise UsageError(f"{text!r}: {error}") from None
        forms = ", ".join([bare_forms, *dict.fromkeys(_address_class(known).FORM for known in SCHEMES)])
        raise UsageError(
            f"{text!r} is no connection string; write {forms} (an IPv6 address in brackets: {ipv6_example})"
        ) from None


def _address_class(scheme: str) -> type[LinkAddress]:
    module, name = SCHEMES[scheme]
    return cast("type[LinkAddress]", getattr(import_module(module), name))
