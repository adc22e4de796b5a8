"""What a vehicle does with what it is sent: parameters, commands, TIMESYNC, positions from outside.

Each datagram stands alone.

Faults at run time, on one vehicle: PARAM_SET of SITL's own names (SIM_GPS1_ENABLE=0, SIM_GPS1_JAM=1, SIM_GPS1_GLTCH_X/Y), or
COMMAND_LONG MAV_CMD_USER_1 (31010) as `fault_of_command` reads it.
"""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20 import development

from sitl_fakes.autopilot import ACCEPTED, DENIED, FAILED, TEMPORARILY_REJECTED, UNSUPPORTED, BeaconRange
from sitl_fakes.faults import fault_of_command
from sitl_fakes.flight_controller import FlightController
from sitl_fakes.geodesy import from_px4_local
from sitl_fakes.receivers import fix_from_gps_input

_EXTERNAL_POSITION_ESTIMATE = 43003  # source: MAVLink, common.xml
_ESTIMATOR_SENSOR_ENABLE, _FUSION_SOURCE_GPS, _ENABLE = 43006, 0.0, 1.0  # source: MAVLink, development.xml
_LONGEST_AGE_S = 5.0  # source: EKF3, setLatLng
_ONLY_THE_GCS = 1  # source: MAV_OPTIONS, bit 0
_GLOBAL_FRAMES = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
_LARGEST_PARAMETER = 1e6  # chosen: beyond every parameter in use
_UINT32_UNKNOWN = 0xFFFFFFFF
_OF_ANY_TARGET = ("RANGING_BEACON",)  # PX4's handler looks at no target


def handle(vehicle: FlightController, payload: bytes, at_s: float) -> list[Any]:
    """Execute one datagram's messages and return the answers.

    What is not MAVLink, or for another vehicle, is ignored.
    """
    # RANGING_BEACON is of the development dialect, which PX4 is built with.
    parser = (development if vehicle.kind == "px4" else mavlink).MAVLink(None)
    parser.robust_parsing = True
    replies: list[Any] = []
    for message in parser.parse_buffer(payload) or []:
        if message.get_type() in _HANDLERS and _accepts(vehicle, message):
            replies += _HANDLERS[message.get_type()](vehicle, message, at_s)
    return replies


def _accepts(vehicle: FlightController, message: Any) -> bool:
    """Whether the message is for this vehicle and from someone it listens to (MAV_OPTIONS bit 0)."""
    if getattr(message, "target_system", 0) not in (0, vehicle.sysid) and message.get_type() not in _OF_ANY_TARGET:
        return False
    if not int(vehicle.params.get("MAV_OPTIONS", 0.0)) & _ONLY_THE_GCS:
        return True
    return message.get_srcSystem() in (vehicle.params["MAV_GCS_SYSID"], vehicle.sysid)


def _gps_input(vehicle: FlightController, message: Any, at_s: float) -> list[Any]:
    delay_ms = vehicle.params.get(f"GPS{message.gps_id + 1}_DELAY_MS", 0.0)
    fix = fix_from_gps_input(message, vehicle.frame, delay_ms)
    if fix is not None:
        vehicle.autopilot.receive_gps_input(message.gps_id, fix, at_s)
    return []


def _global_position_sensor(vehicle: FlightController, message: Any, at_s: float) -> list[Any]:
    place = _horizontal_m(vehicle, message.lat, message.lon)
    if place is not None and math.isfinite(message.eph):
        vehicle.autopilot.receive_global_position(message.id, place, message.eph, at_s)
    return []


def _vision_position_estimate(vehicle: FlightController, message: Any, at_s: float) -> list[Any]:
    """Take a VISION_POSITION_ESTIMATE as a PX4 reads it.

    It is north and east of the local frame. The variances are on the diagonal of the covariance.
    """
    origin_m = vehicle.autopilot.origin_m
    if origin_m is not None and math.isfinite(message.x) and math.isfinite(message.y):
        lat_0, lon_0, _ = vehicle.frame.to_lla(*origin_m)
        lat_deg, lon_deg = from_px4_local(lat_0, lon_0, message.x, message.y)
        east, north, _ = vehicle.frame.to_enu(lat_deg, lon_deg, vehicle.altitude_m)
        vehicle.autopilot.receive_vision((east, north), max(message.covariance[0], message.covariance[6]), at_s)
    return []


