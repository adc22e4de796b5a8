"""What is predicted of one flight without GPS, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gcs_coloc.core.measurements import FloatArray, Vector3
from gcs_coloc.core.readiness.vehicle_readiness import IN_LINE_HDOP

_LEAST_RANGED = 2
_NUMBERS = ("at_s", "hdop", "bound_95_m", "hpl_m", "offset_m", "ranged", "has_fix")
_AFTER_S = 15.0
"""Chosen: what grew in bad geometry is corrected within so long once the geometry is good."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """What is predicted of one vehicle while it is denied, at times `at_s` (N,), s.

    Of each time: its position (N, 3) m; the HDOP of its ranges, infinite below two; the 95 % bound and the protection level HPL
    in m, NaN where there is no estimate; the distance of the estimate from the planned position, m; how many nodes it ranges;
    whether a fix is stated; and what limits it, in words (and its code), empty with a fix. `denied`: who else is denied.
    """

    sysid: int
    denied: tuple[int, ...]
    at_s: FloatArray
    position_enu_m: FloatArray
    hdop: FloatArray
    bound_95_m: FloatArray
    hpl_m: FloatArray
    offset_m: FloatArray
    ranged: FloatArray
    has_fix: FloatArray
    limit: tuple[str, ...]
    limit_code: tuple[str, ...]

    @property
    def is_told(self) -> NDArray[np.bool_]:
        """Whether the prediction tells the size of the bound, (N,).

        Noise decides without an estimate, with fewer than two nodes ranged, or in one line with the peers. In one line the ranges
        bend with the error itself, which an error of zero does not show: the bound is an upper one. It stays so for a while
        after. Where the estimate leaves its bound though nothing errs, the filter has lost a manoeuvre of the plan, and the bound
        is none.
        """
        bad = ~np.isfinite(self.bound_95_m) | (self.ranged < _LEAST_RANGED) | (self.hdop >= IN_LINE_HDOP)
        bad |= self.offset_m > self.bound_95_m
        bad_at_s = np.where(bad, self.at_s, -np.inf)
        return np.asarray(self.at_s - np.maximum.accumulate(bad_at_s) > _AFTER_S)

    @property
    def share_with_fix(self) -> float:
        """Share of the flight without GPS in which a fix is stated."""
        return float(self.has_fix.mean()) if len(self.has_fix) else 0.0


@dataclass(frozen=True, slots=True)
class PredictedStep:
    """One step of a prediction; the fields are those of `Prediction`."""

    at_s: float
    position_enu_m: Vector3
    hdop: float
    bound_95_m: float
    hpl_m: float
    offset_m: float
    ranged: int
    has_fix: bool
    limit: str
    limit_code: str


def as_prediction(sysid: int, denied: tuple[int, ...], rows: Sequence[PredictedStep]) -> Prediction:
    """Return the steps of one vehicle as arrays."""
    arrays = {name: np.array([getattr(row, name) for row in rows], dtype=float) for name in _NUMBERS}
    return Prediction(
        sysid=sysid,
        denied=denied,
        position_enu_m=np.array([row.position_enu_m for row in rows], dtype=float).reshape(-1, 3),
        limit=tuple(row.limit for row in rows),
        limit_code=tuple(row.limit_code for row in rows),
        **arrays,
    )
