"""Error ellipse and error bound of a covariance, and the HDOP of ranges.

The package's one eigen-decomposition of 2x2 matrices is here. It is in closed form, as is that of three directions: numpy's
general decompositions take several times as long.
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
    """The 1-sigma ellipse: semi-axes, and the angle of the major one from the first axis to the second."""

    semi_major_m: float
    semi_minor_m: float
    angle_rad: float


def eigenvalue_mean_and_radius(a: _Real, b: _Real, d: _Real, norm: Callable[[_Real, _Real], _Real]) -> tuple[_Real, _Real]:
    """Return mean and radius of the two eigenvalues of [[a, b], [b, d]] (Mohr's circle).

    The eigenvalues are mean + radius and mean - radius. `norm` is the root of the sum of two squares: math.hypot or the like for
    numbers, numpy.hypot for arrays.
    """
    return 0.5 * (a + d), norm(0.5 * (a - d), b)


def major_axis_rad(a: float, b: float, d: float) -> float:
    """Return the angle of the major axis of the ellipse of [[a, b], [b, d]], from the first axis, rad.

    The major axis is the eigenvector of the larger eigenvalue. The angle is positive towards the second axis.
    """
    return 0.5 * atan2(2.0 * b, a - d)


def error_ellipse(ee: float, en: float, nn: float) -> ErrorEllipse:
    """Return the error ellipse of a horizontal covariance, given by its elements in m^2."""
    mean, radius = eigenvalue_mean_and_radius(ee, en, nn, _norm)
    return ErrorEllipse(sqrt(max(mean + radius, 0.0)), sqrt(max(mean - radius, 0.0)), major_axis_rad(ee, en, nn))


def horizontal_sigma_m(covariance: FloatArray) -> float:
    """Return the 1-sigma along the worst horizontal direction of a covariance, m."""
    return _semi_axes_m(covariance)[0]


def horizontal_bound_95_m(covariance: FloatArray) -> float:
    """Return the radius that holds the horizontal error with 95 %, if the covariance is true, m."""
    return horizontal_sigma_and_bound_95_m(covariance)[1]


def horizontal_sigma_and_bound_95_m(covariance: FloatArray) -> tuple[float, float]:
    """Return `horizontal_sigma_m` and `horizontal_bound_95_m` at once."""
    larger_m, smaller_m = _semi_axes_m(covariance)
    if larger_m == 0.0:
        return 0.0, 0.0
    place = 10.0 * smaller_m / larger_m
    index = min(int(place), 9)
    below, above = _RADIUS_95[index], _RADIUS_95[index + 1]
    return larger_m, larger_m * (below + (place - index) * (above - below))


def horizontal_dilution_of(units: Iterable[tuple[float, float, float]]) -> float:
    """Return the HDOP of ranges to a vehicle of known height, a plain number.

    It follows from the unit vectors between its peers and it. It is infinite where their directions are parallel to within the
    rounding of their squares (some 1e-7 rad).
    """
    ee = en = nn = 0.0
    for e, n, _ in units:
        ee += e * e
        en += e * n
        nn += n * n
    trace, determinant = ee + nn, ee * nn - en * en
    return sqrt(trace / determinant) if determinant > _PARALLEL * trace * trace else inf


def worst_sigma(covariance: FloatArray) -> float:
    """Return the 1-sigma along the worst direction of a covariance (3, 3).

    It is the root of the largest eigenvalue, in the root of the covariance's unit.

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
