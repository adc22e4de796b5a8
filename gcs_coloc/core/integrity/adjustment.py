"""Least-squares adjustment of claimed positions to ranges, at one time or at two: what is left over, and what a fault explains.

Model, linearised at the given places: residual = range - |p_i - p_j| = u.(d_i - d_j) + noise, u the unit vector from j to i, d
the correction that a place needs. A claimed position needs one of its stated size, whatever its spread over time; a vehicle
without a claim a free horizontal one. A range has noise of its own and a part that all ranges of its pair have in common.

With a second, earlier scene the corrections of one vehicle at the two times are correlated, as an error that wanders slowly is:
exp(-interval / time). What changed between the two is then judged by how far honest errors wander in that time, and not by how
large they are.

One scene is adjusted with several earlier ones in one stroke: arrays are (tests, 2 scenes, ...). A row that takes no part in a
test has no weight there; so have all of the earlier scene in a test that has none.

Source: adjustment with prior information in normal-equation form; the statistic is r'(R + H S H')^-1 r.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from gcs_coloc.core.integrity.epoch import LEAST_INFORMATION, LEAST_SIGMA_M, Epoch, EpochArrays, RangeResidual
from gcs_coloc.core.measurements import FloatArray

_RANK_TOLERANCE = 1e-6
_NEWTON_STEPS = 4
_SETTLED_M = 0.5

Past = tuple[Epoch | None, float]
"""An earlier scene, and the correlation (0 to 1) of one vehicle's corrections at the two times; None: the present alone."""


@dataclass(frozen=True, slots=True)
class Effect:
    """What freeing one fault does: the drop of the statistic, the unknowns it took, their values (m), and with it the correction
    of every state.
    """

    gain: float
    rank: int
    size_m: FloatArray
    corrections_m: FloatArray


def adjust(now: Epoch, pasts: Sequence[Past]) -> list[Adjustment]:
    """Adjust `now` with each of the earlier scenes, or alone where there is None."""
    solution = _Solution(now.arrays, pasts)
    return [Adjustment(now, solution, number) for number in range(len(pasts))]


class Adjustment:
    """One adjustment. States are the corrections (3 per vehicle of the scene's arrays), those of `now` first.

    `rows` are the rows of `now` that take part, `vehicles` those that they are about.
    """

    def __init__(self, now: Epoch, solution: _Solution, number: int) -> None:
        self.places = now.places
        self.statistic = float(solution.statistics[number])
        self.degrees_of_freedom = int(solution.degrees_of_freedom[number])
        self.corrections_m = solution.corrections_m[number]
        self.rows: tuple[RangeResidual, ...] = now.rows
        self.vehicles: tuple[int, ...] = now.arrays.vehicles
        self._kept = solution.kept[number]
        if len(self._kept) < len(now.rows):
            self.rows = tuple(now.rows[n] for n in self._kept)
            self.vehicles = tuple(sorted({v for row in self.rows for v in row.pair}))
        self._at = now.arrays.at
        self._solution = solution
        self._number = number

    def claim_gain(self, vehicle: int) -> tuple[float, int]:
        """The drop of the statistic and the unknowns that `vehicle_effect` tells of."""
        gains, ranks, _ = self._solution.claim_effects
        at = self._at[vehicle]
        return float(gains[self._number, at]), int(ranks[self._number, at])

    def claim_information(self, vehicle: int) -> FloatArray:
        """Return what the test knows of a horizontal vector b of a claim (2, 2), 1/m^2: it adds b'Ib to the statistic."""
        return np.asarray(self._solution.claim_information[self._number, self._at[vehicle]])

    def vehicle_effect(self, vehicle: int) -> Effect:
        """What a claim that came to be off by an unknown horizontal vector explains."""
        gain, rank = self.claim_gain(vehicle)
        at = self._at[vehicle]
        size = self._solution.claim_effects[2][self._number, at]
        pull = size @ self._solution.information[self._number, 3 * at : 3 * at + 2]
        return Effect(gain, rank, size, self.corrections_m - self._solution.moved(self._number, pull))

    def rows_effect(self, chosen: Iterable[int]) -> Effect:
        """What one length that came to be on all of the chosen rows (their numbers) explains."""
        rows = np.array([self._kept[n] for n in chosen], dtype=np.intp)
        alone, score, c = self._solution.length_on(self._number, rows)
        moved = self._solution.moved(self._number, c)
        left = alone - float(c @ moved)
        if left < max(_RANK_TOLERANCE * alone, LEAST_INFORMATION):
            return Effect(0.0, 0, np.zeros(1), self.corrections_m)
        score -= float(c @ self.corrections_m)
        size = score / left
        return Effect(score * size, 1, np.array([size]), self.corrections_m - moved * size)

    def horizontal(self, vehicle: int, states: FloatArray) -> FloatArray:
        """Return a vehicle's horizontal part (2,) of a state vector, at the time of `now`."""
        i = 3 * self._at[vehicle]
        return states[i : i + 2]


