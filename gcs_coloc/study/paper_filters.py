"""The paper's synchronous processing of one flight, by all filters at once.

It runs for many draws of noise, values of q and kinds of filter.

The formulas are those of `gcs_coloc.estimators`: arrays here have leading axes for q (Q) and draw (S), and for UAV4's filter one
more for the kind (K). UAV1-3 are peers 0-2, UAV4 is the denied vehicle. Everything is measured at every step by all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.estimators.qu_zhang.cv_filter import density, position_rows, step_noise, transition, white_acceleration_noise
from gcs_coloc.estimators.qu_zhang.trilateration import corrected_covariance, published_covariance, trilaterate
from gcs_coloc.study.paper_options import PaperOptions, QForm, QUnit

KINDS = ("general", "published", "published_with_range_noise", "corrected")
"""UAV4's filters: one constant R; the paper's R to the letter; the same with the range noise in s_i^2; the first-order
covariance of the fix itself."""

_POSITIONS = [0, 2]


@dataclass(frozen=True, slots=True)
class Draw:
    """What the four UAVs measure on one flight.

    `gps_m` (4, T, 2), ranges of UAV4 `ranges_m` (3, T), first velocities `start_velocity_mps` (4, 2).
    """

    gps_m: FloatArray
    ranges_m: FloatArray
    start_velocity_mps: FloatArray


@dataclass(frozen=True, slots=True)
class FilterStep:
    """What UAV4's filters know after one step.

    Fixes (Q, S, 2) in m, states (K, Q, S, 4), covariances (K, Q, S, 4, 4), and the published R (Q, S, 2, 2) in m^2.
    """

    fix_m: FloatArray
    state: FloatArray
    covariance: FloatArray
    published_r: FloatArray


def draw(positions_m: FloatArray, velocities_mps: FloatArray, seed: int, options: PaperOptions) -> Draw:
    """Return one draw of noise on a flight: positions (4, T, 2) m and velocities (4, T, 2) m/s of UAV1-4."""
    rng = np.random.default_rng(seed)
    ranges = np.linalg.norm(positions_m[3] - positions_m[:3], axis=-1)
    return Draw(
        gps_m=positions_m + rng.normal(0.0, options.gps_sigma_m, positions_m.shape),
        ranges_m=ranges + rng.normal(0.0, options.range_sigma_m, ranges.shape),
        start_velocity_mps=velocities_mps[:, 0] + rng.normal(0.0, options.start_speed_sigma_mps, (4, 2)),
    )


def predict(state: FloatArray, covariance: FloatArray, F: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return state (..., 4) and covariance (..., 4, 4) a step F (4, 4) with noise Q (..., 4, 4) later."""
    return state @ F.T, F @ covariance @ F.T + Q


