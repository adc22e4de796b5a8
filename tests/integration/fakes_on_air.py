"""The fakes on real UDP sockets in real time inside a test, which breaks things as events come and waits for what follows."""

from __future__ import annotations

import contextlib
import math
import select
import socket
import time
import tomllib
from collections.abc import Callable, Iterator

from sitl_fakes.fleet import Fleet
from sitl_fakes.scenario import SCENARIOS, Scenario

_TICK_S = 0.01


class OnAir:
    """A four-ship of which vehicle 4 ranges the others. Each vehicle has a socket of its own and sends to the service.

    `spoken_to_at_s` is when each vehicle was first sent something, s.
    """

    def __init__(self, port: int, sockets: dict[int, socket.socket], seed: int) -> None:
        self.fleet = Fleet(_four_ship(), seed)
        self.sockets = sockets
        self._service = ("127.0.0.1", port)
        self.spoken_to_at_s: dict[int, float] = {}
        self._started_s = time.monotonic()

    @property
    def now_s(self) -> float:
        """Time of the simulation, s."""
        return self.fleet.now_s

    def fly(self, limit_s: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Fly in real time until something is so, which is looked at after every step; False where it is not so in time."""
        ends_s = time.monotonic() + limit_s
        while time.monotonic() < ends_s:
            for datagram in self.fleet.advance(time.monotonic() - self._started_s):
                self.sockets[datagram.sysid].sendto(datagram.payload, self._service)
            readable = select.select(list(self.sockets.values()), [], [], _TICK_S)[0]
            for sysid, sock in self.sockets.items():
                if sock in readable:
                    self.spoken_to_at_s.setdefault(sysid, self.now_s)
                    self.fleet.deliver(sysid, sock.recv(4096), self.now_s)
            if until():
                return True
        return False

    def source(self, sysid: int) -> str:
        """What a vehicle's autopilot navigates on."""
        return self.fleet.truth()[sysid].source

    def belief_error_m(self, sysid: int) -> float:
        """How far a vehicle's autopilot believes itself from where it is, m; infinity where it believes nothing."""
        t = self.fleet.truth()[sysid]
        if t.estimate_east_m is None or t.estimate_north_m is None:
            return math.inf
        return math.hypot(t.estimate_east_m - t.east_m, t.estimate_north_m - t.north_m)


@contextlib.contextmanager
def on_air(port: int, seed: int = 1) -> Iterator[OnAir]:
    """The four-ship, sending to a port on loopback."""
    scenario = _four_ship()
    with contextlib.ExitStack() as stack:
        sockets = {v.sysid: stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for v in scenario.vehicle}
        for sock in sockets.values():
            sock.bind(("127.0.0.1", 0))
        yield OnAir(port, sockets, seed)


def _four_ship() -> Scenario:
    with (SCENARIOS / "uwb.toml").open("rb") as file:
        table = tomllib.load(file)
    table["fault"] = []
    for vehicle in table["vehicle"]:
        vehicle["ranges_to"] = [1, 2, 3] if vehicle["sysid"] == 4 else []
    return Scenario.model_validate(table)
