"""Whether an ArduPilot vehicle's parameters let it take GPS_INPUT when its receiver fails, and only then."""

from __future__ import annotations

from collections.abc import Iterator

from gcs_coloc.core.aiding.ekf_gates import EkfGates
from gcs_coloc.core.aiding.method_choice import method_for
from gcs_coloc.core.aiding.settings import AidingMethodName, AidingSettings
from gcs_coloc.doctor import parameters as p
from gcs_coloc.doctor.finding import Finding, Setup, VehicleSurvey, note, right, stop
from gcs_coloc.doctor.parameters import look_up

_TYPE_NONE, _TYPE_AUTO, _TYPE_MAVLINK = 0.0, 1.0, 14.0
_AUTO_SWITCH_WRONG = {
    0.0: "it stays with GPS_PRIMARY for ever: what is sent to it is not used when its receiver fails",
    1.0: "it may leave a healthy receiver for what is sent to it",
    2.0: "it blends its own receiver with what is sent to it",
}
_PRIMARY_UNLESS_NO_FIX = 4.0
_SOURCE_GPS, _SOURCE_BAROMETER = 3.0, 1.0
_EKF3 = 3.0
_DRIVER_DELAY_S = 0.2


def check(vehicle: VehicleSurvey, setup: Setup) -> Iterator[Finding]:
    """Judge the parameters that the vehicle told. Values and meanings: ArduPilot's parameter lists of 4.5 to 4.7."""
    yield from _senders(vehicle, setup)
    aid = setup.aiding
    if method_for(vehicle.sysid, vehicle.autopilot, aid) == "external_position":
        yield right("it is aided by MAV_CMD_EXTERNAL_POSITION_ESTIMATE alone, which needs no GPS parameter")
    else:
        yield from _receivers(vehicle, aid.gps_id)
        yield from _delay(vehicle, aid.gps_id, aid.lag_s)
        yield from _arming(vehicle, aid)
    yield from _filter(vehicle, method_for(vehicle.sysid, vehicle.autopilot, aid))


def _senders(vehicle: VehicleSurvey, setup: Setup) -> Iterator[Finding]:
    option = look_up(vehicle.parameters, p.SENDERS_OPTION)
    lowest = look_up(vehicle.parameters, p.GCS_SYSID)
    if option is None or lowest is None:
        return
    if not int(option[1]) & 1:
        yield right(f"{option[0]} = {option[1]:g}: it listens to every system id")
        return
    highest = max(lowest[1], (look_up(vehicle.parameters, p.GCS_SYSID_HIGH) or lowest)[1])
    if lowest[1] <= setup.system_id <= highest:
        yield right(f"{option[0]} = {option[1]:g}, {lowest[0]} = {lowest[1]:g}: it listens to us, {setup.system_id}")
        return
    yield stop(
        f"{option[0]} = {option[1]:g}: it listens to {lowest[0]} = {lowest[1]:g} only, and we are {setup.system_id}",
        f"set system_id = {lowest[1]:g} in [mavlink] of gcs-coloc, or {option[0]} = {int(option[1]) & ~1} on the vehicle",
    )


def _receivers(vehicle: VehicleSurvey, fed: int) -> Iterator[Finding]:
    own = 1 - fed
    yield from _wanted(
        vehicle, p.GPS_TYPE[fed], _TYPE_MAVLINK, "it takes GPS_INPUT as a receiver", "it does not take GPS_INPUT as that receiver"
    )
    own_type = look_up(vehicle.parameters, p.GPS_TYPE[own])
    if own_type is not None and own_type[1] == _TYPE_MAVLINK:
        yield stop(
            f"{own_type[0]} = 14: its own receiver is switched off, and what is sent to it is its only one",
            f"set {own_type[0]} = {_TYPE_AUTO:g}, or its receiver's type",
            (own_type[0], _TYPE_AUTO),
        )
    elif own_type is not None and own_type[1] == _TYPE_NONE:
        yield note(f"{own_type[0]} = 0: it has no receiver of its own; it can be located, and helps nobody to be")
    switch = look_up(vehicle.parameters, p.GPS_AUTO_SWITCH)
    wrong = _AUTO_SWITCH_WRONG.get(switch[1], "that is not what was tested") if switch is not None else ""
    yield from _wanted(
        vehicle, p.GPS_AUTO_SWITCH, _PRIMARY_UNLESS_NO_FIX, "its own receiver is used while it has a fix, then ours", wrong
    )
    yield from _wanted(vehicle, p.GPS_PRIMARY, float(own), "its own receiver comes first", "what is sent to it comes first")


