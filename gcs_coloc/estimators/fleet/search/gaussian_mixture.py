"""Gaussian mixture: a sum of k Gaussians of position and velocity.

It is given by means x (k, 6), covariances P (k, 6, 6) and log weights w (k,), the largest of which is 0. A wide component is
split for a range at points on a circle, or on a sphere where the height is open.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.measurements import FloatArray

_MOST_COMPONENTS = 96  # chosen: bounds the cost of a range to about a millisecond on a circle, and to four on a sphere
_PRUNED_LOG_WEIGHT = -15.0  # chosen: a component of odds below 1 to 3 million is dropped
_MERGED_NIS = 0.3  # chosen: components closer than half a sigma are one; neighbours on a circle are farther apart
_ALIKE = 4.0  # chosen: components whose variances differ by more are not one, wherever they are
GATE_NIS = 16.0
"""Chosen: as the gate of the filter; a component that a range does not fit keeps its state and loses half of this."""
MOST_SPLIT = 8
"""Chosen: bounds how many wide components are split at a time."""


def update(
    x: FloatArray, P: FloatArray, H: FloatArray, innovation: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Kalman update of k states (k, 6) by H (k, m, 6) with noise variances R (k, m).

    Returns states, covariances, NIS (k,) and the logarithms of the determinants of the innovation covariances (k,).
    """
    PH = P @ H.swapaxes(1, 2)
    S = H @ PH
    diagonal = np.arange(S.shape[1])
    S[:, diagonal, diagonal] += R
    gain = np.linalg.solve(S, PH.swapaxes(1, 2)).swapaxes(1, 2)
    corrected = x + np.einsum("kim,km->ki", gain, innovation)
    covariance = P - gain @ PH.swapaxes(1, 2)
    covariance = 0.5 * (covariance + covariance.swapaxes(1, 2))
    nis = np.einsum("km,km->k", innovation, np.linalg.solve(S, innovation[:, :, None])[:, :, 0])
    return corrected, covariance, nis, np.linalg.slogdet(S)[1]


def with_more_noise(log_likelihood: FloatArray | float, variance_m2: FloatArray, more_m2: FloatArray) -> FloatArray:
    """Return the log-likelihoods of ranges as if their innovation variances were larger.

    That of an outlier is bounded. The half logarithm of two pi is left out, as in all log-likelihoods here.
    """
    common_m2 = variance_m2 + more_m2
    half_nis = -(np.asarray(log_likelihood) + 0.5 * np.log(variance_m2)) * variance_m2 / common_m2
    return np.asarray(-np.minimum(half_nis, 0.5 * GATE_NIS) - 0.5 * np.log(common_m2))


