"""Solution separation: how far an estimate is from the solution of each fault hypothesis.

It also has how well that solution is known.

An epoch's range residuals are taken against the estimates, so that a solution of its adjustment is the separation itself.
The hypotheses:
- the model of the motion is wrong: the ranges of the moment alone, all of them, with all reported positions;
- receivers are wrong: the positions of a subset of up to half of the reporting vehicles carry no information;
- ranges are wrong: those of one pair have an unknown common error, or those of one device an unknown length or factor.

Linear: x = C H' W r with C = (H' W H + S^-1)^-1. Without the prior S_k of some states C becomes
C + C_k (S_k - C_kk)^-1 C_k'; with an unknown that the residuals contain times c, v = C H' W c and a = c' W c - c' W H v,
C becomes C + v v' / a and x becomes x - v (c' W r - c' W H x) / a.

Source: J. Blanch, T. Walter, P. Enge et al., Baseline advanced RAIM user algorithm, IEEE Trans. AES 51 (2015); the two updates
are the matrix inversion lemma (Woodbury).
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gcs_coloc.core.error_ellipse import eigenvalue_mean_and_radius
from gcs_coloc.core.integrity.epoch_tests.epoch import MIN_SIGMA_M, Epoch, range_jacobian
from gcs_coloc.core.integrity.epoch_tests.fault_tests import WELL_PLACED_SIGMA_M
from gcs_coloc.core.integrity.epoch_tests.isolation import MAX_CANDIDATES, MAX_SUBSET
from gcs_coloc.core.measurements import FloatArray

_LEAST_INFORMATION_PER_M2 = 1e-6  # of a coordinate without prior: a 1-sigma of 1 km, so that every hypothesis has a solution
_MEDIAN_SIGMAS = 0.674
"""Median distance in one direction, in sigmas: without a receiver a position is poor in one direction. Source: the Gaussian."""


class FaultClass(Enum):
    """What a hypothesis holds to be wrong."""

    MOTION = "motion"
    RECEIVERS = "receivers"
    RANGES = "ranges"


class Separation(NamedTuple):
    """The solution separation of one vehicle under one fault hypothesis.

    `vehicles` are those at fault. `separation_m` is the distance of the solution from the estimate, `sigma_m` the 1-sigma of
    the solution's worst direction, both in m.
    """

    fault: FaultClass
    vehicles: tuple[int, ...]
    separation_m: float
    sigma_m: float


_Hypotheses = tuple[FaultClass, list[tuple[int, ...]], FloatArray, FloatArray]
"""Hypotheses of one class: who is at fault in each, the shifts (n, 2) of the solutions, m, their covariances (n, 2, 2), m^2.

