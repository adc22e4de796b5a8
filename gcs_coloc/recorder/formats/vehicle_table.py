"""A flight as a table of its vehicles: the columns that CSV and Parquet share.

The table has a row for each vehicle in each snapshot of the fleet.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import hypot
from typing import Protocol

from gcs_coloc.core.snapshot import FleetSnapshot, VehicleSnapshot

Cell = float | int | bool | str | None


class VehicleTable(Protocol):
    """A table that grows with the flight, in order of time and system id."""

    def add(self, fleet: FleetSnapshot) -> None:
        """Add a row for each vehicle of a snapshot; its time is UNIX seconds."""

    def close(self) -> None:
        """Write what is left, and close the file."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column; `digits` are those behind the point in a text, `kind` the type of its values."""

    name: str
    kind: type[float] | type[int] | type[bool] | type[str]
    value: Callable[[VehicleSnapshot], Cell]
    digits: int = 0


def _off_m(v: VehicleSnapshot) -> float | None:
    """Horizontal distance of the reported position from the estimate, m."""
    if v.enu_m is None or v.reported_enu_m is None:
        return None
    return hypot(v.reported_enu_m[0] - v.enu_m[0], v.reported_enu_m[1] - v.enu_m[1])


def _part(values: Sequence[float] | None, place: int) -> float | None:
    return values[place] if values is not None else None


COLUMNS: tuple[Column, ...] = (
    Column("sysid", int, lambda v: v.sysid),
    Column("lat_deg", float, lambda v: v.lat_deg, 8),
    Column("lon_deg", float, lambda v: v.lon_deg, 8),
    Column("alt_msl_m", float, lambda v: v.alt_msl_m, 3),
    Column("sigma_h_m", float, lambda v: v.sigma_h_m, 3),
    Column("bound_95_m", float, lambda v: v.bound_95_m, 3),
    Column("hpl_m", float, lambda v: v.hpl_m, 3),
    Column("vpl_m", float, lambda v: v.vpl_m, 3),
    Column("hdop", float, lambda v: v.hdop, 3),
    Column("nis", float, lambda v: v.consistency.nis_median if v.consistency is not None else None, 4),
    Column("ranges_in_use", int, lambda v: v.ranges_in_use),
    Column("gps_state", str, lambda v: v.gps_state),
    Column("aiding_has_fix", bool, lambda v: v.aiding_has_fix),
    Column("no_estimate_reason", str, lambda v: v.no_estimate_reason),
    Column("sigma_v_m", float, lambda v: v.sigma_v_m, 3),
    Column("ve_mps", float, lambda v: _part(v.velocity_enu_mps, 0), 3),
    Column("vn_mps", float, lambda v: _part(v.velocity_enu_mps, 1), 3),
    Column("vu_mps", float, lambda v: _part(v.velocity_enu_mps, 2), 3),
    Column("var_ee_m2", float, lambda v: _part(v.covariance_h_m2, 0), 4),
    Column("cov_en_m2", float, lambda v: _part(v.covariance_h_m2, 1), 4),
    Column("var_nn_m2", float, lambda v: _part(v.covariance_h_m2, 2), 4),
    Column("reported_lat_deg", float, lambda v: v.reported_lat_deg, 8),
    Column("reported_lon_deg", float, lambda v: v.reported_lon_deg, 8),
    Column("reported_off_m", float, _off_m, 3),
    Column("fix_type", int, lambda v: v.fix_type),
    Column("satellites", int, lambda v: v.satellites),
    Column("name", str, lambda v: v.name or None),
    Column("readiness", str, lambda v: v.readiness.state.value if v.readiness is not None else None),
    Column("readiness_reason", str, lambda v: v.readiness.reason if v.readiness is not None else None),
    Column("without_gps_bound_95_m", float, lambda v: v.readiness.bound_95_m if v.readiness is not None else None, 3),
    Column("without_gps_hpl_m", float, lambda v: v.readiness.hpl_m if v.readiness is not None else None, 3),
    Column("without_gps_hdop", float, lambda v: v.readiness.hdop if v.readiness is not None else None, 3),
)
"""All but the first one, `unix_s`: the time of the row, s since 1970."""
