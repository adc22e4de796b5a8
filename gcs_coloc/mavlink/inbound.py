"""Convert inbound payloads to the core's messages, one function per MAVLink message.

Every function takes the sender's system id, the arrival time and the payload's values in wire order, and returns the
message, or None where it holds nothing for the core. InvalidValueError names the field that is impossible.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.messages.inbound import (
    Airspeed,
    Attitude,
    EkfStatus,
    GlobalPosition,
    GpsReceiver,
    Inbound,
    Interference,
    Pressure,
    ReceiverIntegrity,
    SystemHealth,
    SystemTime,
    VtolState,
)
from gcs_coloc.mavlink import answers, checks, ranges
from gcs_coloc.mavlink._generated import gcs_coloc
from gcs_coloc.mavlink.checks import InvalidValueError
from gcs_coloc.mavlink.heartbeat import heartbeat
from gcs_coloc.mavlink.refusals import Field

# What MAVLink's fields hold for unknown, by their type.
UINT8_MAX = 0xFF
UINT16_MAX = 0xFFFF
UINT32_MAX = 0xFFFFFFFF

GPS_GLITCH_ARDUPILOT = 1 << 15
"""In EKF_STATUS_REPORT. ArduPilot sends it; the dialect's enumeration and ESTIMATOR_STATUS have bit 10 in its place."""

_MOST_GEOID_HEIGHT_M = 110.0
"""The geoid is -107 to +86 m from the ellipsoid (EGM96)."""
_ON_ROTORS = frozenset((mavlink.MAV_VTOL_STATE_TRANSITION_TO_MC, mavlink.MAV_VTOL_STATE_MC))
_VTOL_STATES = _ON_ROTORS | {mavlink.MAV_VTOL_STATE_TRANSITION_TO_FW, mavlink.MAV_VTOL_STATE_FW}
_INTERFERENCE = {state.value: state for state in Interference}
"""A state that is not known yet is UNKNOWN: the message is work in progress."""


