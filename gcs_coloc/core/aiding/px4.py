"""PX4: by which method its EKF2 takes a position, and from which origin."""

from __future__ import annotations

from collections.abc import Callable

from gcs_coloc.core.aiding.parameters import Parameters
from gcs_coloc.core.aiding.settings import AidingMethodName
from gcs_coloc.core.messages.inbound import GlobalOrigin
from gcs_coloc.core.messages.outbound import OriginRequest

SENSOR_ID = 1
"""The id of our GLOBAL_POSITION_SENSOR, by which EKF2_AGPn_ID selects it."""
AGP_SLOTS = range(4)  # PX4's MAX_AGP_INSTANCES
AGP_CONTROL, AGP_ID, EV_CONTROL = "EKF2_AGP{}_CTRL", "EKF2_AGP{}_ID", "EKF2_EV_CTRL"
_ORIGIN_RETRY_S, _ORIGIN_FRESH_S = 2.0, 30.0  # chosen: PX4 reports a new one by itself; 9 + 8 bytes cost a radio nothing
HORIZONTAL = 1
"""Bit of either control: the horizontal position is fused."""


def px4_method(value: Callable[[str], float | None]) -> AidingMethodName:
    """Return the aiding method that a PX4 takes, by its parameters; "auto" where it takes none.

    `value` returns a parameter by its name, None where the vehicle does not have it.

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
        """Request what a vehicle's method needs; return the request for its origin, if one is due.

        Where `chosen` is "auto", parameters are requested until they show a method. Vision positions need the origin.
        """
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
        if method != "global_position_sensor" and not self.is_settled(sysid):
            return "auto"
        return method if self._answered(sysid) else "global_position_sensor"

    def is_settled(self, sysid: int) -> bool:
        """Return whether the parameters that decide on a vehicle's method are known or asked for in vain."""
        return all(self._parameters.is_settled(sysid, name) for name in self._names(sysid))

    def _answered(self, sysid: int) -> bool:
        return any(self._parameters.value(sysid, name) is not None for name in self._names(sysid))

    def _names(self, sysid: int) -> list[str]:
        # A slot exists where the first one does; most vehicles use that.
        slots = AGP_SLOTS if self._parameters.value(sysid, AGP_CONTROL.format(0)) is not None else AGP_SLOTS[:1]
        return [*(name.format(slot) for slot in slots for name in (AGP_CONTROL, AGP_ID)), EV_CONTROL]
