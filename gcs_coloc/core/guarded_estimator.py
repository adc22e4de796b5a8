"""Keeps a faulty estimator from doing harm: what it raises is told and counted, what is not finite is not a position.

Estimators are plug-ins. An exception in one must neither stop the service nor leave an aircraft with a frozen position: the
answer is then Unknown, and the aid goes out with fix_type 1.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from itertools import chain
from math import isfinite
from numbers import Integral
from pathlib import PurePath

from gcs_coloc.core.estimator import Estimator
from gcs_coloc.core.measurements import Estimate, Measurement, NoEstimate, Residual

_RAISED = "raised an exception"
_NO_RESIDUAL = "gave a residual that is none"
_SIX_ROWS = [6] * 6
_NOT_A_POSITION = "gave a result that is no position with a covariance"


class GuardedEstimator:
    """Meets the Estimator protocol around another estimator. `tell` is called with the text of each kind of fault once."""

    def __init__(self, inner: Estimator, tell: Callable[[str], None]) -> None:
        self._inner = inner
        self._tell = tell
        self._faults: Counter[str] = Counter()

    @property
    def name(self) -> str:
        """The inner estimator's name."""
        return self._inner.name

    def set_denied(self, denied: Collection[int], at_s: float) -> None:
        """As the protocol says."""
        try:
            self._inner.set_denied(denied, at_s)
        except Exception as error:
            self._fault(_RAISED, error)

    def reset(self, vehicle: int, at_s: float) -> None:
        """As the protocol says."""
        try:
            self._inner.reset(vehicle, at_s)
        except Exception as error:
            self._fault(_RAISED, error)

    def add(self, measurement: Measurement) -> None:
        """As the protocol says."""
        try:
            self._inner.add(measurement)
        except Exception as error:
            self._fault(_RAISED, error)

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """As the protocol says; Unknown where the inner estimator fails, or its answer is none, or not finite and positive."""
        try:
            answer = self._inner.estimate(vehicle, at_s)
        except Exception as error:
            self._fault(_RAISED, error)
            return NoEstimate(vehicle, at_s, f"the estimator failed: {type(error).__name__}")
        if not isinstance(answer, NoEstimate) and not _is_sound(answer):
            self._fault(_NOT_A_POSITION, None)
            return NoEstimate(vehicle, at_s, f"the estimator {_NOT_A_POSITION}")
        return answer

    def drain_residuals(self) -> list[Residual]:
        """As the protocol says."""
        try:
            residuals = self._inner.drain_residuals()
            sound = [residual for residual in residuals if _is_residual(residual)]
        except Exception as error:
            self._fault(_RAISED, error)
            return []
        if len(sound) != len(residuals):
            self._fault(_NO_RESIDUAL, None)
        return sound

    def counts(self) -> Mapping[str, int]:
        """The inner estimator's counts and the faults."""
        try:
            counts = {str(reason): int(count) for reason, count in self._inner.counts().items()}
        except Exception as error:
            self._fault(_RAISED, error)
            counts = {}
        return {**counts, **self._faults}

    def _fault(self, kind: str, error: Exception | None) -> None:
        self._faults[kind] += 1
        if self._faults[kind] == 1:
            detail = f": {type(error).__name__}: {error}{_place(error)}" if error is not None else ""
            self._tell(f"estimator {self.name} {kind}{detail}; its answers are withheld while it does")


def _place(error: Exception) -> str:
    """Where it was raised, for the author of a plug-in."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return f" ({PurePath(trace.tb_frame.f_code.co_filename).name}, line {trace.tb_lineno})" if trace is not None else ""


def _is_sound(answer: object) -> bool:
    """Whether it is an Estimate, its arrays of the right shapes and finite, its variances and its horizontal part positive."""
    if not isinstance(answer, Estimate) or not isinstance(answer.ranges_in_use, Integral):
        return False
    try:
        # As lists: for so few numbers numpy's functions take several times as long.
        position, velocity, rows = answer.position_enu_m.tolist(), answer.velocity_enu_mps.tolist(), answer.covariance.tolist()
        if len(position) != 3 or len(velocity) != 3 or [len(row) for row in rows] != _SIX_ROWS:
            return False
        is_finite = all(map(isfinite, chain(position, velocity, *rows)))
    except (AttributeError, TypeError):
        return False
    is_positive = all(row[i] > 0.0 for i, row in enumerate(rows)) and rows[0][0] * rows[1][1] > rows[0][1] * rows[1][0]
    return is_finite and is_positive


def _is_residual(residual: object) -> bool:
    return isinstance(residual, Residual) and residual.degrees_of_freedom > 0 and isfinite(residual.nis)
