"""Dilution of precision (DOP): how the peers' geometry turns range errors into position errors.

Source: Qu & Zhang, section II.A.

With unit vectors u_i from peer i to the vehicle as its rows, the design matrix G has the cofactor matrix (G'G)^-1. HDOP is the
root of the sum over east and north on its diagonal: metres of 1-sigma position error per metre of 1-sigma range error.

What a geometry cannot observe has infinite dilution; what it can observe stays finite even where another axis does not.
"""

from __future__ import annotations

import numpy as np

from gcs_coloc.core.measurements import FloatArray


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


def horizontal_dilution(unit_vectors: FloatArray) -> FloatArray:
    """Return the HDOP of ranges without a clock bias to a vehicle whose height is known by other means.

    Args:
        unit_vectors: shape (..., n, 2) or (..., n, 3), from each peer to the vehicle, of length 1 in the given dimensions.
            Only east and north are used: a peer seen steeply above or below adds little to a horizontal position.

    Returns:
        shape (...): infinite where n < 2 or all horizontal directions are parallel. `float()` it for one geometry.

    """
    return np.asarray(np.sqrt(cofactor_diagonal(unit_vectors[..., :2]).sum(axis=-1)))
