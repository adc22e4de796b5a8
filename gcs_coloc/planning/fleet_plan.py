"""Plan of a fleet: vehicles and their motion, stations, and what is assumed of the devices.

The devices are the receivers, altimeters and ranging devices.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.integrity.protection_level import ProtectionSettings
from gcs_coloc.core.measurements import AttitudeMeasurement, FloatArray, Vector3, VehicleClass
from gcs_coloc.core.setting_bounds import between, check_bounds, positive
from gcs_coloc.core.stations.node_id import station_node
from gcs_coloc.core.stations.stations import STATION_SIGMA_M
from gcs_coloc.planning.flight_path import FlightPath, Leg, fly_legs

_ATTITUDE_EVERY_S = 0.45
"""Chosen: below the half second for which the filter takes an attitude as fresh."""


@dataclass(frozen=True, slots=True)
class PlannedVehicle:
    """One vehicle: its system id, where it is flown from and to, and when.

    `begin_enu_m` is where its way begins, at `start_s` on the plan's clock; each leg ends at a waypoint. Before it starts and
    after the end of its way it takes no part. `end_s` cuts its way, None: it flies all of it.
    """

    sysid: int
    name: str
    begin_enu_m: Vector3
    legs: tuple[Leg, ...]
    start_s: float = 0.0
    vehicle_class: VehicleClass = VehicleClass.PLANE
    end_s: float | None = None

    def path(self) -> FlightPath:
        """Return its flight along the way."""
        return fly_legs(self.begin_enu_m, self.legs, self.start_s, self.vehicle_class, self.end_s)


@dataclass(frozen=True, slots=True)
class PlannedStation:
    """One fixed station: where it stands, m in the plan's frame, and how well that is known.

    `sigma_m` is the 1-sigma per axis, as in flight.
    """

    station_id: int
    position_enu_m: Vector3
    sigma_m: float = STATION_SIGMA_M

    @property
    def node(self) -> int:
        """Its node id."""
        return station_node(self.station_id)


@dataclass(frozen=True, slots=True)
class PlanAssumptions:
    """What receivers, altimeters and ranging devices are assumed to do, and what the operator asks.

    Raises:
        ValueError: a value is out of its bounds; the text names it.
    """

    range_sigma_m: float = positive(0.5)
    """1-sigma of a range, m, new in each. Chosen: ultra-wideband outdoors."""
    range_rate_hz: float = between(5.0, 0.2, 100.0)
    """Ranges per second of each pair. Chosen: a ranging device that serves eight peers."""
    max_range_m: float = positive(5000.0)
    """Beyond it there is no range, m. Chosen: radios that range over kilometres; ultra-wideband reaches some hundred metres."""
    position_sigma_m: float = positive(1.5)
    """1-sigma per axis of a healthy vehicle's position, m. Source: a receiver in the open; its vertical one is 1.6 times that."""
    position_white_share: float = between(0.0, 0.0, 1.0)
    """Share of that sigma that is new in each report; the rest lasts for minutes. Chosen: a navigation filter's output drifts."""
    position_rate_hz: float = between(5.0, 0.2, 50.0)
    """Position reports per second of each vehicle. Chosen: ArduPilot's usual rate to a ground station."""
    velocity_sigma_mps: float = positive(0.3)
    """1-sigma per axis of a reported velocity, m/s. Source: Doppler of a usual receiver."""
    height_sigma_m: float = positive(2.0)
    """1-sigma of a barometric height, m, which lasts for minutes. Chosen: pressure of the day, set before the flight."""
    has_air_data: bool = True
    """Whether planes send attitude and airspeed while their GPS has failed. Source: ArduPlane's and PX4's usual streams."""
    delay_is_known: bool = True
    """Whether TIMESYNC or UTC shows the delay of every link."""
    alert_limit_m: float = positive(50.0)
    """No fix is stated while the horizontal protection level exceeds this, m: `alert_limit_m` of `[aiding]`."""

    def __post_init__(self) -> None:
        check_bounds(self)

    @property
    def aiding(self) -> AidingSettings:
        """The settings by which the service decides on a fix."""
        return AidingSettings(alert_limit_m=self.alert_limit_m)

    @property
    def protection(self) -> ProtectionSettings:
        """The settings of the protection level."""
        return ProtectionSettings()


