"""A whole scenario in flight, without IO, stepped by simulated time.

It is deterministic for a scenario and a seed.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from sitl_fakes.faults import Fault
from sitl_fakes.flight import SharedState, VehicleTruth
from sitl_fakes.geodesy import Vector, WorldFrame
from sitl_fakes.scenario import Scenario, ScenarioError
from sitl_fakes.vehicle import Vehicle

STEP_S = 0.02
"""Time step of the simulation, s: the paper's computing cycle."""

_FIRST_OF_2026_S = 1_767_225_600.0  # UTC
_EPSILON_S = 1e-9  # chosen: far below a step, far above rounding


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
        while (self._steps_done + 1) * STEP_S <= to_s + _EPSILON_S:
            self._steps_done += 1
            at_s = self._steps_done * STEP_S
            if self._steps_done > 0:
                for vehicle in self._vehicles.values():
                    vehicle.fly(at_s, STEP_S)
            positions = self._positions_m(at_s)
            for vehicle in self._vehicles.values():
                vehicle.work(at_s, positions)
        out = [Datagram(sysid, due, data) for sysid, v in self._vehicles.items() for due, data in v.sent(to_s + _EPSILON_S)]
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
