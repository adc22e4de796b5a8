"""E1: flights drawn from the fleet filter's own model with its default settings, and the bound that no filter beats there.

The vehicles start where those of the paper's Table 1 start. Truth, slow errors and noise follow the model exactly, which is
what makes 1.0 the limit of MSE / bound: what is above it is the price of linearising and of what the filter has to find out
itself (how white each stream is, and that nobody manoeuvres).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bench.accuracy_flights import GPS_SIGMA_M, RANGE_SIGMA_M, Recording
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    FloatArray,
    Measurement,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.estimators.fleet.settings import FleetSettings
from sitl_fakes.guidance import PAPER_ROUTES

_SPEED_MPS = 50.0
_HEIGHT_SIGMA_M = 1.0
# A filter for a vehicle begins with its reports of the last seconds, 64 at most, without a velocity.
_RECENT_S = 3.0
_RECENT_MOST = 63
_UNKNOWN_VELOCITY_MPS = 30.0
_DENIED = 3
# One vehicle's states that the horizontal position depends on: position, velocity, report error (2 each), stamp error, turn.
_STAMP, _TURN = 6, 7
_BLOCK = 8
_PAIRS = 3


@dataclass(frozen=True, slots=True)
class ModelCase:
    """The denied vehicle has GPS for `healthy_s`; its error counts from `settled_s` to `duration_s` after the loss."""

    rate_hz: float
    healthy_s: float
    settled_s: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class ModelDraws:
    """M draws of K epochs; epoch k is at `times_s[k]`, the loss at time 0.

    `places_m` (M, K, 4, 3) truth, `reports_m` (M, K, 4, 3), `heights_m` (M, K), `ranges_m` (M, K, 3). The bounds (K,) are of the
    trace of the vehicle's horizontal covariance, NaN before they are asked for. `posterior_m2` is the posterior Cramer-Rao bound:
    the information is averaged over the draws, which a filter that meets one draw at a time cannot reach when the draws
    part. `along_m2` is the mean of the bounds along each drawn way.
    """

    case: ModelCase
    times_s: FloatArray
    places_m: FloatArray
    reports_m: FloatArray
    heights_m: FloatArray
    ranges_m: FloatArray
    posterior_m2: FloatArray
    along_m2: FloatArray


class _Slow:
    """First-order Gauss-Markov errors of one sigma; starts from its stationary spread."""

    def __init__(self, shape: tuple[int, ...], sigma: float, time_s: float, step_s: float, rng: np.random.Generator) -> None:
        self.decay = math.exp(-step_s / time_s)
        self.noise = sigma * math.sqrt(1.0 - self.decay**2)
        self._rng = rng
        self.value = rng.normal(0.0, sigma, shape)

    def step(self) -> None:
        self.value = self.value * self.decay + self._rng.normal(0.0, self.noise, self.value.shape)


def draw(case: ModelCase, runs: int, seed: int) -> ModelDraws:
    """Return draws of the case and their bound: Tichavsky's information recursion, its expectations taken over the draws."""
    s, rng = FleetSettings(), np.random.default_rng(seed)
    step_s = 1.0 / case.rate_hz
    epochs = np.arange(-round(case.healthy_s * case.rate_hz), round(case.duration_s * case.rate_hz) + 1)
    times = np.asarray(epochs * step_s, dtype=np.float64)
    slow_share = s.least_coloured_share
    error = _Slow((runs, 4, 2), slow_share * GPS_SIGMA_M, s.report_error_time_s, step_s, rng)
    height_error = _Slow((runs, 4), slow_share * _HEIGHT_SIGMA_M, s.report_error_time_s, step_s, rng)
    baro_error = _Slow((runs,), slow_share * _HEIGHT_SIGMA_M, s.baro_error_time_s, step_s, rng)
    stamp = _Slow((runs, 4), s.time_stamp_offset_sigma_s, s.time_stamp_offset_time_s, step_s, rng)
    turn = _Slow((runs, 4), s.turn_sigma_radps, s.turn_time_s, step_s, rng)
    bias = _Slow((runs, _PAIRS), s.range_bias_sigma_m, s.range_bias_time_s, step_s, rng)
    range_slow_m = s.range_coloured_share * slow_share * RANGE_SIGMA_M
    lasting = _Slow((runs, _PAIRS), range_slow_m, s.range_coloured_time_s, step_s, rng)
    slowness = 1.0 / (1.0 + (_SPEED_MPS / s.low_speed_mps) ** 2)
    density = s.acceleration_density_m2ps3 + slowness * (s.low_speed_density_m2ps3 - s.acceleration_density_m2ps3)
    way = np.linalg.cholesky(np.array([[step_s**3 / 3.0, step_s**2 / 2.0], [step_s**2 / 2.0, step_s]]))
    scale = np.sqrt([density, density, s.climb_density_m2ps3])
    p, v = _at_the_start(runs)
    bounds = [_Bound(case, density, range_slow_m, s, groups) for groups in (1, runs)]
    places, reports = (np.empty((runs, len(times), 4, 3)) for _ in range(2))
    heights, ranges = np.empty((runs, len(times))), np.empty((runs, len(times), _PAIRS))
    traces_m2 = np.full((2, len(times)), np.nan)
    for k, t in enumerate(times):
        if k > 0:
            moved = _move(v, turn.value, step_s, s.turn_time_s)
            for bound in bounds:
                bound.predict(moved, t)
            noise = np.einsum("ij,mvaj->mvai", way, rng.normal(size=(runs, 4, 3, 2))) * scale[:, np.newaxis]
            p = p + moved.way + noise[..., 0]
            v = moved.velocity + noise[..., 1]
            for slow in (error, height_error, baro_error, stamp, turn, bias, lasting):
                slow.step()
        places[:, k] = p
        white = rng.normal(size=(runs, 4, 3)) * (GPS_SIGMA_M, GPS_SIGMA_M, _HEIGHT_SIGMA_M)
        reports[:, k] = p + white + stamp.value[..., np.newaxis] * v
        reports[:, k, :, :2] += error.value
        reports[:, k, :, 2] += height_error.value
        heights[:, k] = p[:, _DENIED, 2] + baro_error.value + rng.normal(0.0, _HEIGHT_SIGMA_M, runs)
        away = p[:, _DENIED, np.newaxis] - p[:, :_PAIRS]
        distance = np.linalg.norm(away, axis=-1)
        unit = away / distance[..., np.newaxis]
        closing = np.einsum("mpa,mpa->mp", unit, v[:, _DENIED, np.newaxis] - v[:, :_PAIRS])
        sigma = np.sqrt(RANGE_SIGMA_M**2 + (closing * s.time_stamp_offset_sigma_s) ** 2)
        ranges[:, k] = distance + bias.value + lasting.value + sigma * rng.normal(size=(runs, _PAIRS))
        for i, bound in enumerate(bounds):
            bound.update(unit[..., :2], sigma, v[..., :2], t)
            if t >= case.settled_s:
                traces_m2[i, k] = bound.trace_m2()
    return ModelDraws(case, times, places, reports, heights, ranges, traces_m2[0], traces_m2[1])


