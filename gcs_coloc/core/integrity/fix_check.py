"""A receiver's position held against where the estimator has the vehicle, and against its ranges. Pure statistics, no memory.

The ranges between the vehicle and peers that are trusted are adjusted as if the receiver were right (`adjustment`). What is left
over is explained by that claim, by a peer's, by a pair or by a device (`exclusion`).

Either witness may be the wrong one. The estimate may be a mirror image, dragged by ranges that are off, or not well known: it
speaks with its covariance, and not against ranges that fit the receiver and would not if it were off by so much.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
from enum import Enum
from math import inf, sqrt

import numpy as np

from gcs_coloc.core.error_bound import horizontal_sigma_m
from gcs_coloc.core.integrity.adjustment import Adjustment, Past, adjust
from gcs_coloc.core.integrity.epoch import LEAST_INFORMATION, Epoch
from gcs_coloc.core.integrity.fault_tests import FaultKind, FaultTestResult, SignificanceLevels, limit, run_test
from gcs_coloc.core.measurements import Estimate, FloatArray, PositionMeasurement

_BEYOND = 1e-6  # chance that an honest receiver and a true covariance differ by so much
_WOULD_SHOW = 50.0  # noncentrality at which a chi-square of two is below its limit at 1e-3 less than once in a thousand tests
_RANGES_THAT_HOLD = 2  # with one, half of a position is prediction: it has been found off and sure of itself


class FixConsistency(Enum):
    """What came of it."""

    NOTHING = "nothing to hold it against"
    AGREES = "agrees, as far as can be told"
    AGAINST_RANGES = "the ranges contradict it, and nothing else would explain them"
    AGAINST_ESTIMATE = "the estimate contradicts it, and the ranges do not speak for it"
    ESTIMATE_OFF = "the ranges fit it and not the estimate"


@dataclass(frozen=True, slots=True)
class FixCheck:
    """A finding, and how far the fix is from where ranges put the vehicle (m, horizontal), None where that is not known.

    `known_m`: how well the best witness that agrees with the fix knows the place, 1-sigma, m; infinity where there is none.
    `ranged`: there were ranges to hold it against.
    """

    finding: FixConsistency
    offset_m: float | None
    known_m: float
    ranged: bool


def check_fix(
    fix: PositionMeasurement, estimate: Estimate | None, scene: Epoch, pasts: Mapping[float, Past], levels: SignificanceLevels
) -> FixCheck:
    """Hold a fix against both witnesses.

    Args:
        fix: what the receiver says.
        estimate: where ranges have the vehicle at a time near the fix's, None where that is not fit to witness.
        scene: the vehicle, where the receiver says, with its rows to peers that are trusted: its `star`.
        pasts: what to compare it with, nothing for 0, by the interval.
        levels: of the tests.
    """
    miss_m = _miss_m(fix, estimate) if estimate is not None else None
    offset_m = float(np.hypot(*miss_m)) if miss_m is not None else None
    fits = adjust(scene, list(pasts.values())) if scene.rows else []
    verdicts = [run_test(fit, levels) if fit.rows else None for fit in fits]
    for verdict in verdicts:
        size_m = _size_if_alone(verdict, fix.vehicle)
        if size_m is not None:
            return FixCheck(FixConsistency.AGAINST_RANGES, offset_m if offset_m is not None else size_m, inf, ranged=True)
    fitting = bool(fits) and _ranges_fit(fits[0], verdicts[0], fix.vehicle, levels)
    information = fits[0].claim_information(fix.vehicle) if fitting else np.zeros((2, 2))
    known_m = 1.0 / sqrt(max(float(np.linalg.eigvalsh(information)[0]), LEAST_INFORMATION))
    if estimate is not None and miss_m is not None and _beyond(miss_m, fix, estimate):
        if float(miss_m @ information @ miss_m) >= _WOULD_SHOW:
            return FixCheck(FixConsistency.ESTIMATE_OFF, offset_m, known_m, ranged=True)
        if (fits and not fitting) or estimate.ranges_in_use >= _RANGES_THAT_HOLD:
            return FixCheck(FixConsistency.AGAINST_ESTIMATE, offset_m, inf, ranged=bool(fits))
        return FixCheck(FixConsistency.AGREES, offset_m, inf, ranged=bool(fits))
    if estimate is not None:
        known_m = min(known_m, horizontal_sigma_m(estimate.covariance))
    finding = FixConsistency.NOTHING if estimate is None and not fits else FixConsistency.AGREES
    return FixCheck(finding, offset_m, known_m, ranged=bool(fits))


def star(scene: Epoch, vehicle: int, peers: Container[int]) -> Epoch:
    """Return the rows between a vehicle and some peers, with their places."""
    rows = tuple(r for r in scene.rows for end, other in (r.pair, r.pair[::-1]) if end == vehicle and other in peers)
    return Epoch(scene.at_s, {end: scene.places[end] for row in rows for end in row.pair}, rows)


def _miss_m(fix: PositionMeasurement, estimate: Estimate) -> FloatArray:
    """Fix minus estimate (2,), at the time of the fix."""
    at_fix = estimate.position_enu_m[:2] - estimate.velocity_enu_mps[:2] * (estimate.at_s - fix.measured_at_s)
    return np.asarray(np.array(fix.position_enu_m[:2]) - at_fix)


def _beyond(miss_m: FloatArray, fix: PositionMeasurement, estimate: Estimate) -> bool:
    covariance = estimate.covariance[:2, :2] + fix.sigma_h_m**2 * np.eye(2)
    return float(miss_m @ np.linalg.solve(covariance, miss_m)) > limit(2, _BEYOND)


def _size_if_alone(verdict: FaultTestResult | None, vehicle: int) -> float | None:
    """By how far the vehicle's claim is off, m, where that and nothing else explains what is left over."""
    if verdict is None or verdict.consistent or len(verdict.possible) != 1:
        return None
    (only,) = verdict.possible
    return only.size_m if only.kind is FaultKind.VEHICLE and only.vehicles == (vehicle,) else None


def _ranges_fit(fit: Adjustment, verdict: FaultTestResult | None, vehicle: int, levels: SignificanceLevels) -> bool:
    """Whether the ranges fit the claim, but for a fault of another one."""
    if verdict is None:
        return False
    if verdict.consistent:
        gain, rank = fit.claim_gain(vehicle)
        return not rank or gain <= limit(rank, levels.rest)
    return bool(verdict.possible) and all((s.kind, s.vehicles) != (FaultKind.VEHICLE, (vehicle,)) for s in verdict.possible)
