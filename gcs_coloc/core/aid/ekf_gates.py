"""What ArduPilot's EKF3 takes of a GPS, by EK3_GPS_CHECK and EK3_CHECK_SCALE, as measured on ArduPlane and ArduCopter 4.7."""

from __future__ import annotations

from dataclasses import dataclass

from gcs_coloc.core.outputs import GpsInput

CHECK, SCALE = "EK3_GPS_CHECK", "EK3_CHECK_SCALE"
_SATELLITES, _HDOP, _SPEED, _POSITION = 1, 2, 4, 8
_LEAST_SATELLITES, _MOST_HDOP = 6, 2.5
_MOST_SPEED_ACC_MPS, _MOST_H_ACC_M, _MOST_V_ACC_M = 1.0, 5.0, 7.5


@dataclass(frozen=True, slots=True)
class EkfGates:
    """The checks of one vehicle: `checks` is the bit mask EK3_GPS_CHECK, `scale_percent` widens those of accuracy."""

    checks: int
    scale_percent: float

    def refusal(self, fix: GpsInput) -> str | None:
        """Which of a fix's numbers the EKF does not take, in words; None where it takes all."""
        scale = self.scale_percent / 100.0
        if self.checks & _SATELLITES and fix.satellites < _LEAST_SATELLITES:
            return f"{fix.satellites} satellites, it wants {_LEAST_SATELLITES}"
        if self.checks & _POSITION and fix.horiz_accuracy_m > _MOST_H_ACC_M * scale:
            return f"horizontal accuracy {fix.horiz_accuracy_m:.1f} m, it takes {_MOST_H_ACC_M * scale:.4g} m"
        if self.checks & _POSITION and fix.vert_accuracy_m > _MOST_V_ACC_M * scale:
            return f"vertical accuracy {fix.vert_accuracy_m:.1f} m, it takes {_MOST_V_ACC_M * scale:.4g} m"
        if self.checks & _SPEED and fix.speed_accuracy_mps > _MOST_SPEED_ACC_MPS * scale:
            return f"speed accuracy {fix.speed_accuracy_mps:.1f} m/s, it takes {_MOST_SPEED_ACC_MPS * scale:.4g} m/s"
        if self.checks & _HDOP and fix.hdop > _MOST_HDOP:
            return f"HDOP {fix.hdop:.1f}, it takes {_MOST_HDOP}"
        return None
