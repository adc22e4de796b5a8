"""Convert the answers of vehicles, and GPS_INPUT from another sender, to the core's messages.

Its functions take and return the same as those of `inbound`.
"""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.messages.control import ForeignGpsInput
from gcs_coloc.core.messages.inbound import (
    CommandOutcome,
    CommandResult,
    GlobalOrigin,
    ParameterValue,
    TimeSyncAnswer,
    VehicleCommand,
)
from gcs_coloc.mavlink import checks
from gcs_coloc.mavlink.checks import InvalidValueError
from gcs_coloc.mavlink.framing import MESSAGE_CLASSES, RawFrame
from gcs_coloc.mavlink.refusals import Field

ESTIMATOR_SENSOR_ENABLE = 43006
"""MAV_CMD_ESTIMATOR_SENSOR_ENABLE of development.xml, which no dialect of pymavlink's has yet."""
_COMMANDS = {
    mavlink.MAV_CMD_EXTERNAL_POSITION_ESTIMATE: VehicleCommand.EXTERNAL_POSITION_ESTIMATE,
    ESTIMATOR_SENSOR_ENABLE: VehicleCommand.ESTIMATOR_SENSOR_ENABLE,
}
_OUTCOMES = {
    mavlink.MAV_RESULT_ACCEPTED: CommandOutcome.ACCEPTED,
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: CommandOutcome.TEMPORARILY_REJECTED,
    mavlink.MAV_RESULT_DENIED: CommandOutcome.DENIED,
    mavlink.MAV_RESULT_UNSUPPORTED: CommandOutcome.UNSUPPORTED,
    mavlink.MAV_RESULT_FAILED: CommandOutcome.FAILED,
    mavlink.MAV_RESULT_IN_PROGRESS: CommandOutcome.IN_PROGRESS,
}

_INTEGER_KINDS = range(mavlink.MAV_PARAM_TYPE_UINT8, mavlink.MAV_PARAM_TYPE_INT32 + 1)
_LEAST_NORMAL = 2.0**-126
"""The least normal number of a float of 32 bits (IEEE 754)."""
_LEAST_BYTES_OF_A_NUMBER = 1 << 23  # as an integer


def timesync(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> TimeSyncAnswer | None:
    """TIMESYNC (111); None where it is the sender's own request (tc1 0), which others may answer."""
    tc1_ns, ts1_ns = values
    if tc1_ns == 0:
        return None
    if tc1_ns < 0:
        raise InvalidValueError(Field.TC1)
    return TimeSyncAnswer(sysid=sysid, received_at_s=received_at_s, ts1_ns=ts1_ns, tc1_ns=tc1_ns)


def command_ack(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> CommandResult:
    """COMMAND_ACK (77)."""
    command, result, *_ = values
    outcome = _OUTCOMES.get(result, CommandOutcome.OTHER)
    return CommandResult(sysid, received_at_s, _COMMANDS.get(command, VehicleCommand.OTHER), outcome)


def param_value(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> ParameterValue | None:
    """PARAM_VALUE (22); None where the value is no number.

    ArduPilot sends an integer as a float, PX4 sends its four bytes in the place of the float's.
    The bytes of an integer below 2^23 are a subnormal float, those of a negative one NaN: a whole number as a float is neither.
    """
    value, _count, _index, name, kind = values
    if kind in _INTEGER_KINDS and (math.isnan(value) or 0.0 < abs(value) < _LEAST_NORMAL):
        (number,) = struct.unpack("<i", struct.pack("<f", value))
        value = float(number) if abs(number) < _LEAST_BYTES_OF_A_NUMBER else math.nan
    if not math.isfinite(value):
        return None
    try:
        text = name.partition(b"\0")[0].decode("ascii")
    except UnicodeDecodeError:
        raise InvalidValueError(Field.PARAM_ID) from None
    return ParameterValue(sysid, received_at_s, text, value, kind)


def foreign_gps_input(raw: RawFrame, received_at_s: float, vehicle: int) -> ForeignGpsInput:
    """A frame of GPS_INPUT (232) that is on its way to a vehicle."""
    unpacker = MESSAGE_CLASSES[raw.message_id].unpacker
    message = gps_input(raw.sysid, received_at_s, unpacker.unpack_from(raw.payload.ljust(unpacker.size, b"\0")))
    return replace(message, vehicle=vehicle)


def gps_input(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> ForeignGpsInput:
    """GPS_INPUT (232) from another sender.

    It has no target field: it reaches every vehicle at the address it came from.
    """
    gps_id = values[15]
    return ForeignGpsInput(sysid, received_at_s, gps_id)


def gps_global_origin(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> GlobalOrigin:
    """GPS_GLOBAL_ORIGIN (49)."""
    lat_e7, lon_e7, alt_mm, *_ = values
    return GlobalOrigin(sysid, received_at_s, *checks.latitude_longitude_deg(lat_e7, lon_e7), checks.altitude_m(alt_mm))
