"""Four real autopilots in flight with the service in the loop: faults, ranges from the truth, and what became of it."""

from __future__ import annotations

import contextlib
import csv
import math
import random
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from flown_place import HOMES_M
from pilot import Pilot, Place3D, distance_m
from service_process import Service
from simulators import Simulator

from bench.free_ports import free_port

STANDBY = "[aiding]\nstandby = true\nswitch_primary = 'auto'"
"""The service's configuration in these flights."""

_OLDEST_TRUTH_S = 0.08
"""No range is made of an older one: two intervals at 25 Hz. A simulator that stalled longer is not where it would have been."""

_READY_S = 150.0


@dataclass(frozen=True)
class Case:
    """One flight. Faults are functions of the flight and the seconds since the fault began."""

    name: str
    denied: tuple[int, ...] = (4,)
    duration_s: float = 180.0
    before_s: float = 40.0
    range_sigma_m: float = 1.0
    range_hz: float = 5.0
    range_bias_m: float = 0.0
    """Every range is longer by this."""
    range_wait_s: tuple[float, float] = (0.0, 0.0)
    """How long a range waits in the companion computer before it is sent, at least and at most."""
    no_ranges_s: tuple[float, float] = (math.inf, math.inf)
    """From when to when since the fault began nothing is ranged."""
    begin: Callable[[FourShip], None] = lambda _: None
    during: Callable[[FourShip, float], None] = lambda _flight, _since_s: None
    end: Callable[[FourShip], None] | None = None
    after_s: float = 0.0
    starts_in_flight: bool = False
    configuration: str = STANDBY
    parameters: Mapping[str, float] = field(default_factory=dict)
    seed: int = 1


