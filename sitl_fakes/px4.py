"""PX4 as far as aiding from outside goes.

It takes no GPS_INPUT. It takes an auxiliary global position, a vision position, ranges and external position estimates.

After PX4's main of August 2026 as flown with SIH: EKF2's AuxGlobalPosition, controlEvPosFusion, its ranging beacons,
VEHICLE_CMD_EXTERNAL_POSITION_ESTIMATE and handleSensorFusionCommand. A GLOBAL_POSITION_SENSOR is stamped on receipt, and a
VISION_POSITION_ESTIMATE taken to be as new: its sender's clock is not known. A
RANGING_BEACON's time is taken for the boot clock's, unconverted; a sample that is not a step of the buffer younger than the last
one, or far behind the horizon, is dropped. The GNSS checks are reduced to the limits of EKF2_REQ_*.
"""

from __future__ import annotations

import math

from sitl_fakes.autopilot import ACCEPTED, DEAD_RECKONING, NO_POSITION, Autopilot, BeaconRange
from sitl_fakes.guidance import Guidance
from sitl_fakes.navigation import Navigation
from sitl_fakes.parameters import Parameters
from sitl_fakes.receivers import GpsFix

_UNKNOWN_ACCURACY_M = 50.0
_LONGEST_AGE_S = 15.0
_HORIZONTAL = 1  # source: EKF2_AGP0_CTRL and EKF2_EV_CTRL, bit 0
_HELD_S = 1.0  # chosen: some fixes missed
_AUX, _VISION, _RANGES = "aux global position", "vision position", "ranging beacons"
_BUFFER_STEP_S = 0.065  # _min_obs_interval_us as flown
_HORIZON_S, _FUSED_WITHIN_S = 0.2, 0.1  # EKF2_DELAY_MAX; TimestampedRingBuffer::pop_first_older_than
_SOURCES = "EKF2_SENS_EN"
_OWN_GPS = 1 << 0  # source: EKF2_SENS_EN, bit 0


