"""Scoring of a run of estimates: errors against the truth, and the stated covariance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import Estimate, FloatArray


@dataclass(frozen=True, slots=True)
class EstimateSeries:
    """The scored epochs of one denied vehicle; positions ENU in metres.

    Epochs without an estimate hold NaN.

    `times_s` (T,), `truth_enu_m` (T, 3), `estimate_enu_m` (T, 3), `covariance_m2` (T, 3, 3).
    """

    times_s: FloatArray
    truth_enu_m: FloatArray
    estimate_enu_m: FloatArray
    covariance_m2: FloatArray

    def known(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return (T,): whether there is an estimate."""
        return ~np.isnan(self.estimate_enu_m[:, 0])


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Metres: root mean square, median, 95th percentile and maximum."""

    rmse_m: float
    median_m: float
    p95_m: float
    max_m: float


@dataclass(frozen=True, slots=True)
class VehicleScore:
    """The figures of one denied vehicle.

    `share_known` is the share of truth epochs with an estimate, `first_known_s` the time from becoming a vehicle to the first
    of them (None: never). `anees` is the mean of e' P^-1 e, which is `anees_expected` (the number of dimensions) where the
    covariance is honest: above is overconfident. `covered_95` is the share of horizontal errors within the stated 95 % bound,
    `beyond_three_bounds` of those beyond three times it: confident and wrong.
    All figures of error are None without any estimate.
    """

    epochs: int
    share_known: float
    first_known_s: float | None
    horizontal: ErrorStatistics | None
    spatial: ErrorStatistics | None
    anees: float | None
    anees_expected: int
    covered_95: float | None
    beyond_three_bounds: float | None


def series_of(times_s: FloatArray, truth_enu_m: FloatArray, answers: Sequence[Estimate | None]) -> EstimateSeries:
    """Return the series of an estimator's answers at `times_s` (T,), beside the truth (T, 3)."""
    estimates = np.full((len(times_s), 3), np.nan)
    covariances = np.full((len(times_s), 3, 3), np.nan)
    for i, answer in enumerate(answers):
        if answer is not None:
            estimates[i] = answer.position_enu_m
            covariances[i] = answer.covariance[:3, :3]
    return EstimateSeries(times_s, truth_enu_m, estimates, covariances)


def normalised_squares(error_m: FloatArray, covariance_m2: FloatArray) -> FloatArray:
    """Return e' P^-1 e (T,) of errors (T, d) and covariances (T, d, d)."""
    solved = np.linalg.solve(covariance_m2, error_m[:, :, np.newaxis])[:, :, 0]
    return np.asarray((error_m * solved).sum(axis=1))


def error_statistics(error_m: FloatArray) -> ErrorStatistics:
    """Return the statistics of errors (T, d), T > 0, by their length."""
    length = np.linalg.norm(error_m, axis=1)
    return ErrorStatistics(
        rmse_m=math.sqrt(float(np.mean(length**2))),
        median_m=float(np.median(length)),
        p95_m=float(np.percentile(length, 95.0)),
        max_m=float(length.max()),
    )


def score(series: EstimateSeries, since_s: float, dims: int) -> VehicleScore:
    """Return the score of one denied vehicle that became one at `since_s`.

    With `dims` 2 the height is left out of ANEES.

    Where the truth is NaN there is no error.
    """
    known = series.known()
    epochs = len(known)
    if not known.any():
        return VehicleScore(epochs, 0.0, None, None, None, None, dims, None, None)
    first_s = float(series.times_s[known][0] - since_s)
    if np.isnan(series.truth_enu_m).all():
        return VehicleScore(epochs, float(known.mean()), first_s, None, None, None, dims, None, None)
    error = (series.estimate_enu_m - series.truth_enu_m)[known]
    covariance = series.covariance_m2[known]
    squares = normalised_squares(error[:, :dims], covariance[:, :dims, :dims])
    bounds = np.array([horizontal_bound_95_m(P) for P in covariance])
    horizontal_m = np.linalg.norm(error[:, :2], axis=1)
    return VehicleScore(
        epochs=epochs,
        share_known=float(known.mean()),
        first_known_s=first_s,
        horizontal=error_statistics(error[:, :2]),
        spatial=error_statistics(error),
        anees=float(squares.mean()),
        anees_expected=dims,
        covered_95=float((horizontal_m <= bounds).mean()),
        beyond_three_bounds=float((horizontal_m > 3.0 * bounds).mean()),
    )
