"""Checks of PX4's parameters: EKF2 fuses the position that is sent by an aiding method."""

from __future__ import annotations

from collections.abc import Iterator

from gcs_coloc.core.aiding.methods.px4_positions import AGP_CONTROL, AGP_ID, AGP_SLOTS, EV_CONTROL, HORIZONTAL, SENSOR_ID
from gcs_coloc.core.aiding.settings import AidingMethodName
from gcs_coloc.doctor import parameters as p
from gcs_coloc.doctor.finding import Finding, Severity, VehicleSurvey, note, stop
from gcs_coloc.doctor.parameters import ParameterRule, apply_rules, equals

_VERTICAL = 2  # bit of either control: the vertical position is fused
_COARSE_RANGE_M = 5.0  # chosen: the default of 30 m makes ranges useless; devices have 0.1 to 5 m
_REBOOT = ", then reboot it"
_OWN_GPS, _VISION, _FIRST_SLOT, _RANGING_BEACON = 0, 3, 4, 12  # source: PX4's parameter reference, bits of EKF2_SENS_EN


def check(vehicle: VehicleSurvey, method: AidingMethodName) -> Iterator[Finding]:
    """Check the parameters that the vehicle sent.

    Values and meanings: PX4's parameter reference, EKF2.
    """
    yield from apply_rules(vehicle.parameters, (_fuses(_OWN_GPS, "its own GPS"),))
    if method == "ranging_beacon":
        yield from apply_rules(vehicle.parameters, _RANGING_RULES)
        return
    has_slots = AGP_CONTROL.format(0) in vehicle.parameters
    if method == "global_position_sensor" or (method == "auto" and has_slots):
        yield from _auxiliary_position(vehicle)
        return
    found = p.look_up(vehicle.parameters, p.AGP_BEFORE_1_18)
    if found is not None and not has_slots:
        yield note(f"{found[0]} = {found[1]:g}: it is of PX4 1.15 to 1.17, which receive no GLOBAL_POSITION_SENSOR")
    yield from apply_rules(vehicle.parameters, _VISION_RULES)


def _auxiliary_position(vehicle: VehicleSurvey) -> Iterator[Finding]:
    """Check the slots of EKF2's auxiliary global position.

    One is to have our id and be on. EKF2 reads the id at its start alone.
    """
    told = vehicle.parameters
    ids = {slot: told[name] for slot in AGP_SLOTS if (name := AGP_ID.format(slot)) in told}
    controls = {slot: int(told.get(AGP_CONTROL.format(slot), 0.0)) for slot in AGP_SLOTS}
    ours = [slot for slot, number in ids.items() if number == SENSOR_ID]
    if not ours:
        name = AGP_ID.format(0)
        if name not in told:
            yield stop(f"{name} could not be read", "run the doctor again, nearer to the vehicle; else its firmware lacks it")
            return
        off = "the slot is off" if told[name] == 0.0 else "it waits for another sensor id than ours"
        yield stop(f"{name} = {told[name]:g}: {off}", f"set {name} = {SENSOR_ID}{_REBOOT}", (name, float(SENSOR_ID)))
    # Of several with our id one that is on serves, as the service sees it.
    slot = next((slot for slot in ours if controls[slot] & HORIZONTAL), ours[0] if ours else 0)
    yield from apply_rules(told, _slot_rules(slot))
    if ours:
        yield note(f"{AGP_ID.format(slot)} = {SENSOR_ID} counts from a start on: if it was set since the last one, reboot it")
    for other, number in ids.items():
        if other != slot and number != 0.0 and controls[other] & HORIZONTAL:
            yield note(f"{AGP_CONTROL.format(other)} = {controls[other]}: it fuses the positions of sensor {number:g} as well")


def _slot_rules(slot: int) -> tuple[ParameterRule, ...]:
    return (
        _takes(AGP_CONTROL.format(slot), "GLOBAL_POSITION_SENSOR", " as an auxiliary global position", "auxiliary global"),
        _arrives_without_delay((p.AGP_DELAY.format(slot),)),
        _fuses(_FIRST_SLOT + slot, "the auxiliary global position that we send"),
    )


def _takes(control: str, message: str, good: str, kind: str) -> ParameterRule:
    """Return the rule that a control parameter lets EKF2 fuse the horizontal position of a message."""
    return ParameterRule(
        (control,),
        lambda value: bool(int(value) & HORIZONTAL),
        Severity.STOP,
        f"it does not take {message}",
        set_to=lambda value: float(int(value) | HORIZONTAL),
        good=f"it takes {message}{good}",
        unreadable=f"its firmware takes no {kind} position",
    )


def _fuses(bit: int, sensor: str) -> ParameterRule:
    """Return the rule that EKF2 may fuse a sensor; a firmware without the parameter always may."""
    return ParameterRule(
        p.EKF2_SOURCES,
        lambda value: bool(int(value) & 1 << bit),
        Severity.STOP,
        f"it does not use {sensor}",
        set_to=lambda value: float(int(value) | 1 << bit),
        remedy_more=", disarmed",
    )


def _arrives_without_delay(names: tuple[str, ...]) -> ParameterRule:
    """Return the rule that EKF2 uses a position as of its arrival, without a delay."""
    return ParameterRule(
        names,
        equals(0.0),
        Severity.STOP,
        lambda ms: f"it takes what is true on arrival to be {ms / 1e3:g} s old",
        set_to=0.0,
        remedy_more=_REBOOT,
    )


_RANGING_RULES = (
    ParameterRule(
        p.RANGING_BEACON_CONTROL,
        equals(1.0),
        Severity.STOP,
        "it does not take RANGING_BEACON",
        set_to=1.0,
        good="it takes RANGING_BEACON",
        unreadable="its firmware fuses no ranges: PX4 does since April 2026, where it is built with CONFIG_EKF2_RANGING_BEACON",
    ),
    ParameterRule(
        p.RANGING_BEACON_NOISE,
        lambda sigma_m: sigma_m <= _COARSE_RANGE_M,
        Severity.STOP,
        lambda sigma_m: f"it takes no range for better than {sigma_m:g} m, whatever the message says",
        set_to=1.0,
        remedy_more=", or to the 1-sigma of your ranging devices",
    ),
    _arrives_without_delay(p.RANGING_BEACON_DELAY),
    _fuses(_RANGING_BEACON, "RANGING_BEACON"),
)

_VISION_RULES = (
    _takes(EV_CONTROL, "VISION_POSITION_ESTIMATE", "; no camera of its own may send it", "vision"),
    ParameterRule(
        (EV_CONTROL,),
        lambda value: not int(value) & _VERTICAL,
        Severity.NOTE,
        "it flies on the height that we compute, which no alert limit guards",
        set_to=lambda value: float(int(value) & ~_VERTICAL),
    ),
    ParameterRule(
        p.EV_NOISE_MODE,
        equals(0.0),
        Severity.STOP,
        "it takes every position to be as good as EKF2_EVP_NOISE says, however coarse it is",
        set_to=0.0,
    ),
    _arrives_without_delay(p.EV_DELAY),
    _fuses(_VISION, "VISION_POSITION_ESTIMATE"),
)
