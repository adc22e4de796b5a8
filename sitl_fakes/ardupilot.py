"""ArduPilot as far as positions from outside go: two GPS ports, EKF3's gates, arming checks, external position estimates.

After ArduPilot 4.7: AP_GPS, AP_Arming::gps_checks, NavEKF3_core::setLatLng and SelectVelPosFusion (a change of receiver sets
the position to the new one's), and measurements on its SITL.
"""

from __future__ import annotations

import math

from sitl_fakes.autopilot import ACCEPTED, DEAD_RECKONING, FAILED, Autopilot, BeaconRange
from sitl_fakes.guidance import Guidance
from sitl_fakes.navigation import Navigation
from sitl_fakes.parameters import Parameters
from sitl_fakes.receivers import GpsFix, is_injected, is_own, not_live, receiver_in_use, refusal
from sitl_fakes.sensors import AirData

_POSITION_NOISE_M = 0.5  # source: EK3_POSNE_M_NSE, its default
_MOST_APART_M = 50.0  # source: AP_GPS, all_consistent
_FROM_GPS = 3.0  # EK3_SRC1_VELZ
_NOT_CHECKED_AGAIN_S = 10.0


class ArduPilot(Autopilot):
    """ArduPlane. It takes GPS_INPUT on the port that is set to it, and external estimates while it dead-reckons."""

    def __init__(self, params: Parameters, guidance: Guidance) -> None:
        super().__init__(Navigation(reset_after_s=10.0), guidance)
        self._params = params
        self._used_at_s = -math.inf
        self._fused = 0
        self._given_up_mps: list[float | None] = [None, None]  # once a driver had a vertical velocity it keeps having one

    def receive_own_fix(self, fix: GpsFix, at_s: float) -> None:
        """Take a message of the aircraft's own receiver, which is wired to the first port."""
        if is_own(0, self._params):
            self.had_gps_time = self.had_gps_time or fix.fix_type >= 3
            self._receive(0, fix, at_s)

    def receive_gps_input(self, gps_id: int, fix: GpsFix, at_s: float) -> None:
        """Take a GPS_INPUT; it is ignored, as by the autopilot, where `gps_id` is not a receiver fed by MAVLink."""
        if gps_id in (0, 1) and is_injected(gps_id, self._params):
            self._receive(gps_id, fix, at_s)

    def receive_global_position(self, sensor_id: int, position_m: tuple[float, float], eph_m: float, at_s: float) -> None:
        """Pass over GLOBAL_POSITION_SENSOR: ArduPilot knows no such sensor."""

    def receive_range(self, beacon: BeaconRange, at_s: float) -> None:
        """Pass over ranges: ArduPilot has no driver that takes RANGING_BEACON."""

    def apply_external_estimate(
        self, position_m: tuple[float, float], accuracy_m: float | None, age_s: float, at_s: float
    ) -> int:
        """Set the position, brought forward by its age, unless a position was accepted within the last second or there never
        was one.
        """
        if self.source(at_s) != DEAD_RECKONING:
            return FAILED
        self.navigation.apply_estimate(position_m, max(accuracy_m or 0.0, _POSITION_NOISE_M), age_s)
        return ACCEPTED

    def arming_refusal(self, at_s: float) -> str | None:
        """Go through the GPS checks: each port in use has a 3D fix in good rhythm, and the two are within 50 m."""
        ports = [i for i in (0, 1) if self._params[f"GPS{i + 1}_TYPE"] != 0]
        for i in ports:
            if self.receivers[i].fix_type(at_s) < 3:
                return f"Arm: GPS {i + 1}: Bad fix"
            if not self.receivers[i].rhythm_ok():
                return f"Arm: GPS {i + 1}: not healthy"
        fixes = [self.receivers[i].fix for i in ports]
        if len(fixes) == 2 and fixes[0] is not None and fixes[1] is not None:
            apart_m = math.dist(fixes[0].position_enu_m, fixes[1].position_enu_m)
            if apart_m >= _MOST_APART_M:
                return f"Arm: GPS positions differ by {apart_m:4.1f}m"
        return None

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

    def own_gps_in_use(self, at_s: float) -> bool:
        """Whether the aircraft's own receiver is the one in use, and used."""
        return is_own(self.in_use, self._params) and super().own_gps_in_use(at_s)

    def heading_command_rad(self, air: AirData, at_s: float, step_s: float) -> float:
        """Choose the receiver anew, then steer."""
        self._choose_receiver(at_s)
        if self.source(at_s) == DEAD_RECKONING:
            self.height.fuse(None)
        return super().heading_command_rad(air, at_s, step_s)

    def _receive(self, instance: int, fix: GpsFix, at_s: float) -> None:
        receiver = self.receivers[instance]
        receiver.receive(fix, at_s)
        if fix.has_vertical_velocity and is_injected(instance, self._params):
            self._given_up_mps[instance] = fix.velocity_enu_mps[2]
        self._choose_receiver(at_s)
        if instance == self.in_use and self._refusal(instance, at_s) is None:
            if instance != self._fused:
                self.navigation.move_to(fix)
                self._fused = instance
            self.navigation.correct(fix, at_s)
            self._used_at_s = at_s
            self.height.fuse(self._given_up_mps[instance] if self._params["EK3_SRC1_VELZ"] == _FROM_GPS else None)
            self._last_used = f"gps{instance + 1}{' injected' if is_injected(instance, self._params) else ''}"

    def _refusal(self, instance: int, at_s: float) -> str | None:
        """Why a receiver in use is not fused. EKF3's checks are for its alignment: they are not made again until none was
        fused for long.
        """
        receiver = self.receivers[instance]
        if at_s - self._used_at_s <= _NOT_CHECKED_AGAIN_S:
            return not_live(receiver, at_s)
        return refusal(receiver, self._params, at_s)

    def _choose_receiver(self, at_s: float) -> None:
        self.in_use = receiver_in_use(self.receivers, self._params, at_s, self.in_use)
