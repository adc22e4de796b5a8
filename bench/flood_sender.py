"""`python -m bench.flood_sender PORT RATE SECONDS ADDRESSES`: hostile datagrams to a port on loopback; prints the rate reached.

A fixed mixture from a fixed seed: noise, frames of live vehicles with false positions, of made-up vehicles, of unknown ids.
"""

from __future__ import annotations

import random
import socket
import sys
import time

from pymavlink.dialects.v20 import ardupilotmega as mavlink

_TICK_S = 0.005
_DATAGRAMS = 4096


def datagrams(seed: int = 1) -> list[bytes]:
    """The mixture."""
    rng = random.Random(seed)
    return [_hostile(rng, number) for number in range(_DATAGRAMS)]


def _hostile(rng: random.Random, number: int) -> bytes:
    sender = mavlink.MAVLink(None, srcSystem=rng.choice((1, 2, 3, 4, rng.randrange(5, 255))), srcComponent=rng.choice((1, 191)))
    sender.seq = number & 0xFF
    kind = rng.randrange(4)
    if kind == 0:
        return rng.randbytes(rng.randrange(1, 280))
    if kind == 1:
        return bytes((0xFD, 9, 0, 0, number & 0xFF, 4, 1, 0xEF, 0xCD, 0xAB)) + rng.randbytes(11)
    if kind == 2:
        return bytes(mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3).pack(sender))
    lat, lon = rng.randrange(-(9 * 10**8), 9 * 10**8), rng.randrange(-(18 * 10**8), 18 * 10**8)
    return bytes(mavlink.MAVLink_global_position_int_message(number, lat, lon, 5 * 10**5, 0, 0, 0, 0, 0).pack(sender))


def main() -> None:
    """Send for as long as asked, as evenly as the clock allows."""
    port, rate, seconds, addresses = int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
    load, target = datagrams(), ("127.0.0.1", port)
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(addresses)]
    for sender in sockets:
        sender.bind(("127.0.0.1", 0))
    start, sent = time.monotonic(), 0
    while (elapsed := time.monotonic() - start) < seconds:
        while sent < elapsed * rate:
            sockets[sent % addresses].sendto(load[sent % _DATAGRAMS], target)
            sent += 1
        time.sleep(_TICK_S)
    print(sent / elapsed)


if __name__ == "__main__":
    main()
