"""True states: the truth about a vehicle for scoring, and what the processes of one airspace send each other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from sitl_fakes.geodesy import Vector


@dataclass(frozen=True, slots=True)
class VehicleTruth:
    """The true state of one vehicle: position (east, north, up m; deg, m above mean sea level), velocity (m/s), attitude
    (rad).

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
    """Return the line of the truth file: degrees to 1e-8, all other numbers to a millimetre or a milliradian and finer; None
    is empty.
    """
    return [_cell(name, value) for name, value in asdict(truth).items()]


def _cell(name: str, value: float | int | str | None) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.8f}" if name in ("lat_deg", "lon_deg") else f"{value:.4f}"
    return str(value)


_MAX_EXTRAPOLATION_S = 1.0


@dataclass(frozen=True, slots=True)
class SharedState:
    """The true state of an aircraft that another process simulates: time (s), position (east, north, up, m), velocity (m/s)."""

    sysid: int
    at_s: float
    position_m: Vector
    velocity_mps: Vector

    @classmethod
    def from_json(cls, fields_by_name: Mapping[str, Any]) -> SharedState:
        """From the fields by name. Raises `ValueError`, `TypeError` or `KeyError` where they are not what they should be."""
        (e, n, u), (ve, vn, vu) = fields_by_name["position_m"], fields_by_name["velocity_mps"]
        if not all(math.isfinite(x) for x in (fields_by_name["at_s"], e, n, u, ve, vn, vu)):
            raise ValueError("not finite")
        return cls(int(fields_by_name["sysid"]), fields_by_name["at_s"], (e, n, u), (ve, vn, vu))

    def position_at(self, at_s: float) -> Vector | None:
        """Position (m) at another time (s), extrapolated at constant velocity; None beyond one second."""
        dt = at_s - self.at_s
        if abs(dt) > _MAX_EXTRAPOLATION_S:
            return None
        (e, n, u), (ve, vn, vu) = self.position_m, self.velocity_mps
        return e + ve * dt, n + vn * dt, u + vu * dt