def recording(draws: ModelDraws, run: int) -> Recording:
    """Return one draw as measurements; questions come right after the measurements of an epoch."""
    case = draws.case
    start: list[Measurement] = []
    rest: list[Measurement] = []
    every = max(1, round(0.1 * case.rate_hz))
    for k, t in enumerate(draws.times_s.tolist()):
        healthy = range(4) if t <= 0.0 else range(_PAIRS)
        into = start if t <= 0.0 else rest
        for vehicle in healthy:
            e, n, u = draws.reports_m[run, k, vehicle].tolist()
            into.append(PositionMeasurement(vehicle + 1, t, t, (e, n, u), GPS_SIGMA_M, _HEIGHT_SIGMA_M))
        if t <= 0.0:
            continue
        if k % every == 0:
            rest.append(AltitudeMeasurement(_DENIED + 1, t, t, float(draws.heights_m[run, k]), _HEIGHT_SIGMA_M))
        rest.extend(
            RangeMeasurement(_DENIED + 1, peer + 1, t, t, range_m, RANGE_SIGMA_M)
            for peer, range_m in enumerate(draws.ranges_m[run, k].tolist())
        )
    scored = np.flatnonzero(draws.times_s >= case.settled_s)
    return Recording(
        start=tuple(start),
        measurements=tuple(rest),
        lost_at_s=0.0,
        asked_s=draws.times_s[scored],
        lag_s=0.0,
        truth_m={_DENIED + 1: draws.places_m[run, scored, _DENIED, :2]},
    )


