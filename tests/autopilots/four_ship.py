"""Four real autopilots in flight with the service in the loop: missions, faults, ranges from the truth, and what became of it."""

from __future__ import annotations

import contextlib
import csv
import math
import random
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from pilot import Pilot, Place3D, distance_m
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from simulators import ORIGIN_ALT_M, ORIGIN_LAT_DEG, ORIGIN_LON_DEG, Place, Simulator, ardupilot

_METRES_PER_DEGREE = 111_177.0
"""Of latitude at 47.5 degrees: places a mission, judges nothing."""

STANDBY = "[aiding]\nstandby = true\nswitch_primary = 'auto'"
"""The service's configuration in these flights."""

_WANTED_HZ: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_SIM_STATE: 25.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 2.0,
}
_OLDEST_TRUTH_S = 0.08
"""No range is made of an older one: two intervals at 25 Hz. A simulator that stalled longer is not where it would have been."""

_CLIMBED_M = 70.0
_ON_THEIR_WAY_S = 50.0
_HOMES_M: Mapping[int, tuple[float, float]] = {1: (0.0, 650.0), 2: (600.0, -350.0), 3: (-600.0, -350.0), 4: (0.0, 0.0)}
"""East and north of each vehicle's home from the origin: a triangle of anchors round the denied one."""

HEIGHT_M: Mapping[int, float] = {1: 100.0, 2: 130.0, 3: 160.0, 4: 115.0}
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
    begin: Callable[[FourShip], None] = lambda _: None
    during: Callable[[FourShip, float], None] = lambda _flight, _since_s: None
    end: Callable[[FourShip], None] | None = None
    after_s: float = 0.0
    starts_in_flight: bool = False
    configuration: str = STANDBY
    parameters: Mapping[str, float] = field(default_factory=dict)
    seed: int = 1


def place(sysid: int, east_m: float = 0.0, north_m: float = 0.0) -> Place:
    """A point of a vehicle's mission, by its distance from its home."""
    east, north = _HOMES_M[sysid][0] + east_m, _HOMES_M[sysid][1] + north_m
    lon_m = _METRES_PER_DEGREE * math.cos(math.radians(ORIGIN_LAT_DEG))
    return Place(ORIGIN_LAT_DEG + north / _METRES_PER_DEGREE, ORIGIN_LON_DEG + east / lon_m)


def mission(sysid: int, half_east_m: float, half_north_m: float) -> list[tuple[int, int, Sequence[float], float, float, float]]:
    """Home, take-off, and round a rectangle for ever."""
    frame, height = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, HEIGHT_M[sysid]
    home = place(sysid)
    none = (0.0, 0.0, 0.0, 0.0)
    corners = [
        (half_east_m, half_north_m),
        (half_east_m, -half_north_m),
        (-half_east_m, -half_north_m),
        (-half_east_m, half_north_m),
    ]
    turn = [place(sysid, *corner) for corner in corners]
    return [
        (mavlink.MAV_CMD_NAV_WAYPOINT, 0, none, home.lat_deg, home.lon_deg, ORIGIN_ALT_M),
        (mavlink.MAV_CMD_NAV_TAKEOFF, frame, (15.0, 0.0, 0.0, 0.0), home.lat_deg, home.lon_deg, min(height, 50.0)),
        *((mavlink.MAV_CMD_NAV_WAYPOINT, frame, none, p.lat_deg, p.lon_deg, height) for p in turn),
        (mavlink.MAV_CMD_DO_JUMP, frame, (3.0, -1.0, 0.0, 0.0), 0.0, 0.0, 0.0),
    ]  # fmt: skip


