"""What a vehicle does with what it is sent: parameters, commands, TIMESYNC, GPS_INPUT. Each datagram is parsed by itself.

Faults at run time, on one vehicle: PARAM_SET of SITL's own names (SIM_GPS1_ENABLE=0, SIM_GPS1_JAM=1, SIM_GPS1_GLTCH_X/Y), or
COMMAND_LONG MAV_CMD_USER_1 (31010) as `fault_of_command` reads it.
"""

from __future__ import annotations

import math
from typing import Any

from pydantic import ValidationError
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fakes.fault_commands import fault_of_command
from sitl_fakes.flight_controller import FlightController
from sitl_fakes.gps_input import fix_from_gps_input
from sitl_fakes.telemetry import build

_EXTERNAL_POSITION_ESTIMATE = 43003
_ONLY_THE_GCS = 1
_LARGEST_PARAMETER = 1e6
_ACCEPTED, _DENIED, _UNSUPPORTED, _FAILED = 0, 2, 3, 4


def handle(vehicle: FlightController, payload: bytes, at_s: float) -> list[Any]:
    """Obey one datagram and return the messages to answer with. What is not MAVLink, or not for this vehicle, is passed over."""
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    replies: list[Any] = []
    for message in parser.parse_buffer(payload) or []:
        if message.get_type() in _HANDLERS and _accepts(vehicle, message):
            replies += _HANDLERS[message.get_type()](vehicle, message, at_s)
    return replies


def _accepts(vehicle: FlightController, message: Any) -> bool:
    """Whether the message is for this vehicle and from someone it listens to (MAV_OPTIONS bit 0)."""
    if getattr(message, "target_system", 0) not in (0, vehicle.sysid):
        return False
    allowed = (vehicle.params["MAV_GCS_SYSID"], vehicle.sysid)
    return not int(vehicle.params["MAV_OPTIONS"]) & _ONLY_THE_GCS or message.get_srcSystem() in allowed


def _gps_input(vehicle: FlightController, message: Any, at_s: float) -> list[Any]:
    fix = fix_from_gps_input(message, vehicle.frame)
    if fix is not None:
        vehicle.autopilot.receive_gps_input(message.gps_id, fix, at_s)
    return []


def _timesync(vehicle: FlightController, message: Any, at_s: float) -> list[Any]:
    return [mavlink.MAVLink_timesync_message(round(vehicle.clock.boot_s(at_s) * 1e9), message.ts1)] if message.tc1 == 0 else []


def _param_value(vehicle: FlightController, name: str) -> Any:
    names = list(vehicle.params)
    value, kind = vehicle.params[name], vehicle.params.type_of(name)
    return mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(names), names.index(name))


def _param_request_list(vehicle: FlightController, _message: Any, _at_s: float) -> list[Any]:
    return [_param_value(vehicle, name) for name in vehicle.params]


def _param_request_read(vehicle: FlightController, message: Any, _at_s: float) -> list[Any]:
    names = list(vehicle.params)
    if message.param_index >= 0:
        return [_param_value(vehicle, names[message.param_index])] if message.param_index < len(names) else []
    return [_param_value(vehicle, message.param_id)] if message.param_id in vehicle.params else []


def _param_set(vehicle: FlightController, message: Any, _at_s: float) -> list[Any]:
    if message.param_id not in vehicle.params or not abs(message.param_value) <= _LARGEST_PARAMETER:
        return []
    vehicle.params.set(message.param_id, message.param_value)
    return [_param_value(vehicle, message.param_id)]


def _command_long(vehicle: FlightController, message: Any, at_s: float) -> list[Any]:
    if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
        return [_ack(message, _set_interval(vehicle, message, at_s))]
    if message.command == mavlink.MAV_CMD_REQUEST_MESSAGE:
        built = build(int(message.param1), vehicle.snapshot(at_s)) if math.isfinite(message.param1) else None
        return [_ack(message, _FAILED)] if built is None else [_ack(message, _ACCEPTED), built]
    if message.command == mavlink.MAV_CMD_USER_1:
        return [_ack(message, _user_fault(vehicle, message, at_s))]
    return [_ack(message, _UNSUPPORTED)]


def _command_int(vehicle: FlightController, message: Any, at_s: float) -> list[Any]:
    if message.command == _EXTERNAL_POSITION_ESTIMATE:
        return [_ack(message, _external_position(vehicle, message, at_s))]
    if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
        return [_ack(message, _set_interval(vehicle, message, at_s))]
    return [_ack(message, _UNSUPPORTED)]


def _set_interval(vehicle: FlightController, message: Any, at_s: float) -> int:
    if not math.isfinite(message.param1):
        return _FAILED
    return _ACCEPTED if vehicle.streams.set_interval(int(message.param1), message.param2, at_s) else _FAILED


def _external_position(vehicle: FlightController, message: Any, at_s: float) -> int:
    """MAV_CMD_EXTERNAL_POSITION_ESTIMATE: taken only while dead reckoning, and only with an altitude of NaN."""
    lat_deg, lon_deg, accuracy_m = message.x * 1e-7, message.y * 1e-7, message.param3
    if not math.isnan(message.z) or abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0:
        return _DENIED
    if vehicle.autopilot.source(at_s) not in ("dead_reckoning", "none"):
        return _FAILED
    east, north, _ = vehicle.frame.to_enu(lat_deg, lon_deg, vehicle.altitude_m)
    vehicle.autopilot.navigation.take_estimate((east, north), accuracy_m if math.isfinite(accuracy_m) else 0.0)
    return _ACCEPTED


def _user_fault(vehicle: FlightController, message: Any, at_s: float) -> int:
    if message.param1 == 0.0:
        vehicle.faults.clear(at_s)
        return _ACCEPTED
    try:
        fault = fault_of_command(vehicle.sysid, [getattr(message, f"param{i}") for i in range(1, 8)], at_s)
    except (ValidationError, OverflowError):
        fault = None
    if fault is None:
        return _DENIED
    vehicle.faults.add(fault)
    return _ACCEPTED


def _ack(message: Any, result: int) -> Any:
    return mavlink.MAVLink_command_ack_message(
        message.command, result, target_system=message.get_srcSystem(), target_component=message.get_srcComponent()
    )


_HANDLERS = {
    "GPS_INPUT": _gps_input,
    "TIMESYNC": _timesync,
    "PARAM_REQUEST_LIST": _param_request_list,
    "PARAM_REQUEST_READ": _param_request_read,
    "PARAM_SET": _param_set,
    "COMMAND_LONG": _command_long,
    "COMMAND_INT": _command_int,
}