def _ranging_beacon(vehicle: FlightController, message: Any, at_s: float) -> list[Any]:
    place = _horizontal_m(vehicle, message.lat, message.lon)
    if place is not None and math.isfinite(message.alt) and _UINT32_UNKNOWN not in (message.range, message.range_accuracy):
        stamp_s, below_m = message.time_usec / 1e6, vehicle.altitude_m - message.alt
        range_m, sigma_m, age_s = message.range / 1e3, message.range_accuracy / 1e3, vehicle.clock.boot_s(at_s) - stamp_s
        vehicle.autopilot.receive_range(BeaconRange(place, below_m, range_m, sigma_m, stamp_s, age_s), at_s)
    return []


def _horizontal_m(vehicle: FlightController, lat_e7: int, lon_e7: int) -> tuple[float, float] | None:
    """Return east and north (m) of a latitude and longitude in 1e-7 degrees.

    None where there is no such place.
    """
    lat_deg, lon_deg = lat_e7 * 1e-7, lon_e7 * 1e-7
    if abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0:
        return None
    east, north, _ = vehicle.frame.to_enu(lat_deg, lon_deg, vehicle.altitude_m)
    return east, north


def _timesync(vehicle: FlightController, message: Any, at_s: float) -> list[Any]:
    return [mavlink.MAVLink_timesync_message(round(vehicle.clock.boot_s(at_s) * 1e9), message.ts1)] if message.tc1 == 0 else []


def _param_value(vehicle: FlightController, name: str) -> Any:
    names, params = list(vehicle.params), vehicle.params
    return mavlink.MAVLink_param_value_message(
        name.encode(), params.on_the_wire(name), params.type_of(name), len(names), names.index(name)
    )


def _param_request_list(vehicle: FlightController, _message: Any, _at_s: float) -> list[Any]:
    return [_param_value(vehicle, name) for name in vehicle.params]


def _param_request_read(vehicle: FlightController, message: Any, _at_s: float) -> list[Any]:
    names = list(vehicle.params)
    if message.param_index >= 0:
        return [_param_value(vehicle, names[message.param_index])] if message.param_index < len(names) else []
    return [_param_value(vehicle, message.param_id)] if message.param_id in vehicle.params else []


def _param_set(vehicle: FlightController, message: Any, _at_s: float) -> list[Any]:
    if message.param_id not in vehicle.params:
        return []
    value = vehicle.params.from_the_wire(message.param_id, message.param_value)
    if not abs(value) <= _LARGEST_PARAMETER:
        return []
    vehicle.params.set(message.param_id, value)
    return [_param_value(vehicle, message.param_id)]


def _command_long(vehicle: FlightController, message: Any, at_s: float) -> list[Any]:
    if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
        return [_ack(message, _set_interval(vehicle, message, at_s))]
    if message.command == mavlink.MAV_CMD_REQUEST_MESSAGE:
        built = vehicle.streams.build(int(message.param1), vehicle.snapshot(at_s)) if math.isfinite(message.param1) else None
        return [_ack(message, FAILED)] if built is None else [_ack(message, ACCEPTED), built]
    if message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
        return _arm(vehicle, message, at_s)
    if message.command == _ESTIMATOR_SENSOR_ENABLE and message.param1 == _FUSION_SOURCE_GPS:
        return [_ack(message, vehicle.autopilot.use_own_gps(used=message.param3 == _ENABLE))]
    if message.command == mavlink.MAV_CMD_USER_1:
        return [_ack(message, _user_fault(vehicle, message, at_s))]
    return [_ack(message, UNSUPPORTED)]


