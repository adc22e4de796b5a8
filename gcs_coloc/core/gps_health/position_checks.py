"""Position checks of a vehicle, by its own velocity and by its own receiver.

They find positions that move otherwise than the velocity says, a receiver that repeats one position, and positions that are not
the receiver's. All checks scale with what the receiver states, so that a coarse one is no fault.

Doppler check: do the fixes of a receiver move as its own velocity says? It finds its position by the code of the signals and its
velocity by their Doppler shift, so that a fault seldom moves both alike. The drift is the slope of position minus integrated
velocity against time, by least squares over a window. It is evidence where ranges leave open who is at fault, and of itself no
fault: a fix that settles after a shadow drifts as well.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import hypot, sqrt
from typing import NamedTuple

from gcs_coloc.core.geodesy import LocalFrame, horizontal_distance_m
from gcs_coloc.core.gps_health.evidence import GpsReason
from gcs_coloc.core.measurements import PositionMeasurement, Vector3
from gcs_coloc.core.messages.inbound import FIX_3D, GlobalPosition, GpsReceiver
from gcs_coloc.core.reasons import StatedReason

_WINDOW_S = 3.0  # chosen: long against the noise of positions, short against the time in which a fault takes an aircraft away
_LONGEST_GAP_S = 1.0  # chosen: over a longer one a turning aircraft does not fly the mean of two velocities
_SIGMAS = 5.0  # chosen: by chance never in a flight; stated accuracies are often too good
_LEAST_MISS_M = 2.0  # chosen: what the rounding of times and velocities adds up to at airspeed
_LEAST_MISS_UP_M = 8.0  # source: sound autopilots within 3 m, and up to 9 m while they are aided (79 recordings of real ones)
_PERSISTS_S = 1.0  # chosen: five positions in a row; one late or early is none
_HELD_S = 10.0  # chosen: three windows, as either side of a jump may be the wrong one
_FROZEN_S = 3.0  # chosen: fifteen fixes in a row at 5 Hz; a receiver may repeat one or two
_FROZEN_PATH_M = 10.0
"""Chosen: beyond the drift of a vehicle that hovers or stands. The filter of one that stands may state a velocity of a metre a
second for minutes while its position stays: its positions have to have moved as far, or its receiver by its own velocity."""
_UNSTATED_SIGMA_M = 5.0  # chosen: a single-frequency receiver without corrections, 95 % within 10 m
_LEAST_OFF_M = 10.0  # chosen: beyond what a sound filter and its receiver differ by in a turn
_APART_IN_TIME_S = 2.0  # a receiver's delay and the gap between two messages that are sent once a second
_OFF_PERSISTS_S = 3.0  # chosen: longer than a filter takes to follow its receiver after a turn


class PathStep(NamedTuple):
    """A reported position, and the path of the integrated velocities: east, north and up, m and m/s."""

    at_s: float
    place_m: Vector3
    path_m: Vector3
    velocity_mps: Vector3

    def missed_m(self, first: PathStep) -> Vector3:
        """Return what the position has moved since an earlier step other than the path."""
        de, dn, du = (now - then for now, then in zip(self.place_m, first.place_m, strict=True))
        pe, pn, pu = (now - then for now, then in zip(self.path_m, first.path_m, strict=True))
        return de - pe, dn - pn, du - pu


def path_step(last: PathStep | None, at_s: float, place_m: Vector3, velocity_mps: Vector3) -> PathStep:
    """Return the step to a reported position and velocity; its path goes on by the trapezoidal rule."""
    if last is None:
        return PathStep(at_s, place_m, (0.0, 0.0, 0.0), velocity_mps)
    half_s = 0.5 * (at_s - last.at_s)
    (pe, pn, pu), (ve0, vn0, vu0), (ve, vn, vu) = last.path_m, last.velocity_mps, velocity_mps
    path_m = pe + half_s * (ve0 + ve), pn + half_s * (vn0 + vn), pu + half_s * (vu0 + vu)
    return PathStep(at_s, place_m, path_m, velocity_mps)


@dataclass(slots=True)
class MotionCheck:
    """The check that a vehicle's positions move as its velocities, and that its receiver moves at all.

    `implausible`: the positions contradict the velocities. That is held for 10 s after the last contradiction, since either side
    of a jump may be the wrong one. `frozen`: the receiver repeats one position while the vehicle moves.
    """

    _steps: deque[PathStep] = field(default_factory=deque)
    _unplaced_until_s: float = float("-inf")
    _missed_since_s: float | None = None
    _missed_at_s: float = float("-inf")
    _miss_m: float = 0.0
    _last_fix: tuple[float, float, float] | None = None
    _same_since_s: float = 0.0
    _heard_at_s: float = 0.0
    _same_path_m: float = 0.0
    _same_own_path_m: float = 0.0
    _same_from: PathStep | None = None
    _same_moved_m: float = 0.0

    def add_position(self, reported: PositionMeasurement, *, own: bool, is_placed: bool = True) -> None:
        """Add a reported position; one without velocity shows nothing.

        `own` is False while the vehicle flies on our fix: its positions are then an echo, and only that it moves counts.
        `is_placed` is False while its EKF has no absolute position: an ArduPlane that has booted states a height of 0 until then.
        """
        if reported.velocity_enu_mps is None or reported.sigma_velocity_mps is None:
            return
        if self._steps and reported.measured_at_s <= self._steps[-1].at_s:
            return
        if not own:
            self._steps.clear()
        step = self._next(reported, reported.velocity_enu_mps)
        if not is_placed:
            self._unplaced_until_s = step.at_s
        while step.at_s - self._steps[0].at_s > _WINDOW_S:
            self._steps.popleft()
        first = self._steps[0]
        east_m, north_m, up_m = step.missed_m(first)
        # A wrong velocity is wrong in the same way for seconds, hence its sigma grows with the span and not with its root.
        drift_m = reported.sigma_velocity_mps * (step.at_s - first.at_s)
        most_m = _SIGMAS * sqrt(2.0 * reported.sigma_h_m**2 + drift_m**2) + _LEAST_MISS_M
        most_up_m = _SIGMAS * sqrt(2.0 * reported.sigma_v_m**2 + drift_m**2) + _LEAST_MISS_UP_M
        if first.at_s <= self._unplaced_until_s or all(each.velocity_mps[2] == 0.0 for each in self._steps):
            up_m = 0.0  # it had no height, or states no vertical velocity
        if hypot(east_m, north_m) <= most_m and abs(up_m) <= most_up_m:
            self._missed_since_s = None
            return
        if self._missed_since_s is None:
            self._missed_since_s = step.at_s
        if step.at_s - self._missed_since_s >= _PERSISTS_S:
            self._missed_at_s, self._miss_m = reported.arrived_at_s, hypot(east_m, north_m, up_m)

    def add_receiver(self, fix: GpsReceiver) -> None:
        """Add a report of the vehicle's real receiver."""
        place, now = (fix.lat_deg, fix.lon_deg, fix.alt_msl_m), self._steps[-1] if self._steps else None
        if place != self._last_fix or fix.fix_type < FIX_3D:
            self._last_fix, self._same_since_s, self._same_from = place, fix.received_at_s, now
            self._same_path_m = self._same_own_path_m = self._same_moved_m = 0.0
        elif now is not None and fix.received_at_s - now.at_s <= _LONGEST_GAP_S + _WINDOW_S:
            step_s = min(fix.received_at_s - self._heard_at_s, _LONGEST_GAP_S)
            self._same_path_m += step_s * hypot(*now.velocity_mps[:2])
            self._same_own_path_m += step_s * hypot(*(fix.velocity_ne_mps or (0.0, 0.0)))
            began = self._same_from = self._same_from or now
            east_m, north_m = now.place_m[0] - began.place_m[0], now.place_m[1] - began.place_m[1]
            self._same_moved_m = max(self._same_moved_m, hypot(east_m, north_m))
        self._heard_at_s = fix.received_at_s

    def implausible(self, now_s: float) -> StatedReason[GpsReason] | None:
        """Return why the positions reported of late are not believed; None where they are."""
        if now_s - self._missed_at_s > _HELD_S:
            return None
        return StatedReason(GpsReason.IMPLAUSIBLE_MOTION, self._miss_m, _WINDOW_S)

    def frozen(self) -> StatedReason[GpsReason] | None:
        """Return why the receiver counts as frozen, as none that moves repeats a fix to the centimetre."""
        moved_m = min(self._same_path_m, max(self._same_moved_m, self._same_own_path_m))
        if self._heard_at_s - self._same_since_s < _FROZEN_S or moved_m < _FROZEN_PATH_M:
            return None
        return StatedReason(GpsReason.FROZEN, moved_m)

    def _next(self, reported: PositionMeasurement, velocity_mps: Vector3) -> PathStep:
        at_s = reported.measured_at_s
        if not self._steps or at_s - self._steps[-1].at_s > _LONGEST_GAP_S:
            self._steps.clear()
            self._missed_since_s = None
        last = self._steps[-1] if self._steps else None
        step = path_step(last, at_s, reported.position_enu_m, velocity_mps)
        self._steps.append(step)
        return step


