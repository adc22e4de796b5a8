"""The standard messages that a vehicle sends, each built from a snapshot."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20 import development

from sitl_fakes.autopilot import Autopilot
from sitl_fakes.flight import Flight
from sitl_fakes.geodesy import Vector, WorldFrame
from sitl_fakes.parameters import Kind
from sitl_fakes.receivers import Receiver


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One vehicle at one moment: its clocks, its autopilot, and its flight with air data and the truth.

    The truth is for the simulator's own messages alone.

    `fixed_boot_s` is the boot time of each receiver's last fix, None where there was none. `altitude_m` and `climb_mps` are
    the autopilot's; the barometer's altitude is in `flight.air`. `notices_jamming`, `notices_spoofing`: its own receiver does.
    """

    kind: Kind
    at_s: float
    boot_s: float
    fixed_boot_s: tuple[float | None, float | None]
    unix_s: float | None
    frame: WorldFrame
    home_alt_m: float
    global_position: Literal["raw", "filtered"]
    autopilot: Autopilot
    second_receiver: bool
    notices_jamming: bool
    notices_spoofing: bool
    flight: Flight
    altitude_m: float
    climb_mps: float

    def reported_position(self) -> tuple[Vector, Vector] | None:
        """Return the position and velocity that the vehicle reports as its own.

        Position is latitude, longitude (deg) and altitude (m), velocity east, north, up (m/s). None before the first fix.
        """
        believed = self.autopilot.believed(self.at_s)
        if believed is None:
            return None
        position, velocity = believed
        receiver = self.autopilot.receivers[self.autopilot.in_use]
        if self.global_position == "raw" and self.autopilot.own_gps_in_use(self.at_s):
            assert receiver.fix is not None
            assert receiver.fixed_at_s is not None
            age = self.at_s - receiver.fixed_at_s
            (east, north, _), (ve, vn, _) = receiver.fix.position_enu_m, receiver.fix.velocity_enu_mps
            position, velocity = (east + ve * age, north + vn * age), (ve, vn)
        return self.frame.to_lla_at(*position, self.altitude_m), (*velocity, self.climb_mps)


_ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
# Autopilot, custom mode (AUTO; AUTO with sub-mode MISSION), base mode without the armed flag: what a plane on its mission says.
_MODES = {"ardupilot": (mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 10, 89), "px4": (mavlink.MAV_AUTOPILOT_PX4, 4 << 16 | 4 << 24, 29)}
# What an ArduPlane in flight reports, taken from one; the GPS is bit 0x20 of the last.
_SENSORS_PRESENT, _SENSORS_ENABLED, _SENSORS_HEALTHY = 320994367, 52558911, 53607487
_GPS_SENSOR = mavlink.MAV_SYS_STATUS_SENSOR_GPS
_EKF_NORMAL, _EKF_RELATIVE, _EKF_NO_POSITION, _EKF_GLITCH = 831, 303, 165, 32768
_EKF_ABSOLUTE_FOR_S = 10.0
# As PX4 SIH quadrotors said: 895 while a global position is used, 383 without one or by
# vision or ranges, 101 in failsafe; 128 beside it at rest.
_EKF2_NORMAL, _EKF2_UNAIDED, _EKF2_DEAD_RECKONING, _EKF2_NO_POSITION = 895, 383, 101, 165
_EKF2_ABSOLUTE_FOR_S = 5.0  # source: EKF2_NOAID_TOUT, its default
_PX4_DEVICE_ID = 33  # the low byte of a device id: no instance, and no number that others know it by


def heartbeat(s: Snapshot) -> Any:
    """HEARTBEAT (0)."""
    autopilot, custom_mode, base_mode = _MODES[s.kind]
    state = mavlink.MAV_STATE_ACTIVE if s.autopilot.armed else mavlink.MAV_STATE_STANDBY
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_FIXED_WING, autopilot, base_mode | (_ARMED if s.autopilot.armed else 0), custom_mode, state, 3
    )