def _wanted(vehicle: VehicleSurvey, names: tuple[str, ...], value: float, good: str, bad: str) -> Iterator[Finding]:
    found = look_up(vehicle.parameters, names)
    if found is None:
        yield stop(f"{names[0]} could not be read", "run the doctor again, nearer to the vehicle; else its firmware lacks it")
    elif found[1] == value:
        yield right(f"{found[0]} = {value:g}: {good}")
    else:
        yield stop(f"{found[0]} = {found[1]:g}: {bad}", f"set {found[0]} = {value:g}", (found[0], value))


def _arming(vehicle: VehicleSurvey, aid: AidingSettings) -> Iterator[Finding]:
    if vehicle.armed or aid.standby:
        return
    fed = look_up(vehicle.parameters, p.GPS_TYPE[aid.gps_id])
    if fed is not None and fed[1] == _TYPE_MAVLINK:
        yield note(
            f"{fed[0]} = 14: it does not arm while nothing is sent to that receiver",
            f"set standby = true in [aiding] of gcs-coloc, or arm it first and set {fed[0]} then",
        )


def _delay(vehicle: VehicleSurvey, fed: int, lag_s: float) -> Iterator[Finding]:
    found = look_up(vehicle.parameters, p.GPS_DELAY_MS[fed])
    if found is None:
        return
    assumed_s = found[1] / 1e3 or _DRIVER_DELAY_S
    if abs(assumed_s - lag_s) > 0.01:
        yield note(
            f"{found[0]} = {found[1]:g}: GPS_INPUT is taken to be {assumed_s:g} s old, what we send is of {lag_s:g} s ago",
            f"set lag_s = {assumed_s:g} in [aiding] of gcs-coloc",
        )


def _filter(vehicle: VehicleSurvey, way: AidingMethodName) -> Iterator[Finding]:
    ekf = look_up(vehicle.parameters, p.EKF_TYPE)
    if ekf is not None and ekf[1] != _EKF3:
        yield note(
            f"{ekf[0]} = {ekf[1]:g}: it does not fly on EKF3; nothing else was tested", f"set {ekf[0]} = 3", (ekf[0], _EKF3)
        )
    source = look_up(vehicle.parameters, p.POSITION_SOURCE)
    if source is not None and source[1] != _SOURCE_GPS:
        yield stop(f"{source[0]} = {source[1]:g}: its position does not come from GPS", f"set {source[0]} = 3", (source[0], 3.0))
    velocity = look_up(vehicle.parameters, p.VELOCITY_SOURCE)
    if velocity is not None and velocity[1] != _SOURCE_GPS:
        yield note(f"{velocity[0]} = {velocity[1]:g}: its velocity does not come from GPS")
    height = look_up(vehicle.parameters, p.HEIGHT_SOURCE)
    if height is not None and height[1] == _SOURCE_GPS:
        yield note(
            f"{height[0]} = {height[1]:g}: it flies on the height that GPS tells, and so on the one that we work out, "
            "which no alert limit guards",
            f"set {height[0]} = {_SOURCE_BAROMETER:g}, its barometer",
            (height[0], _SOURCE_BAROMETER),
        )
    checks, scale = look_up(vehicle.parameters, p.GPS_CHECK), look_up(vehicle.parameters, p.CHECK_SCALE)
    if checks is None or scale is None:
        return
    gates, limits = EkfGates(int(checks[1]), scale[1]), []
    if gates.most_position_m is not None:
        limits.append("{:g} m horizontally, {:g} m vertically".format(*gates.most_position_m))
    if gates.most_speed_mps is not None:
        limits.append(f"{gates.most_speed_mps:g} m/s")
    taken = f"up to 1-sigma of {' and '.join(limits)}" if limits else "however coarse they say they are"
    coarser = "; what is coarser goes by MAV_CMD_EXTERNAL_POSITION_ESTIMATE" if limits and way == "auto" else ""
    yield right(f"{checks[0]} = {checks[1]:g}, {scale[0]} = {scale[1]:g}: GPS positions are taken {taken}{coarser}")
