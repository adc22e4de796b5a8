"""A whole scenario in flight, without IO, stepped by simulated time.

It is deterministic for a scenario and a seed.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import count

import numpy as np

from sitl_fakes.commands import handle, status_text
from sitl_fakes.dynamics import turn_radius_m
from sitl_fakes.faults import Fault, LinkDropout
from sitl_fakes.flight import Flight, SharedState, VehicleTruth
from sitl_fakes.flight_controller import FlightController
from sitl_fakes.geodesy import Vector, WorldFrame
from sitl_fakes.guidance import Guidance, Route
from sitl_fakes.scenario import Scenario, ScenarioError, Telemetry
from sitl_fakes.scenario import Vehicle as VehicleSpec
from sitl_fakes.sensors import EPSILON_S, GpsSensor, Purpose, Ranger, stream

_HEARTBEAT_S = 1.0  # source: MAVLink's heartbeat protocol


class _RadioLink:
    """One direction of a link. Datagrams arrive when their own delay is over: a late one is overtaken."""

    def __init__(self, settings: Telemetry, rng: np.random.Generator) -> None:
        self._settings = settings
        self._rng = rng
        self._under_way: list[tuple[float, int, bytes]] = []
        self._numbers = count()

    def send(self, payload: bytes, at_s: float) -> None:
        """Send a datagram at a time (s); it is lost with the link's probability."""
        s = self._settings
        chance, jitter = self._rng.random(2).tolist()
        if chance >= s.loss:
            heapq.heappush(self._under_way, (at_s + s.latency_s + jitter * s.jitter_s, next(self._numbers), payload))

    def arrived(self, by_s: float) -> list[tuple[float, bytes]]:
        """Take out what arrives by a time (s): arrival time and datagram, in order."""
        out = []
        while self._under_way and self._under_way[0][0] <= by_s:
            due, _, payload = heapq.heappop(self._under_way)
            out.append((due, payload))
        return out


class Vehicle:
    """One vehicle of a fleet. `unix_epoch_s` is the UNIX time of the simulation's time zero."""

    def __init__(self, scenario: Scenario, spec: VehicleSpec, frame: WorldFrame, seed: int, unix_epoch_s: float) -> None:
        self.sysid = spec.sysid
        airspeed = spec.airspeed_mps or scenario.airspeed_mps
        self._route = Route(spec.waypoints, spec.end_of_route or scenario.end_of_route, scenario.hold_radius_m)
        self._guidance = Guidance(self._route, airspeed, scenario.waypoint_radius_m or turn_radius_m(airspeed))
        start = spec.waypoints[0]
        heading = self._route.track(0).track_heading_rad(start)
        self._flight = Flight(scenario, spec.sysid, frame, seed, start, heading, spec.height_m, airspeed)
        self._flight.standing = not spec.armed
        self._controller = FlightController(scenario, spec, frame, self._flight, self._guidance, seed, unix_epoch_s)
        self._gps = GpsSensor(scenario.gps, spec.sysid, seed)
        self._gps_due_s = 0.0
        self._ground_station_due_s = 0.0 if scenario.ground_station else math.inf
        self._ranger = Ranger(scenario.ranging, spec.sysid, scenario.ranging_peers(spec), seed)
        self._downlink = _RadioLink(scenario.telemetry, stream(seed, Purpose.DOWNLINK, spec.sysid))
        self._uplink = _RadioLink(scenario.telemetry, stream(seed, Purpose.UPLINK, spec.sysid))

    @property
    def position_m(self) -> Vector:
        """True position: east, north, up, m."""
        return self._flight.position_m

    @property
    def velocity_mps(self) -> Vector:
        """True velocity over ground: east, north, up, m/s."""
        return self._flight.velocity_mps

    def inject(self, fault: Fault) -> None:
        """Let a fault befall it."""
        self._controller.faults.add(fault)

    def receive(self, payload: bytes, at_s: float) -> None:
        """Put a datagram on the uplink at a time (s)."""
        if not _dead(self._controller.faults.active(at_s)):
            self._uplink.send(payload, at_s)

    def sent(self, by_s: float) -> list[tuple[float, bytes]]:
        """Take what has come down the link by a time (s): arrival time and datagram."""
        return self._downlink.arrived(by_s)

    def fly(self, at_s: float, step_s: float) -> None:
        """Fly the step that ends at `at_s`, or stand for as long as the vehicle is not armed."""
        heading_rad = self._controller.heading_command_rad(at_s, step_s)
        self._flight.standing = not self._controller.autopilot.armed
        if self._flight.standing:
            self._flight.wait(step_s)
        else:
            self._flight.step(heading_rad, step_s, self._controller.autopilot.height.error_m)

    def work(self, at_s: float, positions_m: Mapping[int, Vector]) -> None:
        """Sense, listen and speak at a time (s), given the true positions (m) of all vehicles."""
        controller = self._controller
        active = controller.faults.active(at_s)
        controller.run(active, at_s)
        if self._gps_due_s <= at_s + EPSILON_S:
            self._gps_due_s += self._gps.interval_s
            fix = self._gps.measure(self._flight.position_m, self._flight.velocity_mps, active, at_s)
            if not controller.booting:
                controller.autopilot.receive_own_fix(fix, at_s)
        samples = self._ranger.measure(at_s, self.position_m, positions_m, active)
        received = [payload for _, payload in self._uplink.arrived(at_s + EPSILON_S)]
        if controller.booting:
            return
        messages = [reply for payload in received for reply in handle(controller, payload, at_s)]
        messages += [text for severity, words in controller.autopilot.announcements() for text in status_text(words, severity)]
        messages += controller.streams.due(at_s, controller.snapshot)
        frames = [controller.pack(message) for message in messages]
        frames += [frame for sample in samples if (frame := controller.pack_range(sample, at_s)) is not None]
        if self._ground_station_due_s <= at_s + EPSILON_S:
            self._ground_station_due_s += _HEARTBEAT_S
            frames.append(controller.pack_forwarded())
        if not _dead(active):
            for frame in frames:
                self._downlink.send(frame, at_s)

    def truth(self, at_s: float) -> VehicleTruth:
        """Return what is really so, now."""
        s, autopilot = self._flight.state, self._controller.autopilot
        at = (s.east_m, s.north_m)
        believed = autopilot.believed(at_s)
        estimate = None if believed is None else believed[0]
        return VehicleTruth(
            at_s,
            self.sysid,
            *self._flight.position_m,
            *self._flight.velocity_mps,
            *self._flight.lla,
            roll_rad=s.phi_rad,
            heading_rad=s.psi_rad,
            leg=self._guidance.leg_index,
            cross_track_m=self._route.track(self._guidance.leg_index).cross_track_m(at),
            off_route_m=self._route.distance_m(at),
            estimate_east_m=None if estimate is None else estimate[0],
            estimate_north_m=None if estimate is None else estimate[1],
            source=autopilot.source(at_s),
            aid_refusal=autopilot.injected_refusal(at_s),
        )