def global_position_int(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> GlobalPosition:
    """GLOBAL_POSITION_INT (33)."""
    boot_ms, lat_e7, lon_e7, alt_mm, _relative_alt_mm, vx_cmps, vy_cmps, vz_cmps, _heading = values
    lat_deg, lon_deg = checks.latitude_longitude_deg(lat_e7, lon_e7)
    return GlobalPosition(
        sysid=sysid,
        received_at_s=received_at_s,
        boot_s=boot_ms / 1e3,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_msl_m=checks.altitude_m(alt_mm),
        vn_mps=vx_cmps / 1e2,
        ve_mps=vy_cmps / 1e2,
        vd_mps=vz_cmps / 1e2,
    )


def gps_raw_int(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> GpsReceiver:
    """GPS_RAW_INT (24): the first receiver."""
    time_us, lat_e7, lon_e7, alt_mm, eph, _epv, speed, course, fix, satellites, ellipsoid_mm, h_acc, v_acc, speed_acc, *_ = values
    place, accuracies = (lat_e7, lon_e7, alt_mm, ellipsoid_mm), (h_acc, v_acc, speed_acc)
    return _gps_receiver(sysid, received_at_s, 0, time_us, fix, place, (speed, course), satellites, eph, accuracies)


def gps2_raw(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> GpsReceiver:
    """GPS2_RAW (124): the second receiver."""
    time_us, lat_e7, lon_e7, alt_mm, _dgps_age, eph, _epv, speed, course, fix, satellites, *rest = values
    _dgps_count, _yaw, ellipsoid_mm, h_acc, v_acc, speed_acc, _heading_acc = rest
    place, accuracies = (lat_e7, lon_e7, alt_mm, ellipsoid_mm), (h_acc, v_acc, speed_acc)
    return _gps_receiver(sysid, received_at_s, 1, time_us, fix, place, (speed, course), satellites, eph, accuracies)


def _gps_receiver(
    sysid: int,
    received_at_s: float,
    receiver: int,
    time_us: int,
    fix_type: int,
    place: tuple[int, int, int, int],
    motion: tuple[int, int],
    satellites: int,
    eph: int,
    accuracies: tuple[int, int, int],
) -> GpsReceiver:
    """`place`: latitude, longitude in 1e-7 deg, altitudes above sea and ellipsoid in mm.

    `motion`: speed over ground in cm/s, course in 1e-2 deg. `accuracies`: horizontal, vertical in mm, speed in mm/s.
    """
    if fix_type > mavlink.GPS_FIX_TYPE_PPP:
        raise InvalidValueError(Field.FIX_TYPE)
    lat_deg = lon_deg = alt_msl_m = 0.0
    geoid_height_m = None
    # Without a fix there is no position. What stands in its fields is not checked: the lost fix must be learnt.
    if fix_type >= mavlink.GPS_FIX_TYPE_2D_FIX:
        lat_e7, lon_e7, alt_mm, ellipsoid_mm = place
        lat_deg, lon_deg = checks.latitude_longitude_deg(lat_e7, lon_e7)
        alt_msl_m = checks.altitude_m(alt_mm)
        # 0: an omitted extension field, or no geoid in the receiver.
        geoid_height_m = (ellipsoid_mm - alt_mm) / 1e3 if ellipsoid_mm else None
        if geoid_height_m is not None and abs(geoid_height_m) > _MOST_GEOID_HEIGHT_M:
            geoid_height_m = None
    h_acc_mm, v_acc_mm, speed_acc_mmps = accuracies
    return GpsReceiver(
        sysid=sysid,
        received_at_s=received_at_s,
        receiver=receiver,
        fix_type=fix_type,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_msl_m=alt_msl_m,
        satellites=None if satellites == UINT8_MAX else satellites,
        hdop=None if eph in (0, UINT16_MAX) else eph / 1e2,
        h_acc_m=_thousandths(h_acc_mm),
        v_acc_m=_thousandths(v_acc_mm),
        speed_acc_mps=_thousandths(speed_acc_mmps),
        # Either since boot or UNIX time: by its magnitude, as MAVLink says.
        fixed_boot_s=time_us / 1e6 if 0 < time_us < checks.UNIX_TIME_FROM_US else None,
        geoid_height_m=geoid_height_m,
        velocity_ne_mps=_velocity_ne_mps(*motion),
    )


def _velocity_ne_mps(speed_cmps: int, course_cdeg: int) -> tuple[float, float] | None:
    """Return north and east; None where speed or course is not known."""
    if UINT16_MAX in (speed_cmps, course_cdeg):
        return None
    speed_mps, course_rad = speed_cmps / 1e2, math.radians(course_cdeg / 1e2)
    return speed_mps * math.cos(course_rad), speed_mps * math.sin(course_rad)


def _thousandths(value: int) -> float | None:
    """In thousandths of the unit; None for 0, as which an omitted extension field arrives."""
    return None if value in (0, UINT32_MAX) else value / 1e3


def gnss_integrity(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> ReceiverIntegrity:
    """GNSS_INTEGRITY (441), without its authentication state.

    That state shows no forgery: its one error is that of the receiver's own set-up.
    """
    _errors, _raim_hfom, _raim_vfom, receiver, _authentication, jamming, spoofing, raim, *_qualities = values
    return ReceiverIntegrity(
        sysid=sysid,
        received_at_s=received_at_s,
        receiver=receiver,
        jamming=_INTERFERENCE.get(jamming, Interference.UNKNOWN),
        spoofing=_INTERFERENCE.get(spoofing, Interference.UNKNOWN),
        raim_failed=raim == gcs_coloc.GPS_RAIM_STATE_FAILED,
    )


def sys_status(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> SystemHealth:
    """SYS_STATUS (1), the GPS bit of its three masks, and the battery's charge."""
    present, enabled, healthy, *rest = values
    battery_percent = rest[9]  # -1: not known
    gps = mavlink.MAV_SYS_STATUS_SENSOR_GPS
    return SystemHealth(
        sysid=sysid,
        received_at_s=received_at_s,
        gps_present=bool(present & gps),
        gps_enabled=bool(enabled & gps),
        gps_healthy=bool(healthy & gps),
        battery_percent=battery_percent if battery_percent >= 0 else None,
    )


def ekf_status_report(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> EkfStatus:
    """EKF_STATUS_REPORT (193), from ArduPilot."""
    _velocity, _horizontal, _vertical, _compass, _terrain, flags, _airspeed = values
    return EkfStatus(
        sysid=sysid,
        received_at_s=received_at_s,
        horizontal_position_absolute=bool(flags & mavlink.EKF_POS_HORIZ_ABS),
        constant_position_mode=bool(flags & mavlink.EKF_CONST_POS_MODE),
        gps_glitching=bool(flags & GPS_GLITCH_ARDUPILOT),
    )


def estimator_status(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> EkfStatus:
    """ESTIMATOR_STATUS (230), from PX4.

    At rest on the ground PX4 sets CONST_POS_MODE beside an absolute position; it is ignored then.
    """
    *_, flags = values
    is_absolute = bool(flags & mavlink.ESTIMATOR_POS_HORIZ_ABS)
    return EkfStatus(
        sysid=sysid,
        received_at_s=received_at_s,
        horizontal_position_absolute=is_absolute,
        constant_position_mode=bool(flags & mavlink.ESTIMATOR_CONST_POS_MODE) and not is_absolute,
        gps_glitching=bool(flags & mavlink.ESTIMATOR_GPS_GLITCH),
        global_position_aided=bool(flags & mavlink.ESTIMATOR_PRED_POS_HORIZ_ABS),
        horizontally_aided=bool(flags & mavlink.ESTIMATOR_PRED_POS_HORIZ_REL),
    )


def attitude(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> Attitude:
    """ATTITUDE (30)."""
    boot_ms, roll, pitch, yaw, _roll_rate, _pitch_rate, _yaw_rate = values
    return Attitude(
        sysid=sysid,
        received_at_s=received_at_s,
        boot_s=boot_ms / 1e3,
        roll_rad=checks.angle_rad(roll, Field.ROLL),
        pitch_rad=checks.angle_rad(pitch, Field.PITCH),
        yaw_rad=checks.angle_rad(yaw, Field.YAW),
    )


def vfr_hud(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> Airspeed | None:
    """VFR_HUD (74); None where the airspeed is unknown (NaN)."""
    airspeed, *_ = values
    if math.isnan(airspeed):
        return None
    return Airspeed(sysid=sysid, received_at_s=received_at_s, airspeed_mps=checks.speed_mps(airspeed, Field.AIRSPEED))


def extended_sys_state(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> VtolState | None:
    """EXTENDED_SYS_STATE (245); None of a vehicle that is no VTOL."""
    vtol_state, _landed_state = values
    if vtol_state not in _VTOL_STATES:
        return None
    return VtolState(sysid=sysid, received_at_s=received_at_s, on_rotors=vtol_state in _ON_ROTORS)


def scaled_pressure(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> Pressure:
    """SCALED_PRESSURE (29): the first barometer."""
    boot_ms, pressure_hpa, *_ = values
    return Pressure(
        sysid=sysid, received_at_s=received_at_s, boot_s=boot_ms / 1e3, pressure_hpa=checks.pressure_hpa(pressure_hpa)
    )


def system_time(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> SystemTime:
    """SYSTEM_TIME (2); a UNIX time before September 2001 is a clock that has not been set."""
    unix_us, boot_ms = values
    if unix_us > checks.UNIX_TIME_TO_US:
        raise InvalidValueError(Field.TIME_UNIX_USEC)
    return SystemTime(
        sysid=sysid,
        received_at_s=received_at_s,
        boot_s=boot_ms / 1e3,
        unix_s=unix_us / 1e6 if unix_us >= checks.UNIX_TIME_FROM_US else None,
    )


Converter = Callable[[int, float, tuple[Any, ...]], Inbound | None]

AUTOPILOT_CONVERTERS: Mapping[int, Converter] = MappingProxyType(
    {
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: gps_raw_int,
        mavlink.MAVLINK_MSG_ID_ATTITUDE: attitude,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_position_int,
        mavlink.MAVLINK_MSG_ID_VFR_HUD: vfr_hud,
        mavlink.MAVLINK_MSG_ID_GPS2_RAW: gps2_raw,
        mavlink.MAVLINK_MSG_ID_TIMESYNC: answers.timesync,
        mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: ekf_status_report,
        mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: estimator_status,
        mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: scaled_pressure,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: extended_sys_state,
        mavlink.MAVLINK_MSG_ID_COMMAND_ACK: answers.command_ack,
        mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: answers.gps_global_origin,
        mavlink.MAVLINK_MSG_ID_PARAM_VALUE: answers.param_value,
        gcs_coloc.MAVLINK_MSG_ID_GNSS_INTEGRITY: gnss_integrity,
    }
)
"""Messages that describe the vehicle if its autopilot sends them, by message id. A gimbal's ATTITUDE is not the vehicle's."""

CONVERTERS: Mapping[int, Converter] = MappingProxyType(
    {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
        mavlink.MAVLINK_MSG_ID_DEBUG_VECT: ranges.debug_vect,
        mavlink.MAVLINK_MSG_ID_GPS_INPUT: answers.gps_input,
        mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: ranges.named_value_float,
        gcs_coloc.MAVLINK_MSG_ID_RANGING_BEACON: ranges.ranging_beacon,
        gcs_coloc.MAVLINK_MSG_ID_PEER_RANGE: ranges.peer_range,
        **AUTOPILOT_CONVERTERS,
    }
)
"""All messages that are decoded, by message id; every other one is ignored."""
