"""What observers see of the fleet at one instant: plain values, detached from the engine's own state."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class VehicleView:
    """One vehicle as the service sees it. Positions in degrees and metres above mean sea level; None where unknown.

    `claim_*` is what the vehicle says of itself, `lat_deg` ... what the service holds to be true. `sigma_h_m` is 1-sigma
    along the worst horizontal direction, `bound_95_m` the 95 % horizontal bound. `aid` says in words what is sent to it.
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
    unknown_because: str | None
    claim_lat_deg: float | None
    claim_lon_deg: float | None
    aid: str


@dataclass(frozen=True, slots=True)
class FleetView:
    """The whole fleet at one instant, with the counts of everything that was refused, by reason."""

    at_s: float
    estimator: str
    vehicles: tuple[VehicleView, ...]
    refused: dict[str, int]
