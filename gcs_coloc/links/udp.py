"""Schemes `udpin` and `udpout`: UDP on a non-blocking socket of our own, drained by the event loop."""

from __future__ import annotations

import asyncio
import errno
import socket
import struct
import sys
from ipaddress import ip_address
from typing import Any

from gcs_coloc.core.errors import LinkError
from gcs_coloc.links.base import MAX_UNSENT_BYTES, Address, Clock, DatagramHandler, LinkAddress
from gcs_coloc.links.transport import NetworkAddress, network_error
from gcs_coloc.mavlink.refusals import Counts, Refusal
from gcs_coloc.runtime.clock import arrival_time

MAX_DATAGRAM_BYTES = 65535
"""The 16-bit length field of UDP (RFC 768)."""
DATAGRAMS_PER_WAKE = 64
"""After so many in a row the event loop runs again. Chosen: a flood must not keep everything else from running."""
RECEIVE_BUFFER_BYTES = 1 << 20
"""Chosen: a second of 200 vehicles at 5 kB/s while the process is delayed; the system may grant less."""

_SO_TIMESTAMPNS = 35 if sys.platform == "linux" else None
"""Has each datagram carry when the kernel received it (socket(7); the number: asm-generic/socket.h). Python does not name it."""
_TIMESPEC = struct.Struct("@ll")
"""The stamp: seconds and nanoseconds of UNIX time, in the machine's long."""
_LATE_S = 0.005
"""Where nothing waited so long ago, nothing has waited for longer, and no stamp is read. Chosen: 0.1 m at 20 m/s, for 1 us."""
_ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size)
_LIMITED_BROADCAST = "255.255.255.255"
"""RFC 919. A system without a network does not know it as a broadcast address."""


class _UdpAddress(NetworkAddress):
    def make_link(
        self,
        handler: DatagramHandler,
        clock: Clock,
        *,
        most_unsent_bytes: int = MAX_UNSENT_BYTES,  # noqa: ARG002 - no datagram waits
    ) -> UdpLink:
        """Make the link; no datagram waits in it."""
        return UdpLink(self, handler, clock)


class UdpIn(_UdpAddress):
    """Listen for datagrams; answers go to the address each vehicle was heard from."""

    SCHEME = "udpin"
    FORM = "udpin:HOST:PORT"
    LISTENS = True
    LEARNS_PEERS = True


class UdpOut(_UdpAddress):
    """Send the first datagram to a known address, from a port that the system chooses."""

    SCHEME = "udpout"
    FORM = "udpout:HOST:PORT"
    LISTENS = False

    @property
    def opening(self) -> str:
        """Sending: UDP has no connection."""
        return f"sending to {self}"

    def sends_to(self, link: LinkAddress) -> bool:
        """A udpin link receives what is sent here."""
        return isinstance(link, UdpIn)


