"""Other ways to read data that do not agree, and which of them makes them agree."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.evaluation.data_checks.finding import DataFinding

CLEARLY_BETTER = 1.0 / 3.0
"""A reading is believed that leaves so much of the misfit."""
_AS_GOOD = 1.5
_NOISE_SIGMAS = 3.0
_LEAST_SHARE = 0.5
_FINE_S = np.linspace(-2.0, 2.0, 81)
_COARSE_S = np.concatenate((np.linspace(-30.0, 30.0, 241), np.arange(31.0, 121.0), -np.arange(31.0, 121.0)))

Misfit = Callable[[float], FloatArray]
"""The misfits (N,) in metres with a clock put forward by some seconds; NaN where nothing can be compared."""


@dataclass(frozen=True, slots=True)
class Reading:
    """One way to read the data: the median misfit that it leaves, m, and what is to be said if it is the right one."""

    misfit_m: float
    doubt: DataFinding


def median_misfit_m(misfits_m: FloatArray) -> float:
    """The median, of those that there are; infinite where too few are left to compare."""
    known = misfits_m[np.isfinite(misfits_m)]
    return float(np.median(known)) if len(known) >= _LEAST_SHARE * len(misfits_m) and len(known) else float("inf")


def good(readings: Iterable[Reading], misfit_m: float, sigma_m: float = 0.0) -> list[DataFinding]:
    """Return the readings that fit, simplest first: clearly better than none, and as good as the best or within the noise."""
    candidates = list(readings)
    least_m = min((reading.misfit_m for reading in candidates), default=float("inf"))
    enough_m = min(max(_AS_GOOD * least_m, _NOISE_SIGMAS * sigma_m), CLEARLY_BETTER * misfit_m)
    return [reading.doubt for reading in candidates if reading.misfit_m <= enough_m]


def time_offset_s(misfit: Misfit) -> tuple[float, float]:
    """By how much a clock has to be put forward for the least misfit, s, and the median misfit that is left, m."""
    coarse = _least(misfit, np.concatenate((_FINE_S, _COARSE_S)))
    return _least(misfit, coarse[0] + np.linspace(-0.05, 0.05, 11) * max(1.0, min(abs(coarse[0]), 10.0)))


def small_time_offset_s(misfit: Misfit) -> tuple[float, float]:
    """As `time_offset_s`, within 2 s."""
    return _least(misfit, _FINE_S)


def _least(misfit: Misfit, offsets_s: FloatArray) -> tuple[float, float]:
    medians = [median_misfit_m(misfit(float(offset_s))) for offset_s in offsets_s]
    i = int(np.argmin(medians))
    return float(offsets_s[i]), medians[i]