For several sets of residuals the shifts have a last axis of them."""


class SolutionSeparation:
    """The adjustment of one epoch, from which the hypotheses of each vehicle without prior follow."""

    def __init__(self, epoch: Epoch) -> None:
        self._arrays = arrays = epoch.arrays
        self._H = range_jacobian(arrays.unit_vectors, arrays.ends, len(arrays.vehicles))
        self._weights = 1.0 / np.maximum(arrays.variances_m2, MIN_SIGMA_M**2)
        self._prior = np.where(arrays.has_prior, arrays.sqrt_information**2, _LEAST_INFORMATION_PER_M2)
        weighted = self._weights[:, np.newaxis] * self._H
        self._C: FloatArray = np.linalg.inv(self._H.T @ weighted + np.diag(self._prior))
        self._x: FloatArray = self._C @ (weighted.T @ arrays.residuals_m)
        self._subsets = self._receiver_subsets()

    @property
    def vehicles(self) -> list[int]:
        """The vehicles without prior."""
        return [vehicle for vehicle, free in zip(self._arrays.vehicles, self._arrays.no_prior, strict=True) if free]

    def covariance_m2(self, vehicle: int) -> FloatArray:
        """Return the horizontal covariance (2, 2) of one vehicle by ranges and reported positions alone, m^2."""
        at = 3 * self._arrays.index[vehicle]
        return np.asarray(self._C[at : at + 2, at : at + 2])

    def propagate_m2(self, vehicle: int, ranges_m2: FloatArray, positions_m2: FloatArray) -> FloatArray:
        """Return the horizontal covariance (2, 2), m^2, of errors in the solution of one vehicle.

        `ranges_m2` (residuals, residuals) is the covariance of the ranges' errors, `positions_m2` (states,) are the variances of
        those of the reported positions.
        """
        at = 3 * self._arrays.index[vehicle]
        C = self._C[at : at + 2]
        by_range, by_position = C @ (self._H.T * self._weights), C * self._prior
        return np.asarray(by_range @ ranges_m2 @ by_range.T + (by_position * positions_m2) @ by_position.T)

    def of(self, vehicle: int) -> list[Separation]:
        """Return all hypotheses of one vehicle without prior, that of the motion first."""
        found: list[Separation] = []
        for fault, who, shifts, covariances in self._hypotheses(vehicle, self._x, self._arrays.residuals_m):
            found += _separations(fault, who, np.hypot(shifts[:, 0], shifts[:, 1]), covariances)
        return found

    def expected_of(self, vehicle: int, estimate_m2: FloatArray) -> list[Separation]:
        """Return the hypotheses with the separations that noise alone makes of them, in the median.

        `estimate_m2` is the horizontal covariance (2, 2) of the vehicle's estimate, m^2. The difference to a solution that uses
        a part of what it uses has the difference of their covariances (Blanch et al.). Where nothing is left to place the
        vehicle its solution is the estimate: noise does not move it.
        """
        reported_m2 = np.where(self._arrays.has_prior, self._arrays.sqrt_information**-2.0, 0.0)
        by_noise_m2 = np.diag(1.0 / self._weights) + (self._H * reported_m2) @ self._H.T
        found: list[Separation] = []
        # One unit of each residual at a time: the shifts are linear in them.
        of_each = self._C @ (self._H.T * self._weights)
        for fault, who, shifts, covariances in self._hypotheses(vehicle, of_each, np.eye(len(self._weights))):
            moved_m2 = np.einsum("hkr,rs,hls->hkl", shifts, by_noise_m2, shifts, optimize=True)
            variances_m2 = np.maximum(_larger_eigenvalues(moved_m2 - estimate_m2), 0.0)
            found += _separations(fault, who, _MEDIAN_SIGMAS * np.sqrt(variances_m2), covariances)
        return found

    def _hypotheses(self, vehicle: int, x: FloatArray, residuals_m: FloatArray) -> Iterator[_Hypotheses]:
        """Yield the hypotheses of a vehicle for the solution `x` of residuals (several: along a last axis)."""
        at = 3 * self._arrays.index[vehicle]
        own = slice(at, at + 2)
        yield FaultClass.MOTION, [(vehicle,)], x[np.newaxis, own], self._C[np.newaxis, own, own]
        for subsets in self._subsets:
            yield self._receivers(own, subsets, x)
        yield from self._ranges(own, vehicle, x, residuals_m)

    def _receiver_subsets(self) -> list[NDArray[np.intp]]:
        """Return the subsets of reporting vehicles by their size, each as the places of its vehicles."""
        reporting = [at for at, free in enumerate(self._arrays.no_prior) if not free]
        if len(reporting) > MAX_CANDIDATES:
            # Those whose ranges weigh most.
            weight = np.abs(self._H).T @ self._weights
            reporting = sorted(sorted(reporting, key=lambda at: -weight[3 * at : 3 * at + 2].sum())[:MAX_CANDIDATES])
        largest = min(max(len(reporting) // 2, 1), MAX_SUBSET) if reporting else 0
        return [np.array(list(combinations(reporting, size)), dtype=np.intp) for size in range(1, largest + 1)]

    def _receivers(self, own: slice, subsets: NDArray[np.intp], x: FloatArray) -> _Hypotheses:
        """Return the hypotheses that the positions of a subset are wrong: these keep the least information."""
        states = (3 * subsets[:, :, np.newaxis] + np.arange(2)).reshape(len(subsets), -1)
        removed = 1.0 / (self._prior[states] - _LEAST_INFORMATION_PER_M2)
        inner = -self._C[states[:, :, np.newaxis], states[:, np.newaxis, :]]
        inner[:, np.arange(states.shape[1]), np.arange(states.shape[1])] += removed
        pulls = self._C[own][:, states].transpose(1, 2, 0)
        gains = np.linalg.solve(inner, pulls)
        # The prior mean of a displacement is zero: what is removed pulled the state itself back.
        shifts = x[own] + np.einsum("hsk,hs...->hk...", gains, x[states])
        covariances = self._C[own, own] + pulls.transpose(0, 2, 1) @ gains
        who = [tuple(self._arrays.vehicles[at] for at in subset) for subset in subsets.tolist()]
        return FaultClass.RECEIVERS, who, shifts, covariances

    def _ranges(self, own: slice, vehicle: int, x: FloatArray, residuals_m: FloatArray) -> Iterator[_Hypotheses]:
        """Yield the hypotheses that the ranges of a vehicle's pairs or device are off.

        Hypotheses of other ranges tell of its peers alone.
        """
        arrays = self._arrays
        columns: list[list[float]] = []
        who: list[tuple[int, ...]] = []
        for pair in sorted({(min(pair), max(pair)) for pair in arrays.pairs if vehicle in pair}):
            columns.append([float(set(each) == set(pair)) for each in arrays.pairs])
            who.append(pair)
        measured = [float(i == vehicle) for i, _ in arrays.pairs]
        either = [float(vehicle in pair) for pair in arrays.pairs]
        for rows in [measured, either] if measured != either else [either]:
            if sum(rows) > 1.0:
                columns += [rows, list(arrays.ranges_m * rows / arrays.ranges_m.mean())]
                who += [(vehicle,)] * 2
        if not columns:
            return
        c = np.array(columns)
        weighted = c * self._weights
        v = weighted @ self._H @ self._C
        a = np.maximum(np.einsum("hr,hr->h", weighted, c) - np.einsum("hr,rs,hs->h", weighted, self._H, v), 1e-12)
        size = ((weighted @ (residuals_m - self._H @ x)).T / a).T
        shifts = x[own] - np.einsum("hk,h...->hk...", v[:, own], size)
        covariances = self._C[own, own] + v[:, own, np.newaxis] * v[:, np.newaxis, own] / a[:, np.newaxis, np.newaxis]
        yield FaultClass.RANGES, who, shifts, covariances


def noise_excess_m2(stated: Epoch, found: Epoch) -> dict[int, FloatArray]:
    """Return the variance (2, 2) that noise beyond the stated one adds to vehicles, m^2.

    Only vehicles that the ranges alone place well are in it. `stated` and `found` are one epoch, with its noise as stated and as
    it was found to be; they are the same object where these are alike. The solution has the weights of the stated noise, as the
    filter has.
    """
    if found is stated or not stated.residuals:
        return {}
    solution = SolutionSeparation(stated)
    ranges_m2 = found.arrays.range_covariance_m2 - stated.arrays.range_covariance_m2
    positions_m2 = found.arrays.sqrt_information**-2.0 - stated.arrays.sqrt_information**-2.0
    placed = [v for v in solution.vehicles if float(np.trace(solution.covariance_m2(v))) < WELL_PLACED_SIGMA_M**2]
    return {v: solution.propagate_m2(v, ranges_m2, positions_m2) for v in placed}


def range_excess_m2(stated: Epoch, found: Epoch) -> dict[tuple[int, int], float]:
    """Return the variance that noise beyond the stated one adds to the residuals of each pair, m^2.

    `stated` and `found` are as in `noise_excess_m2`.
    """
    if found is stated:
        return {}
    arrays = found.arrays
    positions_m2 = (arrays.sqrt_information**-2.0 - stated.arrays.sqrt_information**-2.0).reshape(-1, 3)
    along_m2 = np.einsum("rk,erk->r", arrays.unit_vectors**2, positions_m2[arrays.ends])
    excess_m2 = arrays.variances_m2 - stated.arrays.variances_m2 + along_m2
    return dict(zip(arrays.pairs, excess_m2.tolist(), strict=True))


def _separations(
    fault: FaultClass, who: list[tuple[int, ...]], distances_m: FloatArray, covariances: FloatArray
) -> list[Separation]:
    sigmas = np.sqrt(np.maximum(_larger_eigenvalues(covariances), 0.0)).tolist()
    return [Separation(fault, *each) for each in zip(who, distances_m.tolist(), sigmas, strict=True)]


def _larger_eigenvalues(covariances: FloatArray) -> FloatArray:
    """Return the larger eigenvalue of each of some symmetric matrices (n, 2, 2)."""
    mean, radius = eigenvalue_mean_and_radius(covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1], np.hypot)
    return np.asarray(mean + radius)