def _dead(active: list[Fault]) -> bool:
    return any(isinstance(fault, LinkDropout) for fault in active)


STEP_S = 0.02
"""Time step of the simulation, s: the paper's computing cycle."""

_FIRST_OF_2026_S = 1_767_225_600.0  # UTC


@dataclass(frozen=True, slots=True)
class Datagram:
    """One UDP payload from a vehicle.

    `due_s` is the simulated time (s) at which it comes out of the vehicle's link.
    """

    sysid: int
    due_s: float
    payload: bytes


class Fleet:
    """The vehicles of a scenario that this process simulates.

    They are those of `sysids`, or all. Other processes may simulate the others; `add_shared_state` takes their states in.

    Time starts at 0 s; `unix_epoch_s` is the UNIX time of that moment.
    """

    def __init__(
        self, scenario: Scenario, seed: int, unix_epoch_s: float = _FIRST_OF_2026_S, sysids: Collection[int] | None = None
    ) -> None:
        o = scenario.origin
        self.scenario_name = scenario.name
        self.frame = WorldFrame(o.lat_deg, o.lon_deg, o.alt_msl_m, o.geoid_height_m)
        flown = [v for v in scenario.vehicle if sysids is None or v.sysid in sysids]
        self._vehicles = {v.sysid: Vehicle(scenario, v, self.frame, seed, unix_epoch_s) for v in flown}
        self._stations: dict[int, Vector] = {s.node: (s.east_m, s.north_m, s.height_m) for s in scenario.station}
        self._elsewhere: dict[int, SharedState] = {}
        self._steps_done = -1

    @property
    def sysids(self) -> list[int]:
        """System ids of the vehicles that fly here, in the scenario's order."""
        return list(self._vehicles)

    @property
    def now_s(self) -> float:
        """Simulated time of the last step done, s; 0 before the first."""
        return max(self._steps_done, 0) * STEP_S

    def advance(self, to_s: float) -> list[Datagram]:
        """Simulate up to a time (s) and return the datagrams that have come out by then.

        They are in order of time.
        """
        while (self._steps_done + 1) * STEP_S <= to_s + EPSILON_S:
            self._steps_done += 1
            at_s = self._steps_done * STEP_S
            if self._steps_done > 0:
                for vehicle in self._vehicles.values():
                    vehicle.fly(at_s, STEP_S)
            positions = self._positions_m(at_s)
            for vehicle in self._vehicles.values():
                vehicle.work(at_s, positions)
        out = [Datagram(sysid, due, data) for sysid, v in self._vehicles.items() for due, data in v.sent(to_s + EPSILON_S)]
        return sorted(out, key=lambda datagram: datagram.due_s)

    def _positions_m(self, at_s: float) -> dict[int, Vector]:
        elsewhere = {sysid: seen.position_at(at_s) for sysid, seen in self._elsewhere.items()}
        here = {sysid: vehicle.position_m for sysid, vehicle in self._vehicles.items()}
        return {sysid: position for sysid, position in elsewhere.items() if position is not None} | here | self._stations

    def add_shared_state(self, seen: SharedState) -> None:
        """Add the true state of a vehicle of another process, at a simulated time.

        After a second without one it is gone.
        """
        self._elsewhere[seen.sysid] = seen

    def shared_states(self) -> list[SharedState]:
        """Return where the vehicles that fly here truly are at `now_s`."""
        return [SharedState(sysid, self.now_s, v.position_m, v.velocity_mps) for sysid, v in self._vehicles.items()]

    def deliver(self, sysid: int, payload: bytes, at_s: float) -> None:
        """Send a datagram to one vehicle at a time (s).

        It goes through the vehicle's link and is read at the next step after.
        """
        self._vehicles[sysid].receive(payload, at_s)

    def truth(self) -> dict[int, VehicleTruth]:
        """Return what is really so about each vehicle at `now_s`, by system id."""
        return {sysid: vehicle.truth(self.now_s) for sysid, vehicle in self._vehicles.items()}

    def inject(self, fault: Fault) -> None:
        """Add a fault to the vehicle that it names. Raises `ScenarioError` where there is no such vehicle."""
        if fault.vehicle not in self._vehicles:
            raise ScenarioError(f"no vehicle {fault.vehicle} in this scenario")
        self._vehicles[fault.vehicle].inject(fault)
