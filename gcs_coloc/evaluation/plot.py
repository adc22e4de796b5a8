"""The picture of an evaluation: for each vehicle its track, its error against the stated 2-sigma, and the NIS of its ranges."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gcs_coloc.core.errors import UsageError
from gcs_coloc.evaluation.evaluate import Evaluation, VehicleEvaluation


def plot_evaluation(evaluation: Evaluation, path: Path) -> None:
    """Draw each vehicle's track, its error against the stated 2-sigma, and the NIS of its ranges; the ending sets the format.

    Raises:
        UsageError: matplotlib is not installed, or the ending is not one that it writes, or the file cannot be written.

    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError('drawing needs matplotlib: pip install "gcs-coloc[plots]"') from error
    figure = Figure(figsize=(12.0, 6.0 * len(evaluation.denied)), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"{evaluation.dataset}: {evaluation.estimator}")
    rows = figure.subplots(2 * len(evaluation.denied), 2, squeeze=False)
    for i, denied_vehicle in enumerate(evaluation.denied):
        grid = rows[0, 0].get_gridspec()
        for axes in rows[2 * i : 2 * i + 2, 0]:
            axes.remove()
        track = figure.add_subplot(grid[2 * i : 2 * i + 2, 0])
        _draw(denied_vehicle, track, rows[2 * i, 1], rows[2 * i + 1, 1])
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: cannot be written: {error}") from error


def _draw(denied_vehicle: VehicleEvaluation, track: Any, error: Any, nis: Any) -> None:
    series = denied_vehicle.series
    t = series.times_s
    track.plot(series.truth_enu_m[:, 0], series.truth_enu_m[:, 1], color="0.6", lw=3, label="truth")
    track.plot(series.estimate_enu_m[:, 0], series.estimate_enu_m[:, 1], color="#0072b2", lw=1, label="estimate")
    track.set(xlabel="east, m", ylabel="north, m", title=denied_vehicle.node.id, aspect="equal")
    track.legend()
    horizontal_m = np.linalg.norm((series.estimate_enu_m - series.truth_enu_m)[:, :2], axis=1)
    two_sigma_m = 2.0 * np.sqrt(0.5 * (series.covariance_m2[:, 0, 0] + series.covariance_m2[:, 1, 1]))
    error.plot(t, horizontal_m, color="#0072b2", lw=1, label="horizontal error")
    error.plot(t, two_sigma_m, color="#d55e00", lw=1, label="2 sigma, mean of both axes")
    error.set(ylabel="m", ylim=(0.0, None))
    error.legend()
    nis.plot(denied_vehicle.nis[:, 0], denied_vehicle.nis[:, 1], ".", color="0.4", ms=2)
    nis.axhline(1.0, color="#d55e00", lw=1)
    nis.set(xlabel="s", ylabel="NIS of ranges (1 on average)", yscale="symlog")
