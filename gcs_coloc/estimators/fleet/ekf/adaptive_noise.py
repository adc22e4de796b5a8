"""Adaptive noise: coloured/white split of an error, manoeuvre detector and learned noise level.

A receiver states how large its error is, never how it is spread over time. White noise of the stated size makes each report
differ from the smooth curve through its predecessors; the error of a navigation filter's output hardly does, it drifts over
minutes. So the observed scatter is white, the rest of the stated variance coloured, eq. (16). Coloured error taken for white
makes a filter overconfident within seconds; so whiteness has to be proven, and manoeuvres count against it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from operator import attrgetter
from typing import NamedTuple

from gcs_coloc.core.measurements import PositionMeasurement, RangeMeasurement

_DECAY = 1.0 - 1.0 / 1000.0  # chosen: the split follows a change of the noise over 1000 samples
_PROOF_SAMPLES = 20.0  # chosen: with so many samples half of the observed scatter counts as proven white
_LONGEST_GAP_S = 2.0  # chosen: over longer gaps a manoeuvre cannot be told from noise
_JERK_MPS3 = 3.0  # chosen: jerk of usual flight; what it bends the track within four samples does not count as noise
_MOST_SIGMAS = 4.0  # chosen: one outlier counts as no more than this many stated sigmas
_WELL_KNOWN = 0.25  # chosen: relative standard error of the white variance from which on it is used at its upper bound
_LEAST_REST = 0.01  # chosen: share of the stated variance that remains when the uncertain time explains all of it
_LEAST_WHITE_SHARE = 0.05  # chosen: least white sigma as a share of the stated one, which keeps S positive definite
_OVERLAP = 2.3
"""Sum of the squared correlations of third differences (1, 15/20, 6/20, 1/20, both signs): their variance scatters more."""

_MOST_RATIO = 10.0  # chosen: one manoeuvre that was missed for a second raises the learned level by half at most
_SETTLED_RATIO = 0.7
"""Chosen: below 1, as gusts last for seconds: the position errs by more than corrections of white noise would show."""
_LONGEST_LEARNED_S = 1.0  # chosen: what the sum of the corrections was before a longer pause says nothing of the pause

_COMPARED_S = 2.0
"""Chosen: twice the correlation time of manoeuvres that recur; over a shorter time the noise of the velocity hides them."""
_LONGEST_COMPARED_S = 4.0
"""Chosen: over a longer time a vehicle has turned to and fro, which cancels in the change of its velocity."""
_LEAST_LEVEL = 1.0  # chosen: a vehicle that hovered may fly off as it loses its GPS

_NOTHING_SEEN = (0.0, 0.0)

Values = tuple[float, ...]


def without_time_error(m: PositionMeasurement | RangeMeasurement) -> tuple[float, float]:
    """Return the sigmas (horizontal, vertical), m, without the part that an uncertain time causes."""
    if isinstance(m, RangeMeasurement):
        sigma_m = _less(m.sigma_m, m.time_sigma_m if m.clock_of is not None else 0.0)
        return sigma_m, sigma_m
    ve, vn, vu = m.velocity_enu_mps if m.velocity_enu_mps is not None else (0.0, 0.0, 0.0)
    return _less(m.sigma_h_m, math.hypot(ve, vn) * m.time_sigma_s), _less(m.sigma_v_m, vu * m.time_sigma_s)


def _less(sigma_m: float, part_m: float) -> float:
    return math.sqrt(max(sigma_m * sigma_m - part_m * part_m, _LEAST_REST * sigma_m * sigma_m))


class NoiseSplit:
    """Coloured/white split of the noise of one stream of values measured together, eq. (16). Immutable.

    The values may be of several groups (horizontal, vertical), each with a variance of its own.
    """

    __slots__ = ("_history", "_seen")

    def __init__(
        self, history: tuple[tuple[float, tuple[Values, ...]], ...] = (), seen: tuple[tuple[float, float], ...] = ()
    ) -> None:
        self._history = history
        self._seen = seen

    def updated(self, at_s: float, groups: tuple[Values, ...], sigmas_m: Values) -> NoiseSplit:
        """Return the split after one more sample.

        `groups` holds the values by group, m, and `sigmas_m` the stated sigma of each group. Times must not decrease.
        """
        history, seen = self._history, self._seen
        if history and not 0.0 < at_s - history[-1][0] <= _LONGEST_GAP_S:
            history = ()
        if len(history) < 3:
            return NoiseSplit((*history, (at_s, groups)), seen)
        (ta, a), (tb, b), (tc, c) = history
        # The parabola through the last three samples, extrapolated to this one.
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
                residual_m = z - wa * za - wb * zb - wc * zc
                square_m2 = (residual_m * residual_m - bend_m2) / gain
                sum_m2 += square_m2 if square_m2 < most_m2 else most_m2
                weight += 1.0
            now.append((sum_m2 * _DECAY, weight * _DECAY))
        return NoiseSplit((history[1], history[2], (at_s, groups)), tuple(now))

    def split(self, group: int, sigma_m: float, least_coloured_share: float) -> tuple[float, float]:
        """Return the sigmas (white, coloured) in m of a sample with the stated sigma of one group."""
        sum_m2, weight = self._seen[group] if self._seen else _NOTHING_SEEN
        seen_m2 = max(sum_m2, 0.0)
        least_m2 = seen_m2 / (weight + _PROOF_SAMPLES)
        # Without proof each part may be as large as the whole.
        most_m2 = (seen_m2 + _PROOF_SAMPLES * sigma_m * sigma_m) / (weight + _PROOF_SAMPLES)
        # Once the white variance is well known, its upper bound (two standard errors) counts as white.
        error = math.sqrt(2.0 * _OVERLAP / max(weight, 1.0))
        likely_m2 = least_m2 * (1.0 + 2.0 * error) if error < _WELL_KNOWN else least_m2
        coloured_m2 = max(sigma_m * sigma_m - likely_m2, (least_coloured_share * sigma_m) ** 2)
        return math.sqrt(max(most_m2, (_LEAST_WHITE_SHARE * sigma_m) ** 2)), math.sqrt(coloured_m2)

    def mean_square_m2(self, group: int) -> float | None:
        """Return the observed white variance of one group, m^2; None where nothing was observed."""
        sum_m2, weight = self._seen[group] if self._seen else _NOTHING_SEEN
        return max(sum_m2, 0.0) / weight if weight > 0.0 else None

    def lower_bound_m(self, group: int) -> float:
        """Return the white sigma of one group less two standard errors, and by more after few samples, m."""
        sum_m2, weight = self._seen[group] if self._seen else _NOTHING_SEEN
        error = math.sqrt(2.0 * _OVERLAP / max(weight, 1.0))
        return math.sqrt(max(sum_m2, 0.0) / ((weight + _PROOF_SAMPLES) * (1.0 + 2.0 * error)))


NO_SAMPLES = NoiseSplit()
"""The split of a stream without samples."""


class PairNoise(NamedTuple):
    """Noise of the ranges of a pair.

    That of `every` one shows a device that scatters more than it states, that of those `used` how white these are: what the gate
    refuses stands out of the track, and the next three beside it, which would count as proof of white noise.
    """

    every: NoiseSplit = NO_SAMPLES
    used: NoiseSplit = NO_SAMPLES

    def updated(self, at_s: float, range_m: float, sigma_m: float) -> PairNoise:
        """Return the noise after one more range, as one that is used."""
        every = self.every.updated(at_s, ((range_m,),), (sigma_m,))
        return PairNoise(every, every if self.used is self.every else self.used.updated(at_s, ((range_m,),), (sigma_m,)))


@dataclass(slots=True)
class ManoeuvreDetector:
    """Manoeuvre detector: compares the velocity corrections made with their predicted covariance, eq. (9).

    Under a right model the corrections are white with a known covariance. Their exponentially decaying sum c then has the
    decaying sum C as its covariance, and c' C^-1 c / 2 has mean 1. An unmodelled turn makes it large within a second or two.
    Compare Bar-Shalom, Li, Kirubarajan 2001, section 11.2 (adjustable level process noise, fading-memory NIS).
    """

    c_e: float = 0.0
    c_n: float = 0.0
    C_ee: float = 0.0
    C_en: float = 0.0
    C_nn: float = 0.0
    c_u: float = 0.0
    C_uu: float = 0.0
    at_s: float = -math.inf

    def update(
        self, at_s: float, memory_s: float, we: Sequence[float], wn: Sequence[float], wu: Sequence[float], e: Sequence[float]
    ) -> None:
        """Decay to a time, then add the velocity corrections (we, wn, wu) e of the whitened innovations e."""
        f = math.exp(-(at_s - self.at_s) / memory_s) if at_s > self.at_s else 1.0
        g = f * f
        c_e, c_n, c_u = self.c_e * f, self.c_n * f, self.c_u * f
        C_ee, C_en, C_nn, C_uu = self.C_ee * g, self.C_en * g, self.C_nn * g, self.C_uu * g
        for east, north, up, innovation in zip(we, wn, wu, e, strict=True):
            c_e += east * innovation
            c_n += north * innovation
            c_u += up * innovation
            C_ee += east * east
            C_en += east * north
            C_nn += north * north
            C_uu += up * up
        self.c_e, self.c_n, self.c_u = c_e, c_n, c_u
        self.C_ee, self.C_en, self.C_nn, self.C_uu = C_ee, C_en, C_nn, C_uu
        self.at_s = max(at_s, self.at_s)

    def gains(self) -> tuple[float, float]:
        """Return the process noise gains (horizontal, vertical), at least 1, eq. (9).

        They are the squares of c' C^-1 c / 2 and of c^2 / C (a third of it), 1 in steady flight and without data.
        """
        ratio = self.ratio()
        ratio_v = self.c_u * self.c_u / self.C_uu if self.C_uu > 1e-150 else 1.0
        return max(ratio * ratio, 1.0), max(ratio_v * ratio_v / 3.0, 1.0)

    def ratio(self) -> float:
        """Return c' C^-1 c / 2 of the horizontal velocity corrections: 1 on average, and without data."""
        c_e, c_n, C_ee, C_en, C_nn = self.c_e, self.c_n, self.C_ee, self.C_en, self.C_nn
        det = C_ee * C_nn - C_en * C_en
        if det > 1e-9 * C_ee * C_nn and det >= 1e-300:
            return 0.5 * (C_nn * c_e * c_e - 2.0 * C_en * c_e * c_n + C_ee * c_n * c_n) / det
        trace = C_ee + C_nn
        return (c_e * c_e + c_n * c_n) / trace if trace > 1e-150 else 1.0

    def copy(self) -> ManoeuvreDetector:
        """Return an independent copy."""
        return ManoeuvreDetector(*_DETECTOR_FIELDS(self))


