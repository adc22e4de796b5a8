"""The scenario on real UDP sockets in real time: a thin layer of asyncio round `Fleet`.

Each vehicle has a socket of its own.

Aircraft of one scenario may fly in several processes: each then sends the true states of its aircraft by multicast. What a
ranging device measures depends on the truth at both ends, and an aircraft that flies on GPS_INPUT is nowhere to be computed
but in its own process.
"""

from __future__ import annotations

import asyncio
import contextlib
import csv
import json
import logging
import secrets
import signal
import socket
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TextIO

from sitl_fakes.fleet import Fleet
from sitl_fakes.flight import CSV_HEADER, SharedState, csv_row
from sitl_fakes.scenario import SocketError

_log = logging.getLogger(__name__)
_TICK_S = 0.01  # chosen: no finer than the fleet's step
_TRUTH_INTERVAL_S = 0.1  # chosen: as SIM_STATE is sent
_PROGRESS_INTERVAL_S = 5.0  # chosen: a line now and then
_MOST_WARNINGS = 20  # chosen: a screen of them
Address = tuple[str, int]


class TruthFile:
    """The truth as CSV, ten times a second of simulated time.

    Raises `OSError` where the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._file: TextIO = path.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file)
        self._writer.writerow([*CSV_HEADER, "unix_s"])

    def write(self, fleet: Fleet, started_unix_s: float) -> None:
        """Append one line per vehicle. `started_unix_s`: the UNIX time at which the simulated time was 0."""
        self._writer.writerows([*csv_row(truth), f"{started_unix_s + truth.at_s:.4f}"] for truth in fleet.truth().values())

    def close(self) -> None:
        """Write out what is pending and close."""
        self._file.close()


class _VehicleSocket(asyncio.DatagramProtocol):
    def __init__(self, deliver: Callable[[bytes], None]) -> None:
        self._deliver = deliver

    def datagram_received(self, data: bytes, addr: Any) -> None:  # noqa: ARG002 - asyncio's signature
        self._deliver(data)


async def run(
    fleet: Fleet,
    *,
    target: Address,
    duration_s: float,
    sysids: Collection[int] | None = None,
    port_base: int | None = None,
    truth: TruthFile | None = None,
    airspace: Address | None = None,
) -> None:
    """Fly for a duration (s) or until SIGINT or SIGTERM, in real time.

    All vehicles fly; those of `sysids` (default: all) have a socket, bound to `port_base` + sysid (default: any free port),
    from which they send to `target`. What any sender sends to that socket is theirs. Over the multicast group `airspace` the
    fleet receives the states of vehicles of other processes and sends its own. Raises `SocketError` where an address cannot be
    used.
    """
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    started, started_unix_s = loop.time(), time.time()

    def deliver_to(sysid: int) -> Callable[[bytes], None]:
        return lambda data: fleet.deliver(sysid, data, loop.time() - started)

    def see(seen: SharedState) -> None:
        fleet.add_shared_state(replace(seen, at_s=seen.at_s - started_unix_s))

    transports: dict[int, asyncio.DatagramTransport] = {}
    others: Airspace | None = None
    try:
        peer = await _resolve(target)
        if airspace is not None:
            others = Airspace(airspace, peer, fleet.scenario_name, fleet.sysids, see)
        for sysid in fleet.sysids:
            if sysids is None or sysid in sysids:
                local = (_any_address(peer), 0 if port_base is None else port_base + sysid)
                transports[sysid] = await _open(local, deliver_to(sysid))
        clock = _Pace(fleet, truth, started_unix_s)
        while not stop.is_set() and (elapsed := loop.time() - started) < duration_s:
            for sysid, payload in clock.advance(elapsed):
                if sysid in transports:
                    transports[sysid].sendto(payload, peer)
            if others is not None:
                others.send(replace(own, at_s=own.at_s + started_unix_s) for own in fleet.shared_states())
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(stop.wait(), _TICK_S)
    finally:
        for transport in transports.values():
            transport.close()
        if others is not None:
            others.close()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)


class _Pace:
    """Advances the fleet to a time, stopping on the way where truth or progress is due."""

    def __init__(self, fleet: Fleet, truth: TruthFile | None, started_unix_s: float) -> None:
        self._fleet = fleet
        self._started_unix_s = started_unix_s
        self._truth = truth
        self._truth_number = 0
        self._progress_due_s = 0.0

    def advance(self, to_s: float) -> list[tuple[int, bytes]]:
        out = []
        while (truth_s := self._truth_number * _TRUTH_INTERVAL_S) <= to_s:
            out += self._fleet.advance(truth_s)
            self._truth_number += 1
            if self._truth is not None:
                self._truth.write(self._fleet, self._started_unix_s)
        out += self._fleet.advance(to_s)
        if to_s >= self._progress_due_s:
            self._progress_due_s += _PROGRESS_INTERVAL_S
            vehicles = (f"{t.sysid} {t.source} {t.off_route_m:.0f} m off route" for t in self._fleet.truth().values())
            _log.info("t = %.0f s: %s", self._fleet.now_s, ", ".join(vehicles))
        return [(datagram.sysid, datagram.payload) for datagram in out]


async def _resolve(target: Address) -> Any:
    try:
        found = await asyncio.get_running_loop().getaddrinfo(*target, type=socket.SOCK_DGRAM)
    except OSError as error:
        raise SocketError(f"cannot find host {target[0]!r}: {error.strerror}") from error
    return found[0][4]


def _any_address(peer: Any) -> str:
    return "::" if len(peer) == 4 else "0.0.0.0"  # noqa: S104 - a vehicle answers on every interface, as SITL does


async def _open(local: Address, deliver: Callable[[bytes], None]) -> asyncio.DatagramTransport:
    try:
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(lambda: _VehicleSocket(deliver), local_addr=local)
    except OSError as error:
        raise SocketError(f"cannot use UDP port {local[1]}: {error.strerror}") from error
    return transport


class Airspace:
    """The multicast group that the processes of one scenario share, on the network that leads to `target`.

    `on_state` is called with the states of aircraft other than `ours`, with UNIX times as on the wire. Raises
    `SocketError` where the group cannot be joined.
    """

    def __init__(
        self,
        group: tuple[str, int],
        target: tuple[str, int],
        scenario: str,
        ours: Collection[int],
        on_state: Callable[[SharedState], None],
    ) -> None:
        self._group = group
        self._scenario = scenario
        self._ours = frozenset(ours)
        self._on_state = on_state
        self._process = secrets.token_hex(8)
        self._warned: set[str] = set()
        try:
            self._socket = _join(group, target)
        except OSError as error:
            raise SocketError(f"cannot join the multicast group {group[0]}:{group[1]}: {error.strerror or error}") from error
        asyncio.get_running_loop().add_reader(self._socket, self._read)

    def send(self, aircraft: Iterable[SharedState]) -> None:
        """Send the states of our aircraft, at UNIX times.

        A datagram that the network refuses is lost; newer ones follow.
        """
        for one in aircraft:
            text = json.dumps({"process": self._process, "scenario": self._scenario, **asdict(one)})
            try:
                self._socket.sendto(text.encode(), self._group)
            except OSError as error:
                _log.debug("not sent: %s", error)

    def close(self) -> None:
        """Leave the group."""
        asyncio.get_running_loop().remove_reader(self._socket)
        self._socket.close()

    def _read(self) -> None:
        payload, sender = self._socket.recvfrom(2048)
        try:
            fields = json.loads(payload)
            process, scenario = fields.pop("process"), fields.pop("scenario")
            state = SharedState(**fields)
        except (ValueError, TypeError, KeyError, AttributeError):
            self._warn_once(f"{sender[0]} speaks in the airspace, but not of simulated aircraft")
            return
        if process == self._process:
            return
        if scenario != self._scenario:
            self._warn_once(f"{sender[0]} flies another scenario, {scenario!r}, in the same airspace: it is not seen")
        elif state.sysid in self._ours:
            self._warn_once(f"vehicle {state.sysid} is flown by {sender[0]} as well")
        else:
            self._on_state(state)

    def _warn_once(self, text: str) -> None:
        if text not in self._warned and len(self._warned) < _MOST_WARNINGS:
            self._warned.add(text)
            _log.warning("%s", text)


def _join(group: tuple[str, int], target: tuple[str, int]) -> socket.socket:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(target[:2])
        interface = socket.inet_aton(probe.getsockname()[0])
    joined = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        joined.setblocking(False)
        joined.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # several processes of one machine share the port
        joined.bind(group)
        joined.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group[0]) + interface)
        joined.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
    except OSError:
        joined.close()
        raise
    return joined
