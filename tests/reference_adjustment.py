"""Reference adjustment: residual by residual and test by test, as the definition reads."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot

import numpy as np

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, RangeResidual
from gcs_coloc.core.measurements import FloatArray

_RANK_TOLERANCE = 1e-6
_MIN_INFORMATION = 1e-9  # 1/m^2: what is known no better than to 30 km is not known
_MIN_SIGMA_M = 0.01
_NEWTON_STEPS = 4
_CURVATURE_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class ReferenceEffect:
    """What freeing one fault does: the drop of the statistic, the unknowns it took, their values (m), and with it the correction
    of every state.
    """

    gain: float
    rank: int
    size_m: FloatArray
    corrections_m: FloatArray


class Adjustment:
    """One adjustment. States are the corrections (3 per vehicle, in the order of `vehicles`), those of `now` first."""

    def __init__(self, now: Epoch, then: Epoch | None = None, correlation: float = 0.0) -> None:
        """Adjust `now`, or what both epochs hold; `correlation` is that of one vehicle's corrections at the two times, 0 to 1."""
        epochs, self.residuals = _common(now, then)
        self.vehicles = sorted({v for residual in self.residuals[0] for v in residual.pair})
        self.at = {vehicle: index for index, vehicle in enumerate(self.vehicles)}
        self.priors = epochs[0].priors
        self.degrees_of_freedom = 0
        if not self.vehicles:
            return
        i, j = self._ends = [
            np.array([self.at[residual.pair[end]] for residual in self.residuals[0]], dtype=int) for end in (0, 1)
        ]
        priors = [np.array([epoch.priors[v].position_enu_m for v in self.vehicles]) for epoch in epochs]
        self._baselines_m = [place[i] - place[j] for place in priors]
        measured = [np.array([residual.residual_m for residual in residuals]) for residuals in self.residuals]
        self._ranges_m = [residual + _lengths(d) for residual, d in zip(measured, self._baselines_m, strict=True)]
        self._weights = _weights(self.residuals)
        self._prior = self._prior_information(epochs, correlation)
        shift: FloatArray = np.zeros((len(epochs), len(self.vehicles), 3))
        free = np.array([self.priors[v].no_prior for v in self.vehicles], dtype=bool)
        # The move by which a range bends by so much of its sigma, squared: d^2 / 2r.
        straight_m2 = 2.0 * _CURVATURE_SHARE * min(_distance_m(now, r) * hypot(r.sigma_m, r.bias_m) for r in now.residuals)
        for _ in range(_NEWTON_STEPS if free.any() else 1):
            self._solve(shift)
            step = self.corrections_m.reshape(shift.shape) * free[:, np.newaxis]
            step[:, :, 2] = 0.0
            if not np.square(step - shift).sum(axis=2).max(initial=0.0) > straight_m2:
                break
            shift = step
        self._left = self._K - self._K @ self.covariance_m2 @ self._K
        self._score = self._g - self._K @ self.corrections_m
        unknown = np.concatenate([np.repeat(free, 3)] * len(epochs)) & (np.arange(len(self._prior)) % 3 < 2)
        known_share = 1.0 - _MIN_INFORMATION * np.diagonal(self.covariance_m2)[unknown]
        self.degrees_of_freedom = len(self.residuals[0]) * len(epochs) - round(float(known_share.sum()))

    def _prior_information(self, epochs: list[Epoch], correlation: float) -> FloatArray:
        """Return the inverse of the corrections' prior covariance: of each axis a block over the two times."""
        size = 3 * len(self.vehicles)
        # The inverse of [[1, c], [c, 1]] between the two times, in units of the sigmas.
        own, cross = (1.0, 0.0) if len(epochs) == 1 else (1.0 / (1.0 - correlation**2), -correlation / (1.0 - correlation**2))
        information = np.array([_information(epoch, self.vehicles) for epoch in epochs])
        free = information[0] == _MIN_INFORMATION
        prior: FloatArray = np.zeros((len(epochs) * size, len(epochs) * size))
        axis = np.arange(size)
        for a in range(len(epochs)):
            for b in range(len(epochs)):
                both = np.sqrt(information[a] * information[b])
                prior[a * size + axis, b * size + axis] = np.where(free, both * (a == b), both * (own if a == b else cross))
        return prior

    def _solve(self, shift: FloatArray) -> None:
        """Linearise about the shifted priors and solve; corrections are from the priors as given."""
        parts = [self._linearise(number, moved) for number, moved in enumerate(shift)]
        H, r = [part[0] for part in parts], [part[1] for part in parts]
        W, size, span = self._weights, H[0].shape[1], range(len(parts))
        self._H = H
        self._K: FloatArray = np.empty((len(parts) * size, len(parts) * size))
        for a in span:
            for b in span:
                self._K[a * size : (a + 1) * size, b * size : (b + 1) * size] = H[a].T @ (W[a][b][:, np.newaxis] * H[b])
        self._weighted = [sum((W[a][b] * r[b] for b in span), start=np.zeros(len(r[a]))) for a in span]
        self._g: FloatArray = np.concatenate([H[a].T @ self._weighted[a] for a in span])
        self.covariance_m2: FloatArray = np.asarray(np.linalg.inv(self._K + self._prior), dtype=np.float64)
        self.corrections_m: FloatArray = self.covariance_m2 @ self._g
        self.statistic = float(sum(r[a] @ self._weighted[a] for a in span) - self._g @ self.corrections_m)

    def _linearise(self, epoch: int, shift: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the design matrix (residuals, 3 vehicles) and the residuals (residuals,) at the priors, linearised at the
        shifted ones.
        """
        i, j = self._ends
        moves = shift[i] - shift[j]
        moved = self._baselines_m[epoch] + moves
        distance_m = np.maximum(_lengths(moved), _MIN_SIGMA_M)
        unit = moved / distance_m[:, np.newaxis]
        H: FloatArray = np.zeros((len(i), len(self.vehicles), 3))
        number = np.arange(len(i))
        H[number, i], H[number, j] = unit, -unit
        r = self._ranges_m[epoch] - distance_m + np.einsum("ij,ij->i", unit, moves)
        return H.reshape(len(i), -1), r

    def position_effect(self, vehicle: int) -> ReferenceEffect:
        """What a reported position that came to be off by an unknown horizontal vector explains."""
        i = 3 * self.at[vehicle]
        index = slice(i, i + 2)
        inverse, rank = pseudo_inverse(self._left[index, index])
        score = self._score[index]
        size = inverse @ score
        corrections = self.corrections_m - self.covariance_m2 @ (self._K[:, index] @ size)
        return ReferenceEffect(float(score @ size), rank, size, corrections)

    def range_effect(self, chosen: Iterable[int]) -> ReferenceEffect:
        """What one length that came to be on all of the chosen residuals (their numbers) explains."""
        b = np.zeros(len(self.residuals[0]))
        b[list(chosen)] = 1.0
        c = np.concatenate([H.T @ (w * b) for H, w in zip(self._H, self._weights[0], strict=True)])
        left = float(b @ (self._weights[0][0] * b) - c @ self.covariance_m2 @ c)
        if left < max(_RANK_TOLERANCE * float(b @ (self._weights[0][0] * b)), _MIN_INFORMATION):
            return ReferenceEffect(0.0, 0, np.zeros(1), self.corrections_m)
        score = float(b @ self._weighted[0] - c @ self.corrections_m)
        size = score / left
        return ReferenceEffect(score * size, 1, np.array([size]), self.corrections_m - self.covariance_m2 @ c * size)

    def horizontal(self, vehicle: int, states: FloatArray) -> FloatArray:
        """Return a vehicle's horizontal part (2,) of a state vector, at the time of `now`."""
        i = 3 * self.at[vehicle]
        return states[i : i + 2]


def _information(epoch: Epoch, vehicles: list[int]) -> FloatArray:
    """Return what is known of each axis of each vehicle's correction (3 vehicles,), 1/m^2."""
    known = []
    for place in (epoch.priors[v] for v in vehicles):
        horizontal = _MIN_INFORMATION if place.no_prior else max(place.sigma_h_m, _MIN_SIGMA_M) ** -2
        known += [horizontal, horizontal, max(place.sigma_v_m, _MIN_SIGMA_M) ** -2]
    return np.array(known)


def _distance_m(epoch: Epoch, residual: RangeResidual) -> float:
    i, j = (epoch.priors[v].position_enu_m for v in residual.pair)
    return max(float(np.linalg.norm(np.subtract(i, j))), _MIN_SIGMA_M)


def _common(now: Epoch, then: Epoch | None) -> tuple[list[Epoch], list[tuple[RangeResidual, ...]]]:
    """Return the epochs and, for each, its residuals; of two epochs those of the pairs that both have, in the same order."""
    if then is None:
        return [now], [now.residuals]
    earlier = {residual.pair: residual for residual in then.residuals}
    pairs = [
        (residual, earlier[residual.pair])
        for residual in now.residuals
        if residual.pair in earlier and all(now.priors[v].no_prior == then.priors[v].no_prior for v in residual.pair)
    ]
    return [now, then], [tuple(pair[0] for pair in pairs), tuple(pair[1] for pair in pairs)]


def _weights(residuals: list[tuple[RangeResidual, ...]]) -> list[list[FloatArray]]:
    """Return the inverse of the residuals' noise covariance: for each two epochs the weights (residuals,) that tie a residual to
    itself.
    """
    variances = [np.array([residual.sigma_m**2 + residual.bias_m**2 for residual in each]) for each in residuals]
    if len(residuals) == 1:
        return [[1.0 / variances[0]]]
    lasting = np.array([a.bias_m * b.bias_m for a, b in zip(*residuals, strict=True)])
    determinant = variances[0] * variances[1] - lasting**2
    return [
        [variances[1] / determinant, -lasting / determinant],
        [-lasting / determinant, variances[0] / determinant],
    ]


def pseudo_inverse(A: FloatArray) -> tuple[FloatArray, int]:
    """Return the pseudo-inverse of a symmetric (2, 2) matrix and its rank; directions that nothing measures are left out."""
    a, b, d = float(A[0, 0]), float(A[0, 1]), float(A[1, 1])
    mean, half = 0.5 * (a + d), hypot(0.5 * (a - d), b)
    larger, smaller = mean + half, mean - half
    least = max(larger * _RANK_TOLERANCE, _MIN_INFORMATION)
    if smaller > least:
        return np.array([[d, -b], [-b, a]]) / (a * d - b * b), 2
    if larger > least:
        # The projection on the larger one's direction, over it.
        return np.array([[a - smaller, b], [b, d - smaller]]) / (2.0 * half * larger), 1
    return np.zeros((2, 2)), 0


def _lengths(vectors: FloatArray) -> FloatArray:
    """Return the lengths (n,) of vectors (n, 3)."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", vectors, vectors)))
