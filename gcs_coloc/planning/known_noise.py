"""Streams whose noise is known to the filter, as without noise it could not learn it, and measurements condensed into one."""

from __future__ import annotations

from math import hypot, sqrt

from gcs_coloc.estimators.fleet.ekf.adaptive_noise import NoiseSplit

_KNOWN_WEIGHT = 1e6
"""Samples that a stream's noise counts as known by: no bound on it is left."""
_COLOURED_LEAST = 0.1
"""Least share of a sigma that no averaging removes: `least_coloured_share` of the filter."""


def condensed(sigma_m: float, white_share: float, samples: float) -> tuple[float, float]:
    """Return the sigma of the mean of some samples, and the white share of it (as a ratio of sigmas)."""
    white_m = sigma_m * white_share
    coloured_m = sqrt(max(sigma_m * sigma_m - white_m * white_m, (_COLOURED_LEAST * sigma_m) ** 2))
    white_m /= sqrt(samples)
    whole_m = hypot(white_m, coloured_m)
    return whole_m, white_m / whole_m


def known_split(sigmas_m: tuple[float, ...], white_share: float) -> NoiseSplit:
    """Return the split of a stream whose noise is known: this share of its sigma is white."""
    return NoiseSplit((), tuple(((white_share * sigma_m) ** 2 * _KNOWN_WEIGHT, _KNOWN_WEIGHT) for sigma_m in sigmas_m))
