"""Global and local tests of an adjustment: do ranges and reported positions agree?

Also here: how far a fault moves a vehicle without prior (solution separation).

Notation: r residuals, V their covariance under the null hypothesis, so that the statistic is T = r' V^-1 r. Without a fault T is
chi-square with as many degrees of freedom as there are residuals beyond the unknowns.

Global test: alarm where T > chi2(dof, alpha). Local test of a fault with design C and unknown size b: the statistic falls by
gain = r' V^-1 C (C' V^-1 C)^-1 C' V^-1 r, which is chi-square with rank(C) degrees of freedom and equals twice the log
likelihood ratio. Alternatives are a vehicle's reported position off by a horizontal vector, a pair whose ranges are off, and a
device whose ranges are all off by one length; with an earlier epoch, what came to be off since. Which fault explains an alarm is
tested in `isolation`.

Solution separation: how far a vehicle without prior moves when a fault is left out of the adjustment.

Source: W. Baarda, A testing procedure for use in geodetic networks (1968), data snooping; P. J. G. Teunissen, Testing Theory
(2000), eqs. for the generalised likelihood ratio; R. G. Brown and P. W. McBurney, Navigation 35 (1988), and J. Blanch et al.,
Baseline advanced RAIM user algorithm, IEEE Trans. AES 51 (2015), for solution separation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gcs_coloc.core.integrity.epoch_tests.adjustment import Adjustment, FaultEffect, adjust
from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, Past
from gcs_coloc.core.measurements import FloatArray

WELL_PLACED_SIGMA_M = 10.0
"""Chosen: beyond it motion places a vehicle, and no error of a range acts in full."""
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
        """Return the correction (2,) of a vehicle without prior if nobody is faulty, in m.

        In directions that the ranges hardly determine it is reduced.
        """
        return self.fit.placed_offset_m(vehicle, WELL_PLACED_SIGMA_M)


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
    effects = [fit.position_effect(v) for v in reporting] + _range_effects(fit) if weight else []
    best = max((effect.gain for effect in effects if effect.rank), default=0.0)
    plausible = [effect for effect in effects if effect.rank and effect.gain >= best - RULED_OUT_MARGIN]
    without_prior = [v for v in fit.vehicles if fit.priors[v].no_prior]
    separation = {}
    for vehicle in without_prior:
        moves = [fit.horizontal(vehicle, effect.corrections_m) for effect in plausible]
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
    """Return the value that a chi-square variable with `dof` degrees of freedom exceeds with `alpha`.

    `alpha` is a probability.
    """
    # Imported here: it takes a quarter of a second, which a start in flight does not have.
    from scipy.special import chdtri

    return float(chdtri(dof, alpha))
