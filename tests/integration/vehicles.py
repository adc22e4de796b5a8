"""Hovering vehicles on real UDP sockets, packed by pymavlink's own generated code: an independent peer of the service."""

from __future__ import annotations

import contextlib
import math
import select
import socket
import threading
import time
from collections.abc import Collection, Iterator

from pymavlink.dialects.v20 import ardupilotmega as mavlink

LAT, LON, ALT_M = 47.0, 8.0, 500.0
M_PER_DEG_LAT, M_PER_DEG_LON = 111_171.0, 76_056.0  # at 47 deg north
COUNT = 30
"""Vehicles in a swarm."""


class Hover:
    """One hovering vehicle at east, north, up metres. `sock` may be shared by several, as behind a router."""

    def __init__(
        self, sysid: int, enu_m: tuple[float, float, float], service: tuple[str, int], sock: socket.socket | None = None
    ):
        self.sysid, self.enu_m, self.service = sysid, enu_m, service
        self.sock = sock or socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        if sock is None:
            self.sock.bind(("127.0.0.1", 0))
        self.mav = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=1)
        self.started = time.monotonic() - 100.0 * sysid
        self.received: list[tuple[float, object]] = []
        self.parser = mavlink.MAVLink(None)

    @property
    def lla(self) -> tuple[float, float, float]:
        e, n, u = self.enu_m
        return LAT + n / M_PER_DEG_LAT, LON + e / M_PER_DEG_LON, ALT_M + u

    def telemetry(self, step: int, fix_type: int) -> list[bytes]:
        lat, lon, alt = self.lla
        boot_ms = int((time.monotonic() - self.started) * 1e3)
        lat_e7, lon_e7, alt_mm = round(lat * 1e7), round(lon * 1e7), round(alt * 1e3)
        m = mavlink
        out = [m.MAVLink_global_position_int_message(boot_ms, lat_e7, lon_e7, alt_mm, round(self.enu_m[2] * 1e3), 0, 0, 0, 65535)]
        if step % 2 == 0:
            sats = 10 if fix_type >= 3 else 3
            fix = (boot_ms * 1000, fix_type, lat_e7, lon_e7, alt_mm, 120, 180, 0, 0, sats)
            out.append(m.MAVLink_gps_raw_int_message(*fix, h_acc=800, v_acc=1200, vel_acc=200))
        if step % 10 == 0:
            out.append(
                m.MAVLink_heartbeat_message(m.MAV_TYPE_FIXED_WING, m.MAV_AUTOPILOT_ARDUPILOTMEGA, 217, 10, m.MAV_STATE_ACTIVE, 3)
            )
        return [self.pack(message) for message in out]

    def pack(self, message) -> bytes:
        data = message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) & 0xFF
        return data

    def range_to(self, other: Hover) -> bytes:
        """A range as DEBUG_VECT, named after the peer's system id."""
        boot_us = int((time.monotonic() - self.started) * 1e6)
        range_m = math.dist(self.enu_m, other.enu_m)
        return self.pack(mavlink.MAVLink_debug_vect_message(f"RNG{other.sysid}".encode(), boot_us, range_m, 0.5, -1.0))

    def send(self, *datagrams: bytes) -> None:
        for data in datagrams:
            self.sock.sendto(data, self.service)

    def of(self, kind: str) -> list:
        return [message for _, message in self.received if message.get_type() == kind]


@contextlib.contextmanager
def square_fleet(port: int, *, behind_a_router: bool = False) -> Iterator[list[Hover]]:
    """Four vehicles about 400 m apart, sending to a port on loopback; the fourth stands among the other three."""
    places = [(0.0, 0.0, 60.0), (400.0, 30.0, 100.0), (180.0, 380.0, 80.0), (150.0, 160.0, 120.0)]
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in places]
        for sock in sockets:
            sock.bind(("127.0.0.1", 0))
        at = ("127.0.0.1", port)
        yield [Hover(i + 1, place, at, sockets[0 if behind_a_router else i]) for i, place in enumerate(places)]


@contextlib.contextmanager
def swarm(port: int, failed: set[int]) -> Iterator[list[Hover]]:
    """Thirty vehicles near each other. Twice a second: what is shown is tested, on any machine, and not the service's load."""
    landed = threading.Event()
    places = [(40.0 * (i % 6), 25.0 * (i // 6), 60.0 + i) for i in range(COUNT)]
    fleet = [Hover(i + 1, place, ("127.0.0.1", port)) for i, place in enumerate(places)]

    def hover() -> None:
        while not landed.wait(0.5):
            for i, vehicle in enumerate(fleet):
                vehicle.send(*vehicle.telemetry(0, 1 if vehicle.sysid in failed else 3))
                if vehicle.sysid in failed:
                    vehicle.send(*(vehicle.range_to(other) for other in fleet[max(i - 7, 0) : i]))

    thread = threading.Thread(target=hover, daemon=True)
    thread.start()
    try:
        yield fleet
    finally:
        landed.set()
        thread.join()
        for vehicle in fleet:
            vehicle.sock.close()


def fly(fleet: list[Hover], seconds: float, failed: Collection[int] = (), until=lambda: False, noise: bytes = b"") -> None:
    """Send telemetry at 10 Hz, ranges from the failed ones, and take in what comes back; ends early once `until` is true."""
    by_socket = {}
    for vehicle in fleet:
        by_socket.setdefault(vehicle.sock, []).append(vehicle)
    start = time.monotonic()
    for step in range(round(seconds * 10)):
        for vehicle in fleet:
            if noise:
                vehicle.send(noise)
            vehicle.send(*vehicle.telemetry(step, 1 if vehicle.sysid in failed else 3))
            if vehicle.sysid in failed:
                vehicle.send(*(vehicle.range_to(other) for other in fleet if other is not vehicle))
        while (left := start + (step + 1) / 10 - time.monotonic()) > 0:
            for sock in select.select(list(by_socket), [], [], left)[0]:
                data, _ = sock.recvfrom(4096)
                for message in by_socket[sock][0].parser.parse_buffer(data) or []:
                    for vehicle in by_socket[sock]:
                        vehicle.received.append((time.monotonic(), message))
        if until():
            return
