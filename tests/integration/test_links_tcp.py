"""TCP links on loopback, against pymavlink's own connections and plain asyncio."""

from __future__ import annotations

import asyncio
import itertools
import logging
import socket

import pytest
from pymavlink import mavutil

from bench.free_ports import free_port
from gcs_coloc.core.errors import LinkError
from gcs_coloc.links import tcp
from gcs_coloc.links.tcp import TcpClient, TcpClientLink, TcpServer, TcpServerLink
from gcs_coloc.links.transport import MAX_RETRY_S, retry_delays
from gcs_coloc.mavlink.encoder import Encoder
from tests.integration.link_peers import PATIENCE_S, Inbox, heartbeat, until

pytestmark = pytest.mark.integration

LOCALHOST = "127.0.0.1"


def at_once():
    return itertools.repeat(0.0)


def client_link(port, inbox):
    return TcpClientLink(TcpClient(LOCALHOST, port), inbox, inbox.clock, delays=at_once)


class Simulator:
    """A listening peer that keeps its connections."""

    def __init__(self):
        self.connections = asyncio.Queue()

    async def __aenter__(self):
        self.server = await asyncio.start_server(self._accept, LOCALHOST, 0)
        self.port = self.server.sockets[0].getsockname()[1]
        return self

    async def _accept(self, reader, writer):
        await self.connections.put((reader, writer))

    async def next_connection(self):
        return await asyncio.wait_for(self.connections.get(), PATIENCE_S)

    async def __aexit__(self, *_):
        self.server.close()
        await self.server.wait_closed()


async def hang_up(writer):
    writer.close()
    await writer.wait_closed()


def test_client_cuts_the_stream_into_frames_and_sends_back():
    async def scenario():
        inbox = Inbox()
        async with Simulator() as simulator:
            link = client_link(simulator.port, inbox)
            await link.open()
            reader, writer = await simulator.next_connection()
            stream = b"noise" + heartbeat(1, 0) + heartbeat(1, 1)
            for cut in (stream[:11], stream[11:30], stream[30:]):
                writer.write(cut)
                await writer.drain()
            first, second = await inbox.next(), await inbox.next()
            assert [first[2], second[2]] == [heartbeat(1, 0), heartbeat(1, 1)]
            assert first[1] == link.peers[0] == (LOCALHOST, simulator.port)
            assert link.counts["garbage_bytes"] == 5

            ours = Encoder().heartbeat(link.peers[0])
            link.send(link.peers[0], ours)
            assert await asyncio.wait_for(reader.readexactly(len(ours)), PATIENCE_S) == ours
            await link.close()
            assert await asyncio.wait_for(reader.read(), PATIENCE_S) == b""
            await hang_up(writer)

    asyncio.run(scenario())


def test_client_connects_again_and_half_a_frame_of_the_old_connection_is_forgotten(caplog):
    async def scenario():
        inbox = Inbox()
        async with Simulator() as simulator:
            link = client_link(simulator.port, inbox)
            await link.open()
            _, writer = await simulator.next_connection()
            writer.write(heartbeat(1, 0)[:9])
            await hang_up(writer)
            _, writer = await simulator.next_connection()
            writer.write(heartbeat(1, 1))
            assert (await inbox.next())[2] == heartbeat(1, 1)
            assert link.counts["connection_lost"] == 1
            await link.close()
            await hang_up(writer)

    asyncio.run(scenario())
    assert any("connection lost" in record.message for record in caplog.records)


def test_client_waits_for_a_listener_that_comes_late_and_warns_once(caplog):
    caplog.set_level(logging.DEBUG, logger="gcs_coloc")

    async def scenario():
        inbox, port = Inbox(), free_port(socket.SOCK_STREAM)
        link = client_link(port, inbox)
        await link.open()
        await until(lambda: sum("cannot connect" in record.message for record in caplog.records) >= 3)
        assert not link.peers
        link.send((LOCALHOST, port), heartbeat(254))
        assert link.counts["not_connected"] == 1
        connections = asyncio.Queue()
        server = await asyncio.start_server(lambda reader, writer: connections.put_nowait(writer), LOCALHOST, port)
        writer = await asyncio.wait_for(connections.get(), PATIENCE_S)
        writer.write(heartbeat(1))
        assert (await inbox.next())[2] == heartbeat(1)
        await link.close()
        await hang_up(writer)
        server.close()
        await server.wait_closed()

    asyncio.run(scenario())
    refusals = [record.levelno for record in caplog.records if "cannot connect (Connection refused)" in record.message]
    assert refusals.count(logging.WARNING) == 1


def test_peer_that_does_not_read_costs_neither_time_nor_memory():
    async def scenario():
        inbox = Inbox()
        async with Simulator() as simulator:
            link = client_link(simulator.port, inbox)
            await link.open()
            _, writer = await simulator.next_connection()
            writer.transport.pause_reading()
            await until(lambda: link.peers)
            frame = Encoder().heartbeat("x")
            # More than the system's buffers of both sides may hold.
            sends = 0
            while link.counts["output_skipped"] == 0 and sends < 2_000_000:
                link.send(link.peers[0], frame)
                sends += 1
                if sends % 1000 == 0:
                    await asyncio.sleep(0)
            assert link.counts["output_skipped"] > 0
            assert link._connection._transport.get_write_buffer_size() <= 1024
            await link.close()
            await hang_up(writer)

    asyncio.run(scenario())


