"""GPS receivers as ArduPilot sees them: the fix, its age and rhythm, and which one is in use.

What EKF3 demands of a receiver is here, too.

The rules follow ArduPilot 4.7 (AP_GPS, AP_GPS_MAV, AP_NavEKF3), as measured on its SITL: a fix lingers for 4 s after the last
message; a mean interval of 215 ms or more, or two intervals over 245 ms in a row, make a receiver unhealthy.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sitl_fakes.geodesy import Vector, WorldFrame

_TIMEOUT_S = 4.0  # source of this and the next three: ArduPilot's AP_GPS.cpp
_MAX_MEAN_INTERVAL_S = 0.215
_MAX_INTERVAL_S = 0.245
_SETTLED_AFTER_S = 10.0  # as measured: a plane with all checks armed 10 to 30 s after the stream began, not before
_INTERVAL_SMOOTHING = 0.02
_TYPE_MAVLINK = 14  # source: GPS1_TYPE, ArduPilot's parameter list
_CHECK_SATELLITES, _CHECK_HDOP, _CHECK_SPEED, _CHECK_POSITION = 1, 2, 4, 8  # source: EK3_GPS_CHECK, same list
_ANNOUNCED_DELAY_S = 0.2  # the driver's, where GPSn_DELAY_MS is 0
_BUFFERED_S = 0.1  # what EKF3's buffer, sized at boot for the real receiver, has room for: 0.12 s short of 0.2 s in flight
_HIGHEST_M = 100_000.0  # chosen: the edge of space
_FASTEST_MPS = 1_000.0  # chosen: beyond every aircraft here
_IGNORE_ALT, _IGNORE_HDOP, _IGNORE_VDOP, _IGNORE_VEL_HORIZ = 1, 2, 4, 8  # source of both: GPS_INPUT_IGNORE_FLAGS
_IGNORE_VEL_VERT, _IGNORE_SPEED_ACC, _IGNORE_H_ACC, _IGNORE_V_ACC = 16, 32, 64, 128


@dataclass(frozen=True, slots=True)
class GpsFix:
    """One message of a receiver: position, velocity and 1-sigma accuracies.

    Position (m) and velocity (m/s) are east, north, up of the scene.

    An accuracy or dilution that the receiver does not state is None. `age_s` is the assumed age of the data on arrival.
    """

    fix_type: int
    satellites: int
    position_enu_m: Vector
    velocity_enu_mps: Vector
    h_acc_m: float | None
    v_acc_m: float | None
    speed_acc_mps: float | None
    hdop: float | None
    vdop: float | None
    age_s: float = 0.0
    has_vertical_velocity: bool = True


class Receiver:
    """One receiver port: the last message and the rhythm in which messages come."""

    def __init__(self) -> None:
        self.fix: GpsFix | None = None
        self.fixed_at_s: float | None = None
        self._heard_at_s = self._began_at_s = 0.0
        self._mean_interval_s: float | None = None
        self._late_in_a_row = 0

    def receive(self, fix: GpsFix, at_s: float) -> None:
        """Take a message from the receiver."""
        interval = at_s - self._heard_at_s
        if self.fix is None or interval > _TIMEOUT_S:
            self._mean_interval_s, self._late_in_a_row, self._began_at_s = None, 0, at_s
        else:
            mean = interval if self._mean_interval_s is None else self._mean_interval_s
            self._mean_interval_s = mean + _INTERVAL_SMOOTHING * (interval - mean)
            self._late_in_a_row = self._late_in_a_row + 1 if interval > _MAX_INTERVAL_S else 0
        self.fix, self._heard_at_s = fix, at_s
        if fix.fix_type >= 2:
            self.fixed_at_s = at_s

    def fix_type(self, at_s: float) -> int:
        """Fix type now: the last message's, or 1 once it is out of date or where there never was one."""
        if self.fix is None or at_s - self._heard_at_s > _TIMEOUT_S:
            return 1
        return self.fix.fix_type

    def satellites(self, at_s: float) -> int:
        """Satellites in use now."""
        return self.fix.satellites if self.fix is not None and at_s - self._heard_at_s <= _TIMEOUT_S else 0

    def is_settled(self, at_s: float) -> bool:
        """Whether messages have come for so long that a receiver of MAVLink counts as healthy before arming."""
        return at_s - self._began_at_s >= _SETTLED_AFTER_S

    def rhythm_ok(self) -> bool:
        """Whether messages come often and evenly enough."""
        mean = self._mean_interval_s
        return mean is None or (mean < _MAX_MEAN_INTERVAL_S and self._late_in_a_row < 2)


def is_injected(instance: int, params: Mapping[str, float]) -> bool:
    """Whether receiver `instance` (from 0) is fed by MAVLink (GPSn_TYPE = 14)."""
    return params[f"GPS{instance + 1}_TYPE"] == _TYPE_MAVLINK


def is_own(instance: int, params: Mapping[str, float]) -> bool:
    """Whether receiver `instance` (from 0) is the aircraft's own.

    The aircraft's own is wired to the first port, if that port has a type for it.
    """
    return instance == 0 and params["GPS1_TYPE"] not in (0, _TYPE_MAVLINK)


