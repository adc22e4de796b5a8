"""Schemes `tcp` and `tcpin`: a TCP client that reconnects, and a server for several clients."""

from __future__ import annotations

import asyncio
import logging
import socket
from typing import Any

from gcs_coloc.links.base import MAX_UNSENT_BYTES, Address, Clock, DatagramHandler, LinkAddress
from gcs_coloc.links.transport import FrameSource, NetworkAddress, Outbox, StreamLink, network_error, reason
from gcs_coloc.mavlink.refusals import Refusal

MAX_CLIENTS = 64
"""Clients of one listening port. Chosen: more than a fleet that connects by TCP has vehicles."""
SEND_BUFFER_BYTES = 4096
"""About the least that Linux grants (tcp(7)): what is in the system's buffer of a stalled connection cannot be dropped."""
PEER_SILENT_MS = 10_000
"""A connection whose peer has acknowledged nothing for so long is dropped (TCP_USER_TIMEOUT, RFC 5482). Chosen: one outage."""


log = logging.getLogger(__name__)


class TcpClient(NetworkAddress):
    """Connect to a listening TCP port, again and again when the connection is lost."""

    SCHEME = "tcp"
    FORM = "tcp:HOST:PORT"
    LISTENS = False

    def sends_to(self, link: LinkAddress) -> bool:
        """A tcpin link receives what is sent here."""
        return isinstance(link, TcpServer)

    def make_link(self, handler: DatagramHandler, clock: Clock, *, most_unsent_bytes: int = MAX_UNSENT_BYTES) -> TcpClientLink:
        """Make the link, which connects again for as long as it is open."""
        return TcpClientLink(self, handler, clock, most_unsent_bytes=most_unsent_bytes)


class TcpServer(NetworkAddress):
    """Accept TCP connections."""

    SCHEME = "tcpin"
    FORM = "tcpin:HOST:PORT"
    LISTENS = True

    def make_link(self, handler: DatagramHandler, clock: Clock, *, most_unsent_bytes: int = MAX_UNSENT_BYTES) -> TcpServerLink:
        """Make the link."""
        return TcpServerLink(self, handler, clock, most_unsent_bytes=most_unsent_bytes)


class _Connection(asyncio.Protocol):
    """One TCP connection: frames in, and frames out as fast as the peer receives them."""

    def __init__(self, link: TcpClientLink | TcpServerLink) -> None:
        self.lost = asyncio.Event()
        self._link = link
        self._outbox = Outbox(link.counts, link.most_unsent_bytes)
        self._is_stalled = False
        self._source: FrameSource | None = None
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        tcp_socket = transport.get_extra_info("socket")
        tcp_socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        tcp_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, PEER_SILENT_MS)
        # What the system does not accept at once waits in the outbox, where it can still be dropped.
        transport.set_write_buffer_limits(high=0)
        self._transport = transport
        self._source = FrameSource(self._link, self.address, self._link.handler, self._link.clock)

    @property
    def address(self) -> Address:
        """The peer's socket address."""
        assert self._transport is not None
        peer: Address = self._transport.get_extra_info("peername")
        return peer

    def data_received(self, data: bytes) -> None:
        assert self._source is not None
        self._source.feed(data)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        self._link.counts.add(Refusal.CONNECTION_LOST)
        self.lost.set()

    def send(self, payload: bytes, *, forwarded: bool) -> None:
        """Pass frames to the system, or keep them while the peer has not received what it was sent before."""
        self._outbox.put(payload, forwarded=forwarded)
        self._write()

    def pause_writing(self) -> None:
        self._is_stalled = True

    def resume_writing(self) -> None:
        self._is_stalled = False
        self._write()

    def _write(self) -> None:
        assert self._transport is not None
        while not self._is_stalled and (payload := self._outbox.pop()) is not None:
            self._transport.write(payload)

    def abort(self) -> None:
        """Close at once; unsent frames are old by now."""
        assert self._transport is not None
        self._transport.abort()


