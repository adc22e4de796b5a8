"""What is heard about aid: answers to commands and parameters, and GPS_INPUT that somebody else sends. As `inbound`."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from gcs_coloc.core.messages.aiding import CommandResult, ForeignGpsInput, ParameterValue
from gcs_coloc.mavlink.checks import InvalidValueError
from gcs_coloc.mavlink.dialect import MESSAGE_CLASSES
from gcs_coloc.mavlink.framing import RawFrame
from gcs_coloc.mavlink.refusals import Field


def command_ack(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> CommandResult:
    """COMMAND_ACK (77)."""
    command, result, *_ = values
    return CommandResult(sysid, received_at_s, command, result)


def param_value(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> ParameterValue | None:
    """PARAM_VALUE (22), integers as ArduPilot sends them: their value as a float. None for others' that are no number so."""
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
    """GPS_INPUT (232) from somebody else. Whom it reaches, only the address tells that it came from."""
    gps_id = values[15]
    return ForeignGpsInput(sysid, received_at_s, gps_id)