def bounds_rms_m(draws: ModelDraws) -> tuple[float, float]:
    """Return the roots of the means over the scored epochs, m, of the posterior bound and of that along each flight."""
    return math.sqrt(float(np.nanmean(draws.posterior_m2))), math.sqrt(float(np.nanmean(draws.along_m2)))


def _at_the_start(runs: int) -> tuple[FloatArray, FloatArray]:
    p, v = np.zeros((runs, 4, 3)), np.zeros((runs, 4, 3))
    for i, route in enumerate(PAPER_ROUTES):
        leg = np.subtract(route[1], route[0])
        p[:, i, :2] = route[0]
        v[:, i, :2] = _SPEED_MPS * leg / np.linalg.norm(leg)
    return p, v


@dataclass(frozen=True, slots=True)
class _Moved:
    """A step of the mean: way (M, 4, 3), velocity after it (M, 4, 3), and the Jacobians' (M, 4) entries."""

    way: FloatArray
    velocity: FloatArray
    along_s: FloatArray
    across_s: FloatArray
    cos: FloatArray
    sin: FloatArray
    lasting_s: float


def _move(v: FloatArray, turn: FloatArray, step_s: float, turn_time_s: float) -> _Moved:
    lasting_s = -turn_time_s * math.expm1(-step_s / turn_time_s)
    angle = turn * lasting_s
    # sin(a) / w and (1 - cos(a)) / w, also where the turn is nil.
    along = step_s * np.sinc(angle / np.pi)
    across = 0.5 * step_s * angle * np.sinc(0.5 * angle / np.pi) ** 2
    c, s = np.cos(angle), np.sin(angle)
    ve, vn = v[..., 0], v[..., 1]
    after = np.stack([c * ve + s * vn, -s * ve + c * vn, v[..., 2]], axis=-1)
    way = np.stack([along * ve + across * vn, -across * ve + along * vn, step_s * v[..., 2]], axis=-1)
    return _Moved(way, after, along, across, c, s, lasting_s)


