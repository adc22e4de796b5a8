"""What a test of one faulty peer could do at best: it knows the noise, the direction of the fault, its rate and when it began.

Only the ranges of a denied vehicle are looked at, and its own motion is not: at each step it may be anywhere horizontally,
at its true height. What is left of the residuals beside any such place is Gaussian, with the covariance of receivers' errors that
wander and of white ranges. Of all tests with one chance of a false alarm the likelihood ratio's has the largest power (Neyman and
Pearson); its statistic is the fault's expected course, whitened, times what was measured, whitened.
"""

from __future__ import annotations

from math import inf

import numpy as np
from scipy.stats import norm

from bench.integrity_flights import (
    DENIED,
    FAULTY,
    SPOOFED_AT_S,
    STEP_S,
    Flight,
    Scenario,
    enu_m,
    error_and_bound_m,
    fly_step,
    fresh_engine,
)
from gcs_coloc.core.integrity.monitor import IntegrityMonitor
from gcs_coloc.core.integrity.report import IntegrityReport
from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.core.messages.inbound import GlobalPosition, PeerRange

FALSE_ALARMS = (1e-6, 1e-3)
"""Chances of a false alarm in one test: that of `Levels.alarm`, and one that a growing bound, but no accusation, could stand."""
_FLIGHT_S = 80.0


class _Blind(IntegrityMonitor):
    """Detects no fault and inflates no covariance."""

    def review(self, *_: object) -> IntegrityReport:
        """Test nothing."""
        return IntegrityReport()


def detected_in_time(task: tuple[Scenario, int]) -> tuple[bool, ...]:
    """For each of `FALSE_ALARMS`: whether in one draw (scenario, seed) the ideal test detects the fault before the error,
    with nobody excluded, passes 1.5 x the 95 % bound of the estimator itself.
    """
    scenario, seed = task
    engine, flight = fresh_engine(), Flight(scenario, seed)
    engine.integrity = _Blind()
    passed_after_s = inf
    for step in range(round(_FLIGHT_S / STEP_S)):
        t = step * STEP_S
        fly_step(engine, flight, t)
        found = error_and_bound_m(engine, flight, t) if t > SPOOFED_AT_S else None
        if found is not None and found[0] > 1.5 * found[1]:
            passed_after_s = t - SPOOFED_AT_S
            break
    return tuple(after_s < passed_after_s for after_s in detected_after_s(scenario, seed, _FLIGHT_S))


def detected_after_s(scenario: Scenario, seed: int, until_s: float) -> list[float]:
    """For each of `FALSE_ALARMS`: after how long the ideal test detects the fault, s; infinity where not until a time (s)."""
    flight = Flight(scenario, seed)
    peers = [v for v in flight.courses if v != DENIED]
    times: FloatArray = np.arange(round(until_s / STEP_S), dtype=np.float64) * STEP_S
    left, fault_m, spread = [], [], []
    for t in times:
        place = flight.courses[DENIED].at(float(t))[0]
        reported, ranged = {}, {}
        for message in flight.messages(float(t)):
            if isinstance(message, GlobalPosition):
                reported[message.sysid] = enu_m(message)
            elif isinstance(message, PeerRange) and message.sysid == DENIED:
                ranged[message.peer_sysid] = message.range_m
        apart = np.array([reported[v] - place for v in peers])
        distance_m = np.linalg.norm(apart, axis=1)
        units = apart / distance_m[:, np.newaxis]
        parity = np.linalg.svd(units[:, :2])[0][:, 2:].T
        left.append(parity @ (np.array([ranged[v] for v in peers]) - distance_m))
        grown = scenario.jump_m + scenario.walk_mps * (t - SPOOFED_AT_S) if t > SPOOFED_AT_S else 0.0
        fault_m.append(parity @ (-grown * (units @ flight.away) * (np.array(peers) == FAULTY)))
        # What a receiver's error along each axis does to each condition: (conditions, peers * 3).
        spread.append((parity[:, :, np.newaxis] * units).reshape(len(parity), -1))
    C = _covariance(scenario, times, np.array(spread))
    whitener = np.linalg.cholesky(C)
    y, s = (np.linalg.solve(whitener, np.concatenate(each)).reshape(len(times), -1) for each in (left, fault_m))
    power = np.sqrt(np.cumsum(np.sum(s * s, axis=1)))
    is_faulted = power > 0.0
    statistic = np.cumsum(np.sum(s * y, axis=1))[is_faulted] / power[is_faulted]
    out = []
    for chance in FALSE_ALARMS:
        detected = times[is_faulted][statistic > norm.isf(chance)]
        out.append(float(detected[0]) - SPOOFED_AT_S if len(detected) else inf)
    return out


def _covariance(scenario: Scenario, times: FloatArray, spread: FloatArray) -> FloatArray:
    """Return the covariance of all conditions at all times, in the order of the times."""
    white_m2 = scenario.gps_sigma_m**2 * scenario.gps_white_share
    slow_m2 = scenario.gps_sigma_m**2 - white_m2
    keep = np.exp(-np.abs(times[:, np.newaxis] - times) / scenario.gps_time_s)
    C = np.einsum("iaq,jbq->iajb", spread, spread)
    C *= (slow_m2 * keep + white_m2 * np.eye(len(times)))[:, np.newaxis, :, np.newaxis]
    n = spread.shape[0] * spread.shape[1]
    return np.asarray(C.reshape(n, n) + scenario.range_sigma_m**2 * np.eye(n))
