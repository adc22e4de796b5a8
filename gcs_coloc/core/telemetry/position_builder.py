"""Position measurements from what vehicles and their receivers report, with the noise of each.

The noise is what a receiver states, the settings assume or jumps show. What was measured at an uncertain time was measured at an
uncertain place: a position gets speed times time sigma as further noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, hypot, inf
from typing import NamedTuple

from gcs_coloc.core.clocks.vehicle_clocks import ServiceTime
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import PositionMeasurement
from gcs_coloc.core.messages.inbound import GlobalPosition, GpsReceiver
from gcs_coloc.core.telemetry.measurement_settings import MeasurementSettings

_SETTLES_S = 1.0
"""ArduPlane's EKF3, switched back to its own receiver, jumped by 2.9 m and was back after 0.8 s
(docs/results/real-autopilots.md)."""
_OVER_S = 5.0 * _SETTLES_S
_HELD_S = 5.0
"""In another flight it jumped by 4.5 m, stayed there for 4 s and jumped back (docs/results/real-autopilots.md). Only of a vehicle
that is trusted again a jump is held for so long: of another one it may be a spoofer's, to be found at once."""
_TAKEN_AGAIN_S = 10.0  # chosen: GPS_PRIMARY is restored once a vehicle is trusted again, and tried again for some seconds
_MOST_M = 10.0  # chosen: the accuracy of a receiver alone. More would blind the tests that find a faulty receiver
_TIMES_USUAL = 4.0  # chosen: of errors that are independent from report to report one in ten million is as large
_REMEMBERED_S = 20.0  # chosen: the noise of reports is learned anew within some turns
_LONGEST_GAP_S = 1.5  # chosen: reports at 1 Hz, a little late. Over a longer gap a turn looks like a jump
_FIX_3D = 3
_MOST_APART_M = 50.0  # chosen: 7 % of a climb of 700 m; a receiver's height that is further off is none, or of another datum
_HEIGHTS_COMPARED_S = 10.0  # chosen: long against the noise of a receiver's height, short against a climb


class ReceiverAccuracy(NamedTuple):
    """1-sigma per axis of a receiver: horizontal, vertical (m) and of its velocity (m/s)."""

    sigma_h_m: float
    sigma_v_m: float
    sigma_velocity_mps: float


def receiver_accuracy(receiver: GpsReceiver | None, settings: MeasurementSettings) -> ReceiverAccuracy:
    """Return the accuracy that a receiver states, and where it states none what the settings assume."""
    s = settings
    stated_h = receiver.h_acc_m if receiver is not None else None
    stated_v = receiver.v_acc_m if receiver is not None else None
    stated_speed = receiver.speed_acc_mps if receiver is not None else None
    # The error is that of one satellite's range times the dilution; the vertical one follows the horizontal one.
    dilution = max(receiver.hdop, 1.0) if receiver is not None and receiver.hdop is not None else 1.0
    sigma_h_m = max(stated_h, s.min_position_sigma_m) if stated_h is not None else s.position_sigma_h_m * dilution
    sigma_v_m = max(stated_v, s.min_position_sigma_m) if stated_v is not None else s.position_sigma_v_m * dilution
    sigma_v_mps = max(stated_speed, s.min_velocity_sigma_mps) if stated_speed is not None else s.velocity_sigma_mps
    return ReceiverAccuracy(sigma_h_m, sigma_v_m, sigma_v_mps)


@dataclass(slots=True)
class PositionJumps:
    """The jumps of the position that one vehicle reports, which its motion does not explain.

    A jump comes from another receiver or from a reset of the autopilot's filter. Which side of it was right nobody knows. Until
    the filter has settled, its position is as uncertain as the jump was large, whatever its receiver states.
    """

    _last: PositionMeasurement | None = None
    _usual_m2: float = 0.0
    _jump_m: float = 0.0
    _jumped_at_s: float = 0.0
    _distrusted_at_s: float = -inf

    def sigma_m(self, reported: PositionMeasurement, *, is_trusted: bool) -> float:
        """Add a reported position; return the 1-sigma that recent jumps add to it, m on each axis."""
        if not is_trusted:
            self._distrusted_at_s = reported.measured_at_s
        last, velocity = self._last, reported.velocity_enu_mps
        step_s = reported.measured_at_s - last.measured_at_s if last is not None else 0.0
        if last is None or not 0.0 < step_s <= _LONGEST_GAP_S or velocity is None or last.velocity_enu_mps is None:
            if last is None or step_s > 0.0:
                self._last, self._usual_m2 = reported, 4.0 * reported.sigma_h_m**2  # of both reports, on both axes
            return self._left_m(reported.measured_at_s)
        mean_mps = [0.5 * (before + now) for before, now in zip(last.velocity_enu_mps, velocity, strict=True)]
        before_m, now_m = last.position_enu_m, reported.position_enu_m
        miss_m = hypot(*(now_m[axis] - before_m[axis] - step_s * mean_mps[axis] for axis in (0, 1)))
        if miss_m > max(_TIMES_USUAL * self._usual_m2**0.5, self._left_m(reported.measured_at_s)):
            self._jump_m, self._jumped_at_s = min(miss_m, _MOST_M), reported.measured_at_s
        share = min(step_s / _REMEMBERED_S, 1.0)
        self._usual_m2 += share * (miss_m**2 - self._usual_m2)
        self._last = reported
        return self._left_m(reported.measured_at_s)

    def _left_m(self, at_s: float) -> float:
        since_s = at_s - self._jumped_at_s
        if self._jumped_at_s - self._distrusted_at_s < _TAKEN_AGAIN_S:
            since_s = max(since_s - _HELD_S, 0.0)
        return self._jump_m * exp(-since_s / _SETTLES_S) if self._jump_m and since_s < _OVER_S else 0.0


