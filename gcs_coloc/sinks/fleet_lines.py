"""The fleet in plain lines, for a log; and its values as a line and a table write them."""

from __future__ import annotations

from gcs_coloc.core.snapshot import OutSnapshot, VehicleSnapshot
from gcs_coloc.core.standby.standby_snapshot import StandbySnapshot


def out_line(out: OutSnapshot) -> str:
    """The ground tools behind one connection string in one plain line."""
    return (
        f"ground tools on {out.name}: {out.tools}, frames sent {out.frames_sent}, accepted {out.frames_accepted}, "
        f"dropped {out.dropped}, refused {out.refused}"
    )


def standby_line(standby: StandbySnapshot) -> str:
    """The hot standby in one plain line."""
    heard = "never" if standby.other_age_s is None else f"{age(standby.other_age_s)} ago"
    problem = f"; {standby.problem}" if standby.problem is not None else ""
    other = standby.other_state or "unknown"
    return f"hot standby: this service is {standby.state} ({standby.reason}), the other one {other}, last heard {heard}{problem}"


def vehicle_line(v: VehicleSnapshot) -> str:
    """One vehicle in one plain line."""
    return (
        f"vehicle {called(v)}: last heard {v.age_s:.1f} s ago, GPS {v.gps_state} ({v.gps_reason}), position {_where(v)}, "
        f"95 % bound {metres(v.bound_95_m)}, HPL {metres(v.hpl_m)}, HDOP {number(v.hdop)}, {v.ranges_in_use} ranges in use, "
        f"aiding {v.aiding}{_without_gps(v)}"
    )


def called(v: VehicleSnapshot) -> str:
    """A vehicle's system id, with its name where it has one."""
    return f"{v.sysid} {v.name}".rstrip()


def _where(v: VehicleSnapshot) -> str:
    if v.lat_deg is None or v.lon_deg is None or v.alt_msl_m is None:
        return f"unknown: {v.no_estimate_reason}"
    return f"{v.lat_deg:.6f} {v.lon_deg:.6f} {v.alt_msl_m:.0f} m"


def _without_gps(v: VehicleSnapshot) -> str:
    if v.readiness is None:
        return ""
    state = v.readiness.state.value.replace("_", " ")
    return f", without GPS {state}{f' ({v.readiness.text})' if v.readiness.text else ''}"


def age(seconds: float) -> str:
    """A time in at most six characters."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5940.0 else f"{min(seconds / 3600.0, 9999.0):.0f} h"


def metres(m: float | None) -> str:
    """A length in at most six characters."""
    if m is None:
        return "-"
    return f"{m:.1f} m" if m < 99.95 else f"{m:.0f} m" if m < 9999.5 else f"{m / 1000.0:.0f} km"


def number(value: float | None, digits: int = 1) -> str:
    """A number to so many digits after the point."""
    return f"{value:.{digits}f}" if value is not None else "-"
