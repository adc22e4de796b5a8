"""Least-squares adjustment of position priors to ranges, and the effect of each possible fault.

It adjusts one epoch, or two epochs together.

Model, linearised at the priors: r = u.(d_i - d_j) + v, with r the range residual of device i to peer j, u the unit vector from j
to i, d the correction of a vehicle's position, v noise. In matrices r = H d + v, cov(v) = R, cov(d) = S; S is without bound for
the horizontal correction of a vehicle without prior. A range's noise has a part of its own and a part that all ranges of its
pair share.

Normal equations: (K + S^-1) d = g with K = H' R^-1 H, g = H' R^-1 r. Statistic: T = r' (R + H S H')^-1 r = r' R^-1 r - g' d.

With an earlier epoch the corrections of one vehicle at the two times have the correlation c = exp(-interval / correlation time)
of a Gauss-Markov process. The change between the two is then tested by how far fault-free errors change in that time.

Source: P. J. G. Teunissen, Testing Theory (2000), adjustment with prior information; W. Baarda (1968), effect of a fault.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.integrity.epoch_tests.epoch import MIN_INFORMATION_PER_M2, Epoch, Past, RangeResidual
from gcs_coloc.core.integrity.epoch_tests.normal_equations import RANK_TOLERANCE, NormalEquations
from gcs_coloc.core.measurements import FloatArray


@dataclass(frozen=True, slots=True)
class FaultEffect:
    """The effect of one fault as further unknowns.

    `gain`, the fall of the statistic; `rank`, the number of unknowns that the residuals
    determine; `size_m`, their values; `corrections_m`, all states with the fault left out.
    """

    gain: float
    rank: int
    size_m: FloatArray
    corrections_m: FloatArray


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
        """Return the information (2, 2) on a horizontal fault of a reported position, 1/m^2.

        A fault b adds b' I b to the statistic, with I the information.
        """
        return np.asarray(self._solution.position_information[self._number, self._index[vehicle]])

    def position_effect(self, vehicle: int) -> FaultEffect:
        """Return the effect of a reported position that is off by an unknown horizontal vector."""
        gain, rank = self.position_gain(vehicle)
        at = self._index[vehicle]
        size = self._solution.position_effects[2][self._number, at]
        pull = size @ self._solution.information[self._number, 3 * at : 3 * at + 2]
        return FaultEffect(gain, rank, size, self.corrections_m - self._solution.covariance_times(self._number, pull))

    def range_effect(self, chosen: Iterable[int]) -> FaultEffect:
        """Return the effect of one unknown length in all of the chosen residuals, given by their numbers."""
        rows = np.array([self._used[n] for n in chosen], dtype=np.intp)
        alone, score, c = self._solution.range_bias(self._number, rows)
        moved = self._solution.covariance_times(self._number, c)
        left = alone - float(c @ moved)
        if left < max(RANK_TOLERANCE * alone, MIN_INFORMATION_PER_M2):
            return FaultEffect(0.0, 0, np.zeros(1), self.corrections_m)
        score -= float(c @ self.corrections_m)
        size = score / left
        return FaultEffect(score * size, 1, np.array([size]), self.corrections_m - moved * size)

    def placed_offset_m(self, vehicle: int, placed_m: float) -> FloatArray:
        """Return the horizontal correction d (2,) of a vehicle without prior, m.

        It is as far as the ranges determine it: S (S + C)^-1 d, with S the square of `placed_m` times I. d and its covariance C
        are linearised where the vehicle is said to be. In a direction that the ranges hardly see, d is their noise times any
        number.
        """
        correction_m, covariance_m2 = self._solution.first_linear(self._number, self._index[vehicle])
        return np.asarray(np.linalg.solve(covariance_m2 / placed_m**2 + np.eye(2), correction_m))

    def change_m(self, vehicle: int) -> float:
        """Return how much the horizontal correction of a vehicle differs from that in the earlier epoch, m."""
        now_m, then_m = np.split(self.corrections_m, 2)
        return float(np.hypot(*(self.horizontal(vehicle, now_m) - self.horizontal(vehicle, then_m))))

    def horizontal(self, vehicle: int, states: FloatArray) -> FloatArray:
        """Return a vehicle's east and north (2,) of a state vector.

        Of a vector of both epochs they are those in the present one.
        """
        i = 3 * self._index[vehicle]
        return states[i : i + 2]