def update(state: FloatArray, covariance: FloatArray, z: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return state (..., 4) and covariance (..., 4, 4) after an observed position.

    The position is z (..., 2), its covariance R (..., 2, 2). Joseph form. An observation that is not finite (peers exactly in one
    line) is left out.
    """
    finite = np.asarray(np.isfinite(z).all(axis=-1) & np.isfinite(R).all(axis=(-2, -1)))
    z = np.where(finite[..., np.newaxis], z, 0.0)
    R = np.where(finite[..., np.newaxis, np.newaxis], R, np.eye(2))
    H = position_rows(2)
    K = covariance[..., :, _POSITIONS] @ _inverse_2x2(covariance[..., _POSITIONS, :][..., _POSITIONS] + R)
    K = np.where(finite[..., np.newaxis, np.newaxis], K, 0.0)
    state = state + (K @ (z - state[..., _POSITIONS])[..., np.newaxis])[..., 0]
    keep = np.eye(4) - K @ H
    covariance = keep @ covariance @ np.swapaxes(keep, -1, -2) + K @ R @ np.swapaxes(K, -1, -2)
    return state, 0.5 * (covariance + np.swapaxes(covariance, -1, -2))


class PaperFilters:
    """The filters of all four UAVs, for all q and draws; `step` takes them through the flight.

    Args:
        draws: S draws of noise on the same flight.
        constant_R: shape (Q, 2, 2), m^2, of the general filter.
        options: the reading of the paper.

    """

    def __init__(self, draws: list[Draw], constant_R: FloatArray, options: PaperOptions) -> None:
        self._options = options
        q_count, draw_count = len(options.qs), len(draws)
        self._gps = np.stack([one.gps_m for one in draws])
        self._ranges = np.stack([one.ranges_m for one in draws])
        start = np.empty((draw_count, 4, 4))
        start[..., _POSITIONS] = self._gps[:, :, 0]
        start[..., [1, 3]] = np.stack([one.start_velocity_mps for one in draws])
        variances = np.array([options.gps_sigma_m**2, options.start_speed_sigma_mps**2] * 2)
        self._F = transition(options.step_s, 2)
        self._Q = np.stack([process_noise(q, options) for q in options.qs])
        # The peers' covariances do not depend on their measurements: one for each q.
        self._peers = np.broadcast_to(start[:, :3], (q_count, draw_count, 3, 4)).copy()
        self._peer_P = np.broadcast_to(np.diag(variances), (q_count, 4, 4)).copy()
        shape = (len(KINDS), q_count, draw_count)
        self._state = np.broadcast_to(start[:, 3], (*shape, 4)).copy()
        self._P = np.broadcast_to(np.diag(variances), (*shape, 4, 4)).copy()
        self._constant_R = constant_R

    def step(self, k: int) -> FilterStep:
        """Take all filters from step k - 1 to step k >= 1 and return what UAV4's make of it."""
        options = self._options
        gps_R = options.gps_sigma_m**2 * np.eye(2)
        self._peers, self._peer_P = predict(self._peers, self._peer_P, self._F, self._Q)
        peer_P = np.broadcast_to(self._peer_P[:, np.newaxis, np.newaxis], (*self._peers.shape, 4))
        self._peers, updated = update(self._peers, peer_P[:, :1, :1], self._gps[:, :3, k], gps_R)
        self._peer_P = updated[:, 0, 0]
        self._state, self._P = predict(self._state, self._P, self._F, self._Q[:, np.newaxis])

        ranges = self._ranges[:, :, k]
        centres = self._peers[..., _POSITIONS]
        place_P = self._peer_P[:, _POSITIONS][:, :, _POSITIONS]
        fix = trilaterate(centres, np.broadcast_to(ranges**2, centres.shape[:-1]))
        R = self._fix_covariances(centres, place_P, ranges)
        self._state, self._P = update(self._state, self._P, np.broadcast_to(fix, (len(KINDS), *fix.shape)), R)
        return FilterStep(fix, self._state, self._P, R[1])

    def _fix_covariances(self, centres: FloatArray, place_P: FloatArray, ranges: FloatArray) -> FloatArray:
        """Return the covariance R (K, Q, S, 2, 2) of the fix for each filter, m^2.

        The peers are at (Q, S, 3, 2) with covariance (Q, 2, 2). Each filter takes R at its own predicted position.
        """
        sigma = self._options.range_sigma_m
        predicted = self._state[..., _POSITIONS]
        offsets = predicted[1:3, :, :, np.newaxis] - centres
        units = offsets / np.linalg.norm(offsets, axis=-1, keepdims=True)
        of_peers = np.einsum("kqsia,qab,kqsib->kqsi", units, place_P, units)
        range_covariance = 4.0 * sigma**2 * ranges[..., np.newaxis] ** 2 * np.eye(3)
        shape = (*centres.shape, 2)
        return np.stack(
            [
                np.broadcast_to(self._constant_R[:, np.newaxis], (*centres.shape[:2], 2, 2)),
                published_covariance(centres, predicted[1], of_peers[0]),
                published_covariance(centres, predicted[2], of_peers[1] + sigma**2),
                corrected_covariance(
                    centres, predicted[3], range_covariance, np.broadcast_to(place_P[:, np.newaxis, np.newaxis], shape)
                ),
            ]
        )


def process_noise(q: float, options: PaperOptions) -> FloatArray:
    """Return Q (4, 4) of one step under the reading of q that the options choose."""
    per_second = q if options.q_unit is QUnit.DENSITY else density(q, options.step_s)
    if options.q_form is QForm.ACCELERATION:
        return white_acceleration_noise(options.step_s, per_second, 2)
    return step_noise(per_second * options.step_s, 2)


def _inverse_2x2(matrix: FloatArray) -> FloatArray:
    a, b, c, d = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 0], matrix[..., 1, 1]
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2)
    return np.asarray(adjugate / (a * d - b * c)[..., np.newaxis, np.newaxis])
