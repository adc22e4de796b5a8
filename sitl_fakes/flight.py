"""The physical side of one vehicle, and its truth for scoring and for other processes.

The physical side is wind, aircraft, height and air sensors.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields

import pydantic.dataclasses
from pydantic import ConfigDict

from sitl_fakes.dynamics import FlightState, LateralAircraft
from sitl_fakes.geodesy import Vector, WorldFrame
from sitl_fakes.scenario import Scenario, Wind
from sitl_fakes.sensors import AirData, AirSensors, GaussMarkov, Purpose, stream

_CLIMB_TIME_CONSTANT_S = 5.0  # chosen: a gentle climb
_CLIMB_LIMIT_MPS = 2.0  # chosen: a cruise climb of a small aircraft
_MAX_EXTRAPOLATION_S = 1.0


class LocalWind:
    """The wind at one aircraft: the scenario's steady wind and a slow change of its own."""

    def __init__(self, settings: Wind, sysid: int, seed: int) -> None:
        towards = math.radians(settings.from_deg + 180.0)
        self._steady = (settings.speed_mps * math.sin(towards), settings.speed_mps * math.cos(towards))
        rng = stream(seed, Purpose.WIND, sysid)
        self._change = GaussMarkov(rng, settings.variation_mps, settings.variation_time_s, 2)

    def advance(self, by_s: float) -> tuple[float, float]:
        """Move on by a step and return the wind, towards east and north, m/s."""
        east, north = self._change.advance(by_s)
        return self._steady[0] + east, self._steady[1] + north


class Flight:
    """One aircraft in the air at constant airspeed.

    It holds the altitude that its autopilot believes, and so drifts with the error of that. While `standing` it is on the ground
    and does not move.
    """

    def __init__(
        self,
        scenario: Scenario,
        sysid: int,
        frame: WorldFrame,
        seed: int,
        start_m: tuple[float, float],
        heading_rad: float,
        height_m: float,
        airspeed_mps: float,
    ) -> None:
        self._frame = frame
        self._aircraft = LateralAircraft(start_m[0], start_m[1], heading_rad, airspeed_mps)
        self._target_alt_m = scenario.origin.alt_msl_m + height_m
        self._up_m = self._target_alt_m - frame.to_lla(start_m[0], start_m[1], 0.0)[2]
        self._wind = LocalWind(scenario.wind, sysid, seed)
        self._wind_mps = self._wind.advance(0.0)
        self._sensors = AirSensors(scenario.dead_reckoning, sysid, seed)
        self.standing = False
        self.climb_mps = 0.0
        self.lla = frame.to_lla(*self.position_m)
        self.air = self._read(0.0)

    @property
    def state(self) -> FlightState:
        """True state of the aircraft."""
        return self._aircraft.state

    @property
    def position_m(self) -> Vector:
        """True position: east, north, up, m."""
        s = self._aircraft.state
        return s.east_m, s.north_m, self._up_m

    @property
    def velocity_mps(self) -> Vector:
        """True velocity over ground: east, north, up, m/s."""
        if self.standing:
            return 0.0, 0.0, 0.0
        s, v = self._aircraft.state, self._aircraft.airspeed_mps
        course = s.psi_rad + s.beta_rad
        return v * math.sin(course) + self._wind_mps[0], v * math.cos(course) + self._wind_mps[1], self.climb_mps

    def wait(self, step_s: float) -> None:
        """Stand still on the ground for a step."""
        self.air = self._read(step_s)

    def step(self, heading_cmd_rad: float, step_s: float, height_error_m: float = 0.0) -> None:
        """Fly one step towards a heading of the autopilot's own compass.

        The compass has an error; the autopilot's height has one, too.
        """
        self._wind_mps = self._wind.advance(step_s)
        self._aircraft.step(heading_cmd_rad - self._sensors.heading_error_rad, step_s, *self._wind_mps)
        too_low_m = self._target_alt_m - self.air.altitude_m - height_error_m
        self.climb_mps = max(-_CLIMB_LIMIT_MPS, min(_CLIMB_LIMIT_MPS, too_low_m / _CLIMB_TIME_CONSTANT_S))
        self._up_m += self.climb_mps * step_s
        self.lla = self._frame.to_lla(*self.position_m)
        self.air = self._read(step_s)

    def _read(self, step_s: float) -> AirData:
        s = self._aircraft.state
        airspeed_mps, climb_mps = (0.0, 0.0) if self.standing else (self._aircraft.airspeed_mps, self.climb_mps)
        return self._sensors.measure(airspeed_mps, s.phi_rad, s.psi_rad, self.lla[2], climb_mps, step_s)


@dataclass(frozen=True, slots=True)
class VehicleTruth:
    """The true state of one vehicle.

    Position is east, north, up (m), and latitude, longitude (degrees) and altitude above mean sea level (m). Velocity is in m/s,
    attitude in rad.

    `cross_track_m` is the true distance left of the track it is flying, `off_route_m` the least distance to its whole
    route. `estimate_east_m`, `estimate_north_m` are the autopilot's position estimate (None before a first fix), `source`
    is its position source, and `aid_refusal` the reason why the injected receiver is not used (None where it is usable).
    """

    at_s: float
    sysid: int
    east_m: float
    north_m: float
    up_m: float
    ve_mps: float
    vn_mps: float
    vu_mps: float
    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    roll_rad: float
    heading_rad: float
    leg: int
    cross_track_m: float
    off_route_m: float
    estimate_east_m: float | None
    estimate_north_m: float | None
    source: str
    aid_refusal: str | None


CSV_HEADER = [f.name for f in fields(VehicleTruth)]
"""Columns of the truth file: the fields of `VehicleTruth`, in order."""


def csv_row(truth: VehicleTruth) -> list[str]:
    """Return a vehicle's line of the truth file.

    Degrees have eight decimals, all other numbers four. None is empty.
    """
    return [_cell(name, value) for name, value in asdict(truth).items()]


def _cell(name: str, value: float | int | str | None) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.8f}" if name in ("lat_deg", "lon_deg") else f"{value:.4f}"
    return str(value)


@pydantic.dataclasses.dataclass(frozen=True, config=ConfigDict(allow_inf_nan=False))
class SharedState:
    """The true state of an aircraft that another process simulates.

    Time (s), position (east, north, up, m), velocity (m/s).
    """

    sysid: int
    at_s: float
    position_m: Vector
    velocity_mps: Vector

    def position_at(self, at_s: float) -> Vector | None:
        """Position (m) at another time (s), extrapolated at constant velocity; None beyond one second."""
        dt = at_s - self.at_s
        if abs(dt) > _MAX_EXTRAPOLATION_S:
            return None
        (e, n, u), (ve, vn, vu) = self.position_m, self.velocity_mps
        return e + ve * dt, n + vn * dt, u + vu * dt
