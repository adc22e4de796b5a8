"""Scenarios made in code, and a ground station's side of the wire made with pymavlink alone."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fakes.fleet import Datagram, Fleet
from sitl_fakes.scenario import Scenario

ORIGIN = {"lat_deg": 47.0, "lon_deg": 8.0, "alt_msl_m": 500.0, "geoid_height_m": 48.0}
EXACT = {
    "heading_bias_deg": 0.0,
    "airspeed_scale": 0.0,
    "heading_wander_deg": 0.0,
    "airspeed_wander": 0.0,
    "heading_noise_deg": 0.0,
    "airspeed_noise_mps": 0.0,
    "baro_sigma_m": 0.0,
}
_NUMBERS = {message.msgname: number for number, message in mavlink.mavlink_map.items()}
GOOD_GPS = {"sigma_h_m": 0.5, "sigma_v_m": 0.5, "sigma_velocity_mps": 0.1, "correlation_time_s": 0.0}


def scenario(**overrides: Any) -> Scenario:
    """Two aircraft 1 km apart flying north at 22 m/s for a long way; vehicle 1 ranges vehicle 2."""
    table: dict[str, Any] = {
        "name": "test",
        "origin": ORIGIN,
        "gps": GOOD_GPS,
        "vehicle": [
            {"sysid": 1, "waypoints": [[0, 0], [0, 20000]], "ranges_to": [2]},
            {"sysid": 2, "waypoints": [[1000, 0], [1000, 20000]], "height_m": 200.0},
        ],
    }
    return Scenario.model_validate({**table, **overrides})


class GroundStation:
    """Packs messages to vehicles and unpacks theirs, each datagram with a parser of its own."""

    def __init__(self, sysid: int = 255, compid: int = 190) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=compid)

    def pack(self, message: Any) -> bytes:
        return bytes(message.pack(self._mav))


def parse(datagrams: list[Datagram], kind: str | None = None, sysid: int | None = None) -> list[Any]:
    """Decode with pymavlink; `kind` and the sending vehicle `sysid` select. Frames unknown to it come as UNKNOWN_<id>."""
    number = _NUMBERS.get(kind)
    wanted = (d for d in datagrams if sysid in (None, d.sysid) and number in (None, int.from_bytes(d.payload[7:10], "little")))
    messages = (message for d in wanted for message in mavlink.MAVLink(None).parse_buffer(d.payload) or [])
    return [m for m in messages if kind in (None, m.get_type())]


def gps_input(fleet: Fleet, sysid: int, **overrides: Any) -> Any:
    """A GPS_INPUT that a vehicle should take: its true position 0.1 s ago, true velocity, good accuracies."""
    t = fleet.truth()[sysid]
    east, north = t.east_m - 0.1 * t.ve_mps, t.north_m - 0.1 * t.vn_mps
    lat, lon, alt = fleet.frame.to_lla(east + overrides.pop("shift_east_m", 0.0), north, t.up_m)
    vn, ve, vd = fleet.frame.vector_to_local_ned((t.ve_mps, t.vn_mps, t.vu_mps), lat, lon)
    fields: dict[str, Any] = {
        "time_usec": 0,
        "gps_id": 1,
        "ignore_flags": 0,
        "time_week_ms": 0,
        "time_week": 0,
        "fix_type": 3,
        "lat": round(lat * 1e7),
        "lon": round(lon * 1e7),
        "alt": alt,
        "hdop": 1.2,
        "vdop": 1.5,
        "vn": vn,
        "ve": ve,
        "vd": vd,
        "speed_accuracy": 0.5,
        "horiz_accuracy": 2.0,
        "vert_accuracy": 3.0,
        "satellites_visible": 7,
    }
    return mavlink.MAVLink_gps_input_message(**{**fields, **overrides})


def aid(fleet: Fleet, sysid: int, from_s: float, to_s: float, interval_s: float = 0.1, **overrides: Any) -> list[Datagram]:
    """Fly from one time to another while sending GPS_INPUT at an interval; returns what the vehicles sent."""
    gcs, out = GroundStation(), []
    count = math.floor((to_s - from_s) / interval_s + 1e-9)
    for k in range(1, count + 1):
        at_s = from_s + k * interval_s
        out += fleet.advance(at_s)
        fleet.deliver(sysid, gcs.pack(gps_input(fleet, sysid, **overrides)), at_s)
    return out + fleet.advance(to_s)


def ekf_uses_a_position(datagrams: list[Datagram], sysid: int) -> bool:
    """Whether EKF3 says that it does. Where it does not, a plane goes by any 3D fix without it."""
    flags: int = parse(datagrams, "EKF_STATUS_REPORT", sysid)[-1].flags
    return bool(flags & mavlink.EKF_POS_HORIZ_ABS)


def error_m(fleet: Fleet, sysid: int = 1) -> float:
    """How far a vehicle's own position is from where it truly is, horizontally."""
    t = fleet.truth()[sysid]
    return math.hypot(t.estimate_east_m - t.east_m, t.estimate_north_m - t.north_m)


def lost(sysid: int, at_s: float = 5.0) -> dict[str, Any]:
    """A fault table: the vehicle's GPS is lost."""
    return {"kind": "gps_lost", "vehicle": sysid, "at_s": at_s}
