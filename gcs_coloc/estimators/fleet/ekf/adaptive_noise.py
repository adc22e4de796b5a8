"""How much of a stream's error is white and how much is slow, told from the stream itself.

A receiver states how large its error is, never how it is spread over time. White noise of the stated size makes each report
differ from the smooth curve through its predecessors; the error of a navigation filter's output, or of a receiver's fix, hardly
does, for it drifts over minutes. So: what the reports are seen to scatter is white, the rest of what was stated is slow. To
take slow error for white makes a filter overconfident within seconds; so whiteness has to be proven, and manoeuvres count
against it.
"""

from __future__ import annotations

import math

from gcs_coloc.core.measurements import PositionMeasurement, RangeMeasurement

_FADE = 1.0 - 1.0 / 1000.0
_PROOF_SAMPLES = 20.0
_LONGEST_GAP_S = 2.0
_JERK_MPS3 = 3.0
_MOST_SIGMAS = 4.0
_WELL_KNOWN = 0.25
_LEAST_REST = 0.01
_OVERLAP = 2.3
"""How much more the variance of third differences scatters than that of independent values: sum of squared correlations."""

_NOTHING_SEEN = (0.0, 0.0)

Values = tuple[float, ...]


def without_time_error(m: PositionMeasurement | RangeMeasurement) -> tuple[float, float]:
    """Return the sigmas (horizontal, vertical; of a range twice the same) in m without what the uncertain time adds to them."""
    if isinstance(m, RangeMeasurement):
        sigma_m = _less(m.sigma_m, m.time_sigma_m if m.clock_of is not None else 0.0)
        return sigma_m, sigma_m
    ve, vn, vu = m.velocity_enu_mps if m.velocity_enu_mps is not None else (0.0, 0.0, 0.0)
    return _less(m.sigma_h_m, math.hypot(ve, vn) * m.time_sigma_s), _less(m.sigma_v_m, vu * m.time_sigma_s)


def _less(sigma_m: float, part_m: float) -> float:
    return math.sqrt(max(sigma_m * sigma_m - part_m * part_m, _LEAST_REST * sigma_m * sigma_m))


class NoiseSplit:
    """Estimates the variance of the white part of one stream of values that are measured together. Never changes: `updated` tells
    what is known with one report more.

    The values may be of several groups, horizontal and vertical ones: their noise is told apart, one variance for each group.
    """

    __slots__ = ("_history", "_seen")

    def __init__(
        self, history: tuple[tuple[float, tuple[Values, ...]], ...] = (), seen: tuple[tuple[float, float], ...] = ()
    ) -> None:
        self._history = history
        self._seen = seen

    def updated(self, at_s: float, groups: tuple[Values, ...], sigmas_m: Values) -> NoiseSplit:
        """Return what is known with one more report (metres, by groups) of these stated sigmas; times must not decrease."""
        history, seen = self._history, self._seen
        if history and not 0.0 < at_s - history[-1][0] <= _LONGEST_GAP_S:
            history = ()
        if len(history) < 3:
            return NoiseSplit((*history, (at_s, groups)), seen)
        (ta, a), (tb, b), (tc, c) = history
        # The parabola through the last three reports, carried on to this one.
        wa = (at_s - tb) * (at_s - tc) / ((ta - tb) * (ta - tc))
        wb = (at_s - ta) * (at_s - tc) / ((tb - ta) * (tb - tc))
        wc = (at_s - ta) * (at_s - tb) / ((tc - ta) * (tc - tb))
        gain = 1.0 + wa * wa + wb * wb + wc * wc
        bend_m = _JERK_MPS3 * (at_s - ta) * (at_s - tb) * (at_s - tc) / 6.0
        bend_m2 = bend_m * bend_m
        now = []
        for i, sigma_m in enumerate(sigmas_m):
            sum_m2, weight = seen[i] if seen else _NOTHING_SEEN
            most_m2 = (_MOST_SIGMAS * sigma_m) ** 2
            for z, za, zb, zc in zip(groups[i], a[i], b[i], c[i], strict=True):
                miss_m = z - wa * za - wb * zb - wc * zc
                square_m2 = (miss_m * miss_m - bend_m2) / gain
                sum_m2 += square_m2 if square_m2 < most_m2 else most_m2
                weight += 1.0
            now.append((sum_m2 * _FADE, weight * _FADE))
        return NoiseSplit((history[1], history[2], (at_s, groups)), tuple(now))

    def split(self, group: int, sigma_m: float, least_slow_share: float) -> tuple[float, float]:
        """Return the sigmas (white, slow) in metres of a report with the stated sigma of one group."""
        sum_m2, weight = self._seen[group] if self._seen else _NOTHING_SEEN
        seen_m2 = max(sum_m2, 0.0)
        least_m2 = seen_m2 / (weight + _PROOF_SAMPLES)
        # Before there is proof each part may be as large as all that is stated.
        most_m2 = (seen_m2 + _PROOF_SAMPLES * sigma_m * sigma_m) / (weight + _PROOF_SAMPLES)
        # Once that variance is well known, a stream that may well be white (two standard errors) is taken for white.
        error = math.sqrt(2.0 * _OVERLAP / max(weight, 1.0))
        likely_m2 = least_m2 * (1.0 + 2.0 * error) if error < _WELL_KNOWN else least_m2
        slow_m2 = max(sigma_m * sigma_m - likely_m2, (least_slow_share * sigma_m) ** 2)
        return math.sqrt(max(most_m2, (0.05 * sigma_m) ** 2)), math.sqrt(slow_m2)

    def lower_bound_m(self, group: int) -> float:
        """Return by how much one group is seen to scatter at the least (1-sigma in metres, less two standard errors)."""
        sum_m2, weight = self._seen[group] if self._seen else _NOTHING_SEEN
        error = math.sqrt(2.0 * _OVERLAP / max(weight, 1.0))
        return math.sqrt(max(sum_m2, 0.0) / ((weight + _PROOF_SAMPLES) * (1.0 + 2.0 * error)))


NO_SAMPLES = NoiseSplit()
