"""The paper's figures 5, 6 and 7 drawn from the study, and error against stated sigma and NEES for each filter."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gcs_coloc.core.errors import UsageError
from gcs_coloc.study.paper import PaperStudy

_COLOURS = ("#0072b2", "#d55e00", "#e69f00", "#009e73", "#cc79a7")
_ERROR_LIMITS_M = (0.3, 3000.0)
"""What diverges or is singular leaves the picture instead of squeezing the rest into its last line."""


def draw_figures(study: PaperStudy, titles: Mapping[str, str], out_dir: Path) -> list[Path]:
    """Write the figures as PNG into a directory that exists; return their paths.

    `titles` gives the name in print of each filter. Raises UsageError where matplotlib is not installed, OSError where a file
    cannot be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError('drawing needs matplotlib: pip install "gcs-coloc[plots]"') from error
    written = []
    for name, size, draw in (
        ("figure5.png", (8.0, 8.0), _trajectories),
        ("figure6.png", (8.0, 6.5), _detail),
        ("figure7.png", (9.0, 6.5), _error_and_hdop),
        ("honesty.png", (10.0, 2.4 * len(study.series)), _honesty),
    ):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure, study, titles)
        figure.savefig(out_dir / name, dpi=70)
        written.append(out_dir / name)
    return written


def _trajectories(figure: Any, study: PaperStudy, titles: Mapping[str, str]) -> None:
    axes = figure.subplots()
    for uav in range(4):
        route, flown = study.flight.routes_m[uav] / 1e3, study.flight.positions_m[uav] / 1e3
        axes.plot(route[:, 0], route[:, 1], "ks:", ms=4, lw=1, label="planned routes" if uav == 0 else None)
        axes.plot(flown[:, 0], flown[:, 1], color="0.5", lw=1.2, label="flown" if uav == 0 else None)
        axes.annotate(f"UAV{uav + 1}", flown[0], xytext=(5, 5), textcoords="offset points")
    _place_estimates(axes, study, titles)
    limits = np.concatenate(study.flight.positions_m) / 1e3
    axes.set_xlim(limits[:, 0].min() - 1, limits[:, 0].max() + 1)
    axes.set_ylim(limits[:, 1].min() - 1, limits[:, 1].max() + 1)
    axes.set_aspect("equal")
    _finish(axes, "Figure 5: trajectories", "east, km", "north, km")


def _detail(figure: Any, study: PaperStudy, titles: Mapping[str, str]) -> None:
    axes = figure.subplots()
    part = study.flight.times_s <= study.options.first_part_s
    flown = study.flight.positions_m[3, part] / 1e3
    axes.plot(flown[:, 0], flown[:, 1], color="0.5", lw=3, label="UAV4, flown")
    _place_estimates(axes, study, titles)
    axes.set_xlim(flown[:, 0].min() - 0.2, flown[:, 0].max() + 0.2)
    axes.set_ylim(flown[:, 1].min() - 0.2, flown[:, 1].max() + 0.2)
    _finish(axes, f"Figure 6: UAV4 in the first {study.options.first_part_s:g} s", "east, km", "north, km", legend="lower left")


def _place_estimates(axes: Any, study: PaperStudy, titles: Mapping[str, str]) -> None:
    fixes = study.geometry.fix_m / 1e3
    axes.plot(fixes[:, 0], fixes[:, 1], ".", color="0.8", ms=2, zorder=0, label="fixes from three ranges")
    for (kind, series), colour in zip(study.series.items(), _COLOURS, strict=False):
        if kind in ("published_with_range_noise", "fleet"):
            place = series.estimate_m / 1e3
            axes.plot(place[:, 0], place[:, 1], color=colour, lw=1, label=titles[kind])


def _error_and_hdop(figure: Any, study: PaperStudy, titles: Mapping[str, str]) -> None:
    error, hdop = figure.subplots(2, 1, sharex=True)
    any_series = next(iter(study.series.values()))
    error.semilogy(any_series.times_s, study.geometry.fix_error_m, color="0.8", lw=1, label="fix from three ranges alone")
    for (kind, series), colour in zip(study.series.items(), _COLOURS, strict=False):
        error.semilogy(series.times_s, series.error_m, color=colour, lw=1.2, label=titles[kind])
    error.set_ylim(*_ERROR_LIMITS_M)
    _finish(error, f"Figure 7: UAV4, q = {study.options.figure_q:g}, one draw", None, "distance error, m")
    hdop.semilogy(any_series.times_s, study.geometry.hdop_m, color="k", lw=1.2, label="sqrt(A11 + A22), the paper's HDOP")
    _finish(hdop, None, "time, s", "HDOP, m")


def _honesty(figure: Any, study: PaperStudy, titles: Mapping[str, str]) -> None:
    grid = figure.subplots(len(study.series), 2, sharex=True, squeeze=False)
    for (kind, series), (error, nees) in zip(study.series.items(), grid, strict=True):
        error.semilogy(series.times_s, series.error_m, color="#0072b2", lw=1, label="error")
        error.semilogy(series.times_s, 2.0 * series.sigma_m, color="k", lw=1, ls="--", label="2 sigma, as stated")
        error.set_ylim(*_ERROR_LIMITS_M)
        _finish(error, titles[kind], None, "m")
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
