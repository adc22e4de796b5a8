"""The fix policy: whether an estimate may be stated as a fix.

It checks the protection level against the alert limit, whether the ranges fit the estimate, and for how long the position has
rested on prediction alone. A lost fix comes back only after it has been sound for a while (hysteresis).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

from gcs_coloc.core.aiding.inhibit import Inhibit, InhibitReason
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.measurements import Estimate, NoEstimate, NoEstimateReason
from gcs_coloc.core.messages.outbound import GpsInput
from gcs_coloc.core.reasons import StatedReason
from gcs_coloc.core.residual_log import CONSISTENT_MEDIAN_NIS
from gcs_coloc.core.stations.node_id import untested_text

_MOST_DETERMINED_HDOP = 30.0  # from 46 on positions in turns were off by ten times their bound, up to 27 never beyond it
_WEARS_OFF = 3.0  # chosen: a moment that seems determined by chance takes back three times its length
_CERTAIN_AFTER_S = 1.0
"""Chosen: a copter's EKF3 gives up 7 to 10 s after its last fix (posRetryTimeNoVel_ms): each second after a gap counts."""
_LONGEST_STEP_S = 1.0  # chosen: a host that stood still has not seen more


class FixPolicy:
    """The fix policy of one vehicle, from the time that its aiding begins."""

    def __init__(self, settings: AidingSettings, began_at_s: float) -> None:
        self._settings = settings
        self._ranged_at_s = began_at_s
        self._updated_at_s = began_at_s
        self._undetermined_s = 0.0
        self._sound_since_s: float | None = None
        self._lost = False
        self._only_too_uncertain = True
        self._had_fix = False

    def inhibit(
        self,
        answer: Estimate | NoEstimate,
        now_s: float,
        *,
        own_gps: bool,
        air_data: bool = False,
        median_nis: float | None = None,
        range_jump_m: float | None = None,
    ) -> Inhibit | None:
        """Return why the estimate may not be stated as a fix; None where it may.

        Times never decrease from call to call.

        `own_gps`: the vehicle's own receiver is in the estimate, so that it needs no ranges. `air_data`: airspeed and bank show
        how the vehicle moves, so that ranges to one peer, or along one line, are enough for as long as the protection level
        allows. `median_nis`: the median NIS per degree of freedom of its ranges of late, None where there are too few.
        `range_jump_m`: by what length all of its ranges have just come to be off, None where they have not.
        """
        if isinstance(answer, NoEstimate):
            # Not to be located yet is no loss of a fix: the first one is waited for by the vehicle.
            self._lost = self._lost or (self._had_fix and not own_gps)
            if self._had_fix:
                self._only_too_uncertain &= answer.reason.reason is NoEstimateReason.TOO_UNCERTAIN
            else:
                # No ranges have ceased from which nothing was predicted yet.
                self._ranged_at_s = now_s
            self._sound_since_s = None
            return StatedReason(InhibitReason.NO_ESTIMATE, detail=answer.reason.text)
        if own_gps or answer.ranges_in_use > 0:
            self._ranged_at_s = now_s
        shows_motion = air_data and not answer.refuses_air_data
        self._update_geometry(now_s, is_determined=own_gps or shows_motion or _is_determined(answer))
        fault = self._fault(answer, now_s)
        if fault is None and not own_gps and median_nis is not None and median_nis > CONSISTENT_MEDIAN_NIS:
            fault = StatedReason(InhibitReason.RANGES_INCONSISTENT, sqrt(median_nis))
        if fault is None and not own_gps and range_jump_m is not None:
            fault = StatedReason(InhibitReason.RANGES_JUMPED, range_jump_m)
        if fault is not None:
            self._lost, self._sound_since_s = True, None
            self._only_too_uncertain &= fault.reason is InhibitReason.BEYOND_ALERT_LIMIT
            return fault
        if self._sound_since_s is None:
            self._sound_since_s = now_s
        regain_s = self._regain_after_s()
        if self._lost and now_s - self._sound_since_s < regain_s:
            return StatedReason(InhibitReason.REGAINING, limit=regain_s)
        self._lost, self._only_too_uncertain, self._had_fix = False, True, True
        return None

    def prediction_left_s(self, now_s: float) -> float:
        """Return for how long a fix may still be stated without a range, s."""
        return self._settings.prediction_s - (now_s - self._ranged_at_s)

    def _regain_after_s(self) -> float:
        """Return how long a lost fix must be sound, s: shorter where all that it lacked was certainty."""
        after_s = self._settings.regain_after_s
        return min(after_s, _CERTAIN_AFTER_S) if self._only_too_uncertain else after_s

    def _update_geometry(self, now_s: float, *, is_determined: bool) -> None:
        """Count for how long the ranges have not determined the horizontal position.

        By chance they may seem to determine it for a moment. So the count then falls gradually, and not to zero at once.
        """
        passed_s, self._updated_at_s = min(now_s - self._updated_at_s, _LONGEST_STEP_S), now_s
        change_s = -_WEARS_OFF * passed_s if is_determined else passed_s
        self._undetermined_s = min(max(self._undetermined_s + change_s, 0.0), self._settings.prediction_s + passed_s)

    def _fault(self, answer: Estimate, now_s: float) -> Inhibit | None:
        settings = self._settings
        level = answer.protection
        if level is None:
            return StatedReason(InhibitReason.NO_PROTECTION_LEVEL)
        if not level.horizontal_m <= settings.alert_limit_m:
            return StatedReason(InhibitReason.BEYOND_ALERT_LIMIT, level.horizontal_m, settings.alert_limit_m)
        if level.untested and settings.require_fault_tests:
            return StatedReason(InhibitReason.UNTESTED, detail=untested_text(level.untested, answer.vehicle))
        if now_s - self._ranged_at_s > settings.prediction_s:
            return StatedReason(InhibitReason.PREDICTION_ALONE, limit=settings.prediction_s)
        if self._undetermined_s > settings.prediction_s:
            return StatedReason(InhibitReason.UNDETERMINED, limit=settings.prediction_s)
        return None


def _is_determined(answer: Estimate) -> bool:
    """Return whether the ranges determine both horizontal coordinates, whatever is assumed of the motion."""
    return answer.ranges_in_use >= 2 and (answer.hdop is None or answer.hdop <= _MOST_DETERMINED_HDOP)


CHECK, SCALE = "EK3_GPS_CHECK", "EK3_CHECK_SCALE"
_SATELLITES, _HDOP, _SPEED, _POSITION = 1, 2, 4, 8  # bits of CHECK
_LEAST_SATELLITES, _MOST_TAKEN_HDOP = 6, 2.5
_MOST_SPEED_ACC_MPS, _MOST_H_ACC_M, _MOST_V_ACC_M = 1.0, 5.0, 7.5  # where SCALE is 100 %


@dataclass(frozen=True, slots=True)
class EkfGates:
    """The checks by which one vehicle's EKF3 decides whether it aligns on a GPS fix.

    `checks` is the bit mask EK3_GPS_CHECK. `scale_percent` is EK3_CHECK_SCALE, which widens the limits of accuracy.
    """

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
        """Return which of a fix's numbers the EKF does not take, in words; None where it takes all."""
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
        if self.checks & _HDOP and fix.hdop > _MOST_TAKEN_HDOP:
            return f"HDOP {fix.hdop:.1f}, it takes {_MOST_TAKEN_HDOP}"
        return None
