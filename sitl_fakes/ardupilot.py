"""ArduPilot as far as positions from outside go.

It has two GPS ports, EKF3's gates and lanes, arming checks and external position estimates.

After ArduPilot 4.7: AP_GPS, AP_Arming::gps_checks, NavEKF3_core::setLatLng and SelectVelPosFusion (a change of receiver sets
the position to the new one's), NavEKF3::UpdateFilter (lanes), AP_AHRS (the fall back to the receiver), and measurements on its
SITL.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fakes.autopilot import ACCEPTED, DEAD_RECKONING, FAILED, Autopilot, Horizontal
from sitl_fakes.guidance import Guidance
from sitl_fakes.navigation import Navigation
from sitl_fakes.parameters import Parameters
from sitl_fakes.receivers import GpsFix, is_injected, is_own, not_live, receiver_in_use, refusal
from sitl_fakes.sensors import AirData

_POSITION_NOISE_M = 0.5  # source: EK3_POSNE_M_NSE, its default
_MOST_APART_M = 50.0  # source: AP_GPS, all_consistent
_FROM_GPS = 3.0  # EK3_SRC1_VELZ
_NOT_CHECKED_AGAIN_S = 10.0
_RESET_AFTER_S = 10.0  # as measured: a step of 200 m was taken over 10 s later
_LANES_APART_RAD = math.radians(0.3)  # chosen: two inertial sensors, each with its own error of heading
_LANE_RESTS_S = 10.0  # source: NavEKF3::UpdateFilter, "not been the primary core for at least 10 seconds"
_GLITCH_AFTER_S, _GLITCH_OVER_AFTER_S = 1.0, 10.0  # source: NavEKF3_core::calcGpsGoodForFlight
_FALLS_BACK_AFTER_S = 4.0  # source: AP_AHRS::_active_EKF_type by NavEKF3's using_gps


class ArduPilot(Autopilot):
    """ArduPlane.

    It takes GPS_INPUT on the port that is set to it, and external estimates while it dead-reckons.

    Two lanes of EKF3 take the same measurements. Where the one in use refuses them, the other one is used if it refuses less.
    An armed plane whose EKF3 has used no position for 4 s goes by its receiver's fixes, if it has any (DCM).
    """

    def __init__(self, params: Parameters, guidance: Guidance) -> None:
        super().__init__((Navigation(_RESET_AFTER_S), Navigation(_RESET_AFTER_S, _LANES_APART_RAD)), guidance)
        self._params = params
        self._left_lane_at_s = -math.inf
        self._innovations_passed_at_s, self._innovations_failed_at_s = math.inf, -math.inf
        self._glitching = False
        self._goes_by_receiver = False
        self._used_at_s = -math.inf
        self._fused = 0
        self._given_up_mps: list[float | None] = [None, None]  # once a driver had a vertical velocity it keeps having one

    def receive_own_fix(self, fix: GpsFix, at_s: float) -> None:
        """Take a message of the aircraft's own receiver, which is wired to the first port."""
        if is_own(0, self._params):
            self.had_gps_time = self.had_gps_time or fix.fix_type >= 3
            self._receive(0, fix, at_s)

    def receive_gps_input(self, gps_id: int, fix: GpsFix, at_s: float) -> None:
        """Take a GPS_INPUT.

        It is ignored, as by the autopilot, where `gps_id` is not a receiver fed by MAVLink.
        """
        if gps_id in (0, 1) and is_injected(gps_id, self._params):
            self._receive(gps_id, fix, at_s)

    def apply_external_estimate(
        self, position_m: tuple[float, float], accuracy_m: float | None, age_s: float, at_s: float
    ) -> int:
        """Set the position, brought forward by its age, while the plane dead-reckons.

        FAILED where a position was accepted within the last second, or where there never was one.
        """
        if super().source(at_s) != DEAD_RECKONING:
            return FAILED
        for lane in self.lanes:
            lane.apply_estimate(position_m, max(accuracy_m or 0.0, _POSITION_NOISE_M), age_s)
        return ACCEPTED

    def arming_refusal(self, at_s: float) -> str | None:
        """Return why the GPS checks do not let it arm; None where they do.

        Each port in use needs a 3D fix in good rhythm, a port fed by MAVLink for 10 s. Two ports must be within 50 m.
        """
        ports = [i for i in (0, 1) if self._params[f"GPS{i + 1}_TYPE"] != 0]
        for i in ports:
            if self.receivers[i].fix_type(at_s) < 3:
                return f"Arm: GPS {i + 1}: Bad fix"
            is_settled = not is_injected(i, self._params) or self.receivers[i].is_settled(at_s)
            if not (is_settled and self.receivers[i].rhythm_ok()):
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

    def believed(self, at_s: float) -> tuple[Horizontal, Horizontal] | None:
        """Return the position (m) and velocity (m/s) that it flies by; None before the first fix.

        They are those of the lane in use, or the receiver's last fix where it has fallen back to that.
        """
        fix = self.receivers[self.in_use].fix
        if not self._goes_by_receiver or fix is None:
            return super().believed(at_s)
        return fix.position_enu_m[:2], fix.velocity_enu_mps[:2]

    def source(self, at_s: float) -> str:
        """What it navigates on: the receiver in use, too, where it goes by that alone."""
        return self._name(self.in_use) if self._goes_by_receiver else super().source(at_s)

    def gps_glitching(self, at_s: float) -> bool:  # noqa: ARG002 - it was settled with the last fix
        """The flag of EKF_STATUS_REPORT: set after a second of refusals, and cleared after ten without any."""
        return self._glitching

    def heading_command_rad(self, air: AirData, at_s: float, step_s: float) -> float:
        """Choose the receiver anew and whether to go by it alone, then steer."""
        self._choose_receiver(at_s)
        self._fall_back(at_s)
        if super().source(at_s) == DEAD_RECKONING:
            self.height.fuse(None)
        return super().heading_command_rad(air, at_s, step_s)

    def _receive(self, instance: int, fix: GpsFix, at_s: float) -> None:
        receiver = self.receivers[instance]
        receiver.receive(fix, at_s)
        if fix.has_vertical_velocity and is_injected(instance, self._params):
            self._given_up_mps[instance] = fix.velocity_enu_mps[2]
        self._choose_receiver(at_s)
        if instance == self.in_use and self._refusal(instance, at_s) is None:
            for lane in self.lanes:
                if instance != self._fused:
                    lane.move_to(fix)
                lane.correct(fix, at_s)
            self._fused = instance
            self._choose_lane(at_s)
            self._judge_innovations(at_s)
            self._used_at_s = at_s
            self.height.fuse(self._given_up_mps[instance] if self._params["EK3_SRC1_VELZ"] == _FROM_GPS else None)
            self._last_used = self._name(instance)

    def _refusal(self, instance: int, at_s: float) -> str | None:
        """Return why a receiver in use is not fused; None where it is.

        EKF3's checks are for its alignment. They are not made again until no receiver was fused for 10 s.
        """
        receiver = self.receivers[instance]
        if at_s - self._used_at_s <= _NOT_CHECKED_AGAIN_S:
            return not_live(receiver, at_s)
        return refusal(receiver, self._params, at_s)

    def _name(self, instance: int) -> str:
        return f"gps{instance + 1}{' injected' if is_injected(instance, self._params) else ''}"

    def _choose_lane(self, at_s: float) -> None:
        other = 1 - self.lane
        mine, theirs = (max(self.lanes[k].position_ratio, self.lanes[k].velocity_ratio) for k in (self.lane, other))
        if self.armed and mine > 1.0 and theirs < mine and at_s - self._left_lane_at_s > _LANE_RESTS_S:
            self.lane, self._left_lane_at_s = other, at_s
            self._to_say.append((mavlink.MAV_SEVERITY_CRITICAL, f"EKF3 lane switch {other}"))

    def _judge_innovations(self, at_s: float) -> None:
        if max(self.navigation.position_ratio, self.navigation.velocity_ratio) < 1.0:
            self._innovations_passed_at_s = at_s
        else:
            self._innovations_failed_at_s = at_s
        if at_s - self._innovations_passed_at_s > _GLITCH_AFTER_S:
            self._glitching = True
        elif at_s - self._innovations_failed_at_s > _GLITCH_OVER_AFTER_S:
            self._glitching = False

    def _fall_back(self, at_s: float) -> None:
        unaided_s, fixed = self.navigation.since_position_s(at_s), self.receivers[self.in_use].fix_type(at_s) >= 3
        goes_by_receiver = self.armed and fixed and math.inf > unaided_s > _FALLS_BACK_AFTER_S
        if goes_by_receiver != self._goes_by_receiver:
            self._goes_by_receiver = goes_by_receiver
            self._to_say.append((mavlink.MAV_SEVERITY_INFO, f"AHRS: {'DCM' if goes_by_receiver else 'EKF3'} active"))

    def _choose_receiver(self, at_s: float) -> None:
        self.in_use = receiver_in_use(self.receivers, self._params, at_s, self.in_use)
