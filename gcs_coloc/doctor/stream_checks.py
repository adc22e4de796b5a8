"""Whether a vehicle's messages come as often as they are wanted, and what to set where they do not."""

from __future__ import annotations

from collections.abc import Iterator

from gcs_coloc.core.messages.inbound import FIX_3D, Autopilot
from gcs_coloc.core.messages.outbound import Stream
from gcs_coloc.core.telemetry.stream_requests import wanted_hz
from gcs_coloc.doctor.finding import Finding, VehicleSurvey, note, right, stop
from gcs_coloc.doctor.parameters import GPS_TYPE, STREAMS, instances, look_up, serial_ports
from gcs_coloc.mavlink.encoder import STREAM_IDS

_RATES_OF = {
    Stream.POSITION: "POSITION",
    Stream.FIRST_RECEIVER: "EXT_STAT",
    Stream.SECOND_RECEIVER: "EXT_STAT",
    Stream.ATTITUDE: "EXTRA1",
    Stream.AIRSPEED: "EXTRA2",
    Stream.SYSTEM_HEALTH: "EXT_STAT",
    Stream.EKF_STATUS: "EXTRA3",
    Stream.SYSTEM_TIME: "EXTRA3",
}
"""Stream -> the end of the name of ArduPilot's stream rate that it belongs to."""
_RATE_HZ = {
    rate: max(hz for stream, hz in wanted_hz(Autopilot.ARDUPILOT).items() if _RATES_OF.get(stream) == rate) for rate in STREAMS
}
_ESSENTIAL = (Stream.POSITION, Stream.FIRST_RECEIVER)
_NO_POSITION = {
    Autopilot.ARDUPILOT: "; if its receiver has a fix, EK3_GPS_CHECK may refuse the accuracy",
    Autopilot.PX4: "; if its receiver has a fix, EKF2_REQ_EPH, EKF2_REQ_EPV or EKF2_REQ_SACC may refuse the accuracy",
}

_PX4_ENOUGH_BYTES_PER_S = 3000.0  # what is wanted takes about 2000, with three ranges at 5 Hz
_PX4_QUIET_MODES = {1.0: "Custom", 3.0: "OSD", 4.0: "Magic", 7.0: "Minimal", 9.0: "Iridium"}
_PX4_ONBOARD = 2.0  # of MAV_n_MODE; source: PX4's parameter reference

_CARRIES = "see whether the link carries as much"

Remedy = tuple[str, tuple[str, float] | None]
"""What to do in words, and the parameter to set where there is but one."""


def check(vehicle: VehicleSurvey) -> Iterator[Finding]:
    """Check the rates that were measured, and the protocol of the vehicle's ports."""
    good = []
    for stream, hz in wanted_hz(vehicle.autopilot).items():
        if stream is Stream.PRESSURE:
            continue  # without it the height is the autopilot's
        if stream is Stream.SECOND_RECEIVER and _has_no_second_receiver(vehicle):
            continue  # there is nothing to tell of it, however fast
        name, number, rate = stream.value, STREAM_IDS[stream], _RATES_OF.get(stream, "")
        rate_hz = vehicle.rates_hz.get(number, 0.0)
        lacking = stop if stream in _ESSENTIAL else note
        if rate_hz >= 0.5 * hz:
            good.append(f"{name} {rate_hz:.0f} Hz")
        elif rate_hz > 0.0:
            yield note(f"{name} comes at {rate_hz:.1f} Hz, {hz:g} Hz are wanted", *_remedy(vehicle, rate))
        elif number in vehicle.empty and stream is Stream.AIRSPEED:
            good.append(f"{name} without an airspeed, as of a vehicle without its sensor")
        elif number in vehicle.empty and stream is Stream.POSITION:
            yield lacking(
                f"{name} holds no position: the autopilot has none yet",
                f"wait for its EKF{_NO_POSITION.get(vehicle.autopilot, '')}",
            )
        elif number in vehicle.empty:
            yield lacking(f"{name} has impossible values and is not used")
        elif stream is Stream.POSITION and _has_no_fix_yet(vehicle):
            yield lacking(
                f"{name} is not heard: a PX4 sends none before the first fix of its receiver, which has none now",
                "wait for its first fix, with its receiver's antenna in the open",
            )
        else:
            yield lacking(f"{name} is not heard", *_remedy(vehicle, rate))
    if good:
        yield right(f"heard: {', '.join(good)}")
    yield from _protocol(vehicle)


