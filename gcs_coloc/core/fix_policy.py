"""Whether an answer may be claimed as a fix: alert limit, hysteresis, ranges that fit it, no long life on prediction alone."""

from __future__ import annotations

from math import sqrt

from gcs_coloc.core.aid_settings import AidSettings
from gcs_coloc.core.bound import horizontal_bound_95_m
from gcs_coloc.core.measurements import Estimate, Unknown

MOST_MISFIT = 3.0  # 0.45 where the covariance is true, below 0.9 in all simulated flights; here half are beyond 1.7 sigma


class FixPolicy:
    """One vehicle's, from the time that its aid begins."""

    def __init__(self, settings: AidSettings, began_at_s: float) -> None:
        self._settings = settings
        self._ranged_at_s = began_at_s
        self._sound_since_s: float | None = None
        self._lost = False
        self._had_fix = False

    def why_no_fix(
        self,
        answer: Estimate | Unknown,
        now_s: float,
        *,
        own_gps: bool,
        range_misfit: float | None = None,
        range_jump_m: float | None = None,
    ) -> str | None:
        """Why the answer may not be claimed as a fix, in words; None where it may. Times never decrease from call to call.

        `own_gps`: the vehicle's own receiver is in the answer, so that it needs no ranges. `range_misfit`: the median NIS per
        degree of freedom of its ranges of late, None where there are too few. `range_jump_m`: by what length all of its
        ranges have just come to be off, None where they have not.
        """
        if isinstance(answer, Unknown):
            # Not to be located yet is no loss of a fix: the first one is waited for by the vehicle.
            self._lost = self._lost or (self._had_fix and not own_gps)
            self._sound_since_s = None
            return answer.reason
        if own_gps or answer.ranges_in_use > 0:
            self._ranged_at_s = now_s
        fault = self._fault(answer, now_s)
        if fault is None and not own_gps and range_misfit is not None and range_misfit > MOST_MISFIT:
            fault = f"half of its ranges are {sqrt(range_misfit):.1f} sigma or more off where it is held to be"
        if fault is None and not own_gps and range_jump_m is not None:
            fault = f"all of its ranges jumped by {range_jump_m:.0f} m"
        if fault is not None:
            self._lost, self._sound_since_s = True, None
            return fault
        if self._sound_since_s is None:
            self._sound_since_s = now_s
        if self._lost and now_s - self._sound_since_s < self._settings.regain_after_s:
            return f"good enough again, watched for {self._settings.regain_after_s:g} s"
        self._lost, self._had_fix = False, True
        return None

    def _fault(self, answer: Estimate, now_s: float) -> str | None:
        settings = self._settings
        bound_m = horizontal_bound_95_m(answer.covariance)
        if not bound_m <= settings.alert_limit_m:
            return f"95 % horizontal bound {bound_m:.0f} m is beyond the alert limit of {settings.alert_limit_m:g} m"
        if now_s - self._ranged_at_s > settings.prediction_s:
            return f"no range has been in use for {settings.prediction_s:g} s: prediction alone"
        return None
