"""The autopilot: takes fixes from its receivers, navigates on its estimate, steers along its route."""

from __future__ import annotations

from sitl_fakes.guidance import Guidance, heading_for_course
from sitl_fakes.navigation import Navigation
from sitl_fakes.parameters import Parameters
from sitl_fakes.receivers import GpsFix, Receiver, is_injected, is_own, receiver_in_use, refusal
from sitl_fakes.sensors import AirData

_SOURCE_HOLDS_S = 1.0


class Autopilot:
    """One vehicle's autopilot since its last boot. Parameters and the place on the route outlive it."""

    def __init__(self, params: Parameters, guidance: Guidance) -> None:
        self.receivers = (Receiver(), Receiver())
        self.in_use = 0
        self.navigation = Navigation()
        self.had_gps_time = False
        self._params = params
        self._guidance = guidance
        self._heading_to_hold: float | None = None
        self._last_used = 0

    def receive_own_fix(self, fix: GpsFix, at_s: float) -> None:
        """Take a message of the aircraft's own receiver."""
        if is_own(0, self._params):
            self.had_gps_time = self.had_gps_time or fix.fix_type >= 3
            self._receive(0, fix, at_s)

    def receive_gps_input(self, gps_id: int, fix: GpsFix, at_s: float) -> None:
        """Take a GPS_INPUT; it is ignored, without a word, where `gps_id` is not a receiver fed by MAVLink."""
        if gps_id in (0, 1) and is_injected(gps_id, self._params):
            self._receive(gps_id, fix, at_s)

    def _receive(self, instance: int, fix: GpsFix, at_s: float) -> None:
        receiver = self.receivers[instance]
        receiver.receive(fix, at_s)
        self.in_use = receiver_in_use(self.receivers, self._params, at_s, self.in_use)
        if instance == self.in_use and refusal(receiver, self._params, at_s) is None:
            self.navigation.correct(fix, at_s)
            self._last_used = instance

    def heading_command_rad(self, air: AirData, at_s: float, step_s: float) -> float:
        """Carry the estimate over one step and return the heading to fly, rad; without a position, the present heading is
        held.
        """
        self.in_use = receiver_in_use(self.receivers, self._params, at_s, self.in_use)
        self.navigation.predict(air.airspeed_mps, air.heading_rad, step_s)
        position = self.navigation.position_m
        if position is None:
            if self._heading_to_hold is None:
                self._heading_to_hold = air.heading_rad
            return self._heading_to_hold
        course = self._guidance.course_command_rad(position, step_s)
        return heading_for_course(course, air.airspeed_mps, *self.navigation.wind_mps)

    def source(self, at_s: float) -> str:
        """What the autopilot navigates on: "gps1", "gps2", "gps1 injected", "gps2 injected", "dead_reckoning" or "none"."""
        if self.navigation.position_m is None:
            return "none"
        if self.navigation.since_position_s(at_s) > _SOURCE_HOLDS_S:
            return "dead_reckoning"
        name = f"gps{self._last_used + 1}"
        return f"{name} injected" if is_injected(self._last_used, self._params) else name

    def own_gps_in_use(self, at_s: float) -> bool:
        """Whether the aircraft's own receiver is the one in use, and used."""
        return is_own(self.in_use, self._params) and self.source(at_s) == f"gps{self.in_use + 1}"

    def injected_refusal(self, at_s: float) -> str | None:
        """Why the injected receiver is not fit for use now, or None where it is."""
        for instance, receiver in enumerate(self.receivers):
            if is_injected(instance, self._params):
                return refusal(receiver, self._params, at_s)
        return "no receiver is set to MAVLink"

    def gps_healthy(self, at_s: float) -> bool:
        """The GPS bit of SYS_STATUS: it speaks of the receiver in use, not of the aircraft's own."""
        receiver = self.receivers[self.in_use]
        return receiver.fix_type(at_s) >= 3 and receiver.rhythm_ok()
