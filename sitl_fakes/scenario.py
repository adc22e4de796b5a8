"""Scenario files: TOML, checked as a whole.

An unknown key or an impossible value is refused with the file and the key's name.
"""

from __future__ import annotations

import tomllib
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from sitl_fakes.faults import AnyFault
from sitl_fakes.guidance import EndOfRoute
from sitl_fakes.parameters import DEFAULTS, Kind


class FakesError(Exception):
    """Root of all deliberate errors of the fakes."""

    exit_code = 1


class ScenarioError(FakesError):
    """A scenario that is missing, malformed, or holds an unknown key or an impossible value."""

    exit_code = 2


class SocketError(FakesError):
    """An address that cannot be used."""


SystemId = Annotated[int, Field(ge=1, le=254)]
_Share = Annotated[float, Field(ge=0.0, le=1.0)]
_NotNegative = Annotated[float, Field(ge=0.0)]
_Positive = Annotated[float, Field(gt=0.0)]
_Rate = Annotated[float, Field(gt=0.0, le=50.0)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Origin(_Table):
    """Where the scene lies: the point that waypoints are measured from.

    `geoid_height_m` is the height of mean sea level above the ellipsoid there.
    """

    lat_deg: float = Field(ge=-85.0, le=85.0)
    lon_deg: float = Field(ge=-180.0, le=180.0)
    alt_msl_m: float = 0.0
    geoid_height_m: float = 0.0


class Wind(_Table):
    """Steady wind and its slow local changes.

    `from_deg` is where the wind comes from, as meteorologists say. The changes are a Gauss-Markov process per axis.
    """

    speed_mps: _NotNegative = 0.0
    from_deg: float = 0.0
    variation_mps: _NotNegative = 0.0
    variation_time_s: _Positive = 120.0


class Gps(_Table):
    """The vehicles' own receivers.

    Sigmas are per axis. A `correlation_time_s` of 0 makes the position noise white.

    `h_acc`, `v_acc` and `vel_acc` of GPS_RAW_INT state these sigmas.
    """

    rate_hz: _Rate = 5.0
    sigma_h_m: _Positive = 1.5
    sigma_v_m: _Positive = 3.0
    sigma_velocity_mps: _Positive = 0.3
    correlation_time_s: _NotNegative = 60.0
    satellites: int = Field(default=10, ge=4, le=30)
    hdop: _Positive = 1.21
    fix_type: int = Field(default=6, ge=3, le=6)


class Ranging(_Table):
    """The ranging devices: their rate, errors, losses and message.

    The rate is per peer. A bias is drawn once per pair. Outliers are always too long.

    With `companion_link` the companion computers that they are wired to have a link of their own to the ground; else their
    messages pass through the autopilots, as far as these forward them.
    """

    rate_hz: _Rate = 10.0
    sigma_m: _Positive = 0.5
    stated_sigma_m: _NotNegative | None = None
    bias_sigma_m: _NotNegative = 0.0
    outlier_share: _Share = 0.0
    outlier_min_m: _NotNegative = 2.0
    outlier_max_m: _NotNegative = 20.0
    loss: _Share = 0.0
    max_range_m: _Positive = 100_000.0
    message: Literal["peer_range", "ranging_beacon", "debug_vect", "named_value"] = "peer_range"
    time_base: Literal["boot", "unix"] = "boot"
    companion_link: bool = False

    @model_validator(mode="after")
    def _outliers_in_order(self) -> Self:
        if self.outlier_max_m < self.outlier_min_m:
            raise ValueError("outlier_max_m must not be below outlier_min_m")
        return self


class Telemetry(_Table):
    """Each vehicle's radio link, both ways: delay and loss.

    `latency_s` is a fixed delay. `jitter_s` bounds a random extra delay (uniform), so that datagrams overtake.
    """

    latency_s: _NotNegative = 0.0
    jitter_s: _NotNegative = 0.0
    loss: _Share = 0.0


class DeadReckoning(_Table):
    """What spoils an autopilot's dead reckoning; the values are standard deviations.

    Errors of heading and airspeed stay (bias and scale, drawn once per vehicle), wander (Gauss-Markov) or are white. Airspeed
    errors that stay or wander are shares of the airspeed. `baro_sigma_m` is the altimeter's slow error.
    """

    heading_bias_deg: _NotNegative = 1.2
    airspeed_scale: _NotNegative = 0.02
    heading_wander_deg: _NotNegative = 1.0
    airspeed_wander: _NotNegative = 0.015
    wander_time_s: _Positive = 30.0
    heading_noise_deg: _NotNegative = 0.5
    airspeed_noise_mps: _NotNegative = 0.3
    baro_sigma_m: _NotNegative = 0.5


class Vehicle(_Table):
    """One aircraft and the route that it flies.

    Waypoints are [east, north] in metres from the origin. It starts at the first, along the first leg.

    One that is not `armed` stands there until it is armed by command.
    """

    sysid: SystemId
    waypoints: list[tuple[float, float]] = Field(min_length=2)
    height_m: float = 100.0
    airspeed_mps: Annotated[float, Field(ge=12.0, le=60.0)] | None = None
    end_of_route: EndOfRoute | None = None
    boot_offset_s: _NotNegative | None = None
    clock_drift_ppm: float | None = None
    ranges_to: list[SystemId] | None = None
    ranges_to_stations: list[int] | None = None
    autopilot: Kind = "ardupilot"
    armed: bool = True
    params: dict[str, float] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _goes_somewhere(self) -> Self:
        for a, b in pairwise(self.waypoints):
            if a == b:
                raise ValueError(f"two successive waypoints are equal: {list(a)}")
        known = DEFAULTS[self.autopilot]
        for name in self.params:
            if name not in known:
                raise ValueError(f"no such parameter: {name} (known: {', '.join(known)})")
        return self


STATION_NODES_FROM = 100_000
"""Ranging devices are numbered: vehicles by their system ids, stations by their ids beyond this."""


class Station(_Table):
    """One fixed station that vehicles range.

    It stands `east_m` and `north_m` from the origin. Its `id` is a number among stations, not a system id.
    """

    id: int = Field(ge=0, le=65_535)
    east_m: float
    north_m: float
    height_m: float = 0.0

    @property
    def node(self) -> int:
        """Its number as a ranging device."""
        return STATION_NODES_FROM + self.id


class Scenario(_Table):
    """A whole scenario. Vehicles that set no `airspeed_mps` or `end_of_route` take the scenario's.

    `alert_limit_m` is what the operator of these aircraft sets in the service (`[aiding]`); the aircraft do not use it.
    `global_position` decides what a vehicle with GPS reports in GLOBAL_POSITION_INT: "filtered", its autopilot's estimate, or
    "raw", its receiver's fix as it is. A vehicle without `ranges_to` ranges to all others if a fault of its own GPS is
    planned, else to nobody; so it is with `ranges_to_stations` and all stations.
    `truth_messages` sends SIMSTATE and SIM_STATE from the start. With `ground_station` a second one (system id 255) is on
    another port of every vehicle, and its heartbeats are forwarded.
    """

    name: str
    description: str = ""
    duration_s: _Positive = 360.0
    airspeed_mps: float = Field(default=22.0, ge=12.0, le=60.0)
    end_of_route: EndOfRoute = EndOfRoute.STRAIGHT
    hold_radius_m: _Positive = 400.0
    waypoint_radius_m: _Positive | None = None
    global_position: Literal["raw", "filtered"] = "filtered"
    alert_limit_m: float = Field(50.0, gt=0.0)
    truth_messages: bool = False
    ground_station: bool = False
    origin: Origin
    wind: Wind = Wind()
    gps: Gps = Gps()
    ranging: Ranging = Ranging()
    telemetry: Telemetry = Telemetry()
    dead_reckoning: DeadReckoning = DeadReckoning()
    vehicle: list[Vehicle] = Field(min_length=1)
    station: list[Station] = Field(default_factory=list)
    fault: list[AnyFault] = Field(default_factory=list)

    @model_validator(mode="after")
    def _names_existing_vehicles(self) -> Self:
        ids = [v.sysid for v in self.vehicle]
        if len(set(ids)) != len(ids):
            raise ValueError("two vehicles have the same sysid")
        for v in self.vehicle:
            for peer in v.ranges_to or []:
                if peer not in ids or peer == v.sysid:
                    raise ValueError(f"vehicle {v.sysid} cannot range to {peer}: no such other vehicle")
        stations = [s.id for s in self.station]
        if len(set(stations)) != len(stations):
            raise ValueError("two stations have the same id")
        for v in self.vehicle:
            for station in v.ranges_to_stations or []:
                if station not in stations:
                    raise ValueError(f"vehicle {v.sysid} cannot range to station {station}: no such station")
        for f in self.fault:
            if f.vehicle not in ids:
                raise ValueError(f"fault {f.kind!r} names vehicle {f.vehicle}, which does not exist")
        return self

    def ranging_peers(self, vehicle: Vehicle) -> list[int]:
        """The numbers of the ranging devices that a vehicle ranges to: vehicles, then stations."""
        loses_gps = any(f.vehicle == vehicle.sysid and f.kind.startswith("gps_") for f in self.fault)
        others = [v.sysid for v in self.vehicle if v.sysid != vehicle.sysid] if loses_gps else []
        stations = [s.id for s in self.station] if loses_gps else []
        vehicles = vehicle.ranges_to if vehicle.ranges_to is not None else others
        wanted = vehicle.ranges_to_stations if vehicle.ranges_to_stations is not None else stations
        return [*vehicles, *(STATION_NODES_FROM + station for station in wanted)]


SCENARIOS = Path(__file__).with_name("scenarios")
"""The scenarios that come with the program, NAME.toml each."""


def shipped_scenarios() -> dict[str, str]:
    """Name and description of each scenario that comes with the program."""
    return {file.stem: load_scenario(file).description for file in sorted(SCENARIOS.glob("*.toml"))}


def load_scenario(path: str | Path) -> Scenario:
    """Read and check a scenario: a file, or by its name one that comes with the program.

    Raises `ScenarioError`, one line naming the file and the first few keys at fault.
    """
    shipped = SCENARIOS / f"{path}.toml"
    if Path(path).name == str(path) and shipped.is_file():
        path = shipped
    try:
        with Path(path).open("rb") as file:
            table = tomllib.load(file)
    except FileNotFoundError as error:
        raise ScenarioError(f"{path}: no such file, and no scenario of that name; see sitl-fakes --list") from error
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # no TOML, no UTF-8, or a number of thousands of digits
        raise ScenarioError(f"{path}: not valid TOML: {error}") from error
    try:
        return Scenario.model_validate(table)
    except ValidationError as error:
        found = error.errors()
        said = [
            f"{'.'.join(str(p) for p in e['loc']) or 'scenario'}: {e['msg'].removeprefix('Value error, ')}" for e in found[:3]
        ]
        more = f" (and {len(found) - 3} more)" if len(found) > 3 else ""
        raise ScenarioError(f"{path}: {'; '.join(said)}{more}") from error
