"""Outbound messages of the engine, to vehicles and to the operator. Conventions as in `inbound`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


@dataclass(frozen=True, slots=True)
class GpsInput:
    """GPS_INPUT (232) for one vehicle: a synthetic fix.

    It is to be sent to that vehicle's own address and nowhere else.

    The message has no target field. `fix_type` is 3, or 1 where the position is unknown or too uncertain.
    `gps_id` is the zero-based receiver instance. `gps_week` 0 means that the time is not known.
    `yaw` is never sent: a course over ground is not a heading.
    """

    sysid: int
    gps_id: int
    time_usec: int
    gps_week: int
    gps_time_of_week_ms: int
    fix_type: int
    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    hdop: float
    vdop: float
    vn_mps: float
    ve_mps: float
    vd_mps: float
    speed_accuracy_mps: float
    horiz_accuracy_m: float
    vert_accuracy_m: float
    satellites: int


@dataclass(frozen=True, slots=True)
class ExternalPosition:
    """COMMAND_INT MAV_CMD_EXTERNAL_POSITION_ESTIMATE (43003): where a vehicle is as the command arrives.

    `sent_s` (param 1) is the time of sending on a clock of ours that begins near 0, `accuracy_m` (param 3) 1-sigma. The
    processing time (param 2) is 0 and the altitude NaN, as the command wants it.
    """

    sysid: int
    sent_s: float
    lat_deg: float
    lon_deg: float
    accuracy_m: float


@dataclass(frozen=True, slots=True)
class GlobalPositionSensor:
    """GLOBAL_POSITION_SENSOR (296): where a vehicle is as it arrives; `eph_m`, `epv_m` are 1-sigma."""

    sysid: int
    time_usec: int
    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    eph_m: float
    epv_m: float


@dataclass(frozen=True, slots=True)
class VisionPosition:
    """VISION_POSITION_ESTIMATE (102) to one vehicle: where it is when the message arrives.

    The position is from the vehicle's own local origin.

    The message has no target field. `variance_m2` is north, east, down; an orientation is never sent.
    """

    sysid: int
    time_usec: int
    north_m: float
    east_m: float
    down_m: float
    variance_m2: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class RangingBeacon:
    """RANGING_BEACON (513) to one vehicle: a range to it or by it, and where its other end is.

    `boot_us` is when it holds, on the vehicle's own clock; `accuracy_m` is 1-sigma, with the other end's error along the range.
    PX4 takes the message from whomever it reaches: its target is not looked at.
    """

    sysid: int
    boot_us: int
    beacon_id: int
    sequence: int
    range_m: float
    accuracy_m: float
    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    sigma_h_m: float
    sigma_v_m: float


@dataclass(frozen=True, slots=True)
class OriginRequest:
    """COMMAND_LONG MAV_CMD_REQUEST_MESSAGE (512): asks one vehicle for its GPS_GLOBAL_ORIGIN."""

    sysid: int


@dataclass(frozen=True, slots=True)
class SensorEnable:
    """COMMAND_LONG MAV_CMD_ESTIMATOR_SENSOR_ENABLE (43006): a vehicle is to use its own GPS, or not."""

    sysid: int
    gps: bool


@dataclass(frozen=True, slots=True)
class ParameterRequest:
    """PARAM_REQUEST_READ (20): asks one vehicle for one parameter by its name."""

    sysid: int
    name: str


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """PARAM_SET (23): changes a parameter, and is answered with PARAM_VALUE; `kind`: a MAV_PARAM_TYPE."""

    sysid: int
    name: str
    value: float
    kind: int


class Stream(Enum):
    """A message that vehicles are asked for; the value is its MAVLink name."""

    POSITION = "GLOBAL_POSITION_INT"
    FIRST_RECEIVER = "GPS_RAW_INT"
    SECOND_RECEIVER = "GPS2_RAW"
    ATTITUDE = "ATTITUDE"
    AIRSPEED = "VFR_HUD"
    SYSTEM_HEALTH = "SYS_STATUS"
    EKF_STATUS = "EKF_STATUS_REPORT"
    ESTIMATOR_STATUS = "ESTIMATOR_STATUS"
    SYSTEM_TIME = "SYSTEM_TIME"
    PRESSURE = "SCALED_PRESSURE"
    RECEIVER_INTEGRITY = "GNSS_INTEGRITY"
    VTOL_STATE = "EXTENDED_SYS_STATE"


@dataclass(frozen=True, slots=True)
class StreamRequest:
    """COMMAND_LONG MAV_CMD_SET_MESSAGE_INTERVAL (511): asks one vehicle for one message at one rate."""

    sysid: int
    stream: Stream
    interval_us: int


@dataclass(frozen=True, slots=True)
class TimeSyncRequest:
    """TIMESYNC (111) with tc1 0: requests an autopilot's clock. Without a target: for its address alone."""

    sysid: int
    ts1_ns: int


@dataclass(frozen=True, slots=True)
class Notice:
    """A line for the operator: what happened to a vehicle, or to the fleet (`sysid` None)."""

    at_s: float
    sysid: int | None
    level: str
    text: str


@dataclass(frozen=True, slots=True)
class HealthChanged:
    """The GPS health of a vehicle went from one `GpsState` value to another, with the reason in words."""

    at_s: float
    sysid: int
    before: str
    after: str
    reason: str


AidingMessage = GpsInput | ExternalPosition | GlobalPositionSensor | VisionPosition | RangingBeacon
"""What tells a vehicle where it is, or how far from where."""

ToVehicle = AidingMessage | StreamRequest | TimeSyncRequest | ParameterRequest | ParameterSet | OriginRequest | SensorEnable
ChangesVehicle = AidingMessage | ParameterSet | SensorEnable
"""What changes what a vehicle does. All else that is sent asks it something, and two services may ask."""
Untargeted = GpsInput | GlobalPositionSensor | VisionPosition | RangingBeacon | TimeSyncRequest
"""What every vehicle takes whom it reaches: it has no target, or PX4 ignores it."""
ToOperator = Notice | HealthChanged
Outbound = ToVehicle | ToOperator
