"""Checks of ArduPilot's parameters: it uses GPS_INPUT when its receiver fails, and only then."""

from __future__ import annotations

from collections.abc import Iterator

from gcs_coloc.core.aiding.fix_policy import EkfGates
from gcs_coloc.core.aiding.methods.gps_input import DELAY_MS
from gcs_coloc.core.aiding.settings import AidingMethodName, AidingSettings
from gcs_coloc.doctor import parameters as p
from gcs_coloc.doctor.finding import Finding, Setup, Severity, VehicleSurvey, note, right, stop
from gcs_coloc.doctor.parameters import ParameterRule, apply_rules, differs_from, equals, look_up

_TYPE_NONE, _TYPE_AUTO, _TYPE_MAVLINK = 0.0, 1.0, 14.0  # values of GPS1_TYPE; source: ArduPilot's parameter list
_AUTO_SWITCH_WRONG = {
    0.0: "it stays with GPS_PRIMARY for ever: what is sent to it is not used when its receiver fails",
    1.0: "it may leave a healthy receiver for what is sent to it",
    2.0: "it blends its own receiver with what is sent to it",
}
_PRIMARY_UNLESS_NO_FIX = 4.0  # of GPS_AUTO_SWITCH; same source
_SOURCE_NONE, _SOURCE_BAROMETER, _SOURCE_GPS = 0.0, 1.0, 3.0  # of EK3_SRC1_*; same source
_EKF3 = 3.0  # of AHRS_EKF_TYPE; same source
_ARMS_AFTER = "10 to 30 s after"  # measured on real ArduPlanes and ArduCopters, with all checks
_DELAY_MS = 100.0  # measured: with it, and data 0.1 s old, EKF3 does not trail


def check(vehicle: VehicleSurvey, setup: Setup, method: AidingMethodName) -> Iterator[Finding]:
    """Check the parameters that the vehicle sent.

    Values and meanings: ArduPilot's parameter lists of 4.5 to 4.7.
    """
    yield from _senders(vehicle, setup)
    aid = setup.aiding
    if method == "external_position":
        yield right("it is aided by MAV_CMD_EXTERNAL_POSITION_ESTIMATE alone, which needs no GPS parameter")
    else:
        yield from apply_rules(vehicle.parameters, (*_receiver_rules(aid.gps_id), _delay_rule(aid.gps_id)))
        yield from _arming(vehicle, aid)
    yield from _filter(vehicle, method)


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


def _receiver_rules(fed: int) -> tuple[ParameterRule, ...]:
    """The rules for the receivers, where GPS_INPUT goes to the instance `fed`."""
    own = 1 - fed
    lacking = "its firmware lacks it"
    return (
        ParameterRule(
            p.GPS_TYPE[fed],
            equals(_TYPE_MAVLINK),
            Severity.STOP,
            "it does not take GPS_INPUT as that receiver",
            set_to=_TYPE_MAVLINK,
            good="it takes GPS_INPUT as a receiver",
            unreadable=lacking,
        ),
        ParameterRule(
            p.GPS_TYPE[own],
            differs_from(_TYPE_MAVLINK),
            Severity.STOP,
            "its own receiver is switched off, and what is sent to it is its only one",
            set_to=_TYPE_AUTO,
            remedy_more=", or its receiver's type",
        ),
        ParameterRule(
            p.GPS_TYPE[own],
            differs_from(_TYPE_NONE),
            Severity.NOTE,
            "it has no receiver of its own; it can be located, and helps nobody to be",
        ),
        ParameterRule(
            p.GPS_AUTO_SWITCH,
            equals(_PRIMARY_UNLESS_NO_FIX),
            Severity.STOP,
            lambda value: _AUTO_SWITCH_WRONG.get(value, "that is not what was tested"),
            set_to=_PRIMARY_UNLESS_NO_FIX,
            good="its own receiver is used while it has a fix, then ours",
            unreadable=lacking,
        ),
        ParameterRule(
            p.GPS_PRIMARY,
            equals(float(own)),
            Severity.STOP,
            "what is sent to it comes first",
            set_to=float(own),
            good="its own receiver comes first",
            unreadable=lacking,
        ),
    )


