"""GPS_INPUT (232) as ArduPilot's MAVLink GPS driver reads it."""

from __future__ import annotations

import math
from typing import Any

from sitl_fakes.geodesy import WorldFrame
from sitl_fakes.receivers import GpsFix

_ASSUMED_AGE_S = 0.1  # what EKF3's buffer leaves of the 0.2 s that its driver announces
_HIGHEST_M = 100_000.0
_FASTEST_MPS = 1_000.0
_IGNORE_ALT, _IGNORE_HDOP, _IGNORE_VDOP, _IGNORE_VEL_HORIZ = 1, 2, 4, 8
_IGNORE_VEL_VERT, _IGNORE_SPEED_ACC, _IGNORE_H_ACC, _IGNORE_V_ACC = 16, 32, 64, 128


def fix_from_gps_input(message: Any, frame: WorldFrame) -> GpsFix | None:
    """Turn a decoded GPS_INPUT into a fix, or None where it holds no numbers that an aircraft can have.

    Ignored velocity and altitude are zero, as in the driver, and are used as if they were true; ignored accuracies are
    unstated. The data are taken to be as old as EKF3's buffer lets them be.
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
        age_s=_ASSUMED_AGE_S,
    )
