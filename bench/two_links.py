"""Vehicles with two radios, in real time on loopback, and two services of a hot standby, one at each radio.

What has no target the simulated vehicles pass on over their other radio, as ArduPilot does (MAVLink routing).
"""

from __future__ import annotations

import contextlib
import itertools
import select
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fakes.faults import GpsLost
from sitl_fakes.fleet import Fleet
from sitl_fakes.scenario import SCENARIOS, Scenario

DENIED = 4
"""The vehicle that ranges the others and loses its GPS."""
COMPONENT_IDS = (191, 192)
_TICK_S = 0.005
_UNTARGETED = {mavlink.MAVLINK_MSG_ID_GPS_INPUT, mavlink.MAVLINK_MSG_ID_HEARTBEAT}


@dataclass(frozen=True, slots=True)
class Fed:
    """One GPS_INPUT as a vehicle got it: when (monotonic, s), over which radio, from which component, with which fix type."""

    at_s: float
    sysid: int
    radio: int
    compid: int
    fix_type: int


class TwoLinks:
    """A four-ship in the air. `ports` are those of the two services. `fed` is every GPS_INPUT that a vehicle got.

    `sign_ports` are two more that are free.
    """

    def __init__(self, ports: Sequence[int], sign_ports: Sequence[int], stack: contextlib.ExitStack, seed: int) -> None:
        self.fleet = Fleet(_four_ship(), seed)
        self.fed: list[Fed] = []
        self.sign_ports = sign_ports
        self._services = [("127.0.0.1", port) for port in ports]
        self._radios = {
            (sysid, radio): stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            for sysid in self.fleet.sysids
            for radio in (0, 1)
        }
        for each in self._radios.values():
            each.bind(("127.0.0.1", 0))
        self._ends = {each: key for key, each in self._radios.items()}
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._started_s: float | None = None  # until the first flight

    def lose_gps(self, sysid: int = DENIED) -> None:
        """Have a vehicle lose its GPS now, for good."""
        self.fleet.inject(GpsLost(vehicle=sysid, at_s=self.fleet.now_s))

    def fly(self, limit_s: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Fly in real time until something is so, which is looked at after every step; False where it is not so in time."""
        begins_s = time.monotonic()
        if self._started_s is None:
            self._started_s = begins_s
        while time.monotonic() < begins_s + limit_s:
            for datagram in self.fleet.advance(time.monotonic() - self._started_s):
                for radio, service in enumerate(self._services):
                    self._radios[datagram.sysid, radio].sendto(datagram.payload, service)
            for readable in select.select(list(self._ends), [], [], _TICK_S)[0]:
                self._receive(*self._ends[readable], readable.recv(4096))
            if until():
                return True
        return False

    def aids(self, since_s: float = 0.0, sysid: int = DENIED) -> list[Fed]:
        """Every GPS_INPUT that a vehicle got since a time."""
        return [fed for fed in self.fed if fed.sysid == sysid and fed.at_s >= since_s]

    def has_fix_from(self, compid: int, since_s: float = 0.0) -> bool:
        """Whether the denied vehicle was sent a fix by a service."""
        return any(fed.compid == compid and fed.fix_type >= 3 for fed in self.aids(since_s))

    def _receive(self, sysid: int, radio: int, payload: bytes) -> None:
        for message in self._parser.parse_buffer(payload) or []:
            if message.get_msgId() == mavlink.MAVLINK_MSG_ID_GPS_INPUT:
                self.fed.append(Fed(time.monotonic(), sysid, radio, message.get_srcComponent(), message.fix_type))
            if message.get_msgId() in _UNTARGETED:
                self._radios[sysid, 1 - radio].sendto(bytes(message.get_msgbuf()), self._services[1 - radio])
        self.fleet.deliver(sysid, payload, self.fleet.now_s)


def changes(fed: list[Fed]) -> list[tuple[Fed, Fed]]:
    """Where the sender changed: the last GPS_INPUT of the one and the first of the other."""
    return [(before, after) for before, after in itertools.pairwise(fed) if before.compid != after.compid]


@contextlib.contextmanager
def two_links(seed: int = 1) -> Iterator[tuple[TwoLinks, Sequence[int]]]:
    """The four-ship, and the two ports that it sends to."""
    with contextlib.ExitStack() as stack:
        # Bound until the vehicles' sockets are: none of those may get one of these ports.
        with contextlib.ExitStack() as reserved:
            sockets = [reserved.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(4)]
            for each in sockets:
                each.bind(("127.0.0.1", 0))
            numbers = [int(each.getsockname()[1]) for each in sockets]
            air = TwoLinks(numbers[:2], numbers[2:], stack, seed)
        yield air, numbers[:2]


class Pair:
    """The two services as processes: `start` one by its index. `arguments` go to both. What they log goes into `directory`."""

    def __init__(self, air: TwoLinks, ports: Sequence[int], directory: Path, *arguments: str) -> None:
        self._ports = ports
        self._arguments = arguments
        self._signs = air.sign_ports
        self._logs = [directory / f"{index}.log" for index in (0, 1)]
        self.processes: list[subprocess.Popen[bytes] | None] = [None, None]

    def start(self, index: int, *arguments: str, role: str | None = None) -> subprocess.Popen[bytes]:
        """Start one; the first is to be the active one unless told."""
        environment = {
            "GCS_COLOC_MAVLINK__COMPONENT_ID": str(COMPONENT_IDS[index]),
            "GCS_COLOC_STANDBY__PEER": f"127.0.0.1:{self._signs[1 - index]}",
            "GCS_COLOC_STANDBY__LISTEN": f"127.0.0.1:{self._signs[index]}",
            "GCS_COLOC_STANDBY__ROLE": role if role is not None else ("active", "standby")[index],
        }
        command = ["env", *(f"{key}={value}" for key, value in environment.items()), sys.executable, "-m", "gcs_coloc"]
        command += ["--udp", f"127.0.0.1:{self._ports[index]}", *self._arguments, *arguments]
        with self._logs[index].open("ab") as log:
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log)
        self.processes[index] = process
        return process

    def end(self) -> list[str]:
        """Kill both, and return what each has logged in all its runs."""
        for process in self.processes:
            if process is not None:
                process.kill()
                process.wait()
        return [self.log(index) for index in (0, 1)]

    def log(self, index: int) -> str:
        """Return what one of them has logged so far, in all its runs."""
        return self._logs[index].read_text(encoding="utf-8") if self._logs[index].exists() else ""


def _four_ship() -> Scenario:
    with (SCENARIOS / "uwb.toml").open("rb") as file:
        table = tomllib.load(file)
    table["fault"] = []
    for vehicle in table["vehicle"]:
        vehicle["ranges_to"] = [1, 2, 3] if vehicle["sysid"] == DENIED else []
    return Scenario.model_validate(table)