@dataclass(slots=True)
class ReceiverCheck:
    """The check that a vehicle reports the position that its own receiver states.

    Its autopilot may be flying on something else. GLOBAL_POSITION_INT is a filter's output, and the receiver's signs of health
    say nothing of it. The filter may be set to other sources (vision, beacons, another receiver). It may refuse the receiver and
    reckon on, or follow one that has just jumped.

    `fault`: how far the position is off the receiver's; None where it is not.
    """

    fault: StatedReason[GpsReason] | None = None
    _off_since_s: float | None = None

    def add(self, fix: GpsReceiver, position: GlobalPosition | None) -> None:
        """Add a report of the vehicle's own receiver beside the position that it reported last.

        They are of different times: what the vehicle flies in `_APART_IN_TIME_S` is allowed for, beside five sigmas of the
        receiver. A single pair tells nothing, `_OFF_PERSISTS_S` of them in a row do.
        """
        if position is None or fix.fix_type < FIX_3D or fix.received_at_s - position.received_at_s > _APART_IN_TIME_S:
            self.fault = self._off_since_s = None
            return
        off_m = horizontal_distance_m(fix.lat_deg, fix.lon_deg, position.lat_deg, position.lon_deg)
        sigma_m = fix.h_acc_m if fix.h_acc_m is not None else _UNSTATED_SIGMA_M
        flown_m = _APART_IN_TIME_S * hypot(position.vn_mps, position.ve_mps)
        if off_m <= _SIGMAS * sigma_m + _LEAST_OFF_M + flown_m:
            self.fault = self._off_since_s = None
            return
        if self._off_since_s is None:
            self._off_since_s = fix.received_at_s
        if fix.received_at_s - self._off_since_s >= _OFF_PERSISTS_S:
            self.fault = StatedReason(GpsReason.OFF_ITS_RECEIVER, off_m)


