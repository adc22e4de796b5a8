"""The choice of the neighbours that locate a subject best, where there are more than are worth their cost."""

from __future__ import annotations

import numpy as np

from gcs_coloc.core.measurements import FloatArray

_STAY_BONUS = 1.2
_SHARED_BONUS = 1.5
_PRIOR_INFORMATION = 1e-3


def choose_peers(
    here: FloatArray,
    placed: list[tuple[int, FloatArray]],
    kept: frozenset[int],
    shared: frozenset[int],
    most: int,
    *,
    height_known: bool,
) -> frozenset[int]:
    """Choose at most `most` peers greedily: each next one is that which lowers the trace of the position cofactor most.

    Args:
        here: (3,) where the subject is, ENU in metres.
        placed: candidates with their positions (3,), in a fixed order (ties go to the first).
        kept: those in use now; another one has to be clearly better to replace one, for each change costs correlations.
        shared: those that other subjects use: any other one has to be carried for this subject alone.
        most: how many may be used.
        height_known: whether the subject tells its own height, which is then worth a range from straight above.

    """
    there = np.array([position for _, position in placed])
    d = here - there
    units = d / np.maximum(np.linalg.norm(d, axis=1), 1e-9)[:, np.newaxis]
    bonus = np.array([(_STAY_BONUS if v in kept else 1.0) * (_SHARED_BONUS if v in shared else 1.0) for v, _ in placed])
    cofactor = np.diag([1.0, 1.0, _PRIOR_INFORMATION if height_known else 1.0]) / _PRIOR_INFORMATION
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
