"""Adjustment of ranges to reported positions by Gauss-Newton, for each fault hypothesis.

The fault of a hypothesis is a further unknown.

    z = |p_i + d_i - p_j - d_j| + C b + v,    d = e + B b

z ranges, p reported positions, e their fault-free errors with covariance S, b the fault, v noise with covariance R. The errors e
are eliminated: V = R + H S H', with H the range Jacobian. Statistic: T = (z - h(b))' V^-1 (z - h(b)), minimised over b and over
the positions of vehicles without prior. A difference of T between two hypotheses is twice their log likelihood ratio.

The linear `Adjustment` does not serve here: a receiver that is off by a sizeable part of a range bends the range's direction.

Source: P. J. G. Teunissen, Testing Theory (2000), generalised likelihood ratio; Y. Bar-Shalom et al., Estimation with
Applications to Tracking and Navigation (2001), section 3.4, nonlinear least squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from math import pi

import numpy as np
from numpy.typing import NDArray

from gcs_coloc.core.integrity.epoch_tests.epoch import MIN_INFORMATION_PER_M2, MIN_SIGMA_M, Epoch, EpochArrays, Past
from gcs_coloc.core.measurements import FloatArray

_COARSE_STEPS, _NEWTON_STEPS = 2, 5  # chosen: from a start within a third of a range the error is then below a millimetre
_CONTINUED = 60  # starts; chosen: those of four vehicles all, and of larger fleets the likeliest
_REFINED = 12  # hypotheses; chosen: those that may decide are adjusted with V at their own positions
_NEAR_SHARE = 0.1  # of the shortest range; chosen: an offset below it is found from the reported positions
_SEED_DIRECTIONS = 12  # chosen: one every 30 degrees
_ALIKE = 4.0  # difference of T up to which two offsets fit alike; chosen: a likelihood ratio of 7
_RANK_TOLERANCE = 1e-6  # smallest over largest eigenvalue that counts as not zero; chosen: far above rounding
_FAULT_INFORMATION_PER_M2 = 1e-7  # holds a direction that no range sees; of a fault of 300 m it costs 0.01


class FaultKind(Enum):
    """What a fault hypothesis holds to be off."""

    POSITIONS = "positions"
    PAIR = "pair"
    DEVICE = "device"
    SCALE = "scale"


@dataclass(frozen=True, slots=True)
class AdjustedHypothesis:
    """One fault hypothesis after its adjustment to the ranges.

    `vehicles` are the faulty ones, the pair, or the device's owner. `size_m` is how far the positions are off, or the larger of
    the lengths by which the ranges are. `statistic` is that of the rest, `cost` is the same with the penalty of the hypothesis.
    `degrees_of_freedom` are those that are left.
    """

    kind: FaultKind
    vehicles: tuple[int, ...]
    statistic: float
    cost: float
    degrees_of_freedom: int
    size_m: float


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One fault hypothesis: which positions have a common offset, or which ranges are too long.

    `moved` (epochs, vehicles) is 1 for those with the common offset. `lengthened` (rows, 2) has the factors of two unknown
    lengths, one of each epoch.
    """

    kind: FaultKind
    vehicles: tuple[int, ...]
    moved: FloatArray
    lengthened: FloatArray


