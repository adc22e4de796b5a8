"""Takes an estimator through a recording, asks it on the way, and scores it; many draws on all cores."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.stats import chi2

from bench.accuracy_flights import Case, Recording, record
from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import Estimate, FloatArray, Measurement, NoEstimate
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.runtime.pool import Result, Task
from gcs_coloc.runtime.tasks import Workers, run_tasks


class Locator(Protocol):
    """The part of the estimators' protocol that a bench needs; the peers meet it too."""

    def set_denied(self, denied: Sequence[int], at_s: float) -> None:
        """State which vehicles are to be located."""
        ...

    def add(self, measurement: Measurement) -> None:
        """Take one measurement."""
        ...

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """Answer where a vehicle is."""
        ...


@dataclass(frozen=True, slots=True)
class Track:
    """One vehicle of one run: errors (T, 2) m, normalised squares (T,) and 95 % bounds (T,) m, NaN where nothing was stated."""

    asked_s: FloatArray
    error_m: FloatArray
    nees: FloatArray
    bound_m: FloatArray


@dataclass(frozen=True, slots=True)
class Run:
    """One run: a track for each denied vehicle, and the CPU time for each measurement, questions included, us."""

    tracks: dict[int, Track]
    cpu_us: float


def run_estimator(recording: Recording, estimator: Locator) -> Run:
    """Run an estimator over a recording."""
    denied = sorted(recording.truth_m)
    answers: dict[int, list[Estimate | NoEstimate]] = {v: [] for v in denied}
    asked = recording.asked_s.tolist()
    next_asked = 0
    began_s = time.process_time()
    for m in recording.start:
        estimator.add(m)
    estimator.set_denied(denied, recording.lost_at_s)
    for m in recording.measurements:
        while next_asked < len(asked) and asked[next_asked] < m.arrived_at_s:
            for v in denied:
                answers[v].append(estimator.estimate(v, asked[next_asked] - recording.lag_s))
            next_asked += 1
        estimator.add(m)
    for t in asked[next_asked:]:
        for v in denied:
            answers[v].append(estimator.estimate(v, t - recording.lag_s))
    cpu_s = time.process_time() - began_s
    tracks = {v: _track(recording.asked_s, recording.truth_m[v], answers[v]) for v in denied}
    return Run(tracks, cpu_s / (len(recording.start) + len(recording.measurements)) * 1e6)


def _track(asked_s: FloatArray, truth_m: FloatArray, answers: Sequence[Estimate | NoEstimate]) -> Track:
    error = np.full((len(answers), 2), np.nan)
    nees, bound = np.full(len(answers), np.nan), np.full(len(answers), np.nan)
    for i, answer in enumerate(answers):
        if isinstance(answer, Estimate):
            error[i] = answer.position_enu_m[:2] - truth_m[i]
            nees[i] = error[i] @ np.linalg.solve(answer.covariance[:2, :2], error[i])
            bound[i] = horizontal_bound_95_m(answer.covariance)
    return Track(asked_s, error, nees, bound)


def fleet_through(task: tuple[Case, int]) -> Run:
    """Run the fleet filter with its default settings through one draw (case, seed)."""
    case, seed = task
    return run_estimator(record(case, seed), load_estimator("fleet", {}))


def on_all_cores(what: str, function: Callable[[Task], Result], tasks: Sequence[Task]) -> list[Result]:
    """Run the tasks on all cores and tell on a terminal how far it is."""

    def progress(done: int, of: int) -> None:
        if sys.stderr.isatty():
            print(f"\r{what}: {done} of {of}", end="\n" if done == of else "", file=sys.stderr, flush=True)

    return run_tasks(function, tasks, Workers(os.cpu_count() or 1), progress)


def rmse_m(tracks: Sequence[Track], until_s: float = math.inf) -> float:
    """Return the root mean square error over all runs and stated epochs up to a time, m."""
    squares = [np.sum(t.error_m[t.asked_s <= until_s] ** 2, axis=1) for t in tracks]
    return float(np.sqrt(np.nanmean(np.concatenate(squares))))


def relative_error_of_mse(tracks: Sequence[Track]) -> float:
    """Return the standard error of the mean square error over independent runs, as a share of it."""
    means = [float(np.nanmean(np.sum(t.error_m**2, axis=1))) for t in tracks]
    return float(np.std(means, ddof=1) / math.sqrt(len(means)) / np.mean(means))


def anees(tracks: Sequence[Track]) -> float:
    """Return the mean normalised square of the horizontal error over all runs and stated epochs; 2 where it is honest."""
    return float(np.nanmean(np.concatenate([t.nees for t in tracks])))


def band_95(runs: int, dof: int = 2) -> tuple[float, float]:
    """Return the 95 % chi-square band of the mean of normalised squares over independent runs at one epoch."""
    return float(chi2.ppf(0.025, dof * runs)) / runs, float(chi2.ppf(0.975, dof * runs)) / runs


def unknown_share(tracks: Sequence[Track]) -> float:
    """Return the share of epochs at which no position was stated."""
    return float(np.mean(np.isnan(np.concatenate([t.nees for t in tracks]))))


def beyond_6_sigma(tracks: Sequence[Track]) -> float:
    """Return the share of stated epochs with an error beyond 6 sigma: confident and wrong."""
    nees = np.concatenate([t.nees for t in tracks])
    return float(np.mean(nees[~np.isnan(nees)] > 36.0))