class UdpLink:
    """A UDP socket of a udpin or udpout link.

    A udpin link is bound to a port that vehicles send to; a udpout link sends first, to one of theirs.
    """

    def __init__(self, address: NetworkAddress, handler: DatagramHandler, clock: Clock) -> None:
        self._address = address
        self.name = str(address)
        self._handler = handler
        self._clock = clock
        self._socket: socket.socket | None = None
        self._remote: Address | None = None
        self.is_late = False
        self._empty_at_s = float("-inf")  # nothing that waits to be read came before
        self.counts = Counts()

    @property
    def peers(self) -> tuple[Address, ...]:
        """The address that a udpout link sends to before it has heard anyone.

        Empty for udpin, or while the link is not open.
        """
        return (self._remote,) if self._remote is not None else ()

    async def open(self) -> None:
        """Bind the socket.

        LinkError where the port is in use, the host is not found or not ours, or is a broadcast or multicast address.
        """
        loop = asyncio.get_running_loop()
        family, sockaddr = await self._resolve(loop)
        _require_one_host(self._address, family, sockaddr)
        udp_socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            udp_socket.setblocking(False)
            udp_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
            if _SO_TIMESTAMPNS is not None:
                udp_socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            # Neither SO_REUSEADDR nor SO_REUSEPORT: with them a second program would silently receive our vehicles' datagrams.
            if self._address.LISTENS:
                udp_socket.bind(sockaddr)
            else:
                udp_socket.bind(("", 0))
                self._remote = sockaddr
        except OSError as error:
            udp_socket.close()
            raise network_error(self._address, error) from error
        self._empty_at_s = self._clock()
        self._socket = udp_socket
        loop.add_reader(udp_socket, self.receive_waiting, DATAGRAMS_PER_WAKE)

    async def _resolve(self, loop: asyncio.AbstractEventLoop) -> tuple[socket.AddressFamily, Any]:
        try:
            found = await loop.getaddrinfo(self._address.host, self._address.port, type=socket.SOCK_DGRAM)
        except OSError as error:
            raise network_error(self._address, error) from error
        # Autopilots and simulators listen on IPv4; "localhost" may name ::1 first.
        family, _, _, _, sockaddr = min(found, key=lambda entry: entry[0] != socket.AF_INET)
        return family, sockaddr

    def receive_waiting(self, most: int) -> None:
        """Deliver up to `most` datagrams that wait in the system.

        Each has the time when the system received it.
        """
        if (udp_socket := self._socket) is None:
            return
        handle, now = self._handler, self._clock
        ancillary: list[tuple[int, int, bytes]] = []
        now_s = now()
        is_late = self.is_late = now_s - self._empty_at_s > _LATE_S
        for _ in range(most):
            try:
                if is_late:
                    payload, ancillary, _, address = udp_socket.recvmsg(MAX_DATAGRAM_BYTES, _ANCILLARY_BYTES)
                else:
                    payload, address = udp_socket.recvfrom(MAX_DATAGRAM_BYTES)
            except BlockingIOError:
                self._empty_at_s = now() if is_late else now_s
                return
            except OSError:  # an ICMP error that an earlier send brought back
                self.counts.add(Refusal.RECEIVE_ERROR)
                return
            handle(self, address, payload, self._arrived_at_s(ancillary) if is_late else now_s)
            began_s, now_s = now_s, now()
            is_late = self.is_late = is_late or now_s - began_s > _LATE_S

    def _arrived_at_s(self, ancillary: list[tuple[int, int, bytes]]) -> float:
        for level, kind, data in ancillary:
            if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(data) == _TIMESPEC.size:
                seconds, nanoseconds = _TIMESPEC.unpack(data)
                # Nor before the one before: clocks are read anew for each, some microseconds off, and their order is to hold.
                self._empty_at_s = arrival_time(self._clock, seconds * 1_000_000_000 + nanoseconds, self._empty_at_s)
                return self._empty_at_s
        return self._clock()

    def send(self, address: Address, payload: bytes, *, forwarded: bool = False) -> None:  # noqa: ARG002 - no datagram waits
        """Send one datagram; one that the system does not accept at once is dropped and counted."""
        if self._socket is None:
            self.counts.add(Refusal.NOT_SENT)
            return
        try:
            self._socket.sendto(payload, address)
        except (OSError, TypeError):  # TypeError: an address of another family or link
            self.counts.add(Refusal.NOT_SENT)

    async def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()
            self._socket = None


def _require_one_host(address: NetworkAddress, family: socket.AddressFamily, sockaddr: Any) -> None:
    """LinkError where an address is a broadcast or multicast one: all would receive what is meant for one.

    A socket that listens on one would hear nothing that is sent to this host alone.

    Which addresses are broadcast ones depends on the network masks. The system knows them: it requires SO_BROADCAST for them.
    """
    kind = "multicast" if ip_address(sockaddr[0].partition("%")[0]).is_multicast else None
    if sockaddr[0] == _LIMITED_BROADCAST or (
        kind is None and family == socket.AF_INET and not _connects(sockaddr) and _connects(sockaddr, broadcast=True)
    ):
        kind = "broadcast"
    if kind is None:
        return
    if address.LISTENS:
        raise LinkError(f"{address}: {address.host} is a {kind} address; use 0.0.0.0 to listen on all addresses of this machine")
    raise LinkError(
        f"{address}: {address.host} is a {kind} address: all hosts there would get what is sent, and the answers could "
        f"not be told apart; give the one host's address, or listen (udpin:{address.port}) and have each of them connect"
    )


def _connects(sockaddr: Any, *, broadcast: bool = False) -> bool:
    """Whether the system would send to an address; False only where it does not permit it.

    Nothing is sent.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, broadcast)
        return probe.connect_ex(sockaddr) != errno.EACCES
