"""UDP links on loopback, against pymavlink's own connections and plain sockets."""

from __future__ import annotations

import asyncio
import socket
import sys

import pytest
from pymavlink import mavutil

from bench.free_ports import free_port
from gcs_coloc.core.errors import LinkError
from gcs_coloc.core.messages.inbound import Heartbeat
from gcs_coloc.core.messages.outbound import GpsInput
from gcs_coloc.links.routes import Blocked, RouteTable
from gcs_coloc.links.udp import UdpIn, UdpLink, UdpOut
from gcs_coloc.mavlink.decoder import Decoder
from gcs_coloc.mavlink.encoder import Encoder
from gcs_coloc.runtime.clock import ServiceClock
from tests.integration.link_peers import PATIENCE_S, Inbox, heartbeat, stamps_of_arrival

pytestmark = pytest.mark.integration

LOCALHOST = "127.0.0.1"
HELD_UP_S = 0.02
"""The event loop is busy with sending for so long."""
SLACK_S = 100e-6
"""Whole microseconds, and two clocks of the host that are read one after the other."""


def fix_for(sysid):
    return GpsInput(sysid, 1, 0, 0, 0, 3, -35.25, 149.5, 600.0, 1.5, 2.0, 10.0, -5.0, 0.5, 0.5, 3.0, 5.0, 7)


def vehicle_socket():
    vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    vehicle.bind((LOCALHOST, 0))
    vehicle.settimeout(PATIENCE_S)
    return vehicle


def test_gps_input_reaches_a_pymavlink_vehicle_at_the_address_it_was_heard_from():
    async def scenario():
        inbox, port = Inbox(), free_port()
        link = UdpLink(UdpIn(LOCALHOST, port), inbox, inbox.clock)
        await link.open()
        vehicle = mavutil.mavlink_connection(f"udpout:{LOCALHOST}:{port}", source_system=4, source_component=1)
        try:
            vehicle.mav.heartbeat_send(1, 3, 81, 0, 4)
            from_link, address, payload, received_at_s = await inbox.next()
            (frame,) = Decoder().decode(payload, received_at_s)
            assert isinstance(frame.message, Heartbeat)
            assert (from_link, frame.sysid, frame.message.received_at_s) == (link, 4, received_at_s)

            link.send(address, Encoder().encode(fix_for(4), address))
            wait_for = {"type": "GPS_INPUT", "blocking": True, "timeout": PATIENCE_S}
            got = await asyncio.to_thread(lambda: vehicle.recv_match(**wait_for))
            assert (got.lat, got.lon, got.gps_id, got.get_srcSystem()) == (-352_500_000, 1_495_000_000, 1, 254)
        finally:
            vehicle.close()
            await link.close()

    asyncio.run(scenario())


def test_output_for_one_vehicle_reaches_no_other():
    async def scenario():
        inbox, port = Inbox(), free_port()
        link = UdpLink(UdpIn(LOCALHOST, port), inbox, inbox.clock)
        await link.open()
        decoder, encoder, routes = Decoder(), Encoder(), RouteTable()
        vehicles = {sysid: vehicle_socket() for sysid in (1, 2, 3)}
        try:
            for sysid, vehicle in vehicles.items():
                vehicle.sendto(heartbeat(sysid), (LOCALHOST, port))
                _, address, payload, now_s = await inbox.next()
                (frame,) = decoder.decode(payload, now_s, address)
                assert routes.learn(
                    frame.sysid, frame.compid, link, address, is_autopilot_heartbeat=frame.is_autopilot_heartbeat, now_s=now_s
                )
            route = routes.route(2, now_s)
            assert not isinstance(route, Blocked)
            sent = encoder.encode(fix_for(2), route)
            route.link.send(route.address, sent)
            assert vehicles[2].recv(2048) == sent
            # What is sent to each of them now is the first thing that the others get.
            for sysid in (1, 3):
                route = routes.route(sysid, now_s)
                route.link.send(route.address, encoder.heartbeat(route))
                assert vehicles[sysid].recv(2048) != sent
        finally:
            for vehicle in vehicles.values():
                vehicle.close()
            await link.close()

    asyncio.run(scenario())


def test_udpout_speaks_first_and_hears_the_answer():
    async def scenario():
        inbox, vehicle = Inbox(), vehicle_socket()
        link = UdpLink(UdpOut(LOCALHOST, vehicle.getsockname()[1]), inbox, inbox.clock)
        assert not link.peers
        await link.open()
        try:
            link.send(link.peers[0], Encoder().heartbeat(link.peers[0]))
            hello, us = vehicle.recvfrom(2048)
            assert hello == Encoder().heartbeat("the same first frame")
            vehicle.sendto(heartbeat(1), us)
            _, address, payload, _ = await inbox.next()
            assert (address, payload) == (link.peers[0], heartbeat(1))
        finally:
            vehicle.close()
            await link.close()

    asyncio.run(scenario())


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has stamps of arrival in nanoseconds")
def test_burst_arrives_whole_in_order_and_each_datagram_has_the_time_of_its_arrival_however_late_it_is_read():
    async def scenario():
        inbox, port, clock = Inbox(), free_port(), ServiceClock()
        link = UdpLink(UdpIn(LOCALHOST, port), inbox, clock)
        await link.open()
        vehicle = vehicle_socket()
        try:
            burst, sent_s, began_s = [], [], clock()
            while clock() < began_s + HELD_UP_S or len(burst) < 200:
                before_s = clock()
                burst.append(heartbeat(1, len(burst) % 256))
                vehicle.sendto(burst[-1], (LOCALHOST, port))
                sent_s.append((before_s, clock()))
            arrived = [await inbox.next() for _ in burst]
            assert [payload for _, _, payload, _ in arrived] == burst
            late_s = []
            for (before_s, after_s), (*_, stamp_s) in zip(sent_s, arrived, strict=True):
                assert before_s - SLACK_S <= stamp_s <= clock()
                late_s.append(stamp_s - after_s)
            # A busy kernel delivers any of them some milliseconds after it was sent, but not all.
            assert min(late_s) <= SLACK_S
            # The event loop read none before the last was sent: the first has not the time of its reading.
            assert arrived[0][3] < sent_s[-1][0]
        finally:
            vehicle.close()
            await link.close()

    with stamps_of_arrival():
        asyncio.run(scenario())