class TcpClientLink(StreamLink):
    """Connects to a port, such as a simulator's or a router's.

    A connection that fails or ends is made again for ever.
    """

    _connection: _Connection | None = None

    def __init__(self, address: TcpClient, *settings: Any, **further: Any) -> None:
        super().__init__(address, *settings, **further)
        self._address = address

    @property
    def peers(self) -> tuple[Address, ...]:
        """The address of the other end, to which `send` sends; nobody while not connected."""
        return (self._connection.address,) if self._connection else ()

    async def open(self) -> None:
        """Start to connect.

        LinkError where the host is not found; a port where nobody listens yet is no error.
        """
        loop = asyncio.get_running_loop()
        try:
            await loop.getaddrinfo(self._address.host, self._address.port, type=socket.SOCK_STREAM)
        except OSError as error:
            raise network_error(self._address, error) from error
        self._keep(self._stay_connected())

    async def _stay_connected(self) -> None:
        loop = asyncio.get_running_loop()
        delays = self.delays()
        level = logging.WARNING
        while True:
            try:
                _, connection = await loop.create_connection(lambda: _Connection(self), self._address.host, self._address.port)
            except OSError as error:
                log.log(level, "%s: cannot connect (%s), trying again", self.name, reason(error))
                level = logging.DEBUG
            else:
                log.info("%s: connected", self.name)
                self._connection = connection
                await connection.lost.wait()
                self._connection = None
                log.warning("%s: connection lost, connecting again", self.name)
                delays = self.delays()
                level = logging.WARNING
            await asyncio.sleep(next(delays))

    def send(self, address: Address, payload: bytes, *, forwarded: bool = False) -> None:
        """Send frames to the other end.

        Counted as NOT_CONNECTED where it is gone, or is not `address`.
        """
        if self._connection is None or self._connection.address != address:
            self.counts.add(Refusal.NOT_CONNECTED)
        else:
            self._connection.send(payload, forwarded=forwarded)

    async def close(self) -> None:
        """Disconnect and stay so."""
        await self._keep_no_longer()
        if self._connection is not None:
            self._connection.abort()
            await self._connection.lost.wait()
            self._connection = None


class TcpServerLink(StreamLink):
    """Listens for TCP connections; each client is one address."""

    _server: asyncio.Server | None = None

    def __init__(self, address: TcpServer, *settings: Any, **further: Any) -> None:
        super().__init__(address, *settings, **further)
        self._address = address
        self._clients: dict[Address, _ServerConnection] = {}

    @property
    def peers(self) -> tuple[Address, ...]:
        """The clients that are connected."""
        return tuple(self._clients)

    async def open(self) -> None:
        """Listen. LinkError where the port is in use, the host is not found or not ours."""
        loop = asyncio.get_running_loop()
        try:
            self._server = await loop.create_server(
                lambda: _ServerConnection(self, self._clients), self._address.host, self._address.port
            )
        except OSError as error:
            raise network_error(self._address, error) from error

    def send(self, address: Address, payload: bytes, *, forwarded: bool = False) -> None:
        """Send frames to one client; counted as NOT_CONNECTED where it is gone."""
        client = self._clients.get(address)
        if client is None:
            self.counts.add(Refusal.NOT_CONNECTED)
        else:
            client.send(payload, forwarded=forwarded)

    async def close(self) -> None:
        """Stop listening and cut off all clients."""
        if self._server is not None:
            self._server.close()
            clients = list(self._clients.values())
            for client in clients:
                client.abort()
            for client in clients:
                await client.lost.wait()
            await self._server.wait_closed()
            self._server = None


class _ServerConnection(_Connection):
    """A client's connection, in the server's list as long as it lasts."""

    def __init__(self, link: TcpServerLink, clients: dict[Address, _ServerConnection]) -> None:
        super().__init__(link)
        self._clients = clients

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        if len(self._clients) >= MAX_CLIENTS:
            self._link.counts.add(Refusal.TOO_MANY_CLIENTS)
            self.abort()
        else:
            self._clients[self.address] = self

    def connection_lost(self, exc: Exception | None) -> None:
        if self._clients.get(self.address) is self:
            del self._clients[self.address]
        super().connection_lost(exc)
