"""The choice of the neighbours that locate a subject best, where there are more than are worth their cost."""

from __future__ import annotations

import numpy as np

from gcs_coloc.core.measurements import FloatArray

_STAY_BONUS = 1.2
_PRIOR_INFORMATION = 1e-3


def choose_peers(here: FloatArray, placed: list[tuple[int, FloatArray]], kept: frozenset[int], most: int) -> frozenset[int]:
    """Choose at most `most` peers greedily: each next one is that which lowers the trace of the position cofactor most.

    Args:
        here: (3,) where the subject is, ENU in metres.
        placed: candidates with their positions (3,), in a fixed order (ties go to the first).
        kept: those in use now; another one has to be clearly better to replace one, for each change costs correlations.
        most: how many may be used.

    """
    there = np.array([position for _, position in placed])
    d = here - there
    units = d / np.maximum(np.linalg.norm(d, axis=1), 1e-9)[:, np.newaxis]
    bonus = np.array([_STAY_BONUS if vehicle in kept else 1.0 for vehicle, _ in placed])
    cofactor = np.eye(3) / _PRIOR_INFORMATION
    free = np.ones(len(placed), dtype=bool)
    chosen: list[int] = []
    for _ in range(min(most, len(placed))):
        cu = units @ cofactor
        lowered = np.einsum("ij,ij->i", cu, cu) / (1.0 + np.einsum("ij,ij->i", cu, units))
        best = int(np.argmax(np.where(free, lowered * bonus, -1.0)))
        free[best] = False
        chosen.append(placed[best][0])
        g = cu[best]
        cofactor = cofactor - np.outer(g, g) / (1.0 + float(g @ units[best]))
    return frozenset(chosen)