_DRIFT_WINDOW_S = 4.0  # chosen: 2 m/s are then four sigmas of a receiver of 1.5 m at 5 Hz, and detection by ranges takes as long
_LEAST_SPAN_S, _LEAST_FIXES = 3.0, 4  # chosen: a drift of 1 m/s stands out of the noise, and four fixes show that
_LONGEST_FIX_GAP_S = 1.5  # of a receiver at 1 Hz, with what the link adds
_DRIFT_SIGMAS = 4.0  # a drift of a sound receiver is larger once in 3,000 windows (Rayleigh)
_UNSTATED_SIGMA_MPS = 0.3  # EK3_VELNE_M_NSE of ArduPilot


class DopplerCheck:
    """The fixes of one receiver. Only those with the autopilot's time of the fix count: arrivals jitter."""

    def __init__(self) -> None:
        self._steps: deque[PathStep] = deque()
        self._frame: LocalFrame | None = None
        self._has_agreed = False
        self._drifted_at_s = float("-inf")

    def add(self, fix: GpsReceiver) -> None:
        """Add a report of the receiver."""
        if fix.fix_type < FIX_3D or fix.velocity_ne_mps is None or fix.fixed_boot_s is None:
            self._clear()
            return
        if self._steps and not 0.0 <= fix.fixed_boot_s - self._steps[-1].at_s <= _LONGEST_FIX_GAP_S:
            self._clear()
        if self._steps and fix.fixed_boot_s == self._steps[-1].at_s:
            return
        self._append(fix, fix.fixed_boot_s, fix.velocity_ne_mps)
        self._judge(fix)

    def drifts(self, now_s: float) -> bool:
        """Return whether its fixes have moved of late other than its velocity."""
        return now_s - self._drifted_at_s <= _HELD_S

    def _append(self, fix: GpsReceiver, at_s: float, velocity_ne_mps: tuple[float, float]) -> None:
        if self._frame is None:
            self._frame = LocalFrame(fix.lat_deg, fix.lon_deg, fix.alt_msl_m)
        vn, ve = velocity_ne_mps
        velocity_mps = self._frame.enu_from_ned_velocity(fix.lat_deg, fix.lon_deg, (vn, ve, 0.0))
        place_m = self._frame.enu_from_geodetic(fix.lat_deg, fix.lon_deg, fix.alt_msl_m)
        self._steps.append(path_step(self._steps[-1] if self._steps else None, at_s, place_m, velocity_mps))
        while at_s - self._steps[0].at_s > _DRIFT_WINDOW_S:
            self._steps.popleft()

    def _judge(self, fix: GpsReceiver) -> None:
        steps = self._steps
        if len(steps) < _LEAST_FIXES or steps[-1].at_s - steps[0].at_s < _LEAST_SPAN_S:
            return
        mean_s = sum(step.at_s for step in steps) / len(steps)
        spread_s2 = sum((step.at_s - mean_s) ** 2 for step in steps)
        missed = [(step.at_s - mean_s, *step.missed_m(steps[0])) for step in steps]
        east_ms, north_ms = sum(s * e for s, e, _, _ in missed), sum(s * n for s, _, n, _ in missed)
        drift_mps = hypot(east_ms / spread_s2, north_ms / spread_s2)
        sigma_m = fix.h_acc_m if fix.h_acc_m is not None else _UNSTATED_SIGMA_M
        sigma_mps = fix.speed_acc_mps if fix.speed_acc_mps is not None else _UNSTATED_SIGMA_MPS
        if drift_mps <= _DRIFT_SIGMAS * hypot(sigma_m / sqrt(spread_s2), sigma_mps):
            self._has_agreed = True
        elif self._has_agreed:
            # One whose velocity never fitted states none that is worth anything.
            self._drifted_at_s = fix.received_at_s

    def _clear(self) -> None:
        self._steps.clear()
        self._frame = None
