"""The check of predictions: reached 95 % of drawn flights against the predicted 95 % bound, in windows along the way."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.planning.predicted_flight import Prediction
from gcs_coloc.planning.prediction import predict
from gcs_coloc.runtime.kept_results import KeptResults
from gcs_coloc.runtime.tasks import Progress, Workers, run_tasks
from gcs_coloc.study.planning.check_plans import CHECK_PLANS
from gcs_coloc.study.planning.drawn_flight import draw_errors

WINDOW_S = 30.0
"""Errors of so long are pooled. Chosen: geometry changes little; of 20 flights the 95 % is then known to about 15 %."""
_CLOSE = 0.2
_RESAMPLES = 400
"""Chosen: the ends of an interval then scatter by some hundredths of it."""
_RESAMPLE_SEED = 1
_INTERVAL = (0.025, 0.975)
_SETTLED_S = 20.0
"""After the loss of GPS until here the error grows: it is no error of the geometry yet."""


@dataclass(frozen=True, slots=True)
class Window:
    """One window of a plan: from when, s; predicted and reached 95 % of the error, m; share of samples without an estimate.

    `is_told`: the prediction tells the size of the error here (`Prediction.is_told`). `interval`: 95 % confidence interval of
    reached over predicted, by the bootstrap over flights.
    """

    from_s: float
    predicted_m: float
    reached_m: float
    lost: float
    is_told: bool
    interval: tuple[float, float]

    @property
    def ratio(self) -> float:
        """Reached over predicted."""
        return self.reached_m / self.predicted_m

    @property
    def is_close(self) -> bool:
        """Whether the reached 95 % is within 20 % of the predicted one."""
        return abs(self.ratio - 1.0) <= _CLOSE

    @property
    def may_be_close(self) -> bool:
        """Whether the flights leave it open that it is within 20 %: the interval meets that band."""
        low, high = self.interval
        return low <= 1.0 + _CLOSE and high >= 1.0 - _CLOSE

    @property
    def is_shown_close(self) -> bool:
        """Whether the flights show that it is within 20 %: the whole interval is in that band."""
        low, high = self.interval
        return low >= 1.0 - _CLOSE and high <= 1.0 + _CLOSE


@dataclass(frozen=True, slots=True)
class PlanCheck:
    """One plan's check: its windows, how many of the errors are within the predicted bound of their time, and of which share
    of the flight the prediction cannot tell.
    """

    name: str
    text: str
    flights: int
    windows: tuple[Window, ...]
    covered: float
    not_told: float

    @property
    def told(self) -> list[Window]:
        """The windows in which the prediction tells the size of the error."""
        return [window for window in self.windows if window.is_told]

    @property
    def median_ratio(self) -> float:
        """Median of reached over predicted, of all windows."""
        return float(np.median([window.ratio for window in self.windows])) if self.windows else float("nan")


def run_checks(
    names: Sequence[str], flights: int, first_seed: int, workers: Workers, progress: Progress, kept: KeptResults | None = None
) -> list[PlanCheck]:
    """Predict plans and fly each so many times."""
    tasks = [(name, seed) for name in names for seed in range(first_seed, first_seed + flights)]
    drawn = run_tasks(_draw, tasks, workers, progress, kept)
    predicted = run_tasks(_predict, list(names), workers, lambda *_: None, kept)
    checks = []
    for at, name in enumerate(names):
        several = drawn[at * flights : (at + 1) * flights]
        checks.append(compare(name, CHECK_PLANS[name]().text, predicted[at], several))
    return checks


def _draw(task: tuple[str, int]) -> tuple[FloatArray, FloatArray]:
    name, seed = task
    checked = CHECK_PLANS[name]()
    return draw_errors(checked.plan, checked.denied, seed)


def _predict(name: str) -> Prediction:
    checked = CHECK_PLANS[name]()
    return predict(checked.plan, (checked.denied,))[0]


def compare(name: str, text: str, predicted: Prediction, drawn: Sequence[tuple[FloatArray, FloatArray]]) -> PlanCheck:
    """Compare a prediction with drawn flights where it has a bound."""
    times_s = drawn[0][0]
    errors_m = np.stack([errors for _, errors in drawn])
    nearest = np.abs(predicted.at_s[:, np.newaxis] - times_s).argmin(axis=0)
    bound_m = predicted.bound_95_m[nearest]
    has_bound = np.isfinite(bound_m) & (times_s >= predicted.at_s[0] + _SETTLED_S)
    windows = tuple(
        _windows(times_s[has_bound], bound_m[has_bound], errors_m[:, has_bound], predicted.is_told[nearest][has_bound])
    )
    known = np.isfinite(errors_m[:, has_bound])
    covered = float((errors_m[:, has_bound] <= bound_m[has_bound])[known].mean()) if known.any() else 0.0
    return PlanCheck(name, text, len(drawn), windows, covered, 1.0 - float(predicted.is_told.mean()))


def _windows(times_s: FloatArray, bound_m: FloatArray, errors_m: FloatArray, told: NDArray[np.bool_]) -> Iterable[Window]:
    for begin_s in np.arange(times_s[0], times_s[-1], WINDOW_S) if len(times_s) else ():
        inside = (times_s >= begin_s) & (times_s < begin_s + WINDOW_S)
        errors = errors_m[:, inside]
        known = errors[np.isfinite(errors)]
        if len(known):
            # Bounds that change within a window: the errors are compared by their ratio to them.
            middle_m = float(np.median(bound_m[inside]))
            ratios = errors / bound_m[inside]
            scaled = ratios[np.isfinite(ratios)]
            yield Window(
                float(begin_s),
                middle_m,
                middle_m * float(np.quantile(scaled, 0.95)),
                1.0 - len(known) / errors.size,
                bool(told[inside].all()),
                _interval(ratios),
            )


def _interval(ratios: FloatArray) -> tuple[float, float]:
    """Return the 95 % confidence interval of the 95 % of some ratios (flights, times).

    Whole flights are drawn again: the errors of one flight last as long as a window and are no independent samples.
    """
    rng = np.random.default_rng(_RESAMPLE_SEED)
    reached = []
    for _ in range(_RESAMPLES):
        again = ratios[rng.integers(0, len(ratios), len(ratios))]
        known = again[np.isfinite(again)]
        if len(known):
            reached.append(float(np.quantile(known, 0.95)))
    low, high = np.quantile(reached, _INTERVAL).tolist()
    return low, high


def check_table(checks: Sequence[PlanCheck]) -> Table:
    """Return a row for each plan: how many windows are close, median of reached over predicted, errors within their bound."""
    table = Table()
    headings = ("plan", "kind", "predicted 95 % m", "reached / predicted", "told and within 20 %")
    for heading in (*headings, "shown within", "shown outside", "covered", "cannot tell"):
        table.add_column(heading, justify="left" if heading in ("plan", "kind") else "right")
    for check in checks:
        levels = [window.predicted_m for window in check.windows]
        span = f"{min(levels):.1f} to {max(levels):.1f}" if levels else "-"
        counted = f"{sum(window.is_close for window in check.told)} of {len(check.told)}"
        shown = str(sum(window.is_shown_close for window in check.told))
        outside = str(sum(not window.may_be_close for window in check.told))
        shares = (f"{check.median_ratio:.2f}", counted, shown, outside, f"{check.covered:.1%}", f"{check.not_told:.0%}")
        table.add_row(check.name, check.text, span, *shares)
    return table
