"""The posterior Cramer-Rao bound of a scenario of the simulated aircraft, along the way that they truly fly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gcs_coloc.core.errors import DataError, UsageError
from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.study.bound import Bound, BoundOptions, run_bound
from sitl_fakes.errors import ScenarioError
from sitl_fakes.faults import GpsLost
from sitl_fakes.fleet import Fleet
from sitl_fakes.scenario import Scenario, load_scenario


def run(path: str, seed: int, options: BoundOptions) -> dict[int, Bound]:
    """The bound of each vehicle that loses its GPS, by system id, from the loss to the end of the scenario.

    Rate and noise of the ranges and the GPS noise at the start are the scenario's; the rest is in `options`. The other
    vehicles that lose their GPS are taken as known, so that the bound holds, if not tightly, for them too.

    Raises:
        DataError: the scenario cannot be read, or nobody loses its GPS in it.
    """
    try:
        scenario = load_scenario(path)
    except ScenarioError as error:
        raise DataError(str(error)) from None
    losses = {fault.vehicle: fault.at_s for fault in scenario.fault if isinstance(fault, GpsLost)}
    if not losses:
        raise DataError(f"{path}: nobody loses its GPS in this scenario; add a [[fault]] of the kind gps_lost")
    times_s, positions_m, sysids = _flown(scenario, seed)
    noises = replace(options, range_sigma_m=scenario.ranging.sigma_m, start_sigma_m=scenario.gps.sigma_h_m)
    bounds = {}
    for sysid, lost_s in losses.items():
        part = times_s >= lost_s
        bounds[sysid] = run_bound(times_s[part], positions_m[:, part], sysids.index(sysid), noises)
    return bounds


def plot(bounds: dict[int, Bound], path: Path) -> None:
    """Draw the least RMSE of each vehicle over time.

    Raises:
        UsageError: matplotlib is not installed, or the file cannot be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError('drawing needs matplotlib: pip install "gcs-coloc[plots]"') from error
    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for sysid, bound in bounds.items():
        axes.plot(bound.times_s, bound.horizontal_sigma_m, label=f"vehicle {sysid}")
    axes.set(xlabel="time, s", ylabel="least horizontal RMSE, m", title="Posterior Cramer-Rao bound")
    axes.grid(alpha=0.3)
    axes.legend()
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: cannot be written: {error}") from error


def _flown(scenario: Scenario, seed: int) -> tuple[FloatArray, FloatArray, list[int]]:
    fleet = Fleet(scenario, seed)
    step_s = 1.0 / scenario.ranging.rate_hz
    times, rows = [], []
    for step in range(round(scenario.duration_s / step_s) + 1):
        fleet.advance(step * step_s)
        truth = fleet.truth()
        times.append(step * step_s)
        rows.append([(t.east_m, t.north_m, t.up_m) for t in truth.values()])
    return np.array(times), np.array(rows).transpose(1, 0, 2), fleet.sysids
