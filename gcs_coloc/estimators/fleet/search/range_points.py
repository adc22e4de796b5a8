"""Points at which a wide component of a search is split for a range.

They are on a circle, or on a sphere where the height is open.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.estimators.fleet.search.gaussian_mixture import GATE_NIS

_FEWEST_ON_A_CIRCLE = 8
"""Chosen: components 45 degrees apart, where the range is about as short as its sigma."""
_MOST_ON_A_CIRCLE = 72
"""Chosen: components 5 degrees apart; what is left of the bend then counts as noise, eq. (15)."""
_MOST_ON_A_SPHERE = 90
"""Chosen: nearly as many as a search may have components."""
_MOST_TRIED = 2000
"""Chosen: bounds the computing; they are 0.08 of the radius apart, as on a circle."""
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
    """Return the unit vectors to points on a horizontal circle of a sphere.

    The circle is `up` times the radius above the centre.
    """
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
    """Return horizontal unit vectors at right angles to other unit vectors.

    No point of a lattice is right above its centre, so there is always one.
    """
    level = np.stack([unit[:, 1], -unit[:, 0], np.zeros(len(unit))], axis=1)
    return np.asarray(level / np.linalg.norm(level, axis=1)[:, None])