def _command_int(vehicle: FlightController, message: Any, at_s: float) -> list[Any]:
    if message.command == _EXTERNAL_POSITION_ESTIMATE:
        return [_ack(message, _external_position(vehicle, message, at_s))]
    if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
        return [_ack(message, _set_interval(vehicle, message, at_s))]
    return [_ack(message, UNSUPPORTED)]


def _set_interval(vehicle: FlightController, message: Any, at_s: float) -> int:
    if not math.isfinite(message.param1):
        return FAILED
    return ACCEPTED if vehicle.streams.set_interval(int(message.param1), message.param2, at_s) else FAILED


def _arm(vehicle: FlightController, message: Any, at_s: float) -> list[Any]:
    """MAV_CMD_COMPONENT_ARM_DISARM. Whoever is armed flies, and is not disarmed in flight."""
    autopilot = vehicle.autopilot
    if message.param1 != 1.0:
        return [_ack(message, FAILED if autopilot.armed else ACCEPTED)]
    refusal = None if autopilot.armed else autopilot.arming_refusal(at_s)
    if refusal is not None:
        result = TEMPORARILY_REJECTED if vehicle.kind == "px4" else FAILED
        return [_ack(message, result), *status_text(refusal)]
    autopilot.armed = True
    return [_ack(message, ACCEPTED)]


def status_text(text: str, severity: int = mavlink.MAV_SEVERITY_CRITICAL) -> list[Any]:
    """STATUSTEXT; what is longer than its field comes in numbered pieces under one id."""
    size, words = 50, text.encode()
    pieces = [words[i : i + size] for i in range(0, len(words), size)]
    number = 1 if len(pieces) > 1 else 0
    return [mavlink.MAVLink_statustext_message(severity, p, number, k) for k, p in enumerate(pieces)]


def _external_position(vehicle: FlightController, message: Any, at_s: float) -> int:
    """Take MAV_CMD_EXTERNAL_POSITION_ESTIMATE and return its MAV_RESULT.

    It was sent at param1 s of the sender's clock after param2 s of work; its 1-sigma is param3 m. The altitude must be NaN, the
    frame a global one. The autopilot decides about the rest.
    """
    place = _horizontal_m(vehicle, message.x, message.y)
    if place is None or not math.isnan(message.z) or message.frame not in _GLOBAL_FRAMES:
        return DENIED
    sent_s = message.param1 if math.isfinite(message.param1) else at_s
    worked_s = message.param2 if math.isfinite(message.param2) else 0.0
    age_s = at_s - vehicle.offboard_clock.to_local_s(sent_s, at_s) + worked_s
    accuracy_m = message.param3 if math.isfinite(message.param3) else None
    return vehicle.autopilot.apply_external_estimate(place, accuracy_m, min(max(age_s, 0.0), _LONGEST_AGE_S), at_s)


def _user_fault(vehicle: FlightController, message: Any, at_s: float) -> int:
    if message.param1 == 0.0:
        vehicle.faults.clear(at_s)
        return ACCEPTED
    try:
        fault = fault_of_command(vehicle.sysid, [getattr(message, f"param{i}") for i in range(1, 8)], at_s)
    except (ValueError, OverflowError):
        fault = None
    if fault is None:
        return DENIED
    vehicle.faults.add(fault)
    return ACCEPTED


def _ack(message: Any, result: int) -> Any:
    return mavlink.MAVLink_command_ack_message(
        message.command, result, target_system=message.get_srcSystem(), target_component=message.get_srcComponent()
    )


_HANDLERS = {
    "GPS_INPUT": _gps_input,
    "GLOBAL_POSITION_SENSOR": _global_position_sensor,
    "VISION_POSITION_ESTIMATE": _vision_position_estimate,
    "RANGING_BEACON": _ranging_beacon,
    "TIMESYNC": _timesync,
    "PARAM_REQUEST_LIST": _param_request_list,
    "PARAM_REQUEST_READ": _param_request_read,
    "PARAM_SET": _param_set,
    "COMMAND_LONG": _command_long,
    "COMMAND_INT": _command_int,
}