@dataclass(slots=True)
class HeightDifference:
    """How far the height that an autopilot reports is from its receiver's.

    The autopilot's is a barometer's: on a day 20 K off the standard a climb is 7 % off, whatever accuracy the receiver states.
    """

    _mean_m: float | None = None
    _at_s: float = 0.0

    def mean_m(self, message: GlobalPosition, receiver: GpsReceiver | None) -> float:
        """Add what both report; return the mean of the receiver's height less the autopilot's, m."""
        now_s = message.received_at_s
        if receiver is not None and receiver.fix_type >= _FIX_3D and abs(now_s - receiver.received_at_s) <= _LONGEST_GAP_S:
            difference_m = receiver.alt_msl_m - message.alt_msl_m
            if abs(difference_m) > _MOST_APART_M:
                return self.last_m
            if self._mean_m is None:
                self._mean_m = difference_m
            else:
                self._mean_m += (1.0 - exp(-max(now_s - self._at_s, 0.0) / _HEIGHTS_COMPARED_S)) * (difference_m - self._mean_m)
            self._at_s = now_s
        return self.last_m

    @property
    def last_m(self) -> float:
        """The last such mean, m."""
        return self._mean_m or 0.0


def reported_position(
    message: GlobalPosition,
    receiver: GpsReceiver | None,
    measured: ServiceTime,
    frame: LocalFrame,
    settings: MeasurementSettings,
    jumps: PositionJumps,
    heights: HeightDifference,
    *,
    is_trusted: bool,
) -> PositionMeasurement:
    """Return the position that a vehicle reports, with the accuracy of its receiver and what jumps add."""
    ned_mps = (message.vn_mps, message.ve_mps, message.vd_mps)
    accuracy = receiver_accuracy(receiver, settings)
    if is_trusted:
        accuracy = accuracy._replace(sigma_v_m=hypot(accuracy.sigma_v_m, heights.mean_m(message, receiver)))
    reported = _measure(message, ned_mps, accuracy, measured, frame)
    jump_m = jumps.sigma_m(reported, is_trusted=is_trusted)
    return replace(reported, sigma_h_m=hypot(reported.sigma_h_m, jump_m)) if jump_m else reported


def receiver_position(
    fix: GpsReceiver, position: GlobalPosition | None, measured: ServiceTime, frame: LocalFrame, settings: MeasurementSettings
) -> PositionMeasurement:
    """Return a receiver's fix with the autopilot's last velocity; at that speed its age is in `sigma_h_m`."""
    ned_mps = (position.vn_mps, position.ve_mps, position.vd_mps) if position is not None else (0.0, 0.0, 0.0)
    return _measure(fix, ned_mps, receiver_accuracy(fix, settings), measured, frame)


def _measure(
    message: GlobalPosition | GpsReceiver,
    ned_mps: tuple[float, float, float],
    accuracy: ReceiverAccuracy,
    measured: ServiceTime,
    frame: LocalFrame,
) -> PositionMeasurement:
    """Return the measurement of a reported position at a velocity (north, east, down)."""
    vn_mps, ve_mps, vd_mps = ned_mps
    return PositionMeasurement(
        vehicle=message.sysid,
        measured_at_s=measured.at_s,
        arrived_at_s=message.received_at_s,
        position_enu_m=frame.enu_from_geodetic(message.lat_deg, message.lon_deg, message.alt_msl_m),
        sigma_h_m=hypot(accuracy.sigma_h_m, hypot(vn_mps, ve_mps) * measured.sigma_s),
        sigma_v_m=hypot(accuracy.sigma_v_m, vd_mps * measured.sigma_s),
        velocity_enu_mps=frame.enu_from_ned_velocity(message.lat_deg, message.lon_deg, ned_mps),
        sigma_velocity_mps=accuracy.sigma_velocity_mps,
        time_sigma_s=measured.sigma_s,
    )
