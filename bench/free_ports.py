"""Ports on loopback for the programs that tests and measurements start."""

from __future__ import annotations

import contextlib
import os
import socket
from itertools import count

_FIRST, _SHARE, _PROCESSES = 16_384, 256, 64
"""Below 32768, where Linux begins with the ports that it gives to whoever asks for any: a browser could be given one of ours
before the program that it is meant for opens it. Each process has a share of its own, for tests that run side by side."""

_next = count()


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    """A UDP or TCP port that nobody uses and that is not given a second time soon."""
    first = _FIRST + os.getpid() % _PROCESSES * _SHARE
    for _ in range(_SHARE):
        port = first + next(_next) % _SHARE
        with contextlib.suppress(OSError), socket.socket(socket.AF_INET, kind) as probe:
            probe.bind(("", port))
            return port
    raise OSError(f"all of the ports {first} to {first + _SHARE - 1} are in use")


def free_ports(count: int) -> list[int]:
    """So many different UDP ports."""
    return [free_port() for _ in range(count)]