def sys_status(s: Snapshot) -> Any:
    """SYS_STATUS (1)."""
    healthy = _SENSORS_HEALTHY if s.autopilot.gps_healthy(s.at_s) else _SENSORS_HEALTHY & ~_GPS_SENSOR
    return mavlink.MAVLink_sys_status_message(_SENSORS_PRESENT, _SENSORS_ENABLED, healthy, 0, 11900, 1000, 90, 0, 0, 0, 0, 0, 0)


def system_time(s: Snapshot) -> Any:
    """SYSTEM_TIME (2)."""
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


def gps_raw_int(s: Snapshot) -> Any:
    """GPS_RAW_INT (24): the first receiver."""
    return mavlink.MAVLink_gps_raw_int_message(**_gps_fields(s.autopilot.receivers[0], s, 0))


def gps2_raw(s: Snapshot) -> Any:
    """GPS2_RAW (124): the second receiver; None where there is none."""
    if not s.second_receiver:
        return None
    return mavlink.MAVLink_gps2_raw_message(**_gps_fields(s.autopilot.receivers[1], s, 1), dgps_numch=0, dgps_age=0)


def gnss_integrity(s: Snapshot) -> Any:
    """Build GNSS_INTEGRITY (441), as PX4 fills it.

    It has PX4's own number of the receiver. What PX4 does not know of the receiver is marked unknown.
    """
    jamming = development.GPS_JAMMING_STATE_DETECTED if s.notices_jamming else development.GPS_JAMMING_STATE_UNKNOWN
    spoofing = development.GPS_SPOOFING_STATE_DETECTED if s.notices_spoofing else development.GPS_SPOOFING_STATE_UNKNOWN
    return development.MAVLink_gnss_integrity_message(
        _PX4_DEVICE_ID, 0, 0, jamming, spoofing, 0, 65535, 65535, 255, 255, 255, 255
    )


def _local_heading(s: Snapshot) -> float:
    return s.frame.heading_to_local(s.flight.air.heading_rad, s.flight.lla[0], s.flight.lla[1])


def attitude(s: Snapshot) -> Any:
    """ATTITUDE (30)."""
    t = s.flight.state
    return mavlink.MAVLink_attitude_message(
        _ms(s.boot_s), s.flight.air.roll_rad, 0.0, _local_heading(s), t.p_radps, 0.0, t.r_radps
    )


def global_position_int(s: Snapshot) -> Any:
    """GLOBAL_POSITION_INT (33); without a position ArduPilot sends zeros, PX4 nothing."""
    reported = s.reported_position()
    if reported is None and s.kind == "px4":
        return None
    (lat, lon, alt), velocity = reported or ((0.0, 0.0, s.altitude_m), (0.0, 0.0, 0.0))
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
        _centidegrees(_local_heading(s)),
    )


def vfr_hud(s: Snapshot) -> Any:
    """VFR_HUD (74). PX4 without an airspeed sensor, as quadrotors are, says NaN."""
    believed = s.autopilot.believed(s.at_s)
    ground_speed = math.hypot(*(s.autopilot.navigation.velocity_mps if believed is None else believed[1]))
    heading_deg = round(math.degrees(_local_heading(s))) % 360
    # Calibrated airspeed, as the message is defined: less than the true one where the air is thin (ISO 2533).
    temperature_share = 1.0 - 0.0065 * s.flight.air.altitude_m / 288.15
    calibrated_mps = s.flight.air.airspeed_mps * temperature_share ** (4.2559 / 2.0) if s.kind == "ardupilot" else math.nan
    return mavlink.MAVLink_vfr_hud_message(calibrated_mps, ground_speed, heading_deg, 50, s.altitude_m, s.climb_mps)


def scaled_pressure(s: Snapshot) -> Any:
    """SCALED_PRESSURE (29): the barometer alone, whatever the autopilot believes of its height.

    Standard atmosphere.
    """
    pressure_hpa = 1013.25 * (1.0 - 0.0065 * s.flight.air.altitude_m / 288.15) ** 5.25588
    return mavlink.MAVLink_scaled_pressure_message(_ms(s.boot_s), pressure_hpa, 0.0, 1500)