def test_ipv6_loopback():
    async def scenario():
        inbox = Inbox()
        try:
            vehicle = socket.socket(socket.AF_INET6, socket.SOCK_DGRAM)
            vehicle.bind(("::1", 0))
        except OSError as error:
            pytest.skip(f"this machine has no IPv6 loopback: {error}")
        vehicle.settimeout(PATIENCE_S)
        link = UdpLink(UdpOut("::1", vehicle.getsockname()[1]), inbox, inbox.clock)
        await link.open()
        link.send(link.peers[0], heartbeat(254))
        hello, us = vehicle.recvfrom(2048)
        vehicle.sendto(hello, us)
        _, address, payload, _ = await inbox.next()
        assert payload == heartbeat(254)
        assert address == link.peers[0]
        vehicle.close()
        await link.close()

    asyncio.run(scenario())


def test_second_binder_of_a_port_is_refused_and_told_what_to_do():
    async def scenario():
        inbox, port = Inbox(), free_port()
        first, second = (UdpLink(UdpIn(LOCALHOST, port), inbox, inbox.clock) for _ in range(2))
        await first.open()
        try:
            with pytest.raises(LinkError, match=rf"udpin:127.0.0.1:{port}: port {port} is in use .*stop it, or .*forward"):
                await second.open()
        finally:
            await first.close()
        await second.open()  # the port is free again
        await second.close()

    asyncio.run(scenario())


def test_address_that_is_not_ours_is_refused():
    link = UdpLink(UdpIn("203.0.113.1", 14550), Inbox(), lambda: 0.0)
    with pytest.raises(LinkError, match=r"203\.0\.113\.1 is no address of this machine"):
        asyncio.run(link.open())


def test_host_that_is_not_found_is_an_error(monkeypatch):
    def not_found(*args, **kwargs):
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", not_found)
    link = UdpLink(UdpOut("drone.invalid", 14550), Inbox(), lambda: 0.0)
    with pytest.raises(LinkError, match=r"host 'drone\.invalid' is not found"):
        asyncio.run(link.open())


def test_what_cannot_be_sent_is_counted_and_never_raised():
    async def scenario():
        link = UdpLink(UdpIn(LOCALHOST, free_port()), Inbox(), lambda: 0.0)
        link.send((LOCALHOST, 9), b"not open yet")
        await link.open()
        link.send((LOCALHOST, 9), b"x" * 70_000)
        link.send(("::1", 9, 0, 0), b"another family")
        await link.close()
        link.send((LOCALHOST, 9), b"closed")
        await link.close()
        return dict(link.counts)

    assert asyncio.run(scenario()) == {"not_sent": 4}


@pytest.mark.parametrize("host", ["127.255.255.255", "255.255.255.255", "239.1.2.3"])
def test_an_address_that_reaches_everybody_is_refused_with_the_remedy(host):
    """127.255.255.255 is the broadcast address of the loopback network, as 192.168.1.255 may be of another."""
    link = UdpLink(UdpOut(host, 14550), Inbox(), lambda: 0.0)
    with pytest.raises(
        LinkError, match=r"is a (broad|multi)cast address: .*; give the one host's address, or listen \(udpin:14550\)"
    ):
        asyncio.run(link.open())
    assert link.peers == ()


@pytest.mark.parametrize("host", ["127.255.255.255", "255.255.255.255", "239.1.2.3"])
def test_nor_can_be_listened_on_where_what_is_meant_for_this_host_would_not_arrive(host, free_port):
    link = UdpLink(UdpIn(host, free_port), Inbox(), lambda: 0.0)
    with pytest.raises(LinkError, match=r"is a (broad|multi)cast address; use 0\.0\.0\.0 to listen on all addresses of"):
        asyncio.run(link.open())


@pytest.mark.parametrize("host", ["127.0.0.255", "127.0.0.1"])
def test_an_address_that_only_looks_like_a_broadcast_one_is_one_host(host):
    async def scenario():
        link = UdpLink(UdpOut(host, 14550), Inbox(), lambda: 0.0)
        await link.open()
        try:
            return link.peers
        finally:
            await link.close()

    assert asyncio.run(scenario()) == ((host, 14550),)