_DETECTOR_FIELDS = attrgetter(*(one.name for one in fields(ManoeuvreDetector)))


def learned_log_level(log_level: float, ratio: float, since_s: float, time_s: float, bounds: tuple[float, float]) -> float:
    """Return the logarithm of a noise level, adjusted to what the corrections show, eq. (30).

    For the time `since_s` their squares were `ratio` times those predicted. `time_s` is the learning time. `bounds` are those of
    the level itself.
    """
    least, most = bounds
    return min(max(log_level + (ratio - _SETTLED_RATIO) * since_s / time_s, math.log(least)), math.log(most))


@dataclass(slots=True)
class NoiseLevel:
    """How large a noise is against its setting, learned from velocity corrections, eq. (30).

    The corrections are those by ranges and position reports. Air data do not count: where they are wrong, as in gusts, they and
    the ranges correct the velocity to and fro, which cancels in the sum of both. Compare the integral action of an adjustable
    level of process noise (Bar-Shalom, Li, Kirubarajan 2001, section 11.2).
    """

    log_level: float = 0.0
    corrections: ManoeuvreDetector = field(default_factory=ManoeuvreDetector)
    compared: PositionMeasurement | None = None
    """The last report whose velocity was compared with that of an earlier one."""
    shown_log_level: float = -math.inf
    """The same of all that its reports showed, with what its tilt tells of it; none of a vehicle without tilt."""

    @property
    def level(self) -> float:
        """The factor of the variances."""
        return math.exp(self.log_level)

    @property
    def untold_level(self) -> float:
        """The factor of the variances while no tilt tells of its manoeuvres."""
        return math.exp(max(self.log_level, self.shown_log_level))

    def learn(self, at_s: float, time_s: float, bounds: tuple[float, float]) -> None:
        """Adjust the level, within its bounds, by how much the corrections until now exceed their prediction."""
        since_s = min(at_s - self.corrections.at_s, _LONGEST_LEARNED_S)
        if since_s > 0.0 and self.corrections.at_s > -math.inf:
            ratio = min(self.corrections.ratio(), _MOST_RATIO)
            self.log_level = learned_log_level(self.log_level, ratio, since_s, time_s, bounds)

    def learn_from_report(
        self,
        m: PositionMeasurement,
        density_m2ps3: float,
        time_s: float,
        most: float,
        told_mps: Callable[[float, float], tuple[float, float] | None],
    ) -> None:
        """Adjust the level of a vehicle without states by the velocity that it reports, eq. (41).

        The change of that velocity since an earlier report is compared with its prediction. The level rises to `most` at most.
        `density_m2ps3` is that of its white acceleration at level 1, eq. (8). `told_mps` returns by how much the velocity changed
        between two times by the vehicle's tilt, east and north; None where no tilt is known.
        """
        if m.velocity_enu_mps is None or m.sigma_velocity_mps is None:
            return
        before = self.compared
        since_s = m.measured_at_s - before.measured_at_s if before is not None else math.inf
        if since_s < _COMPARED_S:
            return
        self.compared = m
        if before is None or before.velocity_enu_mps is None or since_s > _LONGEST_COMPARED_S:
            return
        (e, n, _), (e_before, n_before, _) = m.velocity_enu_mps, before.velocity_enu_mps
        noise_m2ps2, bounds = 2.0 * m.sigma_velocity_mps**2, (_LEAST_LEVEL, most)

        def learned(log_level: float, told: tuple[float, float]) -> float:
            square_m2ps2 = 0.5 * ((e - e_before - told[0]) ** 2 + (n - n_before - told[1]) ** 2)
            ratio = square_m2ps2 / (math.exp(log_level) * density_m2ps3 * since_s + noise_m2ps2)
            return learned_log_level(log_level, min(ratio, _MOST_RATIO), since_s, time_s, bounds)

        told = told_mps(before.measured_at_s, m.measured_at_s)
        self.shown_log_level = learned(max(self.shown_log_level, 0.0), (0.0, 0.0)) if told is not None else -math.inf
        self.log_level = learned(self.log_level, told or (0.0, 0.0))

    def copy(self) -> NoiseLevel:
        """Return an independent copy."""
        return NoiseLevel(self.log_level, self.corrections.copy(), self.compared, self.shown_log_level)
