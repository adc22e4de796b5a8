"""Dilution of precision (DOP): how the geometry of the peers turns a range error into a position error (Qu & Zhang, II.A).

With unit vectors u_i from peer i to the vehicle, the design matrix G has the rows u_i, or [u_i, 1] where the ranges share an
unknown clock bias (GPS pseudoranges, and the paper's error equation). The cofactor matrix is (G'G)^-1 and the dilutions are
square roots of sums on its diagonal: GDOP over all unknowns, PDOP over position, HDOP over east and north, VDOP over up, TDOP
over the clock bias. They are plain numbers: metres of 1-sigma position error per metre of 1-sigma range error.

What a geometry cannot observe has infinite dilution; what it can observe stays finite even where another axis does not.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import FloatArray

_PARALLEL = 1e-14  # chosen: the rounding of double precision; below it all lines of sight are one


@dataclass(frozen=True, slots=True)
class Dilution:
    """The DOP family of one geometry, each a plain number >= 0, or infinity.

    `vdop` is None in two dimensions, `tdop` is None without a clock column; `gdop` equals `pdop` then.
    """

    gdop: float
    pdop: float
    hdop: float
    vdop: float | None
    tdop: float | None


def cofactor_diagonal(design: FloatArray) -> FloatArray:
    """Return the diagonal of (G'G)^-1, infinite for each unknown that the rows of G leave undetermined.

    Args:
        design: G, shape (..., n, m): n measurements of m unknowns. n may be less than m, or zero.

    Returns:
        shape (..., m), the variance of each unknown per unit variance of a measurement; never raises for its values.

    """
    rows, unknowns = design.shape[-2:]
    if rows < unknowns:
        # Rows of zeros measure nothing; they make the singular vectors of the null space appear.
        padding = [(0, 0)] * (design.ndim - 2) + [(0, unknowns - rows), (0, 0)]
        design = np.pad(design, padding)
    # A direction that does not exist (the vehicle is where its peer is) measures nothing either.
    design = np.where(np.isfinite(design).all(axis=-1, keepdims=True), design, 0.0)
    _, singular_values, vt = np.linalg.svd(design, full_matrices=False)
    tolerance = np.finfo(np.float64).eps * max(design.shape[-2:])
    weights = vt**2
    # Below 1e-150 a square is no longer a number; no measurement is that weak.
    floor = np.maximum(tolerance * singular_values[..., :1], 1e-150)
    seen = (singular_values > floor)[..., np.newaxis]
    determined = weights / np.where(seen, singular_values[..., np.newaxis] ** 2, 1.0)
    # A null-space vector has rounding residues on the axes that it does not touch.
    undetermined = np.where(weights > tolerance, np.inf, 0.0)
    return np.asarray(np.where(seen, determined, undetermined).sum(axis=-2))


def dilution(unit_vectors: FloatArray, *, clock: bool) -> Dilution:
    """Return the DOP family of one geometry.

    Args:
        unit_vectors: shape (n, 2) east, north or (n, 3) east, north, up; from each peer to the vehicle (the sign of all of
            them together makes no difference).
        clock: whether the ranges share an unknown clock bias.

    """
    dimensions = unit_vectors.shape[-1]
    design = np.column_stack([unit_vectors, np.ones(len(unit_vectors))]) if clock else unit_vectors
    variances = cofactor_diagonal(design)
    return Dilution(
        gdop=float(np.sqrt(variances.sum())),
        pdop=float(np.sqrt(variances[:dimensions].sum())),
        hdop=float(np.sqrt(variances[:2].sum())),
        vdop=float(np.sqrt(variances[2])) if dimensions == 3 else None,
        tdop=float(np.sqrt(variances[-1])) if clock else None,
    )


def horizontal_dilution(unit_vectors: FloatArray) -> FloatArray:
    """Return the HDOP of ranges without a clock bias to a vehicle whose height is known by other means.

    Args:
        unit_vectors: shape (..., n, 2) or (..., n, 3), from each peer to the vehicle, of length 1 in the given dimensions.
            Only east and north are used: a peer seen steeply above or below adds little to a horizontal position.

    Returns:
        shape (...): infinite where n < 2 or all horizontal directions are parallel. `float()` it for one geometry.

    """
    return np.asarray(np.sqrt(cofactor_diagonal(unit_vectors[..., :2]).sum(axis=-1)))


def horizontal_dilution_of(units: Iterable[tuple[float, float, float]]) -> float:
    """Return `horizontal_dilution` of one geometry, from its unit vectors, at a hundredth of the cost: for answers in flight.

    Infinite where the directions are parallel to within the rounding of their squares (some 1e-7 rad).
    """
    ee = en = nn = 0.0
    for e, n, _ in units:
        ee += e * e
        en += e * n
        nn += n * n
    trace, determinant = ee + nn, ee * nn - en * en
    return math.sqrt(trace / determinant) if determinant > _PARALLEL * trace * trace else math.inf
