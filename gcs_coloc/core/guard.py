"""Keeps a faulty estimator from doing harm: what it raises is told and counted, what is not finite is not a position.

Estimators are plug-ins. An exception in one must neither stop the service nor leave an aircraft with a frozen position: the
answer is then Unknown, and the aid goes out with fix_type 1.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from itertools import chain
from math import isfinite

from gcs_coloc.core.measurements import Estimate, Measurement, Residual, Unknown
from gcs_coloc.estimators.base import Estimator

_RAISED = "raised an exception"
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

    def set_subjects(self, subjects: Collection[int], at_s: float) -> None:
        """As the protocol says."""
        try:
            self._inner.set_subjects(subjects, at_s)
        except Exception as error:
            self._fault(_RAISED, error)

    def add(self, measurement: Measurement) -> None:
        """As the protocol says."""
        try:
            self._inner.add(measurement)
        except Exception as error:
            self._fault(_RAISED, error)

    def estimate(self, vehicle: int, at_s: float) -> Estimate | Unknown:
        """As the protocol says; Unknown where the inner estimator fails or its answer is not finite and positive."""
        try:
            answer = self._inner.estimate(vehicle, at_s)
        except Exception as error:
            self._fault(_RAISED, error)
            return Unknown(vehicle, at_s, f"the estimator failed: {type(error).__name__}")
        if isinstance(answer, Estimate) and not _is_sound(answer):
            self._fault(_NOT_A_POSITION, None)
            return Unknown(vehicle, at_s, f"the estimator {_NOT_A_POSITION}")
        return answer

    def take_residuals(self) -> list[Residual]:
        """As the protocol says."""
        try:
            return self._inner.take_residuals()
        except Exception as error:
            self._fault(_RAISED, error)
            return []

    def counts(self) -> Mapping[str, int]:
        """The inner estimator's counts and the faults."""
        return {**self._inner.counts(), **self._faults}

    def _fault(self, kind: str, error: Exception | None) -> None:
        self._faults[kind] += 1
        if self._faults[kind] == 1:
            detail = f": {type(error).__name__}: {error}" if error is not None else ""
            self._tell(f"estimator {self.name} {kind}{detail}; its answers are withheld while it does")


def _is_sound(answer: Estimate) -> bool:
    # As lists: for so few numbers numpy's functions take several times as long.
    rows = answer.covariance.tolist()
    numbers = chain(answer.position_enu_m.tolist(), answer.velocity_enu_mps.tolist(), *rows)
    return all(map(isfinite, numbers)) and all(row[i] > 0.0 for i, row in enumerate(rows))
