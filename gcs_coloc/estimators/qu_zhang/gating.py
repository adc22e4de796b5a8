"""A gate on the normalised innovation squared (NIS) that cannot lock itself out.

A plain gate on a filter that has become confident and wrong refuses every true measurement from then on. Here refusals in a row
say that the filter may be the one who is wrong: past a patience, each further one asks for a wider covariance, until measurements
pass again. Single outliers between good measurements never get that far.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

from scipy.stats import chi2

_INFLATION = 4.0
"""Doubles the standard deviation per refusal: ten refusals cover an error of a thousand sigmas."""


@dataclass(frozen=True, slots=True)
class GateResult:
    """What to do with one measurement.

    `inflation` is the factor, >= 1, by which the filter's covariance is to be multiplied now; above 1 only with a refusal.
    """

    accepted: bool
    inflation: float


@dataclass(slots=True)
class NisGate:
    """Judges one filter's measurements of one kind.

    `probability` is that of accepting a measurement that agrees with its stated noise; `patience` is how many refusals in a row
    are blamed on the measurements before the filter itself is doubted.
    """

    probability: float
    patience: int
    refused_in_a_row: int = field(default=0, init=False)

    def judge(self, nis: float, degrees_of_freedom: int) -> GateResult:
        """Accept or refuse a measurement of the given NIS (a plain number). A NaN is refused."""
        if nis <= threshold(self.probability, degrees_of_freedom):
            self.refused_in_a_row = 0
            return GateResult(accepted=True, inflation=1.0)
        self.refused_in_a_row += 1
        return GateResult(accepted=False, inflation=_INFLATION if self.refused_in_a_row > self.patience else 1.0)


@cache
def threshold(probability: float, degrees_of_freedom: int) -> float:
    """Return the NIS that a consistent measurement stays below with the given probability (chi-square quantile)."""
    return float(chi2.ppf(probability, degrees_of_freedom))
