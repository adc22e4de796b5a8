"""What a busy service has waiting in its sockets is not looked at once it is to end: its last words must not come late."""

from __future__ import annotations

import asyncio
import socket

import pytest
from vehicles import Hover

from gcs_coloc.config.fleets import load_settings
from gcs_coloc.runtime.clock import ServiceClock, read_host_clock
from gcs_coloc.service.fleet_service import FleetService

pytestmark = pytest.mark.integration

_GENEROUS_S = 20.0


def test_what_arrives_after_the_end_was_asked_for_is_not_looked_at(free_port):
    async def flight() -> tuple[list[int], list[int]]:
        clock = ServiceClock()
        settings = load_settings(None, {"links": [f"udpin:127.0.0.1:{free_port}"]})
        path = FleetService(settings, clock, read_host_clock(clock()))
        await path.open()
        path.start()
        events = path.events.subscribe()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.bind(("127.0.0.1", 0))
            first, second = (Hover(sysid, (0.0, 0.0, 50.0), ("127.0.0.1", free_port), sock) for sysid in (1, 2))
            first.send(*first.telemetry(0, 3))
            async with asyncio.timeout(_GENEROUS_S):
                await events.get()  # that it was heard for the first time
            before = path.known_sysids()
            path.stop()
            second.send(*second.telemetry(0, 3))
            for _ in range(100):  # loopback has delivered at once; the loop has had its turns
                await asyncio.sleep(0)
            after = path.known_sysids()
        await path.close()
        return before, after

    assert asyncio.run(flight()) == ([1], [1])