def _has_no_fix_yet(vehicle: VehicleSurvey) -> bool:
    """Whether a PX4's receiver is heard and has no fix."""
    is_px4 = vehicle.autopilot is Autopilot.PX4
    return is_px4 and vehicle.receiver is not None and vehicle.receiver.fix_type < FIX_3D


def _has_no_second_receiver(vehicle: VehicleSurvey) -> bool:
    found = look_up(vehicle.parameters, GPS_TYPE[1])
    return found is not None and found[1] == 0.0


def _protocol(vehicle: VehicleSurvey) -> Iterator[Finding]:
    if not vehicle.is_mavlink_1:
        return
    text = "it speaks MAVLink 1 to us, which carries no PEER_RANGE, no signatures, and not the accuracy of its GPS"
    names = [port.protocol_name for port in serial_ports(vehicle.parameters) if port.is_mavlink_1]
    if names:
        yield note(text, f"set {' = 2 or '.join(names)} = 2", (names[0], 2.0) if len(names) == 1 else None)
    else:
        yield note(text, "let its port speak MAVLink 2 (ArduPilot: SERIALn_PROTOCOL = 2; PX4: MAV_PROTO_VER = 2)")


def _remedy(vehicle: VehicleSurvey, stream: str) -> Remedy:
    if vehicle.autopilot is Autopilot.ARDUPILOT:
        return _ardupilot_remedy(vehicle, stream)
    return _px4_remedy(vehicle) if vehicle.autopilot is Autopilot.PX4 else (_CARRIES, None)


def _ardupilot_remedy(vehicle: VehicleSurvey, stream: str) -> Remedy:
    rate_wanted_hz = _RATE_HZ[stream]
    ports = serial_ports(vehicle.parameters)
    rates = [(port, found) for port in ports if (found := look_up(vehicle.parameters, port.rate_names(stream))) is not None]
    if not rates:
        return f"raise SRn_{stream} of its port (MAVn_{stream} since ArduPilot 4.7), or {_CARRIES}", None
    low = [(port, name, rate_hz) for port, (name, rate_hz) in rates if rate_hz < rate_wanted_hz]
    bauds = [
        f"{port.baud_name} = {vehicle.parameters[port.baud_name]:g}" for port in ports if port.baud_name in vehicle.parameters
    ]
    carries = _carries(bauds)
    if not low:
        asked = ", ".join(f"{name} = {rate_hz:g}" for _, (name, rate_hz) in rates)
        return f"{asked} asks for as much: {carries}, and whether another ground station sets other rates", None
    choice = " or ".join(f"{name} = {rate_wanted_hz:g} (SERIAL{port.number}, now {rate_hz:g})" for port, name, rate_hz in low)
    which = ", that of the port we are on" if len(rates) > 1 else ""
    return f"set {choice}{which}; if that does not help, {carries}", (low[0][1], rate_wanted_hz) if len(rates) == 1 else None


def _carries(bauds: list[str]) -> str:
    return f"{_CARRIES} ({', '.join(bauds)})" if bauds else _CARRIES


def _px4_remedy(vehicle: VehicleSurvey) -> Remedy:
    told = vehicle.parameters
    changes: list[tuple[str, float, str]] = []
    bauds: list[str] = []
    for instance in instances(told):
        where = f"TELEM{instance.telem}" if instance.telem is not None else f"instance {instance.number}"
        rate, mode, baud = told.get(instance.rate_name), told.get(instance.mode_name), instance.baud_name
        if rate is not None and 0.0 < rate < _PX4_ENOUGH_BYTES_PER_S:
            changes.append((instance.rate_name, 0.0, f"{where}, now {rate:g} bytes/s; 0 is half of what its baud rate carries"))
        if mode is not None and mode in _PX4_QUIET_MODES:
            changes.append((instance.mode_name, _PX4_ONBOARD, f"{where}, Onboard; now {mode:g}, {_PX4_QUIET_MODES[mode]}"))
        if baud is not None and baud in told:
            bauds.append(f"{baud} = {told[baud]:g}")
    carries = _carries(bauds)
    if not changes:
        return f"{carries}, and MAV_n_RATE and MAV_n_MODE of its instance", None
    listed = ", ".join(f"{name} = {value:g} ({why})" for name, value, why in changes)
    (name, value, _), *others = changes
    return f"set {listed}; if that does not help, {carries}", (name, value) if not others else None