@dataclass(frozen=True)
class FleetPlan:
    """A whole plan: its vehicles, stations and assumptions.

    `frame` is where its metres are counted from. `remarks` are lines on what was skipped or assumed.
    """

    frame: LocalFrame
    vehicles: tuple[PlannedVehicle, ...]
    stations: tuple[PlannedStation, ...] = ()
    assumptions: PlanAssumptions = field(default_factory=PlanAssumptions)
    remarks: tuple[str, ...] = ()

    @cached_property
    def paths(self) -> dict[int, FlightPath]:
        """The flight of each vehicle, by system id."""
        return {vehicle.sysid: vehicle.path() for vehicle in self.vehicles}

    @property
    def span_s(self) -> tuple[float, float]:
        """When the first vehicle starts and the last one ends."""
        return min(path.begin_s for path in self.paths.values()), max(path.end_s for path in self.paths.values())

    def positions(self, at_s: float) -> dict[int, FloatArray]:
        """Return the position (3,) of each vehicle in flight at a time, m."""
        return {sysid: path.position(at_s) for sysid, path in self.paths.items() if path.is_flying(at_s)}

    def vehicle(self, sysid: int) -> PlannedVehicle:
        """Return one vehicle."""
        return next(each for each in self.vehicles if each.sysid == sysid)

    def with_vehicle(self, changed: PlannedVehicle) -> FleetPlan:
        """Return the plan with one vehicle changed; the ways of the others are not flown again."""
        vehicles = tuple(changed if each.sysid == changed.sysid else each for each in self.vehicles)
        plan = replace(self, vehicles=vehicles)
        plan.__dict__["paths"] = {**self.paths, changed.sysid: changed.path()}
        return plan

    def with_station(self, station: PlannedStation) -> FleetPlan:
        """Return the plan with one more station."""
        plan = replace(self, stations=(*self.stations, station))
        plan.__dict__["paths"] = self.paths
        return plan


class PlannedMotion:
    """Positions and velocities of a plan's vehicles at times (N,), s, read once for all steps.

    The times are at even steps; each is stated by its index.
    """

    def __init__(self, plan: FleetPlan, times_s: FloatArray) -> None:
        self._sysids = list(plan.paths)
        at = [path.at(times_s) for path in plan.paths.values()]
        self._positions_m = np.stack([motion.positions_m for motion in at], axis=1)
        self._velocities_mps = np.stack([motion.velocities_mps for motion in at], axis=1)
        self._is_flying = np.stack([(path.begin_s <= times_s) & (times_s <= path.end_s) for path in plan.paths.values()], axis=1)

    def in_flight(self, k: int) -> tuple[dict[int, Vector3], dict[int, Vector3]]:
        """Return the positions, m, and the velocities, m/s, of the vehicles in flight."""
        flying = np.flatnonzero(self._is_flying[k]).tolist()
        places, velocities = self._positions_m[k, flying].tolist(), self._velocities_mps[k, flying].tolist()
        sysids = [self._sysids[i] for i in flying]
        return dict(zip(sysids, map(_vector, places), strict=True)), dict(zip(sysids, map(_vector, velocities), strict=True))


def planned_attitudes(plan: FleetPlan, sysid: int, times_s: FloatArray, step_s: float) -> list[list[AttitudeMeasurement]]:
    """Return the attitudes with airspeed that a vehicle measures before each time, oldest first.

    Those of a time are measured within the step that ends then.
    """
    path = plan.paths[sysid]
    count = math.ceil(step_s / _ATTITUDE_EVERY_S)
    before_s = step_s * np.arange(count - 1, -1, -1) / count
    then_s = (times_s[:, None] - before_s).ravel()
    motion = path.at(then_s)
    ve, vn, vu = motion.velocities_mps.T
    speed = np.hypot(ve, vn)
    angles = np.column_stack([motion.bank_rad, np.arctan2(vu, np.maximum(speed, 0.1)), np.arctan2(ve, vn), speed])
    rows = zip(then_s.tolist(), angles.tolist(), (then_s >= path.begin_s).tolist(), strict=True)
    measured = [AttitudeMeasurement(sysid, t, t, *row) if is_flying else None for t, row, is_flying in rows]
    return [[m for m in measured[k : k + count] if m is not None] for k in range(0, len(measured), count)]


def _vector(row: Sequence[float]) -> Vector3:
    e, n, u = row
    return e, n, u
