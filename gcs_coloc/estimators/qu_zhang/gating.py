"""A gate on the normalised innovation squared (NIS) that cannot lock itself out.

A plain gate refuses every true measurement once its filter is overconfident and wrong. Here many refusals in a row are taken as
evidence against the filter: past a patience, each further refusal inflates its covariance, until measurements pass again.
Single outliers between good measurements never get that far.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

from scipy.stats import chi2

_INFLATION = 4.0
"""Of the covariance. Chosen: it doubles the standard deviation, so ten refusals cover an error of a thousand sigmas."""


@dataclass(frozen=True, slots=True)
class GateResult:
    """What to do with one measurement.

    `inflation` is the factor, >= 1, by which the filter's covariance is to be multiplied now; above 1 only with a refusal.
    """

    accepted: bool
    inflation: float


@dataclass(slots=True)
class NisGate:
    """Tests one filter's measurements of one kind.

    `probability` is that of accepting a measurement that agrees with its stated noise; `patience` is how many refusals in a row
    are blamed on the measurements before the filter's covariance is inflated.
    """

    probability: float
    patience: int
    refused_in_a_row: int = field(default=0, init=False)

    def test(self, nis: float, degrees_of_freedom: int) -> GateResult:
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
