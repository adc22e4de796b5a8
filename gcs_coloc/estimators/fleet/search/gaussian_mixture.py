"""A sum of k Gaussians of position and velocity: means x (k, 6), covariances P (k, 6, 6), log weights w (k,), the largest 0."""

from __future__ import annotations

import math

import numpy as np

from gcs_coloc.core.measurements import FloatArray

_MOST_COMPONENTS = 96
"""Chosen: bounds the cost of a range to about a millisecond."""
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
    """Return the log-likelihoods of ranges had their innovation variances been larger; that of an outlier is bounded.

    Without the half logarithm of two pi, as all log-likelihoods here.
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
    means, covariances, weights = [], [], []
    left = np.arange(len(x))
    while len(left):
        i = left[0]
        d = x[left] - x[i]
        trace = P[left, :3, :3].trace(axis1=1, axis2=2)
        near = (d[:, :3] ** 2).sum(axis=1) <= _MERGED_NIS * (trace + trace[0])
        # A narrow component in the middle of a wide one says something else.
        near &= (trace <= _ALIKE * trace[0]) & (trace[0] <= _ALIKE * trace)
        close = d[near]
        near[near] = np.einsum("ki,ki->k", close, np.linalg.solve(P[left[near]] + P[i], close[:, :, None])[:, :, 0]) < _MERGED_NIS
        group = left[near]
        weight = np.exp(w[group] - w[i])
        mean, covariance = moments(x[group], P[group], weight)
        means.append(mean)
        covariances.append(covariance)
        weights.append(float(w[i]) + math.log(float(weight.sum())))
        left = left[~near]
    order = np.argsort(-np.array(weights), kind="stable")
    w = np.array(weights)[order]
    return np.array(means)[order], np.array(covariances)[order], w - w[0]


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