def pruned(x: FloatArray, P: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the components that matter, likeliest first."""
    order = np.argsort(-w, kind="stable")[:_MOST_COMPONENTS]
    order = order[w[order] > w[order[0]] + _PRUNED_LOG_WEIGHT]
    return x[order], P[order], w[order]


def merged(x: FloatArray, P: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the components with those at one place made one, likeliest first."""
    trace = P[:, :3, :3].trace(axis1=1, axis2=2)
    apart = ((x[:, None, :3] - x[None, :, :3]) ** 2).sum(axis=2)
    near = apart <= _MERGED_NIS * (trace[:, None] + trace)
    # A narrow component in the middle of a wide one says something else.
    near &= (trace <= _ALIKE * trace[:, None]) & (trace[:, None] <= _ALIKE * trace)
    i, j = np.nonzero(np.triu(near, 1))
    d = x[j] - x[i]
    nis = np.einsum("ki,ki->k", d, np.linalg.solve(P[j] + P[i], d[:, :, None])[:, :, 0])
    near[i, j] = near[j, i] = nis < _MERGED_NIS
    np.fill_diagonal(near, val=True)
    means, covariances, weights = x.copy(), 0.5 * (P + P.swapaxes(1, 2)), w.copy()
    is_first = near.sum(axis=1) == 1
    left = np.flatnonzero(~is_first)
    while len(left):
        first = left[0]
        together = near[first, left]
        group = left[together]
        weight = np.exp(w[group] - w[first])
        means[first], covariances[first] = moments(x[group], P[group], weight)
        weights[first], is_first[first] = w[first] + math.log(float(weight.sum())), True
        left = left[~together]
    kept = np.flatnonzero(is_first)
    order = kept[np.argsort(-weights[kept], kind="stable")]
    w = weights[order]
    return means[order], covariances[order], w - w[0]


def moments(x: FloatArray, P: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean (6,) and covariance (6, 6) of a sum of Gaussians."""
    share = weight / weight.sum()
    mean = share @ x
    d = x - mean
    covariance = np.einsum("k,kij->ij", share, P) + np.einsum("k,ki,kj->ij", share, d, d)
    return mean, 0.5 * (covariance + covariance.T)


def tail_merged(x: FloatArray, P: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the likeliest components, and all others as one."""
    order = np.argsort(-w, kind="stable")
    first, rest = order[: MOST_SPLIT - 1], order[MOST_SPLIT - 1 :]
    mean, covariance = moments(x[rest], P[rest], np.exp(w[rest]))
    return (
        np.concatenate([x[first], mean[None]]),
        np.concatenate([P[first], covariance[None]]),
        np.append(w[first], log_sum(w[rest])),
    )


def log_sum(log_weight: FloatArray) -> float:
    """Return the logarithm of the sum of weights that are given by their logarithms."""
    most = float(log_weight.max())
    return most + math.log(float(np.exp(log_weight - most).sum()))


_FEWEST_ON_A_CIRCLE = 8  # chosen: components 45 degrees apart, where the range is about as short as its sigma
_MOST_ON_A_CIRCLE = 72  # chosen: components 5 degrees apart; what is left of the bend then counts as noise, eq. (15)
_MOST_ON_A_SPHERE = 90  # chosen: nearly as many as a search may have components
_MOST_TRIED = 2000  # chosen: bounds the computing; they are 0.08 of the radius apart, as on a circle
_GOLDEN_ANGLE_RAD = math.pi * (3.0 - math.sqrt(5.0))
"""From one point of a Fibonacci lattice to the next (Gonzalez 2010, Mathematical Geosciences 42)."""


class RangePoints(NamedTuple):
    """Points about a peer, `spacing_m` apart, at which a component is split.

    `unit` (k, 3) are the unit vectors from the peer to the points. `along` (k, n, 3) are the directions in which the points
    follow each other.
    """

    unit: FloatArray
    along: FloatArray
    spacing_m: float


def range_points(from_peer_m: FloatArray, covariance_m2: FloatArray, range_m: float, fine_m: float) -> RangePoints:
    """Return the points for a component that is at `from_peer_m` (3,) with a covariance (3, 3), m^2.

    Points that are `fine_m` apart would be near enough to linearise the range. They are on the horizontal circle at the height
    of the component, if that is known so well, and the peer is not right above or beneath it.
    """
    up_m = float(from_peer_m[2])
    if 4.0 * covariance_m2.item(2, 2) < fine_m**2 < range_m**2 - up_m**2:
        count = min(max(math.ceil(2.0 * math.pi * range_m / fine_m), _FEWEST_ON_A_CIRCLE), _MOST_ON_A_CIRCLE)
        unit = _on_circle(count, up_m / range_m)
        return RangePoints(unit, _level(unit)[:, None], 2.0 * math.pi * range_m / count)
    unit, spacing_m = _on_sphere(from_peer_m, covariance_m2, range_m, fine_m)
    level = _level(unit)
    return RangePoints(unit, np.stack([level, np.cross(unit, level)], axis=1), spacing_m)


def _on_circle(count: int, up: float) -> FloatArray:
    """Return unit vectors to points on a horizontal circle, `up` times the radius above the centre."""
    azimuth_rad, level = np.arange(count) * (2.0 * math.pi / count), math.sqrt(1.0 - up * up)
    return np.stack([level * np.sin(azimuth_rad), level * np.cos(azimuth_rad), np.full(count, up)], axis=1)


def _on_sphere(mean_m: FloatArray, covariance_m2: FloatArray, radius_m: float, fine_m: float) -> tuple[FloatArray, float]:
    """Return the unit vectors to points all over a sphere, and the spacing of the points, m.

    Only points where the component may be are returned. If these are too many, they are coarser.
    """
    count = min(math.ceil(4.0 * math.pi * (radius_m / fine_m) ** 2), _MOST_TRIED)
    while True:
        number = np.arange(count)
        up, azimuth_rad = 1.0 - (2.0 * number + 1.0) / count, number * _GOLDEN_ANGLE_RAD
        level = np.sqrt(1.0 - up * up)
        unit = np.stack([level * np.sin(azimuth_rad), level * np.cos(azimuth_rad), up], axis=1)
        spacing_m = radius_m * math.sqrt(4.0 * math.pi / count)
        d = radius_m * unit - mean_m
        nis = np.einsum("ki,ki->k", d, np.linalg.solve(covariance_m2 + spacing_m**2 * np.eye(3), d.T).T)
        near = nis <= nis.min() + GATE_NIS
        if (found := int(near.sum())) <= _MOST_ON_A_SPHERE:
            return unit[near], spacing_m
        # A little fewer than would be right, so that one more round is enough.
        count = count * _MOST_ON_A_SPHERE * 9 // (found * 10)


def _level(unit: FloatArray) -> FloatArray:
    """Return horizontal unit vectors at right angles to others, none of which is vertical."""
    level = np.stack([unit[:, 1], -unit[:, 0], np.zeros(len(unit))], axis=1)
    return np.asarray(level / np.linalg.norm(level, axis=1)[:, None])
