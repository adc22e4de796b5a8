"""Outputs are at the vehicle before the journal is written and before observers get their time."""

from __future__ import annotations

import asyncio
import socket

import pytest
from vehicles import Hover

from gcs_coloc.config.fleets import load_settings
from gcs_coloc.core.messages.outbound import ToVehicle
from gcs_coloc.recorder.journal import Journal
from gcs_coloc.runtime.clock import ServiceClock, read_host_clock
from gcs_coloc.service.fleet_service import FleetService

pytestmark = pytest.mark.integration

_GENEROUS_S = 60.0


def drained(sock: socket.socket) -> int:
    count = 0
    while True:
        try:
            sock.recv(4096)
        except BlockingIOError:
            return count
        count += 1


def test_outputs_are_at_the_vehicle_when_the_journal_is_written_and_then_observers_get_a_slot(free_port, tmp_path, monkeypatch):
    counted: list[tuple[int, int]] = []
    write = Journal.entries

    async def flight() -> None:
        clock = ServiceClock()
        settings = load_settings(None, {"links": [f"udpin:127.0.0.1:{free_port}"], "record": {"directory": str(tmp_path)}})
        path = FleetService(settings, clock, read_host_clock(clock()))
        await path.open()
        path.start()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.bind(("127.0.0.1", 0))
            sock.setblocking(False)

            def watched(journal, at_s, outputs):
                counted.append((sum(isinstance(output, ToVehicle) for output in outputs), drained(sock)))
                return write(journal, at_s, outputs)

            monkeypatch.setattr(Journal, "entries", watched)
            hover = Hover(1, (0.0, 0.0, 50.0), ("127.0.0.1", free_port), sock)
            hover.send(*hover.telemetry(0, 3))
            async with asyncio.timeout(_GENEROUS_S):
                async for _ in path.idle.every(0.01):
                    if sum(due for due, _ in counted) >= 3:
                        break
        await path.close()

    asyncio.run(flight())
    assert all(due == arrived for due, arrived in counted)