def free_port() -> int:
    """A UDP port that is free now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Service:
    """`gcs-coloc` as its user starts it, and the GPS states that its metrics show, as they change."""

    def __init__(self, port: int, directory: Path, configuration: str) -> None:
        self.directory = directory
        self.log = directory / "service.log"
        self._web = free_port()
        self.states: list[tuple[float, int, str]] = []
        self._polled_s = 0.0
        file = directory / "gcs-coloc.toml"
        file.write_text(f'links = ["udpin:127.0.0.1:{port}"]\n{configuration}\n', encoding="utf-8")
        command = [sys.executable, "-m", "gcs_coloc", "--config", str(file), "--record", str(directory)]
        with self.log.open("ab") as log:
            self._process = subprocess.Popen([*command, "--web", f"127.0.0.1:{self._web}"], stdout=subprocess.DEVNULL, stderr=log)

    def poll(self) -> None:
        """Note GPS states that changed, four times a second at most."""
        now_s = time.time()
        if now_s - self._polled_s < 0.25:
            return
        self._polled_s = now_s
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self._web}/metrics", timeout=0.2) as answer:
                text = answer.read().decode()
        except OSError:
            return
        current = {sysid: state for _, sysid, state in self.states}
        for labels in re.findall(r"^gcs_coloc_vehicle_gps_state\{(.*)\} 1(?:\.0)?$", text, re.MULTILINE):
            named = dict(re.findall(r'(\w+)="([^"]*)"', labels))
            sysid, state = int(named["sysid"]), named["state"]
            if current.get(sysid) != state:
                self.states.append((now_s, sysid, state))

    def log_lines(self) -> int:
        """Lines of its log so far, without the one on each vehicle that comes every few seconds."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()
        return sum(": last heard " not in line for line in lines)

    def kill(self) -> None:
        """End it without a word."""
        self._process.kill()
        self._process.wait()

    def stop(self) -> None:
        """End it as Ctrl-C does, so that it closes its recording."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=10.0)
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    @property
    def recordings(self) -> list[Path]:
        """Its recordings, in order."""
        return sorted(self.directory.glob("*.tlog"))


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
        self.service = Service(self.port, self.directory, self.case.configuration)

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
            self._send_a_range(now_s)
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

    def _send_a_range(self, now_s: float) -> None:
        """Of one pair at a time, in turn, so that ranges are evenly spread."""
        pairs = [(a, b) for a in self.case.denied for b in self.pilots if a != b]
        self._range_due_s = max(self._range_due_s + 1.0 / (self.case.range_hz * len(pairs)), now_s)
        self._pair = (self._pair + 1) % len(pairs)
        a, b = pairs[self._pair]
        here, there = (self.now_at(n) for n in (a, b))
        if here is not None and there is not None:
            sigma = self.case.range_sigma_m
            self.pilots[a].send_range(b, distance_m(here, there) + self._random.gauss(0.0, sigma), sigma)

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
    pilots = {n: Pilot(n, pilot_port(n), truth_port(n), ("127.0.0.1", port) if ranges_direct else None) for n in _HOMES_M}
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


@dataclass(frozen=True)
class ArduPilotFlight:
    """How four vehicles of one kind fly a case: simulator's model, parameters, the number of AUTO, half the mission's sides."""

    model: str
    parameters: Mapping[str, float]
    auto_mode: int
    half_sides_m: tuple[float, float]
    announced_delay_s: float = 0.1
    """GPS2_DELAY_MS of the guide: what the service sends is judged for this age."""

    def fly(self, case: Case, program: Path, directory: Path) -> FourShip:
        """Missions up, armed, on their way, then the fault and what follows. Returns when all is over."""
        parameters = {**self.parameters, **case.parameters}
        if case.starts_in_flight:
            parameters["GPS2_TYPE"] = 0  # with 14 and no stream it does not arm

        def start(sysid: int, service_port: int, driver_port: int) -> Simulator:
            where = directory / f"vehicle{sysid}"
            return ardupilot(program, self.model, sysid, place(sysid), service_port, driver_port, where, parameters)

        with in_flight(case, directory, start) as ship:
            pilots = ship.pilots.values()
            ship.wait("heartbeats", lambda: all("HEARTBEAT" in p.latest for p in pilots), 60.0)
            for pilot in pilots:
                for message_id, rate_hz in _WANTED_HZ.items():
                    assert pilot.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e6 / rate_hz) == 0
                pilot.upload(mission(pilot.sysid, *self.half_sides_m))
            for pilot in pilots:
                self._arm(ship, pilot)
            ship.wait("climb", lambda: all(p.truth and p.truth[-1].alt_m > ORIGIN_ALT_M + _CLIMBED_M for p in pilots))
            ship.run(_ON_THEIR_WAY_S)
            if case.starts_in_flight:
                for pilot in pilots:
                    assert pilot.set_parameter("GPS2_TYPE", 14)
                ship.start_service()
            ship.befall()
        return ship

    def _arm(self, ship: FourShip, pilot: Pilot) -> None:
        ends_s = time.monotonic() + _READY_S
        while True:
            pilot.command(mavlink.MAV_CMD_DO_SET_MODE, 1, self.auto_mode)
            if pilot.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0:
                return
            if time.monotonic() > ends_s:
                raise TimeoutError(f"vehicle {pilot.sysid} does not arm: {[text for _, text in pilot.texts[-6:]]}")
            ship.run(2.0)
