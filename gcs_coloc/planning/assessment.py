"""Assessment of a plan: each vehicle predicted without GPS, with its worst stretch and the cause.

Each pair of vehicles is predicted as well where that is asked for.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np

from gcs_coloc.planning.fleet_plan import FleetPlan
from gcs_coloc.planning.predicted_flight import Prediction
from gcs_coloc.planning.prediction import longest_step_s, predict
from gcs_coloc.runtime.tasks import KeptResults, Progress, Workers, run_tasks

_STEPS_A_TASK = 300
"""Steps of the recursion in a task at least. Measured: 2 ms each on the tutorial's plans; a task takes half a second then."""
_LOOKED_AT_S = 30.0
"""Where there is a fix all along, the worst stretch is of this length."""
_LIMIT_IN_A_ROW = 2
"""Steps with a fix that do not end a stretch without: a fix that flickers is none."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """The worst stretch of one vehicle, and what makes it the worst.

    `from_s` and `until_s` are on the plan's clock. `cause` and `code` say why it is the worst, in words and as a code. `has_fix`
    is False if a fix is missing in it. `hpl_m` is the largest protection level in it, NaN where there is none.
    """

    from_s: float
    until_s: float
    cause: str
    code: str
    has_fix: bool
    hpl_m: float


@dataclass(frozen=True, slots=True)
class Outlook:
    """What is predicted of one vehicle, and its worst stretch.

    `cannot_tell` is the share of the flight in which noise decides: without an estimate, or in one line with the peers
    (`Prediction.is_told`).
    """

    predicted: Prediction
    worst: Stretch | None
    cannot_tell: float

    @property
    def median_bound_95_m(self) -> float:
        """Median of the predicted 95 % bound, m; NaN where there is none."""
        return _median(self.predicted.bound_95_m)

    @property
    def median_hpl_m(self) -> float:
        """Median of the protection level, m; NaN where there is none."""
        return _median(self.predicted.hpl_m)


@dataclass(frozen=True, slots=True)
class Assessment:
    """A plan with the outlook of each vehicle alone without GPS, and of both vehicles of each pair."""

    plan: FleetPlan
    singles: tuple[Outlook, ...]
    pairs: tuple[Outlook, ...] = ()

    @property
    def worst(self) -> Outlook:
        """The vehicle with the smallest share of a fix while it alone is without GPS.

        Of equal ones it is that with the largest protection level. One whose way ends before its GPS could fail is none, unless
        there is no other.
        """
        flown = [each for each in self.singles if len(each.predicted.at_s)]
        return min(
            flown or self.singles, key=lambda each: (each.predicted.share_with_fix, -np.nan_to_num(each.median_hpl_m, nan=np.inf))
        )

    @property
    def least_share(self) -> float:
        """The smallest share of the flight with a fix among all outlooks.

        It is 0 where no way is long enough to lose a GPS on.
        """
        flown = (each.predicted for each in (*self.singles, *self.pairs) if len(each.predicted.at_s))
        return min((predicted.share_with_fix for predicted in flown), default=0.0)


def assess(plan: FleetPlan, *, pairs: bool, workers: Workers, progress: Progress, kept: KeptResults | None = None) -> Assessment:
    """Predict each vehicle of a plan, and each pair where asked; what is kept is not computed again."""
    sysids = [vehicle.sysid for vehicle in plan.vehicles]
    denied: list[tuple[int, ...]] = [(sysid,) for sysid in sysids]
    if pairs:
        denied += [pair for pair in combinations(sysids, 2) if _meet(plan, *pair)]
    assert plan.paths  # flown once, here, and handed to all processes
    found = run_tasks(partial(_predict_batch, plan), _batches(plan, denied), workers, progress, kept)
    outlooks = [outlook(predicted) for several in found for predicted in several]
    return Assessment(plan, tuple(outlooks[: len(sysids)]), tuple(outlooks[len(sysids) :]))


def _predict_batch(plan: FleetPlan, batch: Sequence[tuple[int, ...]]) -> list[Prediction]:
    """Predict several sets of denied vehicles of one plan, which is sent once for all of them."""
    return [predicted for denied in batch for predicted in predict(plan, denied)]


def _batches(plan: FleetPlan, denied: Sequence[tuple[int, ...]]) -> list[tuple[tuple[int, ...], ...]]:
    """Return the sets of denied vehicles in their order, grouped into tasks.

    A task holds so many sets that it is worth its way to another process.
    """
    batches: list[list[tuple[int, ...]]] = []
    steps = float(_STEPS_A_TASK)
    for several in denied:
        if steps >= _STEPS_A_TASK:
            batches.append([])
            steps = 0.0
        batches[-1].append(several)
        flown_s = sum(plan.paths[sysid].end_s - plan.paths[sysid].begin_s for sysid in several)
        steps += flown_s / longest_step_s(plan, several)
    return [tuple(batch) for batch in batches]


def _meet(plan: FleetPlan, a: int, b: int) -> bool:
    """Whether two vehicles are in flight at one time: only then is a pair another case than each alone."""
    first, second = plan.paths[a], plan.paths[b]
    return first.begin_s < second.end_s and second.begin_s < first.end_s


def outlook(predicted: Prediction) -> Outlook:
    """Return the prediction with its worst stretch."""
    unknown = 1.0 - float(predicted.is_told.mean()) if len(predicted.at_s) else 0.0
    return Outlook(predicted, worst_stretch(predicted), unknown)


def worst_stretch(predicted: Prediction) -> Stretch | None:
    """Return the longest stretch without a fix, or else that of the largest protection level.

    The latter is half a minute long. None means that the prediction has no step.
    """
    at_s = predicted.at_s
    if not len(at_s):
        return None
    without = _closed(predicted.has_fix < 0.5)
    runs = _runs(without)
    if runs:
        first, last = max(runs, key=lambda run: at_s[run[1]] - at_s[run[0]])
        codes = Counter(code for code in predicted.limit_code[first : last + 1] if code)
        code = codes.most_common(1)[0][0]
        text = max(
            (text for text, its in zip(predicted.limit, predicted.limit_code, strict=True) if its == code),
            key=Counter(predicted.limit[first : last + 1]).__getitem__,
        )
        return Stretch(float(at_s[first]), float(at_s[last]), text, code, has_fix=False, hpl_m=_largest(predicted, first, last))
    middle = int(np.nanargmax(predicted.hpl_m))
    near = np.flatnonzero(np.abs(at_s - at_s[middle]) <= 0.5 * _LOOKED_AT_S)
    first, last = int(near[0]), int(near[-1])
    cause = f"protection level up to {predicted.hpl_m[middle]:.0f} m at HDOP {predicted.hdop[middle]:.1f}"
    return Stretch(float(at_s[first]), float(at_s[last]), cause, "", has_fix=True, hpl_m=_largest(predicted, first, last))


def _largest(predicted: Prediction, first: int, last: int) -> float:
    levels = predicted.hpl_m[first : last + 1]
    return float(np.nanmax(levels)) if np.isfinite(levels).any() else float("nan")


def _runs(flags: Sequence[bool]) -> list[tuple[int, int]]:
    """Return the first and the last index of each run of true ones."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(flags, dtype=int), [0]])))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _closed(flags: np.ndarray) -> list[bool]:
    """Return the flags with short gaps between true ones closed."""
    closed = flags.copy()
    for first, last in _runs((~flags).tolist()):
        if first > 0 and last < len(flags) - 1 and last - first < _LIMIT_IN_A_ROW:
            closed[first : last + 1] = True
    return [bool(flag) for flag in closed]


def _median(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")