def altitude(s: Snapshot) -> Any:
    """ALTITUDE (141): PX4 sends it without a position, too, when it has no GLOBAL_POSITION_INT."""
    above_home_m = s.altitude_m - s.home_alt_m
    return mavlink.MAVLink_altitude_message(
        round(s.boot_s * 1e6), s.flight.air.altitude_m, s.altitude_m, above_home_m, above_home_m, math.nan, math.nan
    )


def gps_global_origin(s: Snapshot) -> Any:
    """GPS_GLOBAL_ORIGIN (49): that of a PX4's local frame; None before its first fix."""
    if s.autopilot.origin_m is None:
        return None
    lat, lon, alt = s.frame.to_lla(*s.autopilot.origin_m)
    return mavlink.MAVLink_gps_global_origin_message(
        round(lat * 1e7), round(lon * 1e7), round(alt * 1000.0), round(s.boot_s * 1e6)
    )


def ekf_status_report(s: Snapshot) -> Any:
    """EKF_STATUS_REPORT (193): ArduPilot's flags."""
    navigation = s.autopilot.navigation
    if navigation.position_m is None:
        flags = _EKF_NO_POSITION
    else:
        flags = _EKF_NORMAL if navigation.since_position_s(s.at_s) <= _EKF_ABSOLUTE_FOR_S else _EKF_RELATIVE
        flags |= _EKF_GLITCH if s.autopilot.gps_glitching(s.at_s) else 0
    velocity_share, position_share = math.sqrt(navigation.velocity_ratio), math.sqrt(navigation.position_ratio)
    return mavlink.MAVLink_ekf_status_report_message(flags, velocity_share, position_share, 0.01, 0.01, 0.0, 0.03)


def estimator_status(s: Snapshot) -> Any:
    """ESTIMATOR_STATUS (230): PX4's flags, which are not ArduPilot's."""
    navigation = s.autopilot.navigation
    if navigation.position_m is None:
        flags = _EKF2_NO_POSITION
    else:
        unaided_s = navigation.since_position_s(s.at_s)
        flags = _EKF2_NORMAL if s.autopilot.uses_global_position(s.at_s) else _EKF2_UNAIDED
        flags = flags if unaided_s <= _EKF2_ABSOLUTE_FOR_S else _EKF2_DEAD_RECKONING
        flags |= 0 if s.autopilot.armed else mavlink.ESTIMATOR_CONST_POS_MODE
        flags |= mavlink.ESTIMATOR_GPS_GLITCH if s.autopilot.gps_glitching(s.at_s) else 0
    velocity_share, position_share = math.sqrt(navigation.velocity_ratio), math.sqrt(navigation.position_ratio)
    return mavlink.MAVLink_estimator_status_message(
        round(s.boot_s * 1e6), flags, velocity_share, position_share, 0.01, 0.01, 0.0, 0.03, navigation.sigma_m, 1.0
    )


def simstate(s: Snapshot) -> Any:
    """SIMSTATE (164): the truth."""
    t = s.flight.state
    yaw = s.frame.heading_to_local(t.psi_rad, s.flight.lla[0], s.flight.lla[1])
    lat, lon = round(s.flight.lla[0] * 1e7), round(s.flight.lla[1] * 1e7)
    return mavlink.MAVLink_simstate_message(t.phi_rad, 0.0, yaw, 0.0, 0.0, 0.0, t.p_radps, 0.0, t.r_radps, lat, lon)


def sim_state(s: Snapshot) -> Any:
    """SIM_STATE (108): the truth."""
    t, (lat, lon, alt) = s.flight.state, s.flight.lla
    yaw = s.frame.heading_to_local(t.psi_rad, lat, lon)
    north, east, down = s.frame.vector_to_local_ned(s.flight.velocity_mps, lat, lon)
    cr, sr, cy, sy = math.cos(t.phi_rad / 2), math.sin(t.phi_rad / 2), math.cos(yaw / 2), math.sin(yaw / 2)
    return mavlink.MAVLink_sim_state_message(
        cr * cy, sr * cy, -sr * sy, cr * sy, t.phi_rad, 0.0, yaw, 0.0, 0.0, 0.0, t.p_radps, 0.0, t.r_radps,
        lat, lon, alt, 0.0, 0.0, north, east, down, round(lat * 1e7), round(lon * 1e7),
    )  # fmt: skip


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
