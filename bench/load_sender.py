"""`python -m bench.load_sender SECONDS PORT...`: the traffic of a fleet of four to each port, in real time, and what comes back.

Each vehicle has a socket of its own, each fleet its own phase. Prints, as JSON, the datagrams sent in the time after the warm-up,
when that time began and ended (time.monotonic), and the intervals in ms between the GPS_INPUT of each aided vehicle.
"""

from __future__ import annotations

import heapq
import json
import select
import socket
import sys
import time
from collections.abc import Iterator
from itertools import repeat

from pymavlink.dialects.v20.ardupilotmega import MAVLINK_MSG_ID_GPS_INPUT

from bench.traffic import WARM_S, fleet_traffic, message_id_of

_TICK_S = 0.001


def main() -> None:
    """Send, and listen in between."""
    seconds, ports = float(sys.argv[1]), [int(text) for text in sys.argv[2:]]
    traffic = fleet_traffic(seconds + 2.0)
    vehicles = sorted({sent.sysid for sent in traffic})
    sockets = {
        (fleet, sysid): socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for fleet in range(len(ports)) for sysid in vehicles
    }
    listening = select.epoll()
    of_descriptor = {}
    for sender in sockets.values():
        sender.bind(("127.0.0.1", 0))
        sender.setblocking(False)
        listening.register(sender, select.EPOLLIN)
        of_descriptor[sender.fileno()] = sender

    def fleets_own(fleet: int) -> Iterator[tuple[float, int, int, bytes]]:
        phase_s = fleet / len(ports)
        return ((sent.at_s + phase_s, number, sent.sysid, sent.payload) for sent, number in zip(traffic, repeat(fleet)))

    last_s: dict[int, float] = {}
    intervals_ms: list[float] = []
    sent_count = 0
    start_s = time.monotonic()
    began_s, end_s = start_s + WARM_S, start_s + WARM_S + seconds
    for at_s, fleet, sysid, payload in heapq.merge(*(fleets_own(fleet) for fleet in range(len(ports)))):
        while start_s + at_s > (now_s := time.monotonic()):
            for descriptor, _ in listening.poll(min(start_s + at_s - now_s, _TICK_S)):
                frame = of_descriptor[descriptor].recv(4096)
                if message_id_of(frame) != MAVLINK_MSG_ID_GPS_INPUT:
                    continue
                came_s = time.monotonic()
                if descriptor in last_s and came_s >= began_s:
                    intervals_ms.append((came_s - last_s[descriptor]) * 1e3)
                last_s[descriptor] = came_s
        if now_s >= end_s:
            break
        sockets[fleet, sysid].sendto(payload, ("127.0.0.1", ports[fleet]))
        sent_count += now_s >= began_s
    print(json.dumps({"sent": sent_count, "began_s": began_s, "ended_s": time.monotonic(), "intervals_ms": intervals_ms}))


if __name__ == "__main__":
    main()
