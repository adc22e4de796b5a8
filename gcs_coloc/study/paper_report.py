"""The paper study in words and files: Table 2 beside the published figures, CSV, JSON and the figures."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from gcs_coloc import __version__
from gcs_coloc.runtime.files import make_output_directory, new_figure, new_table, save_figure, writing
from gcs_coloc.study.paper import FLEET, FilterScore, PaperStudy, Row

TITLES = {
    "general": "general KF",
    "published": "proposed, to the letter",
    "published_with_range_noise": "proposed, with range noise",
    "corrected": "corrected covariance",
    FLEET: "fleet filter",
}
"""What each filter is called in print."""
_COLOURS = ("#0072b2", "#d55e00", "#e69f00", "#009e73", "#cc79a7")
_ERROR_LIMITS_M = (0.3, 3000.0)
"""What diverges or is singular leaves the picture instead of squeezing the rest into its last line."""


def tables(study: PaperStudy) -> list[Table]:
    """Return the study's tables, to be printed by rich.

    They are Table 2 for the whole flight and for its first part, and the scores behind it.
    """
    first_s = study.options.first_part_s
    return [
        _table_2(study, f"Table 2: variance of UAV4's distance error, m², whole flight; {study.options.seeds} draws", whole=True),
        _table_2(study, f"the same over the first {first_s:g} s, before the peers come into one line", whole=False),
        _scores(study),
    ]


def readings(study: PaperStudy) -> dict[str, object]:
    """Return the options that the study was run with: every reading that the paper leaves open."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(study.options).items()}


def write(study: PaperStudy, out_dir: Path) -> list[Path]:
    """Write the study's tables and figures into a directory, and return the files.

    The directory is made. The files are `table2.csv`, `study.json` and the figures.

    Raises:
        UsageError: the directory or a file cannot be written, or matplotlib is not installed.
    """
    make_output_directory(out_dir, "--out")
    with writing(out_dir, ""):
        files = [_write_csv(study, out_dir / "table2.csv"), _write_json(study, out_dir / "study.json")]
        return [*files, *_draw_figures(study, out_dir)]


def _table_2(study: PaperStudy, title: str, *, whole: bool) -> Table:
    of_filters = (TITLES[kind] for kind in _kinds(study))
    table = new_table("q", "general KF, published", "proposed, published", *of_filters, title=title)
    for q in study.options.qs:
        cells = {row.filter: row for row in study.rows if row.q in (q, None)}
        printed = [_number(cells[kind].published_variance_m2) for kind in ("general", "published")]
        variances = [(cells[kind].whole if whole else cells[kind].first).variance_m2 for kind in _kinds(study)]
        table.add_row(f"{q:g}", *printed, *(_number(variance) for variance in variances))
    return table


def _scores(study: PaperStudy) -> Table:
    first_s = study.options.first_part_s
    title = "RMSE and honesty (mean NEES of two coordinates: 2 is honest, more is overconfident)"
    headings = ("filter", "q", "draws", "RMSE, m", "largest, m", "NEES", f"RMSE to {first_s:g} s, m", f"NEES to {first_s:g} s")
    table = new_table(*headings, left=("filter",), title=title)
    for row in study.rows:
        whole, first = row.whole, row.first
        numbers = (whole.rmse_m, whole.largest_m, whole.anees, first.rmse_m, first.anees)
        table.add_row(TITLES[row.filter], "" if row.q is None else f"{row.q:g}", str(row.draws), *map(_number, numbers))
    return table


def _kinds(study: PaperStudy) -> list[str]:
    return list(dict.fromkeys(row.filter for row in study.rows))


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if abs(value) >= 1e4 else f"{value:.1f}"


def _write_csv(study: PaperStudy, path: Path) -> Path:
    parts = ("variance_m2", "rmse_m", "largest_m", "anees")
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        whole, first = [f"whole_{part}" for part in parts], [f"first_{part}" for part in parts]
        writer.writerow(["filter", "q", "draws", "published_variance_m2", *whole, *first])
        for row in study.rows:
            blank = ["" if value is None else value for value in (row.q, row.draws, row.published_variance_m2)]
            scores = [getattr(score, part) for score in (row.whole, row.first) for part in parts]
            writer.writerow([row.filter, *blank, *scores])
    return path


def _write_json(study: PaperStudy, path: Path) -> Path:
    constant = {f"{q:g}": R.tolist() for q, R in zip(study.options.qs, study.constant_r_m2, strict=True)}
    content = {
        "version": __version__,
        "readings": readings(study),
        "constant_r_m2_by_q": constant,
        "rows": [_row(row) for row in study.rows],
    }
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
    return path


def _row(row: Row) -> dict[str, object]:
    flat = asdict(row)
    return {**flat, "whole": _score(row.whole), "first": _score(row.first)}


def _score(score: FilterScore) -> dict[str, float | None]:
    # JSON has no NaN: a filter that never answered has no score.
    return {name: value if math.isfinite(value) else None for name, value in asdict(score).items()}