def test_client_to_a_host_that_is_not_found_is_an_error(monkeypatch):
    def not_found(*args, **kwargs):
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", not_found)
    link = TcpClientLink(TcpClient("drone.invalid", 5760), Inbox(), lambda: 0.0)
    with pytest.raises(LinkError, match=r"host 'drone\.invalid' is not found"):
        asyncio.run(link.open())


def test_server_serves_several_clients_each_at_its_own_address():
    async def scenario():
        inbox, port = Inbox(), free_port(socket.SOCK_STREAM)
        link = TcpServerLink(TcpServer(LOCALHOST, port), inbox, inbox.clock)
        await link.open()
        clients = [await asyncio.open_connection(LOCALHOST, port) for _ in range(2)]
        addresses = []
        for sysid, (_, writer) in enumerate(clients, start=1):
            writer.write(heartbeat(sysid))
            _, address, payload, _ = await inbox.next()
            assert payload == heartbeat(sysid)
            addresses.append(address)
        assert len(set(addresses)) == 2

        for sysid, address in enumerate(addresses, start=1):
            link.send(address, heartbeat(100 + sysid))
        for sysid, (reader, _) in enumerate(clients, start=1):
            want = heartbeat(100 + sysid)
            assert await asyncio.wait_for(reader.readexactly(len(want)), PATIENCE_S) == want

        await hang_up(clients[0][1])
        await until(lambda: link.counts["connection_lost"] == 1)
        link.send(addresses[0], heartbeat(101))
        assert link.counts["not_connected"] == 1
        link.send(addresses[1], heartbeat(103))
        assert await asyncio.wait_for(clients[1][0].readexactly(21), PATIENCE_S) == heartbeat(103)
        await link.close()
        assert await asyncio.wait_for(clients[1][0].read(), PATIENCE_S) == b""
        await hang_up(clients[1][1])

    asyncio.run(scenario())


def test_pymavlink_client_talks_to_our_server():
    async def scenario():
        inbox, port = Inbox(), free_port(socket.SOCK_STREAM)
        link = TcpServerLink(TcpServer(LOCALHOST, port), inbox, inbox.clock)
        await link.open()
        vehicle = await asyncio.to_thread(mavutil.mavlink_connection, f"tcp:{LOCALHOST}:{port}", source_system=4)
        vehicle.mav.heartbeat_send(1, 3, 81, 0, 4)
        _, address, _, _ = await inbox.next()
        link.send(address, Encoder().heartbeat(address))
        wait_for = {"type": "HEARTBEAT", "blocking": True, "timeout": PATIENCE_S}
        got = await asyncio.to_thread(lambda: vehicle.recv_match(**wait_for))
        assert (got.get_srcSystem(), got.get_srcComponent()) == (254, 191)
        vehicle.close()
        await link.close()

    asyncio.run(scenario())


def test_server_turns_away_more_clients_than_it_may_have(monkeypatch):
    monkeypatch.setattr(tcp, "MAX_CLIENTS", 2)

    async def scenario():
        inbox, port = Inbox(), free_port(socket.SOCK_STREAM)
        link = TcpServerLink(TcpServer(LOCALHOST, port), inbox, inbox.clock)
        await link.open()
        clients = [await asyncio.open_connection(LOCALHOST, port) for _ in range(3)]
        await until(lambda: link.counts["too_many_clients"] == 1)
        clients[0][1].write(heartbeat(1))
        assert (await inbox.next())[2] == heartbeat(1)
        await link.close()
        for _, writer in clients:
            writer.transport.abort()

    asyncio.run(scenario())


def test_server_port_in_use_is_an_error_in_words():
    async def scenario():
        inbox, port = Inbox(), free_port(socket.SOCK_STREAM)
        first, second = (TcpServerLink(TcpServer(LOCALHOST, port), inbox, inbox.clock) for _ in range(2))
        await first.open()
        with pytest.raises(LinkError, match=rf"tcpin:127.0.0.1:{port}: port {port} is in use by another program"):
            await second.open()
        await first.close()
        await second.close()

    asyncio.run(scenario())


def test_server_address_that_is_not_ours_is_refused():
    link = TcpServerLink(TcpServer("203.0.113.1", 5760), Inbox(), lambda: 0.0)
    with pytest.raises(LinkError, match=r"203\.0\.113\.1 is no address of this machine"):
        asyncio.run(link.open())


def test_retries_come_soon_at_first_and_seldom_later():
    delays = list(itertools.islice(retry_delays(), 8))
    assert delays[:4] == [1.0, 2.0, 4.0, 8.0]
    assert delays[4:] == [MAX_RETRY_S] * 4