def receiver_in_use(receivers: Sequence[Receiver], params: Mapping[str, float], at_s: float, in_use: int) -> int:
    """Choose between two receivers by GPS_AUTO_SWITCH; `in_use` is the choice so far.

    0: GPS_PRIMARY alone. 4: GPS_PRIMARY while it has a 3D fix, else as 1. Otherwise (1): the better fix, at equal fixes the
    one with two more satellites.
    """
    primary = 1 if params["GPS_PRIMARY"] == 1 else 0
    switching = params["GPS_AUTO_SWITCH"]
    if switching == 0 or params["GPS2_TYPE"] == 0:
        return primary
    if switching == 4 and receivers[primary].fix_type(at_s) >= 3:
        return primary
    other = 1 - in_use
    mine, theirs = receivers[in_use].fix_type(at_s), receivers[other].fix_type(at_s)
    more = receivers[other].satellites(at_s) - receivers[in_use].satellites(at_s)
    return other if theirs > mine or (theirs == mine and more >= 2) else in_use


def not_live(receiver: Receiver, at_s: float) -> str | None:
    """Why a receiver is unusable now whatever its accuracy, or None: fix type and rate."""
    if receiver.fix is None or receiver.fix_type(at_s) < 3:
        return "no 3D fix"
    return None if receiver.rhythm_ok() else "messages too seldom"


def refusal(receiver: Receiver, params: Mapping[str, float], at_s: float) -> str | None:
    """Return why EKF3 does not start to use the receiver now; None where it does.

    It looks at rate, fix type and the checks that EK3_GPS_CHECK enables.
    """
    dead, fix = not_live(receiver, at_s), receiver.fix
    if dead is not None or fix is None:
        return dead
    checks, scale = int(params["EK3_GPS_CHECK"]), params["EK3_CHECK_SCALE"] / 100.0
    if checks & _CHECK_SATELLITES and fix.satellites < 6:
        return "too few satellites"
    if checks & _CHECK_HDOP and (fix.hdop is None or fix.hdop > 2.5):
        return "HDOP too high"
    if checks & _CHECK_SPEED and fix.speed_acc_mps is not None and fix.speed_acc_mps > 1.0 * scale:
        return "speed accuracy too coarse"
    if checks & _CHECK_POSITION:
        if fix.h_acc_m is not None and fix.h_acc_m > 5.0 * scale:
            return "horizontal accuracy too coarse"
        if fix.v_acc_m is not None and fix.v_acc_m > 7.5 * scale:
            return "vertical accuracy too coarse"
    return None


def fix_from_gps_input(message: Any, frame: WorldFrame, delay_ms: float) -> GpsFix | None:
    """Turn a decoded GPS_INPUT into a fix, or None where it holds no numbers that an aircraft can have.

    Ignored velocity and altitude are zero, as in the driver, and are used as if they were true; ignored accuracies are
    unstated. The data are taken to be as old as `delay_ms` says (GPSn_DELAY_MS; 0: the driver's 0.2 s), and no older than
    EKF3's buffer.
    """
    numbers = (
        message.alt,
        message.hdop,
        message.vdop,
        message.vn,
        message.ve,
        message.vd,
        message.speed_accuracy,
        message.horiz_accuracy,
        message.vert_accuracy,
    )
    lat_deg, lon_deg = message.lat * 1e-7, message.lon * 1e-7
    if not all(math.isfinite(x) for x in numbers) or abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0:
        return None
    if abs(message.alt) > _HIGHEST_M or max(abs(message.vn), abs(message.ve), abs(message.vd)) > _FASTEST_MPS:
        return None
    flags = message.ignore_flags

    def stated(flag: int, value: float) -> float | None:
        return None if flags & flag else float(value)

    ned = (
        0.0 if flags & _IGNORE_VEL_HORIZ else float(message.vn),
        0.0 if flags & _IGNORE_VEL_HORIZ else float(message.ve),
        0.0 if flags & _IGNORE_VEL_VERT else float(message.vd),
    )
    return GpsFix(
        fix_type=message.fix_type,
        satellites=message.satellites_visible,
        position_enu_m=frame.to_enu(lat_deg, lon_deg, stated(_IGNORE_ALT, message.alt) or 0.0),
        velocity_enu_mps=frame.vector_from_local_ned(ned, lat_deg, lon_deg),
        h_acc_m=stated(_IGNORE_H_ACC, message.horiz_accuracy),
        v_acc_m=stated(_IGNORE_V_ACC, message.vert_accuracy),
        speed_acc_mps=stated(_IGNORE_SPEED_ACC, message.speed_accuracy),
        hdop=stated(_IGNORE_HDOP, message.hdop),
        vdop=stated(_IGNORE_VDOP, message.vdop),
        age_s=min(delay_ms / 1e3 or _ANNOUNCED_DELAY_S, _BUFFERED_S),
        has_vertical_velocity=not flags & _IGNORE_VEL_VERT,
    )
