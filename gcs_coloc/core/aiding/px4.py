"""PX4: by which method its EKF2 takes a position, from which origin, and whether its own GPS is switched off beside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from gcs_coloc.core.aiding.primary_switch import RETRY_S, SET_TRIES, TRY_AGAIN_S, Parameters
from gcs_coloc.core.aiding.settings import AidingMethodName
from gcs_coloc.core.messages.inbound import CommandOutcome, CommandResult, GlobalOrigin, VehicleCommand
from gcs_coloc.core.messages.outbound import Notice, OriginRequest, SensorEnable

SENSOR_ID = 1
"""The id of our GLOBAL_POSITION_SENSOR, by which EKF2_AGPn_ID selects it."""
AGP_SLOTS = range(4)  # PX4's MAX_AGP_INSTANCES
AGP_CONTROL, AGP_ID, EV_CONTROL = "EKF2_AGP{}_CTRL", "EKF2_AGP{}_ID", "EKF2_EV_CTRL"
_ORIGIN_RETRY_S, _ORIGIN_FRESH_S = 2.0, 30.0  # chosen: PX4 reports a new one by itself; 9 + 8 bytes cost a radio nothing
HORIZONTAL = 1
"""Bit of either control: the horizontal position is fused."""


def px4_method(value: Callable[[str], float | None]) -> AidingMethodName:
    """Return the method that a PX4 with these parameters takes (None: it does not have one); "auto" where it takes none.

    GLOBAL_POSITION_SENSOR is received since EKF2_AGP0_CTRL exists (2026). EKF2_AGP_CTRL of 1.15 to 1.17 is not that way in.
    """
    for slot in AGP_SLOTS:
        control = value(AGP_CONTROL.format(slot))
        if control is not None and int(control) & HORIZONTAL and value(AGP_ID.format(slot)) == SENSOR_ID:
            return "global_position_sensor"
    vision = value(EV_CONTROL)
    return "vision_position" if vision is not None and int(vision) & HORIZONTAL else "auto"


class Px4Methods:
    """The method of each PX4 of one fleet."""

    def __init__(self, parameters: Parameters) -> None:
        self.origins: dict[int, GlobalOrigin] = {}
        self._parameters = parameters
        self._origin_due_s: dict[int, float] = {}

    def review(self, sysid: int, chosen: AidingMethodName, now_s: float) -> list[OriginRequest]:
        """Request what a vehicle's method needs: parameters until they show one ("auto" is chosen), the origin for vision."""
        if chosen == "auto":
            if self.method(sysid) == "auto" or not self._answered(sysid):
                for name in self._names(sysid):
                    self._parameters.request(sysid, name, now_s)
            chosen = self.method(sysid)
        if chosen != "vision_position" or now_s < self._origin_due_s.get(sysid, now_s):
            return []
        self._origin_due_s[sysid] = now_s + (_ORIGIN_FRESH_S if sysid in self.origins else _ORIGIN_RETRY_S)
        return [OriginRequest(sysid)]

    def add_origin(self, origin: GlobalOrigin) -> None:
        """Add the origin that a vehicle reports."""
        self.origins[origin.sysid] = origin

    def forget(self, sysid: int) -> None:
        """Forget the origin of a vehicle that was rebooted."""
        self.origins.pop(sysid, None)
        self._origin_due_s.pop(sysid, None)

    def method(self, sysid: int) -> AidingMethodName:
        """Return the method of a vehicle; "auto" where it takes none, or has not shown yet which.

        Of a vehicle that answers nothing it is not known: what it may take does no harm.
        """
        method = px4_method(lambda name: self._parameters.value(sysid, name))
        if method != "global_position_sensor" and not all(self._parameters.is_settled(sysid, n) for n in self._names(sysid)):
            return "auto"
        return method if self._answered(sysid) else "global_position_sensor"

    def _answered(self, sysid: int) -> bool:
        return any(self._parameters.value(sysid, name) is not None for name in self._names(sysid))

    def _names(self, sysid: int) -> list[str]:
        # A slot exists where the first one does; most vehicles use that.
        slots = AGP_SLOTS if self._parameters.value(sysid, AGP_CONTROL.format(0)) is not None else AGP_SLOTS[:1]
        return [*(name.format(slot) for slot in slots for name in (AGP_CONTROL, AGP_ID)), EV_CONTROL]


