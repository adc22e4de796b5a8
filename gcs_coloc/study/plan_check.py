"""The check of predictions: drawn flights against what was predicted of them, along the way.

Compared are errors, protection levels and fixes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import cos, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import FloatArray, VehicleClass
from gcs_coloc.planning.fleet_plan import FleetPlan, PlanAssumptions, PlannedStation, PlannedVehicle
from gcs_coloc.planning.flight_path import Leg
from gcs_coloc.planning.load import load_plan
from gcs_coloc.planning.predicted_flight import Prediction
from gcs_coloc.planning.prediction import predict
from gcs_coloc.runtime.files import new_table
from gcs_coloc.runtime.tasks import KeptResults, Progress, Workers, run_tasks
from gcs_coloc.study.drawn_flight import DrawnFlight, fly_plan
from sitl_fakes.scenario import SCENARIOS

_FRAME = LocalFrame(47.0, 8.0, 500.0)
_DURATION_S = 300.0  # chosen: several legs
_SURVEYED_M = 0.1  # chosen: stations surveyed by RTK, of which the prediction takes shorter steps
_Points = Sequence[tuple[float, float]]


class CheckedPlan(NamedTuple):
    """One plan, who is denied in it, and what kind it is."""

    text: str
    denied: int
    plan: FleetPlan


def _vehicle(sysid: int, points: _Points, speed_mps: float = 20.0, kind: VehicleClass = VehicleClass.PLANE) -> PlannedVehicle:
    up_m = 80.0 + 15.0 * sysid
    legs = tuple(Leg((*point, up_m), speed_mps) for point in [*points[1:], *points] * 6)
    return PlannedVehicle(sysid, str(sysid), (*points[0], up_m), legs, 0.0, kind, _DURATION_S)


def _box(east: float, north: float, size: float) -> _Points:
    return [(east, north), (east + size, north), (east + size, north + size), (east, north + size)]


def _ring(east: float, north: float, radius: float, first: float) -> _Points:
    angles = [first + k * pi / 3.0 for k in range(6)]
    return [(east + radius * sin(a), north + radius * cos(a)) for a in angles]


def _fleet(*vehicles: PlannedVehicle, stations: _Points = (), **assumed: float | bool) -> FleetPlan:
    placed = tuple(PlannedStation(k, (*place, 15.0), _SURVEYED_M) for k, place in enumerate(stations, start=1))
    return FleetPlan(_FRAME, vehicles, placed, PlanAssumptions(**assumed))  # type: ignore[arg-type]


def _boxes(apart_m: float, size_m: float, speed_mps: float = 20.0) -> list[PlannedVehicle]:
    return [_vehicle(k, _box(apart_m * (k % 2), apart_m * (k // 2), size_m), speed_mps) for k in range(1, 5)]


def _lanes(east_m: float, north_m: float) -> list[PlannedVehicle]:
    return [_vehicle(k, [(east_m * k, north_m * k), (east_m * k, north_m * k + 2500.0)]) for k in range(1, 5)]


def _rings(apart_m: float, radius_m: float, count: int, speed_mps: float, kind: VehicleClass) -> list[PlannedVehicle]:
    rings = [_ring(apart_m * (k % 2), apart_m * (k // 2), radius_m, k) for k in range(1, count + 1)]
    return [_vehicle(k, ring, speed_mps, kind) for k, ring in enumerate(rings, start=1)]


_STATIONS = [(-100.0, -100.0), (1300.0, 0.0), (1200.0, 1300.0), (0.0, 1200.0)]
CHECK_PLANS: Mapping[str, Callable[[], CheckedPlan]] = {
    "around": lambda: CheckedPlan("four planes, each on a square of its own", 1, _fleet(*_boxes(900.0, 500.0))),
    "abreast": lambda: CheckedPlan("four planes abreast, to and fro", 1, _fleet(*_lanes(250.0, 0.0))),
    "column": lambda: CheckedPlan("four planes in a column", 1, _fleet(*_lanes(20.0, 300.0))),
    "far": lambda: CheckedPlan("four planes far apart", 2, _fleet(*_rings(3500.0, 400.0, 4, 20.0, VehicleClass.PLANE))),
    "two-peers": lambda: CheckedPlan(
        "two peers alone", 1, _fleet(*(_vehicle(k, _ring(700.0 * k, 300.0 * (k % 2), 350.0, 2.0 * k)) for k in range(1, 4)))
    ),
    "no-air-data": lambda: CheckedPlan("planes that send no airspeed", 1, _fleet(*_boxes(900.0, 500.0), has_air_data=False)),
    "copters": lambda: CheckedPlan("five copters", 1, _fleet(*_rings(250.0, 150.0, 5, 8.0, VehicleClass.MULTIROTOR))),
    "stations": lambda: CheckedPlan(
        "one plane and four stations", 1, _fleet(_vehicle(1, _box(200.0, 200.0, 800.0)), stations=_STATIONS)
    ),
    "coarse": lambda: CheckedPlan(
        "ranges of 5 m, receivers of 4 m", 3, _fleet(*_boxes(1500.0, 700.0, 25.0), range_sigma_m=5.0, position_sigma_m=4.0)
    ),
    "paper": lambda: CheckedPlan("Qu and Zhang's flight", 4, load_plan([SCENARIOS / "paper.toml"])),
}
"""The plans by name; each is built when asked for."""


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
    """One window of a plan: the predicted and the reached 95 % of the error.

    `from_s`: when it begins. `lost`: share of samples without an estimate. `is_told`: the prediction tells the size of the error
    here (`Prediction.is_told`). `interval`: 95 % confidence interval of reached over predicted, by the bootstrap over flights.
    `hpl_ratio`: stated over predicted protection level, the median.
    """

    from_s: float
    predicted_m: float
    reached_m: float
    lost: float
    is_told: bool
    interval: tuple[float, float]
    hpl_ratio: float

    @property
    def ratio(self) -> float:
        """Reached over predicted."""
        return self.reached_m / self.predicted_m

    @property
    def is_close(self) -> bool:
        """Whether the reached 95 % is within 20 % of the predicted one."""
        return abs(self.ratio - 1.0) <= _CLOSE

    @property
    def is_level_close(self) -> bool:
        """Whether the stated protection level is within 20 % of the predicted one."""
        return abs(self.hpl_ratio - 1.0) <= _CLOSE

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
    """One plan's check: its windows, and what they come to over the whole flight.

    `covered`: share of the errors within the predicted bound of their time. `not_told`: share of the flight of which the
    prediction cannot tell the size of the error. `fix_predicted`, `fix_reached`: share of the flight with a fix. `beyond_hpl`:
    samples with a fix whose error is beyond the predicted protection level of their time.
    """

    name: str
    text: str
    flights: int
    windows: tuple[Window, ...]
    covered: float
    not_told: float
    fix_predicted: float
    fix_reached: float
    beyond_hpl: int

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


def _draw(task: tuple[str, int]) -> DrawnFlight:
    name, seed = task
    checked = CHECK_PLANS[name]()
    return fly_plan(checked.plan, checked.denied, seed)


def _predict(name: str) -> Prediction:
    checked = CHECK_PLANS[name]()
    return predict(checked.plan, (checked.denied,))[0]


def compare(name: str, text: str, predicted: Prediction, drawn: Sequence[DrawnFlight]) -> PlanCheck:
    """Compare a prediction with drawn flights: errors and levels where it has a bound, and fixes."""
    times_s = drawn[0].at_s
    is_settled = times_s >= predicted.at_s[0] + _SETTLED_S
    nearest = np.abs(predicted.at_s[:, np.newaxis] - times_s).argmin(axis=0)
    bound_m, hpl_m, told = predicted.bound_95_m[nearest], predicted.hpl_m[nearest], predicted.is_told[nearest]
    errors_m, hpls_m, fixes = (
        np.stack(several) for several in zip(*((flight.error_m, flight.hpl_m, flight.has_fix) for flight in drawn), strict=True)
    )
    has_bound = np.isfinite(bound_m) & is_settled
    windows = []
    for begin_s in np.arange(times_s[has_bound][0], times_s[has_bound][-1], WINDOW_S) if has_bound.any() else ():
        inside = has_bound & (times_s >= begin_s) & (times_s < begin_s + WINDOW_S)
        if np.isfinite(errors_m[:, inside]).any():
            hpl_ratios = hpls_m[:, inside] / hpl_m[inside]
            windows.append(_window(begin_s, bound_m[inside], errors_m[:, inside], told[inside], hpl_ratios))
    known = np.isfinite(errors_m[:, has_bound])
    return PlanCheck(
        name,
        text,
        len(drawn),
        tuple(windows),
        covered=float((errors_m[:, has_bound] <= bound_m[has_bound])[known].mean()) if known.any() else 0.0,
        not_told=1.0 - float(predicted.is_told.mean()),
        fix_predicted=float(predicted.has_fix[nearest][is_settled].mean()),
        fix_reached=float(fixes[:, is_settled].mean()),
        beyond_hpl=int(((errors_m > hpl_m) & (fixes > 0.5))[:, is_settled].sum()),
    )


def _window(begin_s: float, bound_m: FloatArray, errors_m: FloatArray, told: NDArray[np.bool_], hpl_ratios: FloatArray) -> Window:
    # Bounds that change within a window: the errors are compared by their ratio to them.
    middle_m, ratios = float(np.median(bound_m)), errors_m / bound_m
    known, known_hpl = ratios[np.isfinite(ratios)], hpl_ratios[np.isfinite(hpl_ratios)]
    return Window(
        float(begin_s),
        middle_m,
        middle_m * float(np.quantile(known, 0.95)),
        1.0 - len(known) / errors_m.size,
        bool(told.all()),
        _interval(ratios),
        float(np.median(known_hpl)) if len(known_hpl) else float("nan"),
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
    """Return a table with a row for each plan.

    It shows how many windows are close, the median of reached over predicted, and how many errors are within their bound.
    """
    bounds = ("predicted 95 % m", "reached / predicted", "told and within 20 %", "shown within", "shown outside", "covered")
    levels = ("cannot tell", "HPL stated / predicted", "within 20 %", "beyond predicted HPL", "fix predicted", "fix reached")
    table = new_table("plan", *bounds, *levels, left=("plan",))
    for check in checks:
        bounds_m = [window.predicted_m for window in check.windows]
        span = f"{min(bounds_m):.1f} to {max(bounds_m):.1f}" if bounds_m else "-"
        counted = f"{sum(window.is_close for window in check.told)} of {len(check.told)}"
        shown = str(sum(window.is_shown_close for window in check.told))
        outside = str(sum(not window.may_be_close for window in check.told))
        shares = (f"{check.median_ratio:.2f}", counted, shown, outside, f"{check.covered:.1%}", f"{check.not_told:.0%}")
        close = f"{sum(window.is_level_close for window in check.told)} of {len(check.told)}"
        ratio = f"{np.nanmedian([window.hpl_ratio for window in check.told]):.2f}" if check.told else "-"
        fixes = f"{check.fix_predicted:.1%}", f"{check.fix_reached:.1%}"
        table.add_row(check.name, span, *shares, ratio, close, str(check.beyond_hpl), *fixes)
    return table
