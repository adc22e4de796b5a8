"""How far the position that a vehicle reports jumps other than the vehicle moves: its autopilot took another receiver, or reset.

Which side of a jump was right nobody knows. Until the autopilot's filter has settled, its position is as uncertain as the jump
was large, whatever its receiver states.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, hypot, inf

from gcs_coloc.core.measurements import PositionMeasurement

_SETTLES_S = 1.0
"""ArduPlane's EKF3, switched back to its own receiver, jumped by 2.7 m and was 0.8 m off a second later
(docs/results/real-autopilots.md)."""
_OVER_S = 5.0 * _SETTLES_S
_HELD_S = 5.0
"""In another flight it jumped by 4.5 m, stayed there for 4 s and jumped back (docs/results/real-autopilots.md). Only of a vehicle
that is trusted again a jump is held for so long: of another one it may be a spoofer's, to be found at once."""
_TAKEN_AGAIN_S = 10.0
"""Chosen: GPS_PRIMARY is restored once a vehicle is trusted again, and tried again for some seconds."""
_MOST_M = 10.0
"""Chosen: the accuracy of a receiver alone. More would blind the tests that find a faulty receiver."""
_TIMES_USUAL = 4.0
"""Chosen: of errors that are independent from report to report one in ten million is as large."""
_REMEMBERED_S = 20.0
"""Chosen: the noise of reports is learned anew within some turns."""
_LONGEST_GAP_S = 1.5
"""Chosen: reports at 1 Hz, a little late. Over a longer gap a turn looks like a jump."""


@dataclass(slots=True)
class PositionJumps:
    """The jumps of one vehicle's reported position."""

    _last: PositionMeasurement | None = None
    _usual_m2: float = 0.0
    _jump_m: float = 0.0
    _jumped_at_s: float = 0.0
    _distrusted_at_s: float = -inf

    def sigma_m(self, reported: PositionMeasurement, *, is_trusted: bool) -> float:
        """Add a reported position; return the 1-sigma (m, each axis) that jumps of late add to what is stated of it."""
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
