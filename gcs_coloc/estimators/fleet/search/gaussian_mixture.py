"""Gaussian mixture: a sum of k Gaussians of position and velocity.

It is given by means x (k, 6), covariances P (k, 6, 6) and log weights w (k,), the largest of which is 0.
"""

from __future__ import annotations

import math

import numpy as np

from gcs_coloc.core.measurements import FloatArray

_MOST_COMPONENTS = 96
"""Chosen: bounds the cost of a range to about a millisecond on a circle, and to four on a sphere."""
_PRUNED_LOG_WEIGHT = -15.0
"""Chosen: a component of odds below 1 to 3 million is dropped."""
_MERGED_NIS = 0.3
"""Chosen: components closer than half a sigma are one; neighbours on a circle are farther apart."""
_ALIKE = 4.0
"""Chosen: components whose variances differ by more are not one, wherever they are."""
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
