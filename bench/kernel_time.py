"""When the kernel took a datagram: how late the process that reads it gets its turn does not count. Linux."""

from __future__ import annotations

import socket
import struct

_TIMESPEC = struct.Struct("@ll")
_SO_TIMESTAMPNS = 35  # Linux; the socket module does not name it


def want_arrival_times(receiver: socket.socket) -> None:
    """Have the kernel hand over the time with each datagram, for `arrived_at_s`."""
    receiver.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)


def arrived_at_s(control: list[tuple[int, int, bytes]]) -> float:
    """UNIX seconds at which a datagram arrived, from the control messages of its `recvmsg`."""
    stamp = next(data for level, kind, data in control if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS))
    seconds, nanoseconds = _TIMESPEC.unpack(stamp[: _TIMESPEC.size])
    return float(seconds + nanoseconds * 1e-9)
