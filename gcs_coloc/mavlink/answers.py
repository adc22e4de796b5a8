"""Answers of vehicles to our requests, and GPS_INPUT of somebody else, to the core's messages: functions as in `inbound`."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.messages.control import ForeignGpsInput
from gcs_coloc.core.messages.inbound import CommandOutcome, CommandResult, ParameterValue, TimeSyncAnswer, VehicleCommand
from gcs_coloc.mavlink.checks import InvalidValueError
from gcs_coloc.mavlink.framing import MESSAGE_CLASSES, RawFrame
from gcs_coloc.mavlink.refusals import Field

_COMMANDS = {mavlink.MAV_CMD_EXTERNAL_POSITION_ESTIMATE: VehicleCommand.EXTERNAL_POSITION_ESTIMATE}
_OUTCOMES = {
    mavlink.MAV_RESULT_ACCEPTED: CommandOutcome.ACCEPTED,
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: CommandOutcome.TEMPORARILY_REJECTED,
    mavlink.MAV_RESULT_DENIED: CommandOutcome.DENIED,
    mavlink.MAV_RESULT_UNSUPPORTED: CommandOutcome.UNSUPPORTED,
    mavlink.MAV_RESULT_FAILED: CommandOutcome.FAILED,
    mavlink.MAV_RESULT_IN_PROGRESS: CommandOutcome.IN_PROGRESS,
}


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
    """PARAM_VALUE (22), integers as ArduPilot sends them, as floats. None where another encoding makes that no number."""
    value, _count, _index, name, kind = values
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
    """GPS_INPUT (232) from somebody else. It has no target field: it reaches every vehicle at the address it came from."""
    gps_id = values[15]
    return ForeignGpsInput(sysid, received_at_s, gps_id)
