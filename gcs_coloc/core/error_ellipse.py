"""Error ellipse and error bound of a covariance, with the one eigen-decomposition of 2x2 matrices; HDOP of ranges.

Closed forms: numpy's general decompositions take several times as long for two and three directions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import acos, atan2, cos, inf, sqrt
from typing import NamedTuple, TypeVar

from gcs_coloc.core.measurements import FloatArray

# Radius of the circle that holds 95 % of a plane Gaussian, in units of its larger axis' sigma, for smaller / larger axis
# of 0, 0.1, ... 1: the root of the integral over the circle. From 1.96 (a line) to sqrt(5.99) (a round one).
_RADIUS_95 = (1.9600, 1.9625, 1.9704, 1.9842, 2.0051, 2.0359, 2.0813, 2.1460, 2.2303, 2.3318, 2.4478)

_PARALLEL = 1e-14  # chosen: the rounding of double precision; below it all lines of sight are one

_Real = TypeVar("_Real", float, FloatArray)


class ErrorEllipse(NamedTuple):
    """The 1-sigma ellipse: semi-axes in m, and the angle of the major one from the first axis to the second, in rad."""

    semi_major_m: float
    semi_minor_m: float
    angle_rad: float


def eigenvalue_mean_and_radius(a: _Real, b: _Real, d: _Real, norm: Callable[[_Real, _Real], _Real]) -> tuple[_Real, _Real]:
    """The eigenvalues of [[a, b], [b, d]] are mean + radius and mean - radius (Mohr's circle).

    `norm` is math.hypot for numbers and numpy.hypot for arrays.
    """
    return 0.5 * (a + d), norm(0.5 * (a - d), b)


def major_axis_rad(a: float, b: float, d: float) -> float:
    """Angle of the eigenvector of the larger eigenvalue of [[a, b], [b, d]], from the first axis to the second."""
    return 0.5 * atan2(2.0 * b, a - d)


def error_ellipse(ee: float, en: float, nn: float) -> ErrorEllipse:
    """The error ellipse of a horizontal covariance, given by its elements in m^2."""
    mean, radius = eigenvalue_mean_and_radius(ee, en, nn, _norm)
    return ErrorEllipse(sqrt(max(mean + radius, 0.0)), sqrt(max(mean - radius, 0.0)), major_axis_rad(ee, en, nn))


def horizontal_sigma_m(covariance: FloatArray) -> float:
    """1-sigma along the worst horizontal direction, m: root of the larger eigenvalue of the top-left (2, 2) block."""
    return _semi_axes_m(covariance)[0]


def horizontal_bound_95_m(covariance: FloatArray) -> float:
    """Radius in m that holds the horizontal error with 95 % if the top-left (2, 2) block of the covariance is true."""
    return horizontal_sigma_and_bound_95_m(covariance)[1]


def horizontal_sigma_and_bound_95_m(covariance: FloatArray) -> tuple[float, float]:
    """`horizontal_sigma_m` and `horizontal_bound_95_m` at once."""
    larger_m, smaller_m = _semi_axes_m(covariance)
    if larger_m == 0.0:
        return 0.0, 0.0
    place = 10.0 * smaller_m / larger_m
    index = min(int(place), 9)
    below, above = _RADIUS_95[index], _RADIUS_95[index + 1]
    return larger_m, larger_m * (below + (place - index) * (above - below))


def horizontal_dilution_of(units: Iterable[tuple[float, float, float]]) -> float:
    """HDOP of ranges to a vehicle of known height, a plain number.

    It follows from the unit vectors between its peers and it.

    Infinite where the directions are parallel to within the rounding of their squares (some 1e-7 rad).
    """
    ee = en = nn = 0.0
    for e, n, _ in units:
        ee += e * e
        en += e * n
        nn += n * n
    trace, determinant = ee + nn, ee * nn - en * en
    return sqrt(trace / determinant) if determinant > _PARALLEL * trace * trace else inf


def worst_sigma(covariance: FloatArray) -> float:
    """1-sigma along the worst direction of a covariance (3, 3): root of its largest eigenvalue, in the root of its unit.

    Source: the trigonometric solution of the characteristic equation (Smith 1961).
    """
    (a, b, c), (_, d, e), (_, _, f) = covariance.tolist()
    mean = (a + d + f) / 3.0
    a, d, f = a - mean, d - mean, f - mean
    scale = sqrt((a * a + d * d + f * f + 2.0 * (b * b + c * c + e * e)) / 6.0)
    cube = scale**3
    if cube == 0.0:
        return sqrt(max(mean, 0.0))
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    angle = acos(min(max(0.5 * determinant / cube, -1.0), 1.0)) / 3.0
    return sqrt(max(mean + 2.0 * scale * cos(angle), 0.0))


def _norm(x: float, y: float) -> float:
    return sqrt(x * x + y * y)


def _semi_axes_m(covariance: FloatArray) -> tuple[float, float]:
    mean, radius = eigenvalue_mean_and_radius(covariance.item(0, 0), covariance.item(0, 1), covariance.item(1, 1), _norm)
    return sqrt(max(mean + radius, 0.0)), sqrt(max(mean - radius, 0.0))