class FaultModel:
    """The ranges of one or two epochs, stacked (rows,), with V for given positions. All lengths in m."""

    def __init__(self, now: Epoch, past: Past) -> None:
        then, correlation = past
        self.arrays, epochs = _aligned(now, then)
        self.rows, self.vehicles = len(self.arrays.pairs), len(self.arrays.vehicles)
        self.epochs = len(epochs)
        self._ends = self.arrays.ends
        self._baselines_m = np.concatenate([each.baselines_m for each in epochs])
        self._ranges_m = np.concatenate([each.ranges_m for each in epochs])
        sigmas_m = [np.where(self.arrays.has_prior, 1.0 / each.sqrt_information, 0.0) for each in epochs]
        self._error_m2 = _two_times([one * one for one in sigmas_m], correlation * sigmas_m[0] * sigmas_m[-1])
        biases_m = [each.biases_m for each in epochs]
        self._noise_m2 = _two_times([each.variances_m2 for each in epochs], biases_m[0] * biases_m[-1])
        without = self.arrays.states_without_prior
        self._without_prior = np.concatenate([without + 3 * self.vehicles * epoch for epoch in range(self.epochs)])
        # How a baseline changes with the free positions: (rows, 3, free states).
        axes = np.zeros((3, self.rows * self.epochs, 3))
        axes[np.arange(3), :, np.arange(3)] = 1.0
        self._free_ends = np.stack([self._jacobian(axis)[:, self._without_prior] for axis in axes], axis=1)

    def explain(self, hypotheses: Sequence[Hypothesis], penalties: Sequence[float]) -> list[AdjustedHypothesis]:
        """Return the adjusted hypotheses whose fault the ranges determine, the cheapest first."""
        if not hypotheses:
            return []
        penalty = np.array(penalties)
        crossing = self._crossing(hypotheses)
        lengthened = np.array([each.lengthened for each in hypotheses])
        weights = self._weights(self._jacobian(self._baselines_m))[np.newaxis]
        starts, of = self._starts(crossing, lengthened, weights[0])
        statistics, states = self._minimise(crossing[of], lengthened[of], weights, starts, _COARSE_STEPS)
        likely = np.argsort(statistics + penalty[of], kind="stable")[:_CONTINUED]
        of = of[likely]
        statistics, states = self._minimise(crossing[of], lengthened[of], weights, states[likely], _NEWTON_STEPS)
        order = np.argsort(statistics + penalty[of], kind="stable").tolist()
        few = list(dict.fromkeys(of[order].tolist()))[:_REFINED]
        states = np.array([_nearest_alike(statistics[of == h], states[of == h]) for h in few])
        crossing, lengthened = crossing[few], lengthened[few]
        weights = self._weights(self._jacobian(self._baselines(crossing, states)))
        statistics, states = self._minimise(crossing, lengthened, weights, states, _NEWTON_STEPS)
        ranks = self._ranks(crossing, lengthened, weights, states)
        base = self._ranks(0.0 * crossing[:1], 0.0 * lengthened[:1], weights[:1], states[:1])[0]
        explanations = [
            AdjustedHypothesis(
                hypotheses[h].kind,
                hypotheses[h].vehicles,
                float(statistic),
                float(statistic + penalty[h]),
                self.rows * self.epochs - int(rank),
                _size_m(hypotheses[h].kind, state[:2]),
            )
            for h, statistic, rank, state in zip(few, statistics, ranks, states, strict=True)
            if rank > base
        ]
        return sorted(explanations, key=lambda each: each.cost)

    def linear_gains(self) -> FloatArray:
        """Return by vehicle how much its horizontal fault would explain, linear at the reported positions."""
        jacobian = self._jacobian(self._baselines_m)
        projector = self._without_free(self._weights(jacobian), jacobian)
        innovations = self._ranges_m - np.linalg.norm(self._baselines_m, axis=1)
        gains = []
        for vehicle in range(self.vehicles):
            H = jacobian[:, 3 * vehicle : 3 * vehicle + 2] * self._is_present[:, np.newaxis]
            information = H.T @ projector @ H + _FAULT_INFORMATION_PER_M2 * np.eye(2)
            score = H.T @ projector @ innovations
            gains.append(float(score @ np.linalg.solve(information, score)))
        return np.array(gains)

    @property
    def _is_present(self) -> FloatArray:
        return np.repeat([1.0, 0.0], self.rows)[: self.rows * self.epochs]

    def _weights(self, jacobian: FloatArray) -> FloatArray:
        """V^-1 (..., rows, rows)."""
        return np.asarray(np.linalg.inv(self._noise_m2 + jacobian @ self._error_m2 @ jacobian.swapaxes(-1, -2)))

    def _jacobian(self, baselines_m: FloatArray) -> FloatArray:
        """H (..., rows, states) at some baselines (..., rows, 3)."""
        distances_m = np.maximum(np.linalg.norm(baselines_m, axis=-1, keepdims=True), MIN_SIGMA_M)
        units = baselines_m / distances_m
        row = np.arange(self.rows)
        H: FloatArray = np.zeros((*units.shape[:-1], self.epochs, self.vehicles, 3))
        for epoch in range(self.epochs):
            H[..., epoch * self.rows + row, epoch, self._ends[0], :] = units[..., epoch * self.rows + row, :]
            H[..., epoch * self.rows + row, epoch, self._ends[1], :] = -units[..., epoch * self.rows + row, :]
        return H.reshape(*units.shape[:-1], 3 * self.vehicles * self.epochs)

    def _without_free(self, weights: FloatArray, jacobian: FloatArray) -> FloatArray:
        """V^-1 with the positions of the vehicles without prior eliminated."""
        A = jacobian[:, self._without_prior]
        WA = weights @ A
        return np.asarray(weights - WA @ np.linalg.solve(A.T @ WA + MIN_INFORMATION_PER_M2 * np.eye(A.shape[1]), WA.T))

    def _crossing(self, hypotheses: Sequence[Hypothesis]) -> FloatArray:
        """Which baselines an offset crosses (tests, rows): 1 or -1 where one of the ends alone has it."""
        moved = np.array([each.moved for each in hypotheses])
        i, j = self._ends
        return np.asarray((moved[:, :, i] - moved[:, :, j]).reshape(len(moved), -1))

    def _starts(self, crossing: FloatArray, lengthened: FloatArray, weights: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
        """Return the states (starts, states) to start from, and the hypothesis of each.

        Each hypothesis starts with no fault. One with a large residual also starts from the two best of a ring of offsets: those
        at which the shortest range between what is off and what is not has its length.
        """
        projector = self._without_free(weights, self._jacobian(self._baselines_m))
        ranges_m, baselines_m, moves = self._ranges_m[: self.rows], self._baselines_m[: self.rows], crossing[:, : self.rows]
        innovations = np.abs(ranges_m - np.linalg.norm(baselines_m, axis=1))
        largest_m = np.where(moves, innovations, 0.0).max(axis=1)
        far = np.flatnonzero(largest_m > _NEAR_SHARE * ranges_m.min(initial=np.inf))
        count, free = len(crossing), len(self._without_prior)
        none, of = np.zeros((count, 2 + free)), np.arange(count)
        if not far.size:
            return none, of
        angles = 2.0 * pi * np.arange(_SEED_DIRECTIONS) / _SEED_DIRECTIONS
        ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        shortest = np.where(moves[far], ranges_m, np.inf).argmin(axis=1)
        there_m = -moves[far, shortest, np.newaxis] * baselines_m[shortest, :2]
        seeds: FloatArray = np.zeros((len(far), len(ring), 2 + free))
        seeds[:, :, :2] = there_m[:, np.newaxis] + ranges_m[shortest, np.newaxis, np.newaxis] * ring
        seeded = np.repeat(far, len(ring))
        states = seeds.reshape(-1, 2 + free)
        left = self._residuals(self._baselines(crossing[seeded], states), lengthened[seeded], states)
        costs = ((left @ projector) * left).sum(axis=1).reshape(len(far), len(ring))
        best = np.argsort(costs, axis=1, kind="stable")[:, :2]
        chosen = seeds[np.arange(len(far))[:, np.newaxis], best].reshape(-1, 2 + free)
        return np.concatenate([none, chosen]), np.concatenate([of, np.repeat(far, 2)])

    def _baselines(self, crossing: FloatArray, states: FloatArray) -> FloatArray:
        """The baselines (tests, rows, 3) with the faults and the free positions of some states."""
        baselines_m: FloatArray = self._baselines_m + np.einsum("ras,ts->tra", self._free_ends, states[:, 2:])
        baselines_m[..., :2] += crossing[..., np.newaxis] * states[:, np.newaxis, :2]
        return baselines_m

    def _residuals(self, baselines_m: FloatArray, lengthened: FloatArray, states: FloatArray) -> FloatArray:
        added_m = (lengthened @ states[:, :2, np.newaxis])[..., 0]
        return np.asarray(self._ranges_m - np.linalg.norm(baselines_m, axis=2) - added_m)

    def _design(self, crossing: FloatArray, lengthened: FloatArray, baselines_m: FloatArray) -> FloatArray:
        """The derivative (tests, rows, states) of the ranges by fault and free positions."""
        units = baselines_m / np.maximum(np.linalg.norm(baselines_m, axis=2, keepdims=True), MIN_SIGMA_M)
        by_fault = crossing[..., np.newaxis] * units[..., :2] + lengthened
        return np.concatenate([by_fault, np.einsum("tra,ras->trs", units, self._free_ends)], axis=2)

    def _minimise(
        self, crossing: FloatArray, lengthened: FloatArray, weights: FloatArray, states: FloatArray, steps: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return the smallest statistic that Gauss-Newton meets from some states, and the states there."""
        least: FloatArray = np.full(len(states), np.inf)
        best = states
        damping = np.full(states.shape[1], MIN_INFORMATION_PER_M2)
        damping[:2] = _FAULT_INFORMATION_PER_M2
        for step in range(steps + 1):
            baselines_m = self._baselines(crossing, states)
            left = self._residuals(baselines_m, lengthened, states)
            weighted = (weights @ left[..., np.newaxis])[..., 0]
            statistics = (left * weighted).sum(axis=1)
            is_better = statistics < least
            least, best = np.where(is_better, statistics, least), np.where(is_better[:, np.newaxis], states, best)
            if step == steps:
                break
            J = self._design(crossing, lengthened, baselines_m)
            transposed = J.transpose(0, 2, 1)
            information = transposed @ (weights @ J) + np.diag(damping)
            pull = (transposed @ weighted[..., np.newaxis])[..., 0] - damping * states
            states = states + np.linalg.solve(information, pull[..., np.newaxis])[..., 0]
        return least, best

    def _ranks(self, crossing: FloatArray, lengthened: FloatArray, weights: FloatArray, states: FloatArray) -> FloatArray:
        """Return how many unknowns the ranges determine, by test."""
        J = self._design(crossing, lengthened, self._baselines(crossing, states))
        eigenvalues = np.linalg.eigvalsh(J.transpose(0, 2, 1) @ (weights @ J))
        least = np.maximum(_RANK_TOLERANCE * eigenvalues.max(axis=1, initial=0.0), MIN_INFORMATION_PER_M2)
        return np.asarray((eigenvalues > least[:, np.newaxis]).sum(axis=1))


def _nearest_alike(statistics: FloatArray, states: FloatArray) -> FloatArray:
    """Return the state with the smallest fault of those that fit the ranges as well as the best one.

    Beside a row of vehicles an offset to its other side fits as well as the right one.
    """
    alike = states[statistics <= statistics.min() + _ALIKE]
    return np.asarray(alike[np.hypot(alike[:, 0], alike[:, 1]).argmin()])


def _size_m(kind: FaultKind, fault_m: FloatArray) -> float:
    """Return the size of a fault: an offset (east, north), or a length at each epoch."""
    return float(np.hypot(*fault_m) if kind is FaultKind.POSITIONS else np.abs(fault_m).max())


def _two_times(own: Sequence[FloatArray], shared: FloatArray) -> FloatArray:
    """Return the covariance of variables at one time or two, each correlated with itself alone."""
    if len(own) == 1:
        return np.diag(own[0])
    return np.block([[np.diag(own[0]), np.diag(shared)], [np.diag(shared), np.diag(own[1])]])


def _aligned(now: Epoch, then: Epoch | None) -> tuple[EpochArrays, list[EpochArrays]]:
    """Return the arrays of an epoch, and those of it and an earlier one with the same residuals.

    The residuals are those that both epochs have, of vehicles with a prior in both or in neither.
    """
    if then is None:
        return now.arrays, [now.arrays]
    earlier = {residual.pair: residual for residual in then.residuals}

    def is_alike(vehicle: int) -> bool:
        return now.priors[vehicle].no_prior == then.priors[vehicle].no_prior

    both = [r for r in now.residuals if r.pair in earlier and is_alike(r.from_vehicle) and is_alike(r.to_vehicle)]
    arrays = Epoch(now.at_s, now.priors, tuple(both)).arrays
    return arrays, [arrays, Epoch(then.at_s, then.priors, tuple(earlier[r.pair] for r in both)).arrays]
