"""A relay between fakes and service: it sees every GPS_INPUT, and the service sees each vehicle at an address of its own."""

from __future__ import annotations

import contextlib
import select
import socket
import time

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from bench.kernel_time import arrived_at_s, want_arrival_times


class Relay(contextlib.AbstractContextManager["Relay"]):
    """Listens on `port` for the fakes and passes on to `service_port`, one socket a vehicle, and back."""

    def __init__(self, port: int, service_port: int) -> None:
        self._front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._front.bind(("127.0.0.1", port))
        self._service = ("127.0.0.1", service_port)
        self._backs: dict[tuple[str, int], socket.socket] = {}
        self._owners: dict[socket.socket, tuple[str, int]] = {}

    def __exit__(self, *_: object) -> None:
        self._front.close()
        for back in self._owners:
            back.close()

    def run(self, seconds: float) -> list[float]:
        """Pass on for a time; the intervals in ms between one GPS_INPUT to a vehicle and the next.

        Each is timed by the kernel as it takes it from the service: how late this process gets its turn does not count.
        """
        parser = mavlink.MAVLink(None)
        intervals_ms: list[float] = []
        last_s: dict[socket.socket, float] = {}
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0:
            for ready in select.select([self._front, *self._owners], [], [], left_s)[0]:
                data, control, _, address = ready.recvmsg(4096, 64)
                if ready is self._front:
                    self._back(address).sendto(data, self._service)
                    continue
                self._front.sendto(data, self._owners[ready])
                for message in parser.parse_buffer(data) or []:
                    if message.get_type() == "GPS_INPUT":
                        now_s = arrived_at_s(control)
                        if ready in last_s:
                            intervals_ms.append((now_s - last_s[ready]) * 1e3)
                        last_s[ready] = now_s
        return intervals_ms

    def _back(self, address: tuple[str, int]) -> socket.socket:
        if address not in self._backs:
            back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            want_arrival_times(back)
            back.bind(("127.0.0.1", 0))
            self._backs[address], self._owners[back] = back, address
        return self._backs[address]
