"""A flight as a table: CSV with a row for each vehicle each 0.4 s."""

from __future__ import annotations

import csv
from math import hypot
from pathlib import Path
from typing import Any

from gcs_coloc.core.snapshot import VehicleSnapshot
from gcs_coloc.recorder.flight_history import FlightHistory
from gcs_coloc.recorder.journal import VehicleEntry

COLUMNS = (
    "unix_s", "sysid", "lat_deg", "lon_deg", "alt_msl_m", "sigma_h_m", "bound_95_m", "hpl_m", "vpl_m", "hdop", "nis",
    "ranges_in_use", "gps_state", "aiding_has_fix", "no_estimate_reason", "sigma_v_m", "ve_mps", "vn_mps", "vu_mps",
    "var_ee_m2", "cov_en_m2", "var_nn_m2", "reported_lat_deg", "reported_lon_deg", "reported_off_m", "fix_type", "satellites",
)  # fmt: skip


def write_csv(history: FlightHistory, path: Path) -> None:
    """Write one row for each vehicle each 0.4 s, in order of time; an empty cell where a value is unknown."""
    entries = sorted((e for track in history.tracks.values() for e in track), key=lambda e: (e.at_s, e.vehicle.sysid))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(_row(entry) for entry in entries)


def _row(entry: VehicleEntry) -> list[Any]:
    v = entry.vehicle
    nis = v.consistency.nis_median if v.consistency is not None else None
    return [
        f"{entry.at_s:.6f}", v.sysid, _number(v.lat_deg, 8), _number(v.lon_deg, 8), _number(v.alt_msl_m, 3),
        _number(v.sigma_h_m, 3), _number(v.bound_95_m, 3), _number(v.hpl_m, 3), _number(v.vpl_m, 3), _number(v.hdop, 3),
        _number(nis, 4), v.ranges_in_use,
        v.gps_state, int(v.aiding_has_fix), v.no_estimate_reason or "", _number(v.sigma_v_m, 3),
        *(_number(speed, 3) for speed in v.velocity_enu_mps or (None,) * 3),
        *(_number(moment, 4) for moment in v.covariance_h_m2 or (None,) * 3),
        _number(v.reported_lat_deg, 8), _number(v.reported_lon_deg, 8), _number(_off_m(v), 3), v.fix_type, v.satellites,
    ]  # fmt: skip


def _off_m(v: VehicleSnapshot) -> float | None:
    """Horizontal distance of the reported position from the estimate, m."""
    if v.enu_m is None or v.reported_enu_m is None:
        return None
    return hypot(v.reported_enu_m[0] - v.enu_m[0], v.reported_enu_m[1] - v.enu_m[1])


def _number(value: float | None, digits: int) -> str:
    return f"{value:.{digits}f}" if value is not None else ""
