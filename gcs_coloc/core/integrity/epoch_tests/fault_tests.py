"""Global and local tests of an adjustment: do ranges and reported positions agree?

Also here: how far a fault moves a vehicle without prior (solution separation).

The adjustment is by least squares, of position priors to ranges of one epoch, or of two epochs together. Model, linearised at the
priors: r = u.(d_i - d_j) + v, with r the range residual of device i to peer j, u the unit vector from j to i, d the correction of
a vehicle's position, v noise. In matrices r = H d + v, cov(v) = R, cov(d) = S; S is without bound for the horizontal correction
of a vehicle without prior. A range's noise has a part of its own and a part that all ranges of its pair share. Normal equations:
(K + S^-1) d = g with K = H' R^-1 H, g = H' R^-1 r. Statistic: T = r' V^-1 r = r' R^-1 r - g' d with V = R + H S H', the
covariance of r under the null hypothesis. Without a fault T is chi-square with as many degrees of freedom as there are residuals
beyond the unknowns. With an earlier epoch the corrections of one vehicle at the two times have the correlation c = exp(-interval
/ correlation time) of a Gauss-Markov process. The change between the two is then tested by how far fault-free errors change in
that time.

Global test: alarm where T > chi2(dof, alpha). Local test of a fault with design C and unknown size b: the statistic falls by
gain = r' V^-1 C (C' V^-1 C)^-1 C' V^-1 r, which is chi-square with rank(C) degrees of freedom and equals twice the log
likelihood ratio. Alternatives are a vehicle's reported position off by a horizontal vector, a pair whose ranges are off, and a
device whose ranges are all off by one length; with an earlier epoch, what came to be off since. Which fault explains an alarm is
tested in `isolation`.

Solution separation: how far a vehicle without prior moves when a fault is left out of the adjustment.

Source: W. Baarda, A testing procedure for use in geodetic networks (1968), data snooping; P. J. G. Teunissen, Testing Theory
(2000), adjustment with prior information and the generalised likelihood ratio; R. G. Brown and P. W. McBurney, Navigation 35
(1988), and J. Blanch et al., Baseline advanced RAIM user algorithm, IEEE Trans. AES 51 (2015), for solution separation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gcs_coloc.core.integrity.epoch_tests.epoch import MIN_INFORMATION_PER_M2, Epoch, Past, RangeResidual
from gcs_coloc.core.integrity.epoch_tests.normal_equations import RANK_TOLERANCE, NormalEquations, pseudo_inverse
from gcs_coloc.core.measurements import FloatArray

WELL_PLACED_SIGMA_M = 10.0
"""Chosen: beyond it motion places a vehicle, and no error of a range acts in full."""
_ELSEWHERE_LEVEL = 1e-2  # chosen: a sound estimate is taken for another one in every hundredth test, which costs it 0.2 s
ALARM_LEVEL = 1e-6
"""Probability of a false alarm in one test. Chosen: four tests five times a second make at most one in 14 hours."""
_CLEAR_LEVEL = 1e-2
"""Probability that a fault-free fleet is not called clear. Chosen: a detection ends within seconds of the fault."""
_SEPARATION_FROM_LEVEL = 5e-3
"""A fault as significant as this begins to count in the solution separation. Chosen: rarer than 1 in 200 by chance."""
_SEPARATION_FULL_LEVEL = 5e-4
"""As significant as this it counts in full. Chosen: rarer than 1 in 2000 by chance, long before it is detected."""
REST_LEVEL = 1e-3
"""Probability that the rest is not called consistent when the right fault is left out. Chosen: it is tried again."""
RULED_OUT_MARGIN = 10.0
"""A fault whose gain is smaller than the largest by more than this is ruled out: twice a log likelihood ratio. Chosen: a
likelihood ratio of 150."""


@dataclass(frozen=True, slots=True)
class FaultTestResult:
    """Result of the tests of one adjustment.

    `is_consistent`: no alarm. `is_clear`: far from an alarm. `suspects`: in an alarm the vehicles whose position the local tests
    reject, or all that report one where they reject none. `separation_m2` (2, 2): by vehicle without prior the second moment of
    its solution separation over the plausible faults, zero where none is likely enough to count. `fit` is the adjustment.
    """

    statistic: float
    degrees_of_freedom: int
    is_consistent: bool
    is_clear: bool
    suspects: frozenset[int]
    separation_m2: Mapping[int, FloatArray]
    fit: Adjustment

    def offset_m(self, vehicle: int) -> FloatArray:
        """Return the correction (2,), m, of a vehicle without prior if nobody is faulty, as far as determined."""
        return self.fit.placed_offset_m(vehicle, WELL_PLACED_SIGMA_M)

    def confirms(self, vehicle: int) -> bool:
        """Return whether the ranges locate a vehicle without prior, and where it is said to be."""
        return self.is_clear and self.fit.is_placed(vehicle, WELL_PLACED_SIGMA_M, chi2_limit(2, _ELSEWHERE_LEVEL))


def run_tests(now: Epoch, pasts: Sequence[Past]) -> list[FaultTestResult | None]:
    """Test an epoch, alone or against earlier ones; None where there is no redundancy."""
    return [run_test(fit) for fit in adjust(now, pasts)] if now.residuals else [None] * len(pasts)


def run_test(fit: Adjustment) -> FaultTestResult | None:
    """Test one adjustment; None where there is no redundancy."""
    dof = fit.degrees_of_freedom
    if dof < 1:
        return None
    reporting = [v for v in fit.vehicles if not fit.priors[v].no_prior]
    # Bonferroni: the global test and the local tests together have the level of one test.
    alpha = ALARM_LEVEL / (1 + len(reporting))
    # A gain is at most the statistic: below both limits no local test can reject.
    is_significant = fit.statistic > min(chi2_limit(1, _SEPARATION_FROM_LEVEL), chi2_limit(1, alpha))
    gains = [fit.position_gain(v) for v in reporting] if is_significant else []
    weight = max((_separation_weight(gain, rank) for gain, rank in gains), default=0.0)
    rejected = [v for v, (gain, rank) in zip(reporting, gains, strict=False) if rank and gain > chi2_limit(rank, alpha)]
    alarm = fit.statistic > chi2_limit(dof, alpha) or bool(rejected)
    if alarm:
        weight = 1.0  # of ranges, where no position explains it
    effects = [fit.position_effect(v) for v in reporting] + _range_effects(fit) if weight else []
    best = max((effect.gain for effect in effects if effect.rank), default=0.0)
    plausible = [effect for effect in effects if effect.rank and effect.gain >= best - RULED_OUT_MARGIN]
    without_prior = [v for v in fit.vehicles if fit.priors[v].no_prior]
    separation = {}
    for vehicle in without_prior:
        moves = [fit.placed_move_m(vehicle, effect, WELL_PLACED_SIGMA_M) for effect in plausible]
        separation[vehicle] = weight * sum((np.outer(move, move) for move in moves), start=np.zeros((2, 2)))
    return FaultTestResult(
        statistic=fit.statistic,
        degrees_of_freedom=dof,
        is_consistent=not alarm,
        is_clear=not alarm and not weight and fit.statistic <= chi2_limit(dof, _CLEAR_LEVEL),
        suspects=frozenset(rejected or reporting) if alarm else frozenset(),
        separation_m2=separation,
        fit=fit,
    )


def _separation_weight(gain: float, rank: int) -> float:
    """Return how much a fault counts in the solution separation, 0 to 1."""
    if not rank:
        return 0.0
    low, high = chi2_limit(rank, _SEPARATION_FROM_LEVEL), chi2_limit(rank, _SEPARATION_FULL_LEVEL)
    return min(max((gain - low) / (high - low), 0.0), 1.0)


def _range_effects(fit: Adjustment) -> list[FaultEffect]:
    pairs: dict[tuple[int, ...], list[int]] = {}
    devices: dict[int, list[int]] = {}
    for number, residual in enumerate(fit.residuals):
        pairs.setdefault(tuple(sorted(residual.pair)), []).append(number)
        devices.setdefault(residual.from_vehicle, []).append(number)
    chosen = [numbers for _, numbers in sorted(pairs.items())] + [own for _, own in sorted(devices.items()) if len(own) > 1]
    return [fit.range_effect(numbers) for numbers in chosen]


@lru_cache(maxsize=1024)
def chi2_limit(dof: int, alpha: float) -> float:
    """Return what a chi-square variable with `dof` degrees of freedom exceeds with probability `alpha`."""
    # Imported here: it takes a quarter of a second, which a start in flight does not have.
    from scipy.special import chdtri

    return float(chdtri(dof, alpha))


@dataclass(frozen=True, slots=True)
class FaultEffect:
    """The effect of one fault as further unknowns.

    `gain`, the fall of the statistic; `rank`, the number of unknowns that the residuals
    determine; `size_m`, their values; `corrections_m`, all states with the fault left out. A fault of one metre moves them by
    `pulls` (unknowns, states); `covariance_m2` is that of the unknowns.
    """

    gain: float
    rank: int
    size_m: FloatArray
    corrections_m: FloatArray
    pulls: FloatArray
    covariance_m2: FloatArray


def adjust(now: Epoch, pasts: Sequence[Past]) -> list[Adjustment]:
    """Adjust the present epoch with each of the earlier ones, or alone where there is None."""
    solution = NormalEquations(now.arrays, pasts)
    return [Adjustment(now, solution, number) for number in range(len(pasts))]


class Adjustment:
    """One adjustment of position priors to ranges.

    States are the corrections, 3 per vehicle of the epoch's arrays, those of the present epoch first. `residuals` are those of
    the present epoch that take part, `vehicles` their vehicles.
    """

    def __init__(self, now: Epoch, solution: NormalEquations, number: int) -> None:
        self.priors = now.priors
        self.statistic = float(solution.statistics[number])
        self.degrees_of_freedom = int(solution.degrees_of_freedom[number])
        self.corrections_m = solution.corrections_m[number]
        self.residuals: tuple[RangeResidual, ...] = now.residuals
        self.vehicles: tuple[int, ...] = now.arrays.vehicles
        self._used = solution.used[number]
        if len(self._used) < len(now.residuals):
            self.residuals = tuple(now.residuals[n] for n in self._used)
            self.vehicles = tuple(sorted({v for r in self.residuals for v in r.pair}))
        self._index = now.arrays.index
        self._solution = solution
        self._number = number

    def position_gain(self, vehicle: int) -> tuple[float, int]:
        """Return the gain and the rank of `position_effect`."""
        gains, ranks, _ = self._solution.position_effects
        at = self._index[vehicle]
        return float(gains[self._number, at]), int(ranks[self._number, at])

    def position_information(self, vehicle: int) -> FloatArray:
        """Return the information I (2, 2), 1/m^2, on a horizontal fault b, which adds b' I b to the statistic."""
        return np.asarray(self._solution.position_information[self._number, self._index[vehicle]])

    def position_effect(self, vehicle: int) -> FaultEffect:
        """Return the effect of a reported position that is off by an unknown horizontal vector."""
        gain, rank = self.position_gain(vehicle)
        at = self._index[vehicle]
        size = self._solution.position_effects[2][self._number, at]
        pulls = self._solution.covariance_times(self._number, self._solution.information[self._number, 3 * at : 3 * at + 2])
        covariance_m2, _ = pseudo_inverse(self.position_information(vehicle))
        return FaultEffect(gain, rank, size, self.corrections_m - size @ pulls, pulls, covariance_m2)

    def range_effect(self, chosen: Iterable[int]) -> FaultEffect:
        """Return the effect of one unknown length in all of the chosen residuals, given by their numbers."""
        rows = np.array([self._used[n] for n in chosen], dtype=np.intp)
        alone, score, c = self._solution.range_bias(self._number, rows)
        moved = self._solution.covariance_times(self._number, c)
        left = alone - float(c @ moved)
        if left < max(RANK_TOLERANCE * alone, MIN_INFORMATION_PER_M2):
            return FaultEffect(0.0, 0, np.zeros(1), self.corrections_m, moved[np.newaxis], np.zeros((1, 1)))
        score -= float(c @ self.corrections_m)
        size = score / left
        corrections_m, covariance_m2 = self.corrections_m - moved * size, np.array([[1.0 / left]])
        return FaultEffect(score * size, 1, np.array([size]), corrections_m, moved[np.newaxis], covariance_m2)

    def placed_move_m(self, vehicle: int, effect: FaultEffect, placed_m: float) -> FloatArray:
        """Return the horizontal correction (2,) of a vehicle without prior with a fault left out, m.

        It is as far as the rest determines it, as in `placed_offset_m`: beside two peers in one line with the vehicle the noise
        of a metre says that it is anywhere.
        """
        pulls = effect.pulls[:, 3 * self._index[vehicle] : 3 * self._index[vehicle] + 2]
        spread_m2 = pulls.T @ effect.covariance_m2 @ pulls
        move_m, sound_m = self.horizontal(vehicle, effect.corrections_m), self.horizontal(vehicle, self.corrections_m)
        return sound_m + np.asarray(np.linalg.solve(spread_m2 / placed_m**2 + np.eye(2), move_m - sound_m))

    def placed_offset_m(self, vehicle: int, placed_m: float) -> FloatArray:
        """Return the horizontal correction d (2,) of a vehicle without prior, m.

        It is as far as the ranges determine it: S (S + C)^-1 d, with S the square of `placed_m` times I. d and its covariance C
        are linearised where the vehicle is said to be. In a direction that the ranges hardly see, d is their noise times any
        number.
        """
        correction_m, covariance_m2 = self._solution.first_linear(self._number, self._index[vehicle])
        return np.asarray(np.linalg.solve(covariance_m2 / placed_m**2 + np.eye(2), correction_m))

    def is_placed(self, vehicle: int, placed_m: float, limit: float) -> bool:
        """Return whether a correction d is known to `placed_m`, with d^T C^-1 d within a limit."""
        correction_m, covariance_m2 = self._solution.first_linear(self._number, self._index[vehicle])
        is_known = float(np.linalg.eigvalsh(covariance_m2)[-1]) <= placed_m**2
        return is_known and float(correction_m @ np.linalg.solve(covariance_m2, correction_m)) <= limit

    def change_m(self, vehicle: int) -> float:
        """Return how much the horizontal correction of a vehicle differs from that in the earlier epoch, m."""
        now_m, then_m = np.split(self.corrections_m, 2)
        return float(np.hypot(*(self.horizontal(vehicle, now_m) - self.horizontal(vehicle, then_m))))

    def horizontal(self, vehicle: int, states: FloatArray) -> FloatArray:
        """Return a vehicle's present east and north (2,) of a state vector."""
        i = 3 * self._index[vehicle]
        return states[i : i + 2]
