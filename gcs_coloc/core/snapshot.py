"""What observers see of the fleet at one instant: plain values, detached from the engine's own state."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Consistency:
    """Whether the innovations of a vehicle's ranges, its own and those to it, have the size that the estimator says.

    `nis_median` is the median of their normalised innovation squared over the last seconds, refused ones included, with the 95 %
    band of that median for independent innovations; of `ranges` in all, `refused` were not used.
    """

    nis_median: float
    band_low: float
    band_high: float
    ranges: int
    refused: int


@dataclass(frozen=True, slots=True)
class RangeSnapshot:
    """The newest range between two vehicles as the estimator saw it; `refused` says in words why it was not used."""

    from_sysid: int
    to_sysid: int
    age_s: float
    innovation_m: float
    sigma_m: float
    nis: float
    refused: str | None


@dataclass(frozen=True, slots=True)
class LinkSnapshot:
    """Frames of one vehicle since the start: received without copies, missing by their sequence numbers, and copies."""

    sysid: int
    received: int
    lost: int
    duplicates: int


@dataclass(frozen=True, slots=True)
class OutSnapshot:
    """The ground tools behind one connection string: how many can be sent to now, frames handed on to them, frames taken from
    them, how often what they were slow to take was dropped, and how often what they sent was refused, since the start.
    """

    name: str
    tools: int
    frames_sent: int
    frames_accepted: int
    dropped: int
    refused: int


# Not frozen, and yet nobody changes one: to make one of so many fields would take four times as long, many times a second.
@dataclass(slots=True)
class VehicleSnapshot:
    """One vehicle as the service sees it. Positions in degrees and metres above mean sea level; None where unknown.

    `lat_deg`, `lon_deg`, `alt_msl_m` are the service's estimate, `reported_*` is what the vehicle says of itself.
    `sigma_h_m` is 1-sigma along the worst horizontal direction, `sigma_v_m` that of the height, `bound_95_m` the 95 % horizontal
    bound. `no_estimate_reason` says why there is no estimate.
    `enu_m` and `velocity_enu_mps` are the estimate in the fleet's frame, `covariance_h_m2` its horizontal covariance (east-east,
    east-north, north-north). `yaw_rad` is the vehicle's own, from true north, clockwise.
    `aiding` says in words what is sent to it, `aiding_has_fix` whether that is a position, `fix_acknowledged` whether its
    receiver shows our fix, `inhibit_reason` why nothing can be sent to it. `gps_primary` says what the service does with its
    GPS_PRIMARY. `gps_override`, `aiding_override`, `primary_override` are the operator's decisions on these three.
    `delay_s` is how much longer its newest position was under way than the quickest of the last minute. `clock_method` is how its
    clock is known (TIMESYNC or one-way stamps), `clock_sigma_s` how well.
    """

    sysid: int
    age_s: float
    autopilot: str
    gps_state: str
    gps_reason: str
    lat_deg: float | None
    lon_deg: float | None
    alt_msl_m: float | None
    sigma_h_m: float | None
    bound_95_m: float | None
    hdop: float | None
    ranges_in_use: int
    no_estimate_reason: str | None
    reported_lat_deg: float | None
    reported_lon_deg: float | None
    aiding: str
    aiding_has_fix: bool = False
    fix_acknowledged: bool | None = None
    gps_primary: str | None = None
    inhibit_reason: str | None = None
    gps_override: str = "auto"
    aiding_override: str = "auto"
    primary_override: str = "auto"
    sigma_v_m: float | None = None
    enu_m: tuple[float, float, float] | None = None
    velocity_enu_mps: tuple[float, float, float] | None = None
    covariance_h_m2: tuple[float, float, float] | None = None
    reported_enu_m: tuple[float, float, float] | None = None
    yaw_rad: float | None = None
    fix_type: int | None = None
    satellites: int | None = None
    delay_s: float | None = None
    clock_method: str | None = None
    clock_sigma_s: float | None = None
    consistency: Consistency | None = None


@dataclass(frozen=True, slots=True)
class FleetSnapshot:
    """The whole fleet at one instant, with the counts of everything that was refused, by reason.

    `estimator_counts` is what the estimator made of its measurements, used ones among them. `ranges` and `links` are sorted
    by their system ids, `outs` are the ground tools. `utc_minus_service_s` turns `at_s` into UNIX time; None where the host
    does not know the time. `origin` is the fleet frame's: latitude and longitude in degrees, altitude in metres.
    """

    at_s: float
    estimator: str
    vehicles: tuple[VehicleSnapshot, ...]
    refused: dict[str, int]
    estimator_counts: dict[str, int]
    ranges: tuple[RangeSnapshot, ...] = ()
    links: tuple[LinkSnapshot, ...] = ()
    outs: tuple[OutSnapshot, ...] = ()
    utc_minus_service_s: float | None = None
    origin: tuple[float, float, float] | None = None
