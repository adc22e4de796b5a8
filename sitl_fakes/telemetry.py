"""The standard messages that a vehicle sends, each built from a snapshot, and the rates at which they are due."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fakes.receivers import Receiver
from sitl_fakes.snapshot import Snapshot

_AUTO_MODE = 10
_BASE_MODE = 217  # armed; manual input, stabilised, guided and custom modes on: what a plane in AUTO says
# What an ArduPlane in flight reports, taken from one; the GPS is bit 0x20 of the last.
_SENSORS_PRESENT, _SENSORS_ENABLED, _SENSORS_HEALTHY = 320994367, 52558911, 53607487
_GPS_SENSOR = mavlink.MAV_SYS_STATUS_SENSOR_GPS
_EKF_NORMAL, _EKF_RELATIVE, _EKF_NO_POSITION, _EKF_GLITCH = 831, 303, 165, 32768
_EKF_ABSOLUTE_FOR_S = 10.0
_EPSILON_S = 1e-9

Builder = Callable[[Snapshot], Any]


def _heartbeat(_: Snapshot) -> Any:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, _BASE_MODE, _AUTO_MODE, mavlink.MAV_STATE_ACTIVE, 3
    )


def _sys_status(s: Snapshot) -> Any:
    healthy = _SENSORS_HEALTHY if s.autopilot.gps_healthy(s.at_s) else _SENSORS_HEALTHY & ~_GPS_SENSOR
    return mavlink.MAVLink_sys_status_message(_SENSORS_PRESENT, _SENSORS_ENABLED, healthy, 0, 11900, 1000, 90, 0, 0, 0, 0, 0, 0)


def _system_time(s: Snapshot) -> Any:
    unix_us = 0 if s.unix_s is None else round(s.unix_s * 1e6)
    return mavlink.MAVLink_system_time_message(unix_us, _ms(s.boot_s))


def _gps_fields(receiver: Receiver, s: Snapshot, instance: int) -> dict[str, int]:
    fix, fixed_boot_s = receiver.fix, s.fixed_boot_s[instance]
    if fix is None:
        blank = dict.fromkeys(("time_usec", "lat", "lon", "alt", "vel", "cog", "satellites_visible"), 0)
        return {**blank, "fix_type": 1, "eph": 65535, "epv": 65535}
    lat, lon, alt = s.frame.to_lla(*fix.position_enu_m)
    north, east, _ = s.frame.vector_to_local_ned(fix.velocity_enu_mps, lat, lon)
    return {
        "time_usec": 0 if fixed_boot_s is None else round(fixed_boot_s * 1e6),
        "fix_type": receiver.fix_type(s.at_s),
        "lat": round(lat * 1e7),
        "lon": round(lon * 1e7),
        "alt": _int32(alt * 1000.0),
        "eph": 65535 if fix.hdop is None else _unsigned(fix.hdop, 100.0, 65535),
        "epv": 65535 if fix.vdop is None else _unsigned(fix.vdop, 100.0, 65535),
        "vel": _unsigned(math.hypot(north, east), 100.0, 65535),
        "cog": _centidegrees(math.atan2(east, north)),
        "satellites_visible": receiver.satellites(s.at_s),
        "alt_ellipsoid": _int32((alt + s.frame.geoid_height_m) * 1000.0),
        "h_acc": _unsigned(fix.h_acc_m or 0.0, 1000.0, 2**32 - 1),
        "v_acc": _unsigned(fix.v_acc_m or 0.0, 1000.0, 2**32 - 1),
        "vel_acc": _unsigned(fix.speed_acc_mps or 0.0, 1000.0, 2**32 - 1),
    }


def _gps_raw_int(s: Snapshot) -> Any:
    return mavlink.MAVLink_gps_raw_int_message(**_gps_fields(s.autopilot.receivers[0], s, 0))


def _gps2_raw(s: Snapshot) -> Any:
    if not s.second_receiver:
        return None
    return mavlink.MAVLink_gps2_raw_message(**_gps_fields(s.autopilot.receivers[1], s, 1), dgps_numch=0, dgps_age=0)


def _local_heading(s: Snapshot) -> float:
    return s.frame.heading_to_local(s.air.heading_rad, s.true_lla[0], s.true_lla[1])


def _attitude(s: Snapshot) -> Any:
    t = s.true_state
    return mavlink.MAVLink_attitude_message(_ms(s.boot_s), s.air.roll_rad, 0.0, _local_heading(s), t.p_radps, 0.0, t.r_radps)


def _global_position_int(s: Snapshot) -> Any:
    reported = s.reported_position()
    heading = _centidegrees(_local_heading(s))
    if reported is None:
        relative = round((s.air.altitude_m - s.home_alt_m) * 1000.0)
        return mavlink.MAVLink_global_position_int_message(
            _ms(s.boot_s), 0, 0, round(s.air.altitude_m * 1000.0), relative, 0, 0, 0, heading
        )
    (lat, lon, alt), velocity = reported
    north, east, down = (_int16(v * 100.0) for v in s.frame.vector_to_local_ned(velocity, lat, lon))
    return mavlink.MAVLink_global_position_int_message(
        _ms(s.boot_s),
        round(lat * 1e7),
        round(lon * 1e7),
        round(alt * 1000.0),
        round((alt - s.home_alt_m) * 1000.0),
        north,
        east,
        down,
        heading,
    )


def _vfr_hud(s: Snapshot) -> Any:
    ground_speed = math.hypot(*s.autopilot.navigation.velocity_mps)
    heading_deg = round(math.degrees(_local_heading(s))) % 360
    return mavlink.MAVLink_vfr_hud_message(s.air.airspeed_mps, ground_speed, heading_deg, 50, s.air.altitude_m, s.climb_mps)


def _ekf_status_report(s: Snapshot) -> Any:
    navigation = s.autopilot.navigation
    if navigation.position_m is None:
        flags = _EKF_NO_POSITION
    else:
        flags = _EKF_NORMAL if navigation.since_position_s(s.at_s) <= _EKF_ABSOLUTE_FOR_S else _EKF_RELATIVE
        flags |= _EKF_GLITCH if navigation.glitching else 0
    position_variance = 1.5 if navigation.glitching else 0.05
    return mavlink.MAVLink_ekf_status_report_message(flags, 0.02, position_variance, 0.01, 0.01, 0.0, 0.03)


def _simstate(s: Snapshot) -> Any:
    t = s.true_state
    yaw = s.frame.heading_to_local(t.psi_rad, s.true_lla[0], s.true_lla[1])
    lat, lon = round(s.true_lla[0] * 1e7), round(s.true_lla[1] * 1e7)
    return mavlink.MAVLink_simstate_message(t.phi_rad, 0.0, yaw, 0.0, 0.0, 0.0, t.p_radps, 0.0, t.r_radps, lat, lon)


def _sim_state(s: Snapshot) -> Any:
    t, (lat, lon, alt) = s.true_state, s.true_lla
    yaw = s.frame.heading_to_local(t.psi_rad, lat, lon)
    north, east, down = s.frame.vector_to_local_ned(s.true_velocity_mps, lat, lon)
    cr, sr, cy, sy = math.cos(t.phi_rad / 2), math.sin(t.phi_rad / 2), math.cos(yaw / 2), math.sin(yaw / 2)
    return mavlink.MAVLink_sim_state_message(
        cr * cy, sr * cy, -sr * sy, cr * sy, t.phi_rad, 0.0, yaw, 0.0, 0.0, 0.0, t.p_radps, 0.0, t.r_radps,
        lat, lon, alt, 0.0, 0.0, north, east, down, round(lat * 1e7), round(lon * 1e7),
    )  # fmt: skip


# Message id: (builder, default rate in Hz, 0 off).
_STREAMS: dict[int, tuple[Builder, float]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: (_heartbeat, 1.0),
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: (_sys_status, 2.0),
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: (_system_time, 1.0),
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: (_gps_raw_int, 5.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE: (_attitude, 10.0),
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: (_global_position_int, 10.0),
    mavlink.MAVLINK_MSG_ID_VFR_HUD: (_vfr_hud, 5.0),
    mavlink.MAVLINK_MSG_ID_SIM_STATE: (_sim_state, 0.0),
    mavlink.MAVLINK_MSG_ID_GPS2_RAW: (_gps2_raw, 5.0),
    mavlink.MAVLINK_MSG_ID_SIMSTATE: (_simstate, 0.0),
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: (_ekf_status_report, 2.0),
}
_TRUTH_RATE_HZ = 10.0
_TRUTH_MESSAGES = (mavlink.MAVLINK_MSG_ID_SIMSTATE, mavlink.MAVLINK_MSG_ID_SIM_STATE)


class Streams:
    """Which message is due when. Phases differ by message, so that a vehicle does not send everything at once."""

    def __init__(self, rng: np.random.Generator, starts_at_s: float, truth_messages: bool) -> None:
        self._interval_s: dict[int, float] = {}
        self._due_s: dict[int, float] = {}
        self._defaults_hz = {message_id: rate for message_id, (_, rate) in _STREAMS.items()}
        if truth_messages:
            self._defaults_hz.update(dict.fromkeys(_TRUTH_MESSAGES, _TRUTH_RATE_HZ))
        for message_id, rate_hz in self._defaults_hz.items():
            phase = float(rng.random())
            if rate_hz > 0.0:
                self._interval_s[message_id] = 1.0 / rate_hz
                self._due_s[message_id] = starts_at_s + phase / rate_hz

    def set_interval(self, message_id: int, interval_us: float, at_s: float) -> bool:
        """MAV_CMD_SET_MESSAGE_INTERVAL: -1 off, 0 the default rate, else microseconds. False where the message is not offered."""
        if message_id not in _STREAMS or not math.isfinite(interval_us):
            return False
        default_hz = self._defaults_hz[message_id]
        interval_s = interval_us * 1e-6 if interval_us > 0.0 else 1.0 / default_hz if interval_us == 0.0 and default_hz else 0.0
        if interval_s > 0.0:
            self._interval_s[message_id] = interval_s
            self._due_s[message_id] = at_s + interval_s
        else:
            self._interval_s.pop(message_id, None)
            self._due_s.pop(message_id, None)
        return True

    def due(self, at_s: float, take_snapshot: Callable[[float], Snapshot]) -> list[Any]:
        """Build what is due at a time (s); each message at most once, however small its interval."""
        if not any(due_s <= at_s + _EPSILON_S for due_s in self._due_s.values()):
            return []
        snapshot, out = take_snapshot(at_s), []
        for message_id, due_s in self._due_s.items():
            if due_s <= at_s + _EPSILON_S:
                interval = self._interval_s[message_id]
                self._due_s[message_id] = max(due_s + interval, at_s)
                message = _STREAMS[message_id][0](snapshot)
                if message is not None:
                    out.append(message)
        return out


def build(message_id: int, snapshot: Snapshot) -> Any | None:
    """Build one message now (MAV_CMD_REQUEST_MESSAGE), or None where it is not offered."""
    return _STREAMS[message_id][0](snapshot) if message_id in _STREAMS else None


def _ms(seconds: float) -> int:
    return int(seconds * 1000.0) & 0xFFFFFFFF


def _unsigned(value: float, scale: float, largest: int) -> int:
    return max(0, min(largest, round(value * scale)))


def _int16(value: float) -> int:
    return max(-(2**15), min(2**15 - 1, round(value)))


def _int32(value: float) -> int:
    return max(-(2**31), min(2**31 - 1, round(value)))


def _centidegrees(angle_rad: float) -> int:
    return round(math.degrees(angle_rad) * 100.0) % 36000
