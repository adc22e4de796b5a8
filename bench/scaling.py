"""What the fleet filter costs: CPU time by the number of vehicles heard and of denied vehicles."""

from __future__ import annotations

import time

import numpy as np

from bench.figures import Figure
from gcs_coloc.core.measurements import AltitudeMeasurement, Measurement, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.registry import load_estimator

_HEARD = (4, 10, 30, 100, 240)
_FAILED = (1, 2, 3, 4, 5)
_RATE_HZ = 5.0
_FIELD_M = 5000.0
_SPEED_MPS = 25.0
_GPS_SIGMA_M, _RANGE_SIGMA_M, _HEIGHT_SIGMA_M = 1.5, 1.0, 1.0
_WARM_S = 3.0
_LOST_AT_S = 0.01  # after the reports that they start from


def measure(quick: bool) -> list[Figure]:
    """Straight flights over 5 km; each failed vehicle ranges all others five times a second, and is asked as often."""
    seconds = 4.0 if quick else 10.0
    cost = {(heard, failed): _cost(heard, failed, seconds) for failed in _FAILED for heard in _HEARD}
    figures = [
        Figure(
            f"CPU per measurement, {failed} denied, {', '.join(map(str, _HEARD))} heard",
            ", ".join(f"{cost[heard, failed][0]:.0f}" for heard in _HEARD) + " us",
        )
        for failed in _FAILED
    ]
    for failed in _FAILED:
        exponent = _exponent(_HEARD, [cost[heard, failed][1] for heard in _HEARD])
        name = f"CPU per second of flight ~ (vehicles heard)^a, {failed} denied"
        figures.append(Figure(name, f"a = {exponent:.2f}", "a <= 1", exponent <= 1.0))
    for heard in (10, 100):
        exponent = _exponent(_FAILED, [cost[heard, failed][1] for failed in _FAILED])
        name = f"CPU per second of flight ~ (denied vehicles)^b, {heard} heard"
        figures.append(Figure(name, f"b = {exponent:.2f}", "b near 1", exponent <= 1.2))
    return figures


def _exponent(counts: tuple[int, ...], cost: list[float]) -> float:
    return float(np.polyfit(np.log(counts), np.log(cost), 1)[0])


def _cost(heard: int, failed: int, seconds: float) -> tuple[float, float]:
    """Return CPU in us for each measurement, and as a share of the time flown, once all clusters have formed."""
    rng = np.random.default_rng(heard * 100 + failed)
    count = heard + failed
    start = np.column_stack([rng.uniform(-0.5, 0.5, (count, 2)) * _FIELD_M, rng.uniform(50.0, 150.0, count)])
    course = rng.uniform(0.0, 2.0 * np.pi, count)
    velocity = _SPEED_MPS * np.column_stack([np.sin(course), np.cos(course), np.zeros(count)])
    denied = range(1, failed + 1)
    estimator = load_estimator("fleet", {})
    for vehicle in range(1, count + 1):
        estimator.add(_report(vehicle, 0.0, start[vehicle - 1], velocity[vehicle - 1], rng))
    estimator.set_denied(denied, _LOST_AT_S)
    spent_s, taken, t = 0.0, 0, 0.0
    while t < _WARM_S + seconds:
        t += 1.0 / _RATE_HZ
        batch = _epoch(t, start + velocity * t, velocity, failed, rng)
        began_s = time.process_time()
        for m in batch:
            estimator.add(m)
        for vehicle in denied:
            estimator.estimate(vehicle, t)
        if t > _WARM_S:
            spent_s += time.process_time() - began_s
            taken += len(batch)
    return spent_s / taken * 1e6, spent_s / seconds


def _epoch(t: float, places: np.ndarray, velocity: np.ndarray, failed: int, rng: np.random.Generator) -> list[Measurement]:
    batch: list[Measurement] = [_report(i + 1, t, places[i], velocity[i], rng) for i in range(failed, len(places))]
    for i in range(failed):
        batch.append(AltitudeMeasurement(i + 1, t, t, float(places[i, 2] + rng.normal(0.0, _HEIGHT_SIGMA_M)), _HEIGHT_SIGMA_M))
        for j in range(len(places)):
            if j > i or j >= failed:
                distance_m = float(np.linalg.norm(places[i] - places[j]) + rng.normal(0.0, _RANGE_SIGMA_M))
                batch.append(RangeMeasurement(i + 1, j + 1, t, t, max(0.0, distance_m), _RANGE_SIGMA_M))
    return batch


def _report(vehicle: int, t: float, place: np.ndarray, velocity: np.ndarray, rng: np.random.Generator) -> PositionMeasurement:
    e, n, u = (place + rng.normal(0.0, _GPS_SIGMA_M, 3)).tolist()
    ve, vn, vu = (velocity + rng.normal(0.0, 0.5, 3)).tolist()
    return PositionMeasurement(vehicle, t, t, (e, n, u), _GPS_SIGMA_M, _GPS_SIGMA_M, (ve, vn, vu), 0.5)