class _Step(Enum):
    SETTING = "being set"
    OURS = "ours"
    RESTORING = "being restored"
    LEFT = "left as it is"


@dataclass(slots=True)
class _Switch:
    step: _Step
    due_s: float
    tries: int = 0
    is_sent: bool = False


class GpsSwitch:
    """Whether the EKF2 of each PX4 uses its own GPS: switched off where that lies, by command, and on again; as `PrimarySwitch`.

    A lying receiver stays in EKF2 beside the position that is sent. Not every firmware knows the command.
    """

    def __init__(self) -> None:
        self._switches: dict[int, _Switch] = {}

    def holds(self, sysid: int) -> bool:
        """Return whether its own GPS is switched off by us, or may be: what it reports of itself is then an echo."""
        switch = self._switches.get(sysid)
        return switch is not None and switch.is_sent

    def switching(self, sysid: int) -> bool:
        """Return whether a switch was begun and neither given up nor undone."""
        return sysid in self._switches

    def status(self, sysid: int) -> str | None:
        """Return the state of the switch in words; None where nothing was done."""
        switch = self._switches.get(sysid)
        return switch.step.value if switch is not None else None

    def review(self, sysid: int, now_s: float, *, wanted: bool) -> list[SensorEnable | Notice]:
        """Return the next step, if one is due, towards what is wanted: its own GPS switched off, or on as before."""
        switch = self._switches.get(sysid)
        if switch is None:
            if not wanted:
                return []
            switch = self._switches[sysid] = _Switch(_Step.SETTING, now_s)
        elif not wanted and switch.step is not _Step.RESTORING:
            if not switch.is_sent:
                del self._switches[sysid]
                return []
            switch.step, switch.due_s, switch.tries = _Step.RESTORING, now_s, 0
        if switch.step in (_Step.OURS, _Step.LEFT) or now_s < switch.due_s:
            return []
        if switch.tries >= SET_TRIES:
            switch.tries, switch.due_s = 0, now_s + TRY_AGAIN_S
            what = "off" if switch.step is _Step.SETTING else "on"
            text = f"its GPS could not be switched {what}: no answer; tried again in {TRY_AGAIN_S:g} s"
            return [Notice(now_s, sysid, "error", text)]
        switch.tries, switch.due_s, switch.is_sent = switch.tries + 1, now_s + RETRY_S, True
        return [SensorEnable(sysid, gps=switch.step is _Step.RESTORING)]

    def add_result(self, result: CommandResult) -> list[Notice]:
        """Add a vehicle's answer to a command."""
        switch = self._switches.get(result.sysid)
        if switch is None or result.command is not VehicleCommand.ESTIMATOR_SENSOR_ENABLE:
            return []
        at_s, sysid, is_accepted = result.received_at_s, result.sysid, result.outcome is CommandOutcome.ACCEPTED
        if switch.step is _Step.SETTING and is_accepted:
            switch.step = _Step.OURS
            return [Notice(at_s, sysid, "warning", "its own GPS is switched off: it flies on the position that it is sent")]
        if switch.step is _Step.SETTING and result.outcome is not CommandOutcome.IN_PROGRESS:
            switch.step, switch.is_sent = _Step.LEFT, False
            text = f"it does not let its own GPS be switched off ({result.outcome.value}): it may follow a receiver that lies"
            return [Notice(at_s, sysid, "warning", text)]
        if switch.step is _Step.RESTORING and is_accepted:
            del self._switches[sysid]
            return [Notice(at_s, sysid, "info", "its own GPS is switched on again")]
        return []

    def close(self) -> list[SensorEnable]:
        """Return what switches every vehicle's GPS on before the service ends; no time is left to see it confirmed."""
        held = [sysid for sysid, switch in self._switches.items() if switch.is_sent]
        self._switches.clear()
        return [SensorEnable(sysid, gps=True) for sysid in held]
