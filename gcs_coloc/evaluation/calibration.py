"""Calibration of ranging devices: bias and scale of each, from ranges between known positions.

Model: a range of devices i and j is (1 + s_i + s_j) d + b_i + b_j with the distance d. Only sums of two devices are ever seen:
what the data do not tell apart is shared by a prior that all biases and scales are small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from gcs_coloc.core.errors import DataError
from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.evaluation.data_checks.range_checks import RangePair, range_pairs
from gcs_coloc.evaluation.data_checks.recorded_data import RecordedData

_BIAS_PRIOR_M = 1.0
"""Chosen: antenna delays of ultra-wideband radios before calibration are some decimetres, of others a metre."""
_SCALE_PRIOR = 0.003
"""Chosen: crystals are good to 1e-5; what is beyond is a firmware's fit, and at room scale hardly told apart from a bias."""
_HUBER_SIGMAS = 2.0  # chosen: outliers beyond count as 2 sigmas; Gaussian errors lose little
_ROUNDS = 20
"""Rounds of reweighting; chosen: the weights of 20 % outliers settle within ten."""


@dataclass(frozen=True, slots=True)
class DeviceCalibration:
    """Bias (m) and scale error of one device with their 1-sigma; `ranges` were used for them."""

    vehicle: int
    bias_m: float
    bias_sigma_m: float
    scale: float
    scale_sigma: float
    ranges: int


@dataclass(frozen=True, slots=True)
class PairResidual:
    """Mean residual (range minus distance) of one pair before and after calibration, m.

    With what is left around it (rms), m.
    """

    ends: tuple[int, int]
    ranges: int
    before_m: float
    after_m: float
    rms_m: float


@dataclass(frozen=True, slots=True)
class Calibration:
    """The devices that were calibrated, and the pairs behind them."""

    devices: tuple[DeviceCalibration, ...]
    pairs: tuple[PairResidual, ...]


def calibrate(data: RecordedData) -> Calibration:
    """Estimate bias and scale of every device.

    The truth stands in for a vehicle's reports where it is given.

    Raises:
        DataError: no two devices have twenty ranges at times at which both positions are known.
    """
    moving_without_truth = {v: track for v, track in data.reports.items() if track.is_static or v not in data.truth}
    pairs = list(range_pairs(replace(data, reports=moving_without_truth), trust_truth=True))
    if not pairs:
        raise DataError("no pair has 20 ranges at times at which the positions of both ends are known: nothing to calibrate with")
    vehicles = sorted({vehicle for pair in pairs for vehicle in pair.ends})
    H, residuals, variances, owners = _rows(pairs, vehicles)
    prior = np.array([1.0 / _BIAS_PRIOR_M**2, 1.0 / _SCALE_PRIOR**2] * len(vehicles))
    weights: FloatArray = 1.0 / variances
    state: FloatArray = np.zeros(2 * len(vehicles))
    for _ in range(_ROUNDS):
        information = (H * weights[:, np.newaxis]).T @ H + np.diag(prior)
        state = np.asarray(np.linalg.solve(information, H.T @ (weights * residuals)), dtype=np.float64)
        # The scatter counts, not the stated sigma: the weights must tell outliers from a sigma that is too small.
        left = np.abs(residuals - H @ state)
        scatter = np.array([max(1.4826 * float(np.median(left[owners == k])), 1e-3) for k in range(len(pairs))])[owners]
        weights = np.asarray(np.minimum(1.0, _HUBER_SIGMAS * scatter / np.maximum(left, 1e-9)) / variances)
    sigmas = np.sqrt(np.diag(np.linalg.inv(information)))
    counts = {v: sum(len(pair.rows) for pair in pairs if v in pair.ends) for v in vehicles}
    devices = tuple(
        DeviceCalibration(
            v, float(state[2 * i]), float(sigmas[2 * i]), float(state[2 * i + 1]), float(sigmas[2 * i + 1]), counts[v]
        )
        for i, v in enumerate(vehicles)
    )
    after = residuals - H @ state
    return Calibration(devices, tuple(_pair_residual(k, pair, residuals, after, owners) for k, pair in enumerate(pairs)))


def _rows(pairs: Sequence[RangePair], vehicles: Sequence[int]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the Jacobian (N, 2 V), residuals (N,), variances (N,) and the number of each row's pair (N,)."""
    parts, residuals, variances, owners = [], [], [], []
    for k, pair in enumerate(pairs):
        distances = pair.distances_m()
        known = np.isfinite(distances)
        distances, count = distances[known], int(known.sum())
        H = np.zeros((count, 2 * len(vehicles)))
        for vehicle in pair.ends:
            place = 2 * vehicles.index(vehicle)
            H[:, place], H[:, place + 1] = 1.0, distances
        parts.append(H)
        residuals.append(pair.rows[known, 3] - distances)
        # Errors of reported positions last: they do not average out over the ranges of a pair.
        variances.append(pair.rows[known, 4] ** 2 + count * pair.position_variance_m2())
        owners.append(np.full(count, k))
    return np.concatenate(parts), np.concatenate(residuals), np.concatenate(variances), np.concatenate(owners)


def _pair_residual(k: int, pair: RangePair, before: FloatArray, after: FloatArray, owners: FloatArray) -> PairResidual:
    mine = owners == k
    left = after[mine]
    rms_m = sqrt(float(np.mean((left - left.mean()) ** 2)))
    return PairResidual(pair.ends, int(mine.sum()), float(np.median(before[mine])), float(np.median(left)), rms_m)
