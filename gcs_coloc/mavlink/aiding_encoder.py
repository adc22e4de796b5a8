"""The ways to aid besides GPS_INPUT, and parameters, to pymavlink's messages. All are addressed to the vehicle's autopilot."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.messages.aiding import ExternalPosition, GlobalPositionSensor, ParameterRequest, ParameterSet
from gcs_coloc.core.messages.outbound import GpsInput

SENSOR_ID = 1
"""The id of our GLOBAL_POSITION_SENSOR, by which PX4's EKF2_AGPn_ID selects it."""
_BY_NAME = -1


def wire_message(message: ExternalPosition | GlobalPositionSensor | ParameterRequest | ParameterSet) -> Any:
    """The message of pymavlink's. ValueError where a number in it is not finite or impossible."""
    if isinstance(message, ExternalPosition):
        return _external_position(message)
    if isinstance(message, GlobalPositionSensor):
        return _global_position_sensor(message)
    target = (message.sysid, mavlink.MAV_COMP_ID_AUTOPILOT1)
    if isinstance(message, ParameterRequest):
        return mavlink.MAVLink_param_request_read_message(*target, message.name.encode(), _BY_NAME)
    if not math.isfinite(message.value):
        raise ValueError("PARAM_SET cannot be encoded: the value is not finite")
    return mavlink.MAVLink_param_set_message(*target, message.name.encode(), message.value, message.kind)


def require_place(place: GpsInput | ExternalPosition | GlobalPositionSensor, name: str) -> None:
    """ValueError where a field of a message with a latitude and a longitude is not finite, or they are no place on earth."""
    for field in place.__dataclass_fields__:
        if not math.isfinite(getattr(place, field)):
            raise ValueError(f"{name} cannot be encoded: {field} is not finite")
    if abs(place.lat_deg) > 90.0 or abs(place.lon_deg) > 180.0:
        raise ValueError(f"{name} cannot be encoded: {place.lat_deg}, {place.lon_deg} is no latitude and longitude")


def _external_position(place: ExternalPosition) -> Any:
    """COMMAND_INT (75) MAV_CMD_EXTERNAL_POSITION_ESTIMATE; ArduPilot refuses it with an altitude."""
    require_place(place, "MAV_CMD_EXTERNAL_POSITION_ESTIMATE")
    return mavlink.MAVLink_command_int_message(
        target_system=place.sysid,
        target_component=mavlink.MAV_COMP_ID_AUTOPILOT1,
        frame=mavlink.MAV_FRAME_GLOBAL,
        command=mavlink.MAV_CMD_EXTERNAL_POSITION_ESTIMATE,
        current=0,
        autocontinue=0,
        param1=place.sent_s,
        param2=0.0,
        param3=place.accuracy_m,
        param4=0.0,
        x=round(place.lat_deg * 1e7),
        y=round(place.lon_deg * 1e7),
        z=math.nan,
    )


def _global_position_sensor(place: GlobalPositionSensor) -> Any:
    """GLOBAL_POSITION_SENSOR (296); PX4 refuses it with an eph of 0."""
    require_place(place, "GLOBAL_POSITION_SENSOR")
    if place.eph_m <= 0.0:
        raise ValueError("GLOBAL_POSITION_SENSOR cannot be encoded: eph_m must be above 0")
    return mavlink.MAVLink_global_position_sensor_message(
        target_system=place.sysid,
        target_component=mavlink.MAV_COMP_ID_AUTOPILOT1,
        id=SENSOR_ID,
        time_usec=place.time_usec,
        processing_time=0,
        source=mavlink.GLOBAL_POSITION_SRC_PSEUDOLITES,
        flags=0,
        lat=round(place.lat_deg * 1e7),
        lon=round(place.lon_deg * 1e7),
        alt_ellipsoid=math.nan,
        alt=place.alt_msl_m,
        eph=place.eph_m,
        epv=place.epv_m,
    )