class FourShip:
    """Four vehicles, each with its simulator and its pilot, and the service.

    `events` are what befell whom, `killed_s` when the service was killed, as UNIX times.
    """

    def __init__(
        self, case: Case, directory: Path, service_port: int, simulators: list[Simulator], pilots: dict[int, Pilot]
    ) -> None:
        self.case, self.directory, self.port = case, directory, service_port
        self.simulators, self.pilots = simulators, pilots
        self.events: list[tuple[float, int, str]] = []
        self.killed_s: list[float] = []
        self.service: Service | None = None
        self.log_lines = 0
        self.ready_s = self.begins_s = self.ends_s = math.inf
        self._random = random.Random(case.seed)
        self._range_due_s = 0.0
        self._waiting: list[tuple[float, Callable[[], None]]] = []
        self._pair = 0
        self._heartbeat_due_s = 0.0
        for pilot in pilots.values():
            pilot.while_waiting = lambda waiting=pilot: self._serve_others(waiting)  # type: ignore[misc]

    def _serve_others(self, waiting: Pilot) -> None:
        for pilot in self.pilots.values():
            if pilot is not waiting:
                pilot.receive()
        self.send_due()

    def start_service(self) -> None:
        """Start the service (again)."""
        before = self.service.states if self.service is not None else []
        self.service = Service(self.port, self.directory, self.case.configuration, before)

    def event(self, sysid: int, text: str) -> None:
        """Write down what befalls a vehicle now."""
        self.events.append((time.time(), sysid, text))

    def step(self) -> None:
        """Read what came, send what is due, for some milliseconds."""
        for pilot in self.pilots.values():
            pilot.receive()
        self.send_due()
        time.sleep(0.003)

    def send_due(self) -> None:
        """Send heartbeats and ranges that are due, and see what the service makes of it all."""
        now_s = time.monotonic()
        if now_s >= self._heartbeat_due_s:
            self._heartbeat_due_s = now_s + 1.0
            for pilot in self.pilots.values():
                pilot.heartbeat()
        if now_s >= self._range_due_s:
            self._measure_a_range(now_s)
        for due_s, send in [each for each in self._waiting if each[0] <= now_s]:
            self._waiting.remove((due_s, send))
            send()
        if self.service is not None:
            self.service.poll()
        for simulator in self.simulators:
            assert simulator.running, simulator.log.read_text(errors="replace")[-2000:]

    def run(self, seconds: float, each: Callable[[float], None] = lambda _: None) -> None:
        """Fly on for some seconds."""
        started_s = time.monotonic()
        while (since_s := time.monotonic() - started_s) < seconds:
            each(since_s)
            self.step()

    def wait(self, what: str, condition: Callable[[], bool], limit_s: float = _READY_S) -> None:
        """Fly until something is so. Raises TimeoutError with what the vehicles last said."""
        ends_s = time.monotonic() + limit_s
        while not condition():
            if time.monotonic() > ends_s:
                said = {n: [text for _, text in p.texts[-4:]] for n, p in self.pilots.items()}
                raise TimeoutError(f"{what}: not within {limit_s:g} s; the vehicles said {said}")
            self.step()

    def befall(self) -> None:
        """Fly the case: level, its fault, and what comes after it."""
        case = self.case
        self.run(case.before_s)
        assert self.service is not None
        lines_before = self.service.log_lines()
        self.begins_s = time.time()
        case.begin(self)
        self.run(case.duration_s, lambda since_s: case.during(self, since_s))
        self.ends_s = time.time()
        self.log_lines = self.service.log_lines() - lines_before
        if case.end is not None:
            case.end(self)
            self.run(case.after_s)

    def _measure_a_range(self, now_s: float) -> None:
        """Of one pair at a time, in turn, so that ranges are evenly spread."""
        pairs = [(a, b) for a in self.case.denied for b in self.pilots if a != b]
        self._range_due_s = max(self._range_due_s + 1.0 / (self.case.range_hz * len(pairs)), now_s)
        self._pair = (self._pair + 1) % len(pairs)
        a, b = pairs[self._pair]
        here, there = (self.now_at(n) for n in (a, b))
        is_silent = self.case.no_ranges_s[0] <= time.time() - self.begins_s < self.case.no_ranges_s[1]
        if here is not None and there is not None and not is_silent:
            sigma = self.case.range_sigma_m
            range_m = distance_m(here, there) + self.case.range_bias_m + self._random.gauss(0.0, sigma)
            send = partial(self.pilots[a].send_range, b, range_m, sigma, time.time())
            self._waiting.append((now_s + self._random.uniform(*self.case.range_wait_s), send))

    def now_at(self, sysid: int) -> Place3D | None:
        """Where a vehicle truly is now: its last true position, carried on by the difference of the last two."""
        truth, now_s = self.pilots[sysid].truth, time.time()
        if len(truth) < 6 or now_s - truth[-1].unix_s > _OLDEST_TRUTH_S:
            return None
        a, b = truth[-6], truth[-1]
        by = (now_s - b.unix_s) / max(b.unix_s - a.unix_s, 1e-3)
        lat, lon = b.lat_deg + by * (b.lat_deg - a.lat_deg), b.lon_deg + by * (b.lon_deg - a.lon_deg)
        return replace(b, unix_s=now_s, lat_deg=lat, lon_deg=lon, alt_m=b.alt_m + by * (b.alt_m - a.alt_m))

    def write(self) -> None:
        """Truth and events as CSV beside the recording, as `gcs-coloc replay --truth` reads them."""
        with (self.directory / "truth.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["unix_s", "sysid", "lat_deg", "lon_deg", "alt_msl_m"])
            rows = sorted((p.unix_s, n, p) for n, pilot in self.pilots.items() for p in pilot.truth[::2])
            writer.writerows([f"{t:.4f}", n, f"{p.lat_deg:.7f}", f"{p.lon_deg:.7f}", f"{p.alt_m:.3f}"] for t, n, p in rows)
        with (self.directory / "events.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([["unix_s", "sysid", "event"], *([f"{t:.3f}", n, e] for t, n, e in self.events)])


@contextlib.contextmanager
def in_flight(
    case: Case,
    directory: Path,
    start: Callable[[int, int, int], Simulator],
    *,
    service_port: int | None = None,
    pilot_port: Callable[[int], int] = lambda _sysid: free_port(),
    truth_port: Callable[[int], int | None] = lambda _sysid: None,
    ranges_direct: bool = False,
) -> Iterator[FourShip]:
    """Simulators and service; ended whatever happens. `start` starts one by system id, service's port and driver's port.

    `ranges_direct`: to the service itself, past an autopilot that forwards none.
    """
    directory.mkdir(parents=True, exist_ok=True)
    port = service_port or free_port()
    pilots = {n: Pilot(n, pilot_port(n), truth_port(n), ("127.0.0.1", port) if ranges_direct else None) for n in HOMES_M}
    simulators: list[Simulator] = []
    ship = FourShip(case, directory, port, simulators, pilots)
    try:
        if not case.starts_in_flight:
            ship.start_service()
            time.sleep(3.0)
        simulators += [start(n, port, pilots[n].port) for n in pilots]
        yield ship
    finally:
        for simulator in simulators:
            simulator.stop()
        if ship.service is not None:
            ship.service.stop()
        for pilot in pilots.values():
            pilot.close()
        ship.write()