class Px4(Autopilot):
    """PX4 fixed wing.

    Where its own receiver and the auxiliary position disagree, it stays with its receiver.
    """

    def __init__(self, params: Parameters, guidance: Guidance) -> None:
        super().__init__((Navigation(reset_after_s=7.0),), guidance)
        self._params = params
        self._slot_id = params["EKF2_AGP0_ID"]  # read at boot alone
        self._uses_own_gps = bool(int(params[_SOURCES]) & _OWN_GPS)
        self._gps_used_at_s = self._aux_used_at_s = -math.inf
        self._range_stamp_s = -math.inf
        self._vision_at_s = -math.inf
        self._vision_bias_m = (0.0, 0.0)

    def receive_own_fix(self, fix: GpsFix, at_s: float) -> None:
        """Take a message of the aircraft's own receiver, if it is as good as EKF2_REQ_* demand."""
        self.had_gps_time = self.had_gps_time or fix.fix_type >= 3
        self.receivers[0].receive(fix, at_s)
        if not self.armed:
            self._uses_own_gps = bool(int(self._params[_SOURCES]) & _OWN_GPS)
        if self._uses_own_gps and self._good_enough(fix):
            self.navigation.correct(fix, at_s)
            self.origin_m = self.origin_m or fix.position_enu_m
            self._last_used, self._gps_used_at_s = "gps1", at_s

    def receive_global_position(self, sensor_id: int, position_m: tuple[float, float], eph_m: float, at_s: float) -> None:
        """Fuse an auxiliary position of the slot's sensor.

        EKF2_AGP0_CTRL must have it on, and `eph_m` must be above 0. It moves the estimate by more than the gate only where the
        own receiver was not used of late.
        """
        if self._slot_off() or sensor_id != self._slot_id or not eph_m > 0.0:
            return
        if self.navigation.correct_position(
            position_m,
            max(eph_m, self._params["EKF2_AGP0_NOISE"]),
            at_s,
            gate_sigma=max(self._params["EKF2_AGP0_GATE"], 1.0),
            may_reset=at_s - self._gps_used_at_s > _HELD_S,
        ):
            self._last_used, self._aux_used_at_s = _AUX, at_s

    def receive_vision(self, position_m: tuple[float, float], variance_m2: float, at_s: float) -> None:
        """Fuse a position of the local frame, where EKF2_EV_CTRL has that on.

        It has its own variance unless EKF2_EV_NOISE_MD is 1.

        The first one sets the estimate. Beside its own receiver they move nothing: EKF2 learns how far they are off then.
        """
        p, believed = self._params, self.navigation.position_m
        if not self._vision_on() or believed is None:
            return
        least_m = p["EKF2_EVP_NOISE"]
        is_stated = not int(p["EKF2_EV_NOISE_MD"]) and math.isfinite(variance_m2)
        sigma_m = max(math.sqrt(max(variance_m2, 0.0)), least_m) if is_stated else least_m
        goes_on, self._vision_at_s = at_s - self._vision_at_s <= _HELD_S, at_s
        if at_s - self._gps_used_at_s <= _HELD_S:
            self._vision_bias_m = (position_m[0] - believed[0], position_m[1] - believed[1])
            return
        self._vision_bias_m = self._vision_bias_m if goes_on else (0.0, 0.0)
        seen_m = (position_m[0] - self._vision_bias_m[0], position_m[1] - self._vision_bias_m[1])
        if not goes_on:
            self.navigation.take_position(seen_m, sigma_m, at_s)
        elif not self.navigation.correct_position(seen_m, sigma_m, at_s, gate_sigma=max(p["EKF2_EVP_GATE"], 1.0)):
            return
        self._last_used, self._aux_used_at_s = _VISION, at_s

    def receive_range(self, beacon: BeaconRange, at_s: float) -> None:
        """Fuse a range where EKF2_RNGBC_CTRL has it on; EKF2_RNGBC_NOISE is the least sigma."""
        p = self._params
        age_s = beacon.age_s + p["EKF2_RNGBC_DELAY"] / 1e3
        if not int(p["EKF2_RNGBC_CTRL"]) or beacon.stamp_s < self._range_stamp_s + _BUFFER_STEP_S:
            return
        self._range_stamp_s = beacon.stamp_s
        if age_s > _HORIZON_S + _FUSED_WITHIN_S:
            return
        there_m, below_m, range_m = beacon[:3]
        sigma_m = max(beacon.sigma_m, p["EKF2_RNGBC_NOISE"])
        gate_sigma = max(p["EKF2_RNGBC_GATE"], 1.0)
        if self.navigation.correct_range(there_m, below_m, range_m, sigma_m, age_s, at_s, gate_sigma=gate_sigma):
            self._last_used, self._aux_used_at_s = _RANGES, at_s

    def apply_external_estimate(
        self,
        position_m: tuple[float, float],
        accuracy_m: float | None,
        age_s: float,
        at_s: float,  # noqa: ARG002 - ArduPilot's answer depends on the time
    ) -> int:
        """Set the position, brought forward by its age, whatever it navigates on.

        This is a hard reset, which forgets the wind.
        """
        self.navigation.apply_estimate(position_m, accuracy_m or _UNKNOWN_ACCURACY_M, min(age_s, _LONGEST_AGE_S))
        self.navigation.forget_wind()
        return ACCEPTED

    def use_own_gps(self, *, used: bool) -> int:
        """Fuse the aircraft's own receiver, or not.

        EKF2 keeps what it is told while it is disarmed over a reboot.
        """
        self._uses_own_gps = used
        if not self.armed:
            sources = int(self._params[_SOURCES])
            self._params.set(_SOURCES, sources | _OWN_GPS if used else sources & ~_OWN_GPS)
        return ACCEPTED

    def arming_refusal(self, at_s: float) -> str | None:
        """Demand a position, from whatever source."""
        located = self.source(at_s) not in (NO_POSITION, DEAD_RECKONING)
        return None if located else "Arming denied: Resolve system health failures first"

    def uses_global_position(self, at_s: float) -> bool:
        """Whether a receiver or an auxiliary position is fused; a vision position and ranges are none."""
        return self.source(at_s) in ("gps1", _AUX)

    def injected_refusal(self, at_s: float) -> str | None:
        """Why neither positions nor ranges from outside are used now, or None where they are."""
        if at_s - self._aux_used_at_s <= _HELD_S:
            return None
        if self._vision_on():
            return "no vision position is fused"
        off = self._slot_off()
        if off and int(self._params["EKF2_RNGBC_CTRL"]):
            return "no range to a beacon is fused"
        return off or "no auxiliary global position is fused"

    def _vision_on(self) -> bool:
        return bool(int(self._params["EKF2_EV_CTRL"]) & _HORIZONTAL) and self.origin_m is not None

    def _slot_off(self) -> str | None:
        if not int(self._params["EKF2_AGP0_CTRL"]) & _HORIZONTAL:
            return "EKF2_AGP0_CTRL is off"
        return None if self._slot_id else "EKF2_AGP0_ID was 0 at the start"

    def gps_healthy(self, at_s: float) -> bool:
        """The GPS bit of SYS_STATUS: the aircraft's own receiver has a fix."""
        return self.receivers[0].fix_type(at_s) >= 3

    def _good_enough(self, fix: GpsFix) -> bool:
        p = self._params
        return (
            fix.fix_type >= 3
            and fix.satellites >= p["EKF2_REQ_NSATS"]
            and (fix.h_acc_m or 0.0) <= p["EKF2_REQ_EPH"]
            and (fix.v_acc_m or 0.0) <= p["EKF2_REQ_EPV"]
            and (fix.speed_acc_mps or 0.0) <= p["EKF2_REQ_SACC"]
        )
