"""`python -m bench.load_sender SECONDS SIZE FLEET...`: the traffic of a fleet to each port, in real time, and what comes back.

SIZE is VEHICLES,DENIED of each fleet, as 4,1. FLEET is PORT or PORT,OUT,LEAD: OUT is a port of ours to which the service hands
each frame on once it has taken it (`--out`), and the first datagram goes LEAD seconds ahead of the others, for it sets the
service's grid of deadlines. Each vehicle has a socket of its own, each fleet its own phase.

Prints, as JSON, the datagrams sent in the time after the warm-up, when that time began and ended (time.monotonic), and of each
fleet when GPS_INPUT came (`gps_input_s`) and when each range of the vehicle without GPS was sent and handed on (`ranges_s`). Both
are UNIX seconds, timed by the kernel where they come in: how late this process gets its turn does not count.
"""

from __future__ import annotations

import heapq
import json
import select
import socket
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import repeat

from pymavlink.dialects.v20.ardupilotmega import MAVLINK_MSG_ID_GPS_INPUT

from bench.kernel_time import arrived_at_s, want_arrival_times
from bench.traffic import LOST, WARM_S, FleetSize, Sent, fleet_traffic, message_id_of
from gcs_coloc.mavlink._generated.gcs_coloc import MAVLINK_MSG_ID_PEER_RANGE

_TICK_S = 0.001
_APART_S = 0.5 * (5.0**0.5 - 1.0)
"""From fleet to fleet: by the golden ratio they come at different times of every period, a second's and a tenth's alike."""


@dataclass
class _Fleet:
    port: int
    out: int | None = None
    lead_s: float = 0.0
    gps_input_s: list[float] = field(default_factory=list)
    ranges_s: list[tuple[float, float]] = field(default_factory=list)
    sent_at_s: dict[bytes, float] = field(default_factory=dict)


def main() -> None:
    """Send, and listen in between."""
    seconds, fleets = float(sys.argv[1]), [_fleet(text) for text in sys.argv[3:]]
    traffic = fleet_traffic(seconds + 2.0, FleetSize(*map(int, sys.argv[2].split(","))))
    listening = select.epoll()
    senders: dict[tuple[int, int], socket.socket] = {}
    of_descriptor: dict[int, tuple[socket.socket, _Fleet, bool]] = {}

    def socket_of(fleet: _Fleet, *, is_out: bool) -> socket.socket:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.setblocking(False)
        want_arrival_times(opened)
        opened.bind(("127.0.0.1", (fleet.out or 0) if is_out else 0))
        listening.register(opened, select.EPOLLIN)
        of_descriptor[opened.fileno()] = opened, fleet, is_out
        return opened

    for number, fleet in enumerate(fleets):
        senders |= {(number, sysid): socket_of(fleet, is_out=False) for sysid in {sent.sysid for sent in traffic}}
        if fleet.out is not None:
            socket_of(fleet, is_out=True)
    sent_count = 0
    start_s = time.monotonic() + max(fleet.lead_s for fleet in fleets)
    began_s, end_s = start_s + WARM_S, start_s + WARM_S + seconds
    timetable = (_timetable(traffic, number * _APART_S % 1.0, number, fleet.lead_s) for number, fleet in enumerate(fleets))
    for at_s, number, sysid, payload in heapq.merge(*timetable):
        while start_s + at_s > (now_s := time.monotonic()):
            for descriptor, _ in listening.poll(min(start_s + at_s - now_s, _TICK_S)):
                _receive(*of_descriptor[descriptor], measuring=now_s >= began_s)
        if now_s >= end_s:
            break
        fleet = fleets[number]
        if fleet.out is not None and sysid == LOST and message_id_of(payload) == MAVLINK_MSG_ID_PEER_RANGE:
            fleet.sent_at_s[payload] = time.time()
        senders[number, sysid].sendto(payload, ("127.0.0.1", fleet.port))
        sent_count += now_s >= began_s
    told = [{"gps_input_s": fleet.gps_input_s, "ranges_s": fleet.ranges_s} for fleet in fleets]
    print(json.dumps({"sent": sent_count, "began_s": began_s, "ended_s": time.monotonic(), "fleets": told}))


def _fleet(text: str) -> _Fleet:
    port, *probe = text.split(",")
    return _Fleet(int(port), int(probe[0]), float(probe[1])) if probe else _Fleet(int(port))


def _timetable(traffic: list[Sent], phase_s: float, number: int, lead_s: float) -> Iterator[tuple[float, int, int, bytes]]:
    for n, (sent, fleet) in enumerate(zip(traffic, repeat(number))):
        yield sent.at_s + phase_s - (lead_s if n == 0 else 0.0), fleet, sent.sysid, sent.payload


def _receive(ready: socket.socket, fleet: _Fleet, is_out: bool, *, measuring: bool) -> None:
    data, control, _, _ = ready.recvmsg(4096, 64)
    at_s = arrived_at_s(control)
    if is_out:
        sent_at_s = fleet.sent_at_s.pop(data, None)
        if sent_at_s is not None and measuring:
            fleet.ranges_s.append((sent_at_s, at_s))
    elif measuring and message_id_of(data) == MAVLINK_MSG_ID_GPS_INPUT:
        fleet.gps_input_s.append(at_s)


if __name__ == "__main__":
    main()
