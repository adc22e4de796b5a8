"""What a message that nobody uses costs the service after its datagram was read: a real socket, beside a reader of the same."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable

from bench.figures import Figure, interleaved
from bench.free_ports import free_port
from bench.traffic import OTHERS, fleet_traffic, message_id_of
from gcs_coloc.config.settings import Settings
from gcs_coloc.links.udp import DATAGRAMS_PER_WAKE
from gcs_coloc.runtime.clock import ServiceClock, read_host_clock
from gcs_coloc.service.fleet_service import FleetService

_GOAL_US = 5.0


def measure(quick: bool) -> list[Figure]:
    """CPU of this process, which sends as well: what sending and reading cost stands in both."""
    frames = [sent.payload for sent in fleet_traffic(5.0 if quick else 30.0) if message_id_of(sent.payload) in OTHERS]
    cost_us = interleaved(
        {"service": lambda: asyncio.run(_service_us(frames)), "reader": lambda: asyncio.run(_reader_us(frames))}, 9
    )
    used_us = cost_us["service"] - cost_us["reader"]
    return [
        Figure(
            "a message that nobody uses, after its datagram was read",
            f"{used_us:.1f} us; sending and reading it {cost_us['reader']:.1f} us",
            f"< {_GOAL_US:.0f} us",
            used_us < _GOAL_US,
        )
    ]


async def _service_us(frames: list[bytes]) -> float:
    port, clock = free_port(), ServiceClock()
    # What one process sends in bursts is no flood here.
    settings = Settings.model_validate({"links": [f"udpin:127.0.0.1:{port}"], "senders": {"bytes_per_s": 1e9}})
    service = FleetService(settings, clock, read_host_clock(clock()))
    await service.open()
    try:
        return await _sent_us(frames, port)
    finally:
        await service.close()


async def _reader_us(frames: list[bytes]) -> float:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reader:
        reader.bind(("127.0.0.1", 0))
        reader.setblocking(False)
        asyncio.get_running_loop().add_reader(reader, _drain, reader.recvfrom)
        return await _sent_us(frames, reader.getsockname()[1])


def _drain(receive: Callable[[int], object]) -> None:
    for _ in range(DATAGRAMS_PER_WAKE):
        try:
            receive(65535)
        except BlockingIOError:
            return


async def _sent_us(frames: list[bytes], port: int) -> float:
    """Send them in bursts that one wake takes, and give the loop its turns."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", port))
        began_s = time.process_time()
        for first in range(0, len(frames), DATAGRAMS_PER_WAKE // 2):
            for frame in frames[first : first + DATAGRAMS_PER_WAKE // 2]:
                sender.send(frame)
            for _ in range(3):
                await asyncio.sleep(0)
        return (time.process_time() - began_s) / len(frames) * 1e6
