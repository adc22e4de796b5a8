"""The truth about a vehicle, for scoring alone: it goes to a file or to SIMSTATE, never into any other message."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields


@dataclass(frozen=True, slots=True)
class VehicleTruth:
    """What is really so about one vehicle: position (east, north, up m; deg, m above mean sea level), velocity (m/s), attitude
    (rad).

    `cross_track_m` is the true distance left of the track it is flying, `off_route_m` the least distance to its whole
    route. `estimate_east_m`, `estimate_north_m` are where its autopilot believes it is (None before a first fix), `source`
    is what that rests on, and `aid_refusal` says why the injected receiver is not used (None where it is fit).
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
