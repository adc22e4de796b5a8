"""The posterior Cramer-Rao bound of a vehicle's state along its flight.

No unbiased estimator can have a smaller error covariance.

The bound is the information recursion of Tichavsky et al. (1998) for a constant-velocity vehicle with white acceleration, its
measurement Jacobians taken at the true positions: J' = (F J^-1 F' + Q)^-1 + sum of h' h / r. With Jacobians that do not depend on
the estimate it is the Riccati recursion of the filter that knows the truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gcs_coloc.core.errors import DataError, UsageError
from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.estimators.qu_zhang.cv_filter import transition, white_acceleration_noise
from gcs_coloc.runtime.files import new_figure, save_figure
from sitl_fakes.faults import GpsLost
from sitl_fakes.fleet import Fleet
from sitl_fakes.scenario import Scenario, ScenarioError, load_scenario


@dataclass(frozen=True, slots=True)
class BoundOptions:
    """What is known of a flight's denied vehicle. Raises UsageError for values without a bound.

    Attributes:
        range_sigma_m: white noise of each range.
        peer_sigma_m: of each peer's position, per axis, new in every range.
        density_m2ps3: spectral density of the denied vehicle's acceleration: how much it is left to itself between ranges.
        start_sigma_m: of the denied vehicle's position at the start, per axis.
        start_speed_sigma_mps: of its velocity at the start, per axis.

    """

    range_sigma_m: float = 20.0
    peer_sigma_m: float = 4.0
    density_m2ps3: float = 1.0
    start_sigma_m: float = 15.0
    start_speed_sigma_mps: float = 1.0

    def __post_init__(self) -> None:
        positive = (self.range_sigma_m, self.start_sigma_m, self.start_speed_sigma_mps)
        if min(positive) <= 0.0 or self.peer_sigma_m < 0.0 or self.density_m2ps3 < 0.0:
            raise UsageError("a bound needs sigmas above 0, and a peer sigma and an acceleration density not below 0")


@dataclass(frozen=True, slots=True)
class Bound:
    """The bound at each time.

    `covariance` (T, 2 d, 2 d) is that of [x, vx, y, vy, ...] in d dimensions, in m and m/s.
    """

    times_s: FloatArray
    covariance: FloatArray

    @property
    def horizontal_sigma_m(self) -> FloatArray:
        """Root of the summed variances of east and north, shape (T,), m: the least RMSE at each time."""
        return np.asarray(np.sqrt(self.covariance[:, 0, 0] + self.covariance[:, 2, 2]))

    def horizontal_rmse_m(self) -> float:
        """Return the least horizontal RMSE over the flight, m."""
        return float(np.sqrt(np.mean(self.horizontal_sigma_m**2)))


def run_bound(times_s: FloatArray, positions_m: FloatArray, denied_vehicle: int, options: BoundOptions) -> Bound:
    """Return the bound on one vehicle's state from its ranges to all others at every time.

    Args:
        times_s: shape (T,), ascending.
        positions_m: shape (V, T, d), true positions of V vehicles in d = 2 or 3 dimensions.
        denied_vehicle: index of the vehicle to be located.
        options: noises.

    """
    axes = positions_m.shape[-1]
    offsets = positions_m[denied_vehicle] - np.delete(positions_m, denied_vehicle, axis=0)
    with np.errstate(invalid="ignore"):
        units = offsets / np.linalg.norm(offsets, axis=-1, keepdims=True)
    # A peer at the very place of the denied vehicle has no direction to tell.
    H = np.zeros((*units.shape[:-1], 2 * axes))
    H[..., ::2] = np.nan_to_num(units)
    variance = options.range_sigma_m**2 + options.peer_sigma_m**2
    information = np.einsum("vti,vtj->tij", H, H) / variance
    P = np.diag([options.start_sigma_m**2, options.start_speed_sigma_mps**2] * axes)
    covariances = np.empty((len(times_s), 2 * axes, 2 * axes))
    before_s = times_s[0]
    for k, time_s in enumerate(times_s):
        F = transition(time_s - before_s, axes)
        P = F @ P @ F.T + white_acceleration_noise(time_s - before_s, options.density_m2ps3, axes)
        if k > 0:
            P = np.linalg.inv(np.linalg.inv(P) + information[k])
            P = 0.5 * (P + P.T)
        covariances[k] = P
        before_s = time_s
    return Bound(times_s, covariances)


def run_scenario_bound(path: str, seed: int, options: BoundOptions) -> dict[int, Bound]:
    """Return the bound of each vehicle that loses its GPS, by system id.

    A bound goes from the loss to the end of the scenario. Rate and noise of the ranges and the GPS noise at the start are the
    scenario's; the rest is in `options`. The other vehicles that lose their GPS are taken as known, so that the bound holds, if
    not tightly, for them too.

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


def plot_bounds(bounds: dict[int, Bound], path: Path) -> None:
    """Draw the least RMSE of each vehicle over time.

    Raises:
        UsageError: matplotlib is not installed, or the file cannot be written.
    """
    figure = new_figure((9.0, 4.5))
    axes = figure.add_subplot()
    for sysid, bound in bounds.items():
        axes.plot(bound.times_s, bound.horizontal_sigma_m, label=f"vehicle {sysid}")
    axes.set(xlabel="time, s", ylabel="least horizontal RMSE, m", title="Posterior Cramer-Rao bound")
    axes.grid(alpha=0.3)
    axes.legend()
    save_figure(figure, path)


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
