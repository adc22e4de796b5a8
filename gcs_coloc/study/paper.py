"""The study of Qu & Zhang's paper: their simulation flown again, with other filters beside.

It repeats their Table 2, tries other covariances, and runs the fleet filter on the same data.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.runtime.tasks import KeptResults, Progress, Workers, run_tasks
from gcs_coloc.study.paper_filters import KINDS
from gcs_coloc.study.paper_options import PUBLISHED_TABLE_2, PaperOptions
from gcs_coloc.study.paper_runs import (
    FilterSeries,
    Geometry,
    PaperFlight,
    PaperRun,
    Sums,
    constant_covariance,
    fly,
    run_fleet,
    run_paper_filters,
)

FLEET = "fleet"

_SEEDS_PER_TASK = 5
"""More draws at once are faster by numpy and slower to show progress."""


@dataclass(frozen=True, slots=True)
class FilterScore:
    """Errors of one filter over all draws and steps of a part of the flight.

    `variance_m2` is the paper's figure, the variance of the distance error along a flight, mean over draws; `rmse_m` and
    `largest_m` are of the distance error; `anees` is the mean normalised squared error of two coordinates, 2 if honest.
    """

    variance_m2: float
    rmse_m: float
    largest_m: float
    anees: float


@dataclass(frozen=True, slots=True)
class Row:
    """The scores of one filter at one q.

    `q` is None for the fleet filter. `whole` is over the whole flight, `first` over its first part. `published_variance_m2` is
    the paper's figure; None where it has none.
    """

    filter: str
    q: float | None
    draws: int
    whole: FilterScore
    first: FilterScore
    published_variance_m2: float | None


@dataclass(frozen=True, slots=True)
class PaperStudy:
    """The study's result.

    `rows` are by filter and q, `series` by filter at the q of the figures. `constant_r_m2` is the general filter's R by q, shape
    (Q, 2, 2), m^2.
    """

    options: PaperOptions
    flight: PaperFlight
    rows: tuple[Row, ...]
    series: dict[str, FilterSeries]
    geometry: Geometry
    constant_r_m2: FloatArray


def run_paper_study(options: PaperOptions, workers: Workers, progress: Progress, kept: KeptResults | None = None) -> PaperStudy:
    """Fly, draw noise, filter and score; `progress` is called with how many of how many tasks are done."""
    flight = fly(options)
    constant_R = constant_covariance(flight, options)
    seeds = [options.first_seed + i for i in range(options.seeds)]
    # The fleet's tasks are the longest: they come first, so that no core waits for one at the end.
    tasks: list[int | list[int]] = [*seeds[: options.fleet_seeds]]
    tasks += [seeds[i : i + _SEEDS_PER_TASK] for i in range(0, len(seeds), _SEEDS_PER_TASK)]
    results = run_tasks(partial(_run, flight, constant_R, options), tasks, workers, progress, kept)
    fleet = [one for one in results if isinstance(one, FilterSeries)]
    runs = [one for one in results if isinstance(one, PaperRun)]
    whole, first = _joined([run.whole for run in runs]), _joined([run.first for run in runs])
    rows = [
        Row(
            filter=kind,
            q=q,
            draws=options.seeds,
            whole=_score(whole, i, j),
            first=_score(first, i, j),
            published_variance_m2=_published(kind, q),
        )
        for i, kind in enumerate(KINDS)
        for j, q in enumerate(options.qs)
    ]
    draws = [run.whole.count.shape[-1] for run in runs]
    series = {
        kind: replace(runs[0].series[kind], nees=np.average([run.series[kind].nees for run in runs], axis=0, weights=draws))
        for kind in KINDS
    }
    if fleet:
        series[FLEET] = replace(fleet[0], nees=np.mean([one.nees for one in fleet], axis=0))
        early = [one.times_s <= options.first_part_s for one in fleet]
        rows.append(
            Row(
                filter=FLEET,
                q=None,
                draws=len(fleet),
                whole=_score_series([(one.error_m, one.nees) for one in fleet]),
                first=_score_series([(one.error_m[part], one.nees[part]) for one, part in zip(fleet, early, strict=True)]),
                published_variance_m2=None,
            )
        )
    return PaperStudy(options, flight, tuple(rows), series, runs[0].geometry, constant_R)


def _run(flight: PaperFlight, constant_R: FloatArray, options: PaperOptions, seeds: int | list[int]) -> PaperRun | FilterSeries:
    """Run the fleet filter for one seed, or the paper's filters for several."""
    if isinstance(seeds, int):
        return run_fleet(flight, seeds, options)
    return run_paper_filters(flight, seeds, constant_R, options)


def _joined(parts: list[Sums]) -> Sums:
    return Sums(**{one.name: np.concatenate([getattr(part, one.name) for part in parts], axis=-1) for one in fields(Sums)})


def _score(sums: Sums, kind: int, q: int) -> FilterScore:
    count = sums.count[kind, q]
    mean, square = sums.error_m[kind, q] / count, sums.squared_m2[kind, q] / count
    return FilterScore(
        variance_m2=float(np.maximum(square - mean**2, 0.0).mean()),
        rmse_m=float(np.sqrt(square.mean())),
        largest_m=float(sums.largest_m[kind, q].max()),
        anees=float((sums.nees[kind, q] / count).mean()),
    )


def _score_series(draws: list[tuple[FloatArray, FloatArray]]) -> FilterScore:
    """Return the score over the samples that have an estimate; NaN where there is none at all."""
    known = [(error[np.isfinite(error)], nees[np.isfinite(error)]) for error, nees in draws]
    known = [one for one in known if len(one[0])]
    if not known:
        return FilterScore(*[float("nan")] * 4)
    errors = np.concatenate([error for error, _ in known])
    return FilterScore(
        variance_m2=float(np.mean([error.var() for error, _ in known])),
        rmse_m=float(np.sqrt(np.mean(errors**2))),
        largest_m=float(errors.max()),
        anees=float(np.mean([nees.mean() for _, nees in known])),
    )


def _published(kind: str, q: float) -> float | None:
    pair = PUBLISHED_TABLE_2.get(q)
    column = {"general": 0, "published": 1}.get(kind)
    return None if pair is None or column is None else pair[column]
