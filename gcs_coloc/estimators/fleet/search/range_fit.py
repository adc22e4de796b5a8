"""The robust fit of position, velocity and accelerations to ranges, eq. (26), from many points."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from gcs_coloc.core.measurements import FloatArray

LEAST_RANGES = 6  # as many as unknowns: position and velocity
_AZIMUTHS = 12  # chosen: a start every 30 degrees
_ELEVATIONS_RAD = (-0.8, -0.1, 0.1, 0.8)
"""Chosen: starting points 30 degrees apart on the sphere about each peer, above and below it."""
_STARTS = 24  # chosen: so many descents find the global minimum; all run at once
_ITERATIONS = 25  # chosen: Levenberg-Marquardt converges in about ten
_HUBER_SIGMAS = 2.0  # chosen: residuals beyond it pull no harder (Huber 1964)
_ROUGH_MOST_SIGMAS = 50.0  # chosen: bounds the residuals in the ranking of starting points


class RangesToFit(NamedTuple):
    """What is fitted, for n ranges and k unknowns, of which the first six are position and velocity.

    `ranges` (n, 6): time, s, the peer's east, north and up, range and sigma, m. `peers` (n,): the peer of each. `heights` (m, 3):
    time, s, height and sigma, m. `place` (n, 3, k): the place at the time of each range by the unknowns. `prior_sigmas` (k,).
    """

    ranges: FloatArray
    peers: npt.NDArray[np.int64]
    heights: FloatArray
    place: FloatArray
    prior_sigmas: FloatArray

    def without(self, peer: int) -> RangesToFit:
        """Return what is left without the ranges to one peer."""
        kept = self.peers != peer
        return self._replace(ranges=self.ranges[kept], peers=self.peers[kept], place=self.place[kept])


class RangeFit(NamedTuple):
    """The minima of eq. (26) from all starting points.

    States (s, k), costs (s,) and normal matrices (s, k, k); the index of the best.
    """

    x: FloatArray
    cost: FloatArray
    normal: FloatArray
    best: int

    def residuals(self, of: RangesToFit) -> FloatArray:
        """Return the residuals (n,) of some ranges at the best minimum, in sigmas."""
        return np.asarray(_residuals(self.x[self.best : self.best + 1], of)[0])


def fit_ranges(to_fit: RangesToFit, effort: float = 1.0) -> RangeFit:
    """Return the minima of eq. (26). `effort` is the share of the usual starting points and steps."""
    x = _starting_points(to_fit, round(effort * _STARTS))
    x, cost, normal = _descend(x, to_fit, round(effort * _ITERATIONS))
    return RangeFit(x, cost, normal, int(np.argmin(cost)))


def _starting_points(to_fit: RangesToFit, starts: int) -> FloatArray:
    """Return (s, k): positions on the spheres about the peers, those that fit all ranges best, at rest."""
    azimuth = np.arange(_AZIMUTHS) * (2.0 * math.pi / _AZIMUTHS)
    directions = np.array(
        [(math.sin(a) * math.cos(h), math.cos(a) * math.cos(h), math.sin(h)) for h in _ELEVATIONS_RAD for a in azimuth]
    )
    # The latest ranges are enough to place starting points by.
    rows, heights = to_fit.ranges[-8:], to_fit.heights
    points = (rows[:, np.newaxis, 1:4] + rows[:, 4, np.newaxis, np.newaxis] * directions).reshape(-1, 3)
    if len(heights):
        points[:, 2] = heights[-1, 1]
    candidates = np.zeros((len(points), to_fit.place.shape[2]))
    candidates[:, :3] = points
    rough = np.minimum(np.abs(_residuals(candidates, to_fit)), _ROUGH_MOST_SIGMAS).sum(axis=1)
    order = np.argsort(rough, kind="stable")
    # The best ones crowd together: others spread over the rest reach the far side too.
    near, far = order[: starts // 2], order[starts // 2 :: max(1, len(order) // (starts // 2))]
    return np.asarray(candidates[np.concatenate([near, far])])


def _residuals(x: FloatArray, to_fit: RangesToFit) -> FloatArray:
    """Return (s, n): the residual of each range at each state (s, k), in sigmas."""
    ranges = to_fit.ranges
    distance = np.linalg.norm(np.einsum("nij,sj->sni", to_fit.place, x) - ranges[:, 1:4], axis=2)
    return np.asarray((ranges[:, 4] - distance) / ranges[:, 5])


def _descend(x: FloatArray, to_fit: RangesToFit, iterations: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Minimise eq. (26) from all starting points at once (Levenberg-Marquardt, Huber weights).

    Returns the states (s, k), their costs (s,) and normal matrices (s, k, k).
    """
    centre = np.zeros(len(to_fit.prior_sigmas))
    centre[2] = float(to_fit.ranges[:, 3].mean())
    prior = np.diag(to_fit.prior_sigmas**-2)
    damping = np.full(len(x), 1e-2)
    cost, gradient, normal = _linearise(x, to_fit, prior, centre)
    eye = np.eye(len(centre))
    for _ in range(iterations):
        scale = np.einsum("sii->si", normal)[:, :, np.newaxis] * eye
        step = np.linalg.solve(normal + damping[:, np.newaxis, np.newaxis] * scale, gradient[:, :, np.newaxis])[:, :, 0]
        tried = x + step
        cost_t, gradient_t, normal_t = _linearise(tried, to_fit, prior, centre)
        better = cost_t <= cost
        x = np.where(better[:, np.newaxis], tried, x)
        gradient = np.where(better[:, np.newaxis], gradient_t, gradient)
        normal = np.where(better[:, np.newaxis, np.newaxis], normal_t, normal)
        cost = np.where(better, cost_t, cost)
        damping = np.clip(np.where(better, damping * 0.2, damping * 5.0), 1e-9, 1e9)
    return x, cost, normal


def _linearise(
    x: FloatArray, to_fit: RangesToFit, prior: FloatArray, centre: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return cost (s,), downhill gradient (s, k) and normal matrix (s, k, k) at the states (s, k)."""
    ranges, heights, place = to_fit.ranges, to_fit.heights, to_fit.place
    d = np.einsum("nij,sj->sni", place, x) - ranges[:, 1:4]
    distance = np.maximum(np.linalg.norm(d, axis=2), 1e-6)
    u = d / distance[:, :, np.newaxis]
    J = np.einsum("sni,nij->snj", u, place) / ranges[:, 5, np.newaxis]
    residual = (ranges[:, 4] - distance) / ranges[:, 5]
    size = np.abs(residual)
    weight = np.minimum(1.0, _HUBER_SIGMAS / np.maximum(size, 1e-12))
    cost = np.where(size <= _HUBER_SIGMAS, size * size, 2.0 * _HUBER_SIGMAS * size - _HUBER_SIGMAS * _HUBER_SIGMAS).sum(axis=1)
    JW = J * weight[:, :, np.newaxis]
    normal = JW.transpose(0, 2, 1) @ J + prior
    off = centre - x
    gradient = np.einsum("sni,sn->si", JW, residual) + off @ prior
    cost = cost + np.einsum("si,ij,sj->s", off, prior, off)
    if len(heights):
        H = np.zeros((len(heights), len(centre)))
        H[:, 2] = 1.0 / heights[:, 2]
        H[:, 5] = heights[:, 0] / heights[:, 2]
        miss_h = heights[:, 1] / heights[:, 2] - x @ H.T
        normal = normal + H.T @ H
        gradient = gradient + miss_h @ H
        cost = cost + (miss_h * miss_h).sum(axis=1)
    return cost, gradient, normal
