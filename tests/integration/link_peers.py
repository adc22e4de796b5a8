"""What the tests of links share: an inbox for what arrives, frames to send."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
import time

from pymavlink.dialects.v20 import ardupilotmega as mavlink

PATIENCE_S = 60.0
"""A test that waits so long has failed; nothing is measured by it."""


class Inbox:
    """A link's handler and clock. The clock counts how often it was read."""

    def __init__(self):
        self._arrived = asyncio.Queue()
        self._ticks = 0

    def clock(self):
        self._ticks += 1
        return float(self._ticks)

    def __call__(self, link, address, payload, received_at_s):
        self._arrived.put_nowait((link, address, payload, received_at_s))

    async def next(self):
        return await asyncio.wait_for(self._arrived.get(), PATIENCE_S)

    def empty(self):
        return self._arrived.empty()


async def until(condition):
    """Let the event loop run until something holds."""

    async def watch():
        while not condition():  # noqa: ASYNC110 - what is waited for is another program's or the system's doing
            await asyncio.sleep(0)

    await asyncio.wait_for(watch(), PATIENCE_S)


def heartbeat(sysid, sequence=0):
    sender = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=1)
    sender.seq = sequence
    return mavlink.MAVLink_heartbeat_message(1, 3, 81, 0, 4, 3).pack(sender)


@contextlib.contextmanager
def stamps_of_arrival():
    """Have the kernel stamp what arrives: it begins a moment after the first socket asks for it, and ends with the last one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, 35, 1)  # SO_TIMESTAMPNS
        probe.bind(("127.0.0.1", 0))
        give_up = time.monotonic() + PATIENCE_S
        stamp_ns = read_ns = 0
        while stamp_ns > read_ns - 500_000:
            assert time.monotonic() < give_up, "the kernel stamps nothing"
            probe.sendto(b"?", probe.getsockname())
            sent_ns = time.monotonic_ns()
            while time.monotonic_ns() < sent_ns + 1_000_000:
                pass
            read_ns = time.time_ns()
            ((_, _, data),) = probe.recvmsg(16, 64)[1]
            seconds, nanoseconds = struct.unpack("@ll", data)
            stamp_ns = seconds * 1_000_000_000 + nanoseconds
        yield
