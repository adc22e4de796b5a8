"""What ArduPilot's EKF3 takes of a GPS, by EK3_GPS_CHECK and EK3_CHECK_SCALE, as measured on ArduPlane and ArduCopter 4.7."""

from __future__ import annotations

from dataclasses import dataclass

from gcs_coloc.core.messages.outbound import GpsInput

CHECK, SCALE = "EK3_GPS_CHECK", "EK3_CHECK_SCALE"
_SATELLITES, _HDOP, _SPEED, _POSITION = 1, 2, 4, 8  # bits of CHECK
_LEAST_SATELLITES, _MOST_HDOP = 6, 2.5
_MOST_SPEED_ACC_MPS, _MOST_H_ACC_M, _MOST_V_ACC_M = 1.0, 5.0, 7.5  # where SCALE is 100 %


@dataclass(frozen=True, slots=True)
class EkfGates:
    """The checks of one vehicle: `checks` is the bit mask EK3_GPS_CHECK, `scale_percent` widens those of accuracy."""

    checks: int
    scale_percent: float

    @property
    def most_position_m(self) -> tuple[float, float] | None:
        """The largest horizontal and vertical 1-sigma that it takes, m; None where it takes any."""
        scale = self.scale_percent / 100.0
        return (_MOST_H_ACC_M * scale, _MOST_V_ACC_M * scale) if self.checks & _POSITION else None

    @property
    def most_speed_mps(self) -> float | None:
        """The largest 1-sigma of the speed that it takes, m/s; None where it takes any."""
        return _MOST_SPEED_ACC_MPS * self.scale_percent / 100.0 if self.checks & _SPEED else None

    def refusal(self, fix: GpsInput) -> str | None:
        """Which of a fix's numbers the EKF does not take, in words; None where it takes all."""
        if self.checks & _SATELLITES and fix.satellites < _LEAST_SATELLITES:
            return f"{fix.satellites} satellites, it wants {_LEAST_SATELLITES}"
        if self.most_position_m is not None:
            horizontal_m, vertical_m = self.most_position_m
            if fix.horiz_accuracy_m > horizontal_m:
                return f"horizontal accuracy {fix.horiz_accuracy_m:.1f} m, it takes {horizontal_m:.4g} m"
            if fix.vert_accuracy_m > vertical_m:
                return f"vertical accuracy {fix.vert_accuracy_m:.1f} m, it takes {vertical_m:.4g} m"
        if self.most_speed_mps is not None and fix.speed_accuracy_mps > self.most_speed_mps:
            return f"speed accuracy {fix.speed_accuracy_mps:.1f} m/s, it takes {self.most_speed_mps:.4g} m/s"
        if self.checks & _HDOP and fix.hdop > _MOST_HDOP:
            return f"HDOP {fix.hdop:.1f}, it takes {_MOST_HDOP}"
        return None
