"""The normal equations of an epoch's adjustments with several earlier ones, solved by Newton's method.

The model is that of `Adjustment`. One epoch is adjusted with several earlier ones at once: arrays are (tests, 2 epochs, ...).
A residual that one of the epochs lacks has weight 0 in that test, and so has the whole earlier epoch of a test without one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from gcs_coloc.core.error_ellipse import eigenvalue_mean_and_radius
from gcs_coloc.core.integrity.epoch_tests.epoch import MIN_INFORMATION_PER_M2, MIN_SIGMA_M, EpochArrays, Past, range_jacobian
from gcs_coloc.core.measurements import FloatArray

RANK_TOLERANCE = 1e-6  # smallest over largest eigenvalue that counts as not zero; chosen: far above rounding
_NEWTON_STEPS = 4  # chosen: bounds the time of an adjustment that diverges
_CURVATURE_SHARE = 0.05  # chosen: what the curvature of a range may be of its sigma. It adds a 400th to the variance


class NormalEquations:
    """The adjustments of one epoch with several earlier ones.

    Each of `pasts` makes one test: with an earlier epoch, or of the present one alone. `used` has for each test the numbers of
    the residuals that take part.
    """

    def __init__(self, now: EpochArrays, pasts: Sequence[Past]) -> None:
        tests, rows = len(pasts), len(now.pairs)
        self._now = now
        self.used: list[Sequence[int]] = [range(rows)] * tests
        self._baselines_m: FloatArray = np.empty((tests, 2, rows, 3))
        self._unit_vectors: FloatArray = np.empty((tests, 2, rows, 3))
        self._ranges_m: FloatArray = np.empty((tests, 2, rows))
        self._residuals_m: FloatArray = np.empty((tests, 2, rows))
        self._baselines_m[:], self._unit_vectors[:], self._ranges_m[:] = now.baselines_m, now.unit_vectors, now.ranges_m
        self._residuals_m[:] = now.residuals_m
        self._weights: FloatArray = np.zeros((tests, 2, 2, rows))
        earlier: FloatArray = np.empty((tests, len(now.sqrt_information)))
        earlier[:] = now.sqrt_information
        for test, (past, _) in enumerate(pasts):
            if past is None:
                self._weights[test, 0, 0] = 1.0 / now.variances_m2
            else:
                self._add(test, past.arrays, earlier)
        self._prior = _prior_information(now, earlier, [0.0 if past is None else c for past, c in pasts])
        variances_without_prior_m2 = self._solve_by_newton()
        used_residuals = [len(used) * (1 if past is None else 2) for used, (past, _) in zip(self.used, pasts, strict=True)]
        known = [round(shares) for shares in (1.0 - MIN_INFORMATION_PER_M2 * variances_without_prior_m2).sum(axis=1).tolist()]
        self.degrees_of_freedom = [rows - unknown for rows, unknown in zip(used_residuals, known, strict=True)]

    def _add(self, test: int, then: EpochArrays, earlier: FloatArray) -> None:
        """Add an earlier epoch to a test: the residuals of the pairs that both have, and its priors."""
        now = self._now
        mine: slice | list[int] = slice(None)
        theirs: slice | list[int] = slice(None)
        if now.pairs == then.pairs and now.no_prior == then.no_prior:
            earlier[test] = then.sqrt_information
        else:
            mine, theirs = _common_residuals(now, then)
            self.used[test] = mine
            for vehicle, at in now.index.items():
                was = then.index.get(vehicle)
                if was is not None and now.no_prior[at] == then.no_prior[was]:
                    earlier[test, 3 * at : 3 * at + 3] = then.sqrt_information[3 * was : 3 * was + 3]
        self._baselines_m[test, 1, mine] = then.baselines_m[theirs]
        self._unit_vectors[test, 1, mine] = then.unit_vectors[theirs]
        self._ranges_m[test, 1, mine] = then.ranges_m[theirs]
        self._residuals_m[test, 1, mine] = then.residuals_m[theirs]
        now_m2, then_m2 = now.variances_m2[mine], then.variances_m2[theirs]
        shared_m2 = now.biases_m[mine] * then.biases_m[theirs]
        determinant = now_m2 * then_m2 - shared_m2 * shared_m2
        # R^-1 of one pair at the two times: a 2x2 block, as pairs are independent of each other.
        self._weights[test, 0, 0, mine] = then_m2 / determinant
        self._weights[test, 1, 1, mine] = now_m2 / determinant
        self._weights[test, 0, 1, mine] = self._weights[test, 1, 0, mine] = -shared_m2 / determinant

    def _solve_by_newton(self) -> FloatArray:
        """Solve, by Newton's method where ranges bend; return the variances of states without prior, m^2."""
        vehicles, tests = len(self._now.vehicles), len(self._weights)
        # A move of d metres bends a range of r metres by d^2 / 2r.
        straight_m2 = 2.0 * _CURVATURE_SHARE * self._now.distance_times_sigma_m2
        without_prior = np.concatenate([self._now.states_without_prior, self._now.states_without_prior + 3 * vehicles])
        shift: FloatArray = np.zeros((tests, 6 * vehicles))
        variances_without_prior_m2 = self._solve(self._unit_vectors, self._residuals_m, without_prior)
        self._first = self.corrections_m, self._columns
        for _ in range(_NEWTON_STEPS - 1):
            step = self.corrections_m[:, without_prior]
            moves_m2 = np.square(step - shift[:, without_prior]).reshape(tests, -1, 2).sum(axis=2)
            moving = moves_m2.max(axis=1, initial=0.0) > straight_m2
            if not moving.any():
                break
            shift[:, without_prior] = np.where(moving[:, np.newaxis], step, shift[:, without_prior])
            variances_without_prior_m2 = self._solve(*self._linearise(shift.reshape(tests, 2, vehicles, 3)), without_prior)
        return variances_without_prior_m2

    def _linearise(self, shift: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return unit vectors and residuals at shifted positions, for corrections that count from the priors."""
        i, j = self._now.ends
        moves = shift[:, :, i] - shift[:, :, j]
        moved = self._baselines_m + moves
        distances_m = np.maximum(np.sqrt(np.einsum("tsra,tsra->tsr", moved, moved)), MIN_SIGMA_M)
        unit_vectors = moved / distances_m[..., np.newaxis]
        return unit_vectors, self._ranges_m - distances_m + np.einsum("tsra,tsra->tsr", unit_vectors, moves)

    def _solve(self, unit_vectors: FloatArray, residuals_m: FloatArray, without_prior: NDArray[np.intp]) -> FloatArray:
        """Solve the normal equations; return the variances of the states without prior, m^2."""
        tests, vehicles = len(unit_vectors), len(self._now.vehicles)
        H = range_jacobian(unit_vectors, self._now.ends, vehicles)
        self._transposed = H.transpose(0, 1, 3, 2)
        self._weighted_m = np.einsum("tabr,tbr->tar", self._weights, residuals_m)
        self._g: FloatArray = (self._transposed @ self._weighted_m[..., np.newaxis]).reshape(tests, 6 * vehicles)
        blocks = self._transposed[:, :, np.newaxis] @ (self._weights[..., np.newaxis] * H[:, np.newaxis])
        self.information: FloatArray = blocks.transpose(0, 1, 3, 2, 4).reshape(tests, 6 * vehicles, 6 * vehicles)
        right_sides: FloatArray = np.zeros((tests, 1 + len(without_prior), 6 * vehicles))
        right_sides[:, 0] = self._g
        right_sides[:, 1 + np.arange(len(without_prior)), without_prior] = 1.0
        known = self.information + self._prior
        # One by one: for matrices of this size numpy's batched solve takes longer.
        self._factors: list[tuple[FloatArray, NDArray[np.intc]]] = []
        solutions: FloatArray = np.empty_like(right_sides)
        for test in range(tests if vehicles else 0):
            factors, pivots, solution, info = lapack.dgesv(known[test].T, right_sides[test].T)
            assert info == 0, "every state has prior information"
            self._factors.append((factors, pivots))
            solutions[test] = solution.T
        self.corrections_m: FloatArray = solutions[:, 0]
        self._columns: FloatArray = solutions[:, 1:]  # of the covariance, of the states without prior
        explained = np.einsum("ts,ts->t", self._g, self.corrections_m)
        self.statistics = np.einsum("tsr,tsr->t", residuals_m, self._weighted_m) - explained
        return np.asarray(self._columns[:, np.arange(len(without_prior)), without_prior])

    def first_linear(self, test: int, at: int) -> tuple[FloatArray, FloatArray]:
        """Return the first linear solution of a vehicle without prior in the present epoch.

        It is the horizontal correction (2,), m, and its covariance (2, 2), m^2. It is linearised where the vehicle is said to
        be, before any further step of Newton's method. `at` is the vehicle's number in the epoch's arrays.
        """
        corrections_m, columns = self._first
        states = slice(3 * at, 3 * at + 2)
        column = int(np.searchsorted(self._now.states_without_prior, 3 * at))
        return corrections_m[test, states], columns[test, column : column + 2, states]

    def covariance_times(self, test: int, pulls: FloatArray) -> FloatArray:
        """Return the covariance of all states of a test, times some vectors (..., states): m for 1/m."""
        solution, _ = lapack.dgetrs(*self._factors[test], pulls.T)
        return np.asarray(solution).T

    @cached_property
    def position_effects(self) -> tuple[FloatArray, NDArray[np.intp], FloatArray]:
        """The effect of a horizontal fault of each vehicle: gain, rank and size.

        Gain and rank are (tests, vehicles), the size is (tests, vehicles, 2) in m.
        """
        score = self._g - (self.information @ self.corrections_m[..., np.newaxis])[..., 0]
        inverses, ranks = pseudo_inverse(self.position_information)
        scores = score[:, self._horizontal]
        sizes = (inverses @ scores[..., np.newaxis])[..., 0]
        return (scores * sizes).sum(axis=2), ranks, sizes

    @cached_property
    def position_information(self) -> FloatArray:
        """The information on each vehicle's fault (tests, vehicles, 2, 2), 1/m^2: K - K (K + S^-1)^-1 K."""
        K, at = self.information, self._horizontal
        pulls = K[:, at]
        moved = np.array(
            [self.covariance_times(test, pulls[test].reshape(at.size, -1)) for test in range(len(self._factors))]
        ).reshape(pulls.shape)
        return np.asarray(K[:, at[:, :, np.newaxis], at[:, np.newaxis, :]] - pulls @ moved.transpose(0, 1, 3, 2))

    @property
    def _horizontal(self) -> NDArray[np.intp]:
        """The indices of each vehicle's horizontal states in the present epoch (vehicles, 2)."""
        return (3 * np.arange(len(self._now.vehicles)))[:, np.newaxis] + np.arange(2)

    def range_bias(self, test: int, rows: NDArray[np.intp]) -> tuple[float, float, FloatArray]:
        """Return the terms of the normal equations for one unknown length in some residuals.

        With C the indicator of these residuals of the present epoch and W = R^-1 they are C' W C, C' W r and H' W C (states,).
        """
        weights = self._weights[test, :, 0, rows].T
        c = (self._transposed[test][:, :, rows] @ weights[..., np.newaxis])[..., 0]
        return float(weights[0].sum()), float(self._weighted_m[test, 0, rows].sum()), c.reshape(-1)


def _prior_information(now: EpochArrays, earlier: FloatArray, correlations: Sequence[float]) -> FloatArray:
    """Return S^-1 (tests, states, states): a 2x2 block over the two times for each axis of each vehicle."""
    tests, size = earlier.shape
    # The inverse of [[1, c], [c, 1]] in units of the sigmas. A state without prior has no correlation over time.
    own = np.where(now.has_prior, [[1.0 / (1.0 - c * c)] for c in correlations], 1.0)
    cross = now.has_prior * [[-c / (1.0 - c * c)] for c in correlations] * now.sqrt_information * earlier
    prior: FloatArray = np.zeros((tests, 4 * size * size))
    below = 2 * size + 1  # from one element of a diagonal to the next
    prior[:, : 2 * size * size : below] = now.sqrt_information * now.sqrt_information * own
    prior[:, 2 * size * size + size :: below] = earlier * earlier * own
    prior[:, size : 2 * size * size : below] = prior[:, 2 * size * size :: below] = cross
    return prior.reshape(tests, 2 * size, 2 * size)


def _common_residuals(now: EpochArrays, then: EpochArrays) -> tuple[list[int], list[int]]:
    """Return the numbers, in each of two epochs, of the residuals that both have.

    Each vehicle of such a residual has a prior in both epochs or in neither.
    """
    earlier = {pair: number for number, pair in enumerate(then.pairs)}
    as_before = {v for v in now.vehicles if v in then.index and now.no_prior[now.index[v]] == then.no_prior[then.index[v]]}
    mine = [n for n, pair in enumerate(now.pairs) if pair in earlier and as_before.issuperset(pair)]
    return mine, [earlier[now.pairs[n]] for n in mine]


def pseudo_inverse(A: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return pseudo-inverses of symmetric matrices (..., 2, 2) without uninformed directions, and ranks."""
    a, b, d = A[..., 0, 0], A[..., 0, 1], A[..., 1, 1]
    mean, radius = eigenvalue_mean_and_radius(a, b, d, np.hypot)
    larger, smaller = mean + radius, mean - radius
    least = np.maximum(larger * RANK_TOLERANCE, MIN_INFORMATION_PER_M2)
    ranks = (larger > least).astype(int) + (smaller > least)
    # Rank one: the projection on the larger eigenvalue's direction, over that eigenvalue.
    adjugate = np.where(
        (ranks == 2)[..., np.newaxis, np.newaxis],
        np.stack([np.stack([d, -b], -1), np.stack([-b, a], -1)], -2),
        np.stack([np.stack([a - smaller, b], -1), np.stack([b, d - smaller], -1)], -2),
    )
    over = np.where(ranks == 2, a * d - b * b, np.where(ranks == 1, 2.0 * radius * larger, np.inf))
    return adjugate / over[..., np.newaxis, np.newaxis], ranks