class _Bound:
    """J' = D22 - D21 (J + D11)^-1 D12 over four vehicles' horizontal states and three pairs' range errors.

    J is (G, n, n): with one group the expectations are taken over all draws, with as many as draws each stands for itself.
    """

    def __init__(self, case: ModelCase, density: float, range_slow_m: float, s: FleetSettings, groups: int) -> None:
        self._groups = groups
        self._step_s = step_s = 1.0 / case.rate_hz
        self._begins_s = -min(_RECENT_S, _RECENT_MOST * step_s)
        slow = s.least_coloured_share * GPS_SIGMA_M
        sigmas = [slow, slow, s.time_stamp_offset_sigma_s, s.turn_sigma_radps]
        times = [s.report_error_time_s, s.report_error_time_s, s.time_stamp_offset_time_s, s.turn_time_s]
        self._decay = np.exp(-step_s / np.array(times))
        Q = np.zeros((_BLOCK, _BLOCK))
        for a in (0, 1):
            Q[a, a], Q[a + 2, a + 2] = density * step_s**3 / 3.0, density * step_s
            Q[a, a + 2] = Q[a + 2, a] = density * step_s**2 / 2.0
        Q[4:, 4:] = np.diag(np.square(sigmas) * (1.0 - self._decay**2))
        self._inverse_q = np.linalg.inv(Q)
        pair_sigmas = np.array([s.range_bias_sigma_m, range_slow_m])
        self._pair_decay = np.exp(-step_s / np.array([s.range_bias_time_s, s.range_coloured_time_s]))
        self._pair_inverse_q = np.diag(1.0 / (np.square(pair_sigmas) * (1.0 - self._pair_decay**2)))
        prior = np.array([GPS_SIGMA_M] * 2 + [_UNKNOWN_VELOCITY_MPS] * 2 + sigmas)
        J = np.diag(1.0 / np.concatenate([np.tile(prior, 4), np.tile(pair_sigmas, _PAIRS)]) ** 2)
        self._J = np.broadcast_to(J, (groups, *J.shape)).copy()

    def predict(self, moved: _Moved, to_s: float) -> None:
        """Take the information over a step to a time, with the Jacobians of the draws."""
        if to_s <= self._begins_s:
            return
        F = np.zeros((len(moved.cos), 4, _BLOCK, _BLOCK))
        F[..., 0, 0] = F[..., 1, 1] = 1.0
        F[..., 0, 2] = F[..., 1, 3] = moved.along_s
        F[..., 0, 3], F[..., 1, 2] = moved.across_s, -moved.across_s
        F[..., 2, 2] = F[..., 3, 3] = moved.cos
        F[..., 2, 3], F[..., 3, 2] = moved.sin, -moved.sin
        F[..., 2, _TURN] = moved.velocity[..., 1] * moved.lasting_s
        F[..., 3, _TURN] = -moved.velocity[..., 0] * moved.lasting_s
        F[..., 0:2, _TURN] = 0.5 * self._step_s * F[..., 2:4, _TURN]
        for i, decay in enumerate(self._decay.tolist(), start=4):
            F[..., i, i] = decay
        QF = self._inverse_q @ F
        inner, outer = self._mean(np.swapaxes(F, -1, -2) @ QF), self._mean(QF)
        D11, D21, D22 = (np.zeros_like(self._J) for _ in range(3))
        for i in range(4):
            where = slice(_BLOCK * i, _BLOCK * (i + 1))
            D11[:, where, where], D21[:, where, where] = inner[:, i], outer[:, i]
            D22[:, where, where] = self._inverse_q
        QD = self._pair_inverse_q * self._pair_decay
        for i in range(_PAIRS):
            where = slice(4 * _BLOCK + 2 * i, 4 * _BLOCK + 2 * i + 2)
            D11[:, where, where], D21[:, where, where] = QD * self._pair_decay, QD
            D22[:, where, where] = self._pair_inverse_q
        J = D22 - D21 @ np.linalg.solve(self._J + D11, np.swapaxes(D21, -1, -2))
        self._J = 0.5 * (J + np.swapaxes(J, -1, -2))

    def update(self, unit: FloatArray, range_sigma_m: FloatArray, v: FloatArray, at_s: float) -> None:
        """Add the information of an epoch's reports (of the denied vehicle too before the loss) and ranges (after it)."""
        if at_s <= self._begins_s:
            return
        runs = len(v)
        for i in range(4 if at_s <= 0.0 else _PAIRS):
            H = np.zeros((runs, 2, _BLOCK))
            H[:, (0, 1), (0, 1)] = H[:, (0, 1), (4, 5)] = 1.0 / GPS_SIGMA_M
            H[:, :, _STAMP] = v[:, i] / GPS_SIGMA_M
            where = slice(_BLOCK * i, _BLOCK * (i + 1))
            self._J[:, where, where] += self._mean(np.swapaxes(H, -1, -2) @ H)
        if at_s <= 0.0:
            return
        denied_vehicle = _BLOCK * _DENIED
        for i in range(_PAIRS):
            h = np.zeros((runs, self._J.shape[-1]))
            h[:, denied_vehicle : denied_vehicle + 2] = unit[:, i]
            h[:, _BLOCK * i : _BLOCK * i + 2] = -unit[:, i]
            h[:, 4 * _BLOCK + 2 * i : 4 * _BLOCK + 2 * i + 2] = 1.0
            h /= range_sigma_m[:, i, np.newaxis]
            self._J += self._mean(h[:, :, np.newaxis] * h[:, np.newaxis])

    def trace_m2(self) -> float:
        """Return the bound on the sum of the denied vehicle's horizontal variances, m^2, its mean over the groups."""
        where = slice(_BLOCK * _DENIED, _BLOCK * _DENIED + 2)
        return float(np.trace(np.linalg.inv(self._J)[:, where, where], axis1=1, axis2=2).mean())

    def _mean(self, values: FloatArray) -> FloatArray:
        return values if self._groups > 1 else values.mean(axis=0, keepdims=True)