_FILTER_RULES = (
    ParameterRule(p.EKF_TYPE, equals(_EKF3), Severity.NOTE, "it does not fly on EKF3; nothing else was tested", set_to=_EKF3),
    ParameterRule(
        p.POSITION_SOURCE, equals(_SOURCE_GPS), Severity.STOP, "its position does not come from GPS", set_to=_SOURCE_GPS
    ),
    ParameterRule(p.VELOCITY_SOURCE, equals(_SOURCE_GPS), Severity.NOTE, "its velocity does not come from GPS"),
    ParameterRule(
        p.VERTICAL_VELOCITY_SOURCE,
        equals(_SOURCE_NONE),
        Severity.NOTE,
        "it fuses a receiver's vertical velocity, which makes its altitude swing by metres; ours is marked as to be ignored, "
        "and that holds only until another program feeds that receiver",
        set_to=_SOURCE_NONE,
    ),
    ParameterRule(
        p.HEIGHT_SOURCE,
        differs_from(_SOURCE_GPS),
        Severity.NOTE,
        "it flies on the GPS height, and so on the one that we compute, which no alert limit guards",
        set_to=_SOURCE_BAROMETER,
        remedy_more=", its barometer",
    ),
)


def _arming(vehicle: VehicleSurvey, aid: AidingSettings) -> Iterator[Finding]:
    fed = look_up(vehicle.parameters, p.GPS_TYPE[aid.gps_id])
    if vehicle.armed or fed is None or fed[1] != _TYPE_MAVLINK:
        return
    healthy = f'{_ARMS_AFTER} the stream began; before, it says "GPS {aid.gps_id + 1}: not healthy"'
    if aid.standby:
        yield right(f"{fed[0]} = 14, standby = true in [aiding]: it arms {healthy}")
        return
    yield note(
        f"{fed[0]} = 14: it does not arm while nothing is sent to that receiver",
        f"set standby = true in [aiding] of gcs-coloc, with which it arms {healthy}; or arm it first and set {fed[0]} then",
    )


def _delay_rule(fed: int) -> ParameterRule:
    return ParameterRule(
        DELAY_MS[fed],
        equals(_DELAY_MS),
        Severity.NOTE,
        lambda ms: (
            "its driver announces 0.2 s, and EKF3 uses as much of it as its buffer has room for: what is sent is timed by lag_s "
            "of [aiding]"
            if ms == 0.0
            else f"what is sent is timed for {ms / 1e3:g} s; EKF3 may use less, as its buffer is sized at boot"
        ),
        set_to=_DELAY_MS,
    )


def _filter(vehicle: VehicleSurvey, way: AidingMethodName) -> Iterator[Finding]:
    yield from apply_rules(vehicle.parameters, _FILTER_RULES)
    checks, scale = look_up(vehicle.parameters, p.GPS_CHECK), look_up(vehicle.parameters, p.CHECK_SCALE)
    if checks is None or scale is None:
        return
    gates, limits = EkfGates(int(checks[1]), scale[1]), []
    if gates.most_position_m is not None:
        limits.append("{:g} m horizontally, {:g} m vertically".format(*gates.most_position_m))
    if gates.most_speed_mps is not None:
        limits.append(f"{gates.most_speed_mps:g} m/s")
    aligns = f"up to 1-sigma of {' and '.join(limits)}" if limits else "however coarse they say they are"
    coarser = ", and until then coarser ones go by MAV_CMD_EXTERNAL_POSITION_ESTIMATE too" if limits and way == "auto" else ""
    aligned = f"; once aligned it fuses any accuracy{coarser}" if limits else ""
    yield right(f"{checks[0]} = {checks[1]:g}, {scale[0]} = {scale[1]:g}: it aligns on GPS positions {aligns}{aligned}")
