"""Output of an evaluation: a picture of each vehicle, and every epoch as CSV."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.evaluation.evaluate import Evaluation, VehicleEvaluation
from gcs_coloc.runtime.files import new_figure, save_figure, writing

_COLUMNS = ("dataset", "estimator", "id", "t_s", "e_m", "n_m", "u_m", "sigma_e_m", "sigma_n_m", "sigma_u_m", "bound_95_m",
            "true_e_m", "true_n_m", "true_u_m", "error_h_m", "error_3d_m")  # fmt: skip


def write_epochs(evaluations: Sequence[Evaluation], path: Path | str) -> None:
    """Write every epoch of every denied vehicle as CSV.

    Cells without an estimate, or without truth, are empty.

    Raises:
        UsageError: the file cannot be written.
    """
    with writing(Path(path), ""), Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(_COLUMNS)
        for evaluation in evaluations:
            for vehicle in evaluation.denied:
                series = vehicle.series
                for t, true, here, P in zip(
                    series.times_s, series.truth_enu_m, series.estimate_enu_m, series.covariance_m2, strict=True
                ):
                    sigmas = np.sqrt(np.diag(P))
                    bound_m = horizontal_bound_95_m(P) if np.isfinite(P).all() else np.nan
                    errors = (np.linalg.norm((here - true)[:2]), np.linalg.norm(here - true))
                    numbers = (*here, *sigmas, bound_m, *true, *errors)
                    cells = ("" if np.isnan(x) else f"{x:.4f}" for x in numbers)
                    writer.writerow((evaluation.dataset, evaluation.estimator, vehicle.node.id, f"{t:.4f}", *cells))


def plot_evaluation(evaluation: Evaluation, path: Path | str) -> None:
    """Draw each vehicle's track, its error against the stated 2-sigma, and the NIS of its ranges.

    The file's ending sets the format.

    Raises:
        UsageError: matplotlib is not installed, or the ending is not one that it writes, or the file cannot be written.

    """
    figure = new_figure((12.0, 6.0 * len(evaluation.denied)))
    figure.suptitle(f"{evaluation.dataset}: {evaluation.estimator}")
    rows = figure.subplots(2 * len(evaluation.denied), 2, squeeze=False)
    for i, denied_vehicle in enumerate(evaluation.denied):
        grid = rows[0, 0].get_gridspec()
        for axes in rows[2 * i : 2 * i + 2, 0]:
            axes.remove()
        track = figure.add_subplot(grid[2 * i : 2 * i + 2, 0])
        _draw(denied_vehicle, track, rows[2 * i, 1], rows[2 * i + 1, 1])
    save_figure(figure, path)


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