def _draw_figures(study: PaperStudy, out_dir: Path) -> list[Path]:
    written = []
    for name, size, draw in (
        ("figure5.png", (8.0, 8.0), _trajectories),
        ("figure6.png", (8.0, 6.5), _detail),
        ("figure7.png", (9.0, 6.5), _error_and_hdop),
        ("honesty.png", (10.0, 2.4 * len(study.series)), _honesty),
    ):
        figure = new_figure(size)
        draw(figure, study)
        save_figure(figure, out_dir / name, dpi=70)
        written.append(out_dir / name)
    return written


def _trajectories(figure: Any, study: PaperStudy) -> None:
    axes = figure.subplots()
    for uav in range(4):
        route, flown = study.flight.routes_m[uav] / 1e3, study.flight.positions_m[uav] / 1e3
        axes.plot(route[:, 0], route[:, 1], "ks:", ms=4, lw=1, label="planned routes" if uav == 0 else None)
        axes.plot(flown[:, 0], flown[:, 1], color="0.5", lw=1.2, label="flown" if uav == 0 else None)
        axes.annotate(f"UAV{uav + 1}", flown[0], xytext=(5, 5), textcoords="offset points")
    _place_estimates(axes, study)
    limits = np.concatenate(study.flight.positions_m) / 1e3
    axes.set_xlim(limits[:, 0].min() - 1, limits[:, 0].max() + 1)
    axes.set_ylim(limits[:, 1].min() - 1, limits[:, 1].max() + 1)
    axes.set_aspect("equal")
    _finish(axes, "Figure 5: trajectories", "east, km", "north, km")


def _detail(figure: Any, study: PaperStudy) -> None:
    axes = figure.subplots()
    part = study.flight.times_s <= study.options.first_part_s
    flown = study.flight.positions_m[3, part] / 1e3
    axes.plot(flown[:, 0], flown[:, 1], color="0.5", lw=3, label="UAV4, flown")
    _place_estimates(axes, study)
    axes.set_xlim(flown[:, 0].min() - 0.2, flown[:, 0].max() + 0.2)
    axes.set_ylim(flown[:, 1].min() - 0.2, flown[:, 1].max() + 0.2)
    _finish(axes, f"Figure 6: UAV4 in the first {study.options.first_part_s:g} s", "east, km", "north, km", legend="lower left")


def _place_estimates(axes: Any, study: PaperStudy) -> None:
    fixes = study.geometry.fix_m / 1e3
    axes.plot(fixes[:, 0], fixes[:, 1], ".", color="0.8", ms=2, zorder=0, label="fixes from three ranges")
    for (kind, series), colour in zip(study.series.items(), _COLOURS, strict=False):
        if kind in ("published_with_range_noise", "fleet"):
            place = series.estimate_m / 1e3
            axes.plot(place[:, 0], place[:, 1], color=colour, lw=1, label=TITLES[kind])


def _error_and_hdop(figure: Any, study: PaperStudy) -> None:
    error, hdop = figure.subplots(2, 1, sharex=True)
    any_series = next(iter(study.series.values()))
    error.semilogy(any_series.times_s, study.geometry.fix_error_m, color="0.8", lw=1, label="fix from three ranges alone")
    for (kind, series), colour in zip(study.series.items(), _COLOURS, strict=False):
        error.semilogy(series.times_s, series.error_m, color=colour, lw=1.2, label=TITLES[kind])
    error.set_ylim(*_ERROR_LIMITS_M)
    _finish(error, f"Figure 7: UAV4, q = {study.options.figure_q:g}, one draw", None, "distance error, m")
    hdop.semilogy(any_series.times_s, study.geometry.hdop_m, color="k", lw=1.2, label="sqrt(A11 + A22), the paper's HDOP")
    _finish(hdop, None, "time, s", "HDOP, m")


def _honesty(figure: Any, study: PaperStudy) -> None:
    grid = figure.subplots(len(study.series), 2, sharex=True, squeeze=False)
    for (kind, series), (error, nees) in zip(study.series.items(), grid, strict=True):
        error.semilogy(series.times_s, series.error_m, color="#0072b2", lw=1, label="error")
        error.semilogy(series.times_s, 2.0 * series.sigma_m, color="k", lw=1, ls="--", label="2 sigma, as stated")
        error.set_ylim(*_ERROR_LIMITS_M)
        _finish(error, TITLES[kind], None, "m")
        nees.semilogy(series.times_s, series.nees, color="#d55e00", lw=1, label="NEES, mean over draws")
        nees.axhline(2.0, color="k", lw=1, ls="--", label="2: honest")
        nees.set_ylim(0.1, 1e4)
        _finish(nees, None, None, None)
    for axes in grid[-1]:
        axes.set_xlabel("time, s")


def _finish(axes: Any, title: str | None, x: str | None, y: str | None, legend: str = "upper left") -> None:
    if title:
        axes.set_title(title)
    if x:
        axes.set_xlabel(x)
    if y:
        axes.set_ylabel(y)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc=legend)