class _Solution:
    """The adjustments of one scene with several earlier ones. `kept`: for each test the numbers of the rows that take part."""

    def __init__(self, now: EpochArrays, pasts: Sequence[Past]) -> None:
        tests, rows = len(pasts), len(now.pairs)
        self._now = now
        self.kept: list[Sequence[int]] = [range(rows)] * tests
        self._apart_m: FloatArray = np.empty((tests, 2, rows, 3))
        self._units: FloatArray = np.empty((tests, 2, rows, 3))
        self._ranges_m: FloatArray = np.empty((tests, 2, rows))
        self._residuals_m: FloatArray = np.empty((tests, 2, rows))
        self._apart_m[:], self._units[:], self._ranges_m[:] = now.apart_m, now.units, now.ranges_m
        self._residuals_m[:] = now.residuals_m
        self._weights: FloatArray = np.zeros((tests, 2, 2, rows))
        earlier: FloatArray = np.empty((tests, len(now.roots)))
        earlier[:] = now.roots
        for test, (past, _) in enumerate(pasts):
            if past is None:
                self._weights[test, 0, 0] = 1.0 / now.variances_m2
            else:
                self._add(test, past.arrays, earlier)
        self._prior = _prior_information(now, earlier, [0.0 if past is None else c for past, c in pasts])
        free_variances_m2 = self._solve_by_newton()
        taking_part = [len(kept) * (1 if past is None else 2) for kept, (past, _) in zip(self.kept, pasts, strict=True)]
        known = [round(shares) for shares in (1.0 - LEAST_INFORMATION * free_variances_m2).sum(axis=1).tolist()]
        self.degrees_of_freedom = [rows - unknown for rows, unknown in zip(taking_part, known, strict=True)]

    def _add(self, test: int, then: EpochArrays, earlier: FloatArray) -> None:
        """Lay an earlier scene beside the present one: the rows of the pairs that both have, and what was known of the places."""
        now = self._now
        mine: slice | list[int] = slice(None)
        theirs: slice | list[int] = slice(None)
        if now.pairs == then.pairs and now.free == then.free:
            earlier[test] = then.roots
        else:
            mine, theirs = _common(now, then)
            self.kept[test] = mine
            for vehicle, at in now.at.items():
                was = then.at.get(vehicle)
                if was is not None and now.free[at] == then.free[was]:
                    earlier[test, 3 * at : 3 * at + 3] = then.roots[3 * was : 3 * was + 3]
        self._apart_m[test, 1, mine] = then.apart_m[theirs]
        self._units[test, 1, mine] = then.units[theirs]
        self._ranges_m[test, 1, mine] = then.ranges_m[theirs]
        self._residuals_m[test, 1, mine] = then.residuals_m[theirs]
        now_m2, then_m2 = now.variances_m2[mine], then.variances_m2[theirs]
        lasting_m2 = now.biases_m[mine] * then.biases_m[theirs]
        determinant = now_m2 * then_m2 - lasting_m2 * lasting_m2
        # The inverse of a pair's noise covariance at the two times, which ties its rows to each other alone.
        self._weights[test, 0, 0, mine] = then_m2 / determinant
        self._weights[test, 1, 1, mine] = now_m2 / determinant
        self._weights[test, 0, 1, mine] = self._weights[test, 1, 0, mine] = -lasting_m2 / determinant

    def _solve_by_newton(self) -> FloatArray:
        """Solve, and where a free place has to move far, again about where it moves; return the free states' variances, m^2."""
        vehicles, tests = len(self._now.vehicles), len(self._weights)
        free = np.concatenate([self._now.free_states, self._now.free_states + 3 * vehicles])
        shift: FloatArray = np.zeros((tests, 6 * vehicles))
        free_variances_m2 = self._solve(self._units, self._residuals_m, free)
        for _ in range(_NEWTON_STEPS - 1):
            step = self.corrections_m[:, free]
            moving = np.abs(step - shift[:, free]).max(axis=1, initial=0.0) > _SETTLED_M
            if not moving.any():
                break
            shift[:, free] = np.where(moving[:, np.newaxis], step, shift[:, free])
            free_variances_m2 = self._solve(*self._linearise(shift.reshape(tests, 2, vehicles, 3)), free)
        return free_variances_m2

    def _linearise(self, shift: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the rows' directions and residuals about the shifted places, for corrections of the places as given."""
        i, j = self._now.ends
        moves = shift[:, :, i] - shift[:, :, j]
        moved = self._apart_m + moves
        distances_m = np.maximum(np.sqrt(np.einsum("tsra,tsra->tsr", moved, moved)), LEAST_SIGMA_M)
        units = moved / distances_m[..., np.newaxis]
        return units, self._ranges_m - distances_m + np.einsum("tsra,tsra->tsr", units, moves)

    def _solve(self, units: FloatArray, residuals_m: FloatArray, free: NDArray[np.intp]) -> FloatArray:
        """Solve with these directions and residuals of the rows; return the free states' variances, m^2."""
        tests, _, rows, _ = units.shape
        vehicles = len(self._now.vehicles)
        i, j = self._now.ends
        number = np.arange(rows)
        design: FloatArray = np.zeros((tests, 2, rows, vehicles, 3))
        design[:, :, number, i] = units
        design[:, :, number, j] = -units
        H = design.reshape(tests, 2, rows, 3 * vehicles)
        self._transposed = H.transpose(0, 1, 3, 2)
        self._weighted_m = np.einsum("tabr,tbr->tar", self._weights, residuals_m)
        self._g: FloatArray = (self._transposed @ self._weighted_m[..., np.newaxis]).reshape(tests, 6 * vehicles)
        blocks = self._transposed[:, :, np.newaxis] @ (self._weights[..., np.newaxis] * H[:, np.newaxis])
        self.information: FloatArray = blocks.transpose(0, 1, 3, 2, 4).reshape(tests, 6 * vehicles, 6 * vehicles)
        asked: FloatArray = np.zeros((tests, 1 + len(free), 6 * vehicles))
        asked[:, 0] = self._g
        asked[:, 1 + np.arange(len(free)), free] = 1.0
        known = self.information + self._prior
        # Each for itself: for matrices of this size numpy's own stroke over all tests takes longer.
        self._factors: list[tuple[FloatArray, NDArray[np.intc]]] = []
        answers: FloatArray = np.empty_like(asked)
        for test in range(tests if vehicles else 0):
            factors, pivots, answer, info = lapack.dgesv(known[test].T, asked[test].T)
            assert info == 0, "what is known of each place leaves no state unknown"
            self._factors.append((factors, pivots))
            answers[test] = answer.T
        self.corrections_m: FloatArray = answers[:, 0]
        explained = np.einsum("ts,ts->t", self._g, self.corrections_m)
        self.statistics = np.einsum("tsr,tsr->t", residuals_m, self._weighted_m) - explained
        return np.asarray(answers[:, 1 + np.arange(len(free)), free])

    def moved(self, test: int, pulls: FloatArray) -> FloatArray:
        """The product of a test's covariance of all states and some vectors: (..., states), m in answer to 1/m."""
        answer, _ = lapack.dgetrs(*self._factors[test], pulls.T)
        return np.asarray(answer).T

    @cached_property
    def claim_effects(self) -> tuple[FloatArray, NDArray[np.intp], FloatArray]:
        """For each test and vehicle, what a correction of its place at `now` by an unknown horizontal vector explains of the
        statistic (tests, vehicles), the unknowns it takes (tests, vehicles), and the vector (tests, vehicles, 2), m.
        """
        score = self._g - (self.information @ self.corrections_m[..., np.newaxis])[..., 0]
        inverses, ranks = pinv(self.claim_information)
        scores = score[:, self._horizontal]
        sizes = (inverses @ scores[..., np.newaxis])[..., 0]
        return (scores * sizes).sum(axis=2), ranks, sizes

    @cached_property
    def claim_information(self) -> FloatArray:
        """What each test knows of such a correction, beyond the claim's stated error, 1/m^2 (tests, vehicles, 2, 2)."""
        K, at = self.information, self._horizontal
        pulls = K[:, at]
        moved = np.array([self.moved(test, pulls[test].reshape(at.size, -1)) for test in range(len(self._factors))]).reshape(
            pulls.shape
        )
        return np.asarray(K[:, at[:, :, np.newaxis], at[:, np.newaxis, :]] - pulls @ moved.transpose(0, 1, 3, 2))

    @property
    def _horizontal(self) -> NDArray[np.intp]:
        """The horizontal states at `now` of each vehicle (vehicles, 2)."""
        return (3 * np.arange(len(self._now.vehicles)))[:, np.newaxis] + np.arange(2)

    def length_on(self, test: int, rows: NDArray[np.intp]) -> tuple[float, float, FloatArray]:
        """One length b on some rows of `now`: b'Wb, b'Wr and H'Wb (states,), W the inverse of the rows' noise."""
        weights = self._weights[test, :, 0, rows].T
        c = (self._transposed[test][:, :, rows] @ weights[..., np.newaxis])[..., 0]
        return float(weights[0].sum()), float(self._weighted_m[test, 0, rows].sum()), c.reshape(-1)


def _prior_information(now: EpochArrays, earlier: FloatArray, correlations: Sequence[float]) -> FloatArray:
    """Return the inverse of the corrections' prior covariance (tests, states, states): of each axis a block over two times."""
    tests, size = earlier.shape
    # The inverse of [[1, c], [c, 1]] between the two times, in units of the sigmas; what is free at one time is so for itself.
    own = np.where(now.claimed, [[1.0 / (1.0 - c * c)] for c in correlations], 1.0)
    cross = now.claimed * [[-c / (1.0 - c * c)] for c in correlations] * now.roots * earlier
    prior: FloatArray = np.zeros((tests, 4 * size * size))
    below = 2 * size + 1  # from an element of a diagonal to the next one
    prior[:, : 2 * size * size : below] = now.roots * now.roots * own
    prior[:, 2 * size * size + size :: below] = earlier * earlier * own
    prior[:, size : 2 * size * size : below] = prior[:, 2 * size * size :: below] = cross
    return prior.reshape(tests, 2 * size, 2 * size)


def _common(now: EpochArrays, then: EpochArrays) -> tuple[list[int], list[int]]:
    """Return the numbers, in each of two scenes, of the rows that both have, between vehicles that claim as much in both."""
    earlier = {pair: number for number, pair in enumerate(then.pairs)}
    as_before = {v for v in now.vehicles if v in then.at and now.free[now.at[v]] == then.free[then.at[v]]}
    mine = [n for n, pair in enumerate(now.pairs) if pair in earlier and as_before.issuperset(pair)]
    return mine, [earlier[now.pairs[n]] for n in mine]


def pinv(A: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the pseudo-inverses of symmetric (..., 2, 2) matrices and their ranks; what nothing measures is left out."""
    a, b, d = A[..., 0, 0], A[..., 0, 1], A[..., 1, 1]
    mean, half = 0.5 * (a + d), np.hypot(0.5 * (a - d), b)
    larger, smaller = mean + half, mean - half
    least = np.maximum(larger * _RANK_TOLERANCE, LEAST_INFORMATION)
    ranks = (larger > least).astype(int) + (smaller > least)
    # Of rank one the projection on the larger one's direction, over it: the same form with the smaller one taken away.
    adjugate = np.where(
        (ranks == 2)[..., np.newaxis, np.newaxis],
        np.stack([np.stack([d, -b], -1), np.stack([-b, a], -1)], -2),
        np.stack([np.stack([a - smaller, b], -1), np.stack([b, d - smaller], -1)], -2),
    )
    over = np.where(ranks == 2, a * d - b * b, np.where(ranks == 1, 2.0 * half * larger, np.inf))
    return adjugate / over[..., np.newaxis, np.newaxis], ranks
