"""Tests a receiver's fix against the estimate and against the ranges. Pure statistics, no memory.

The ranges between the vehicle and witnesses are adjusted with the fix as the vehicle's prior (`Adjustment`). What is left over is
explained by a fault of that fix, of peers' positions, of a pair or of a device (`isolation`).

Either reference may be wrong itself. An estimate may be a reflection, biased by ranges, or uncertain: it counts with its
covariance, and not against ranges that fit the fix and would not fit if the fix were off by that much.
"""

from __future__ import annotations

from collections.abc import Collection, Container, Mapping
from dataclasses import dataclass
from enum import Enum
from math import hypot, inf, sqrt

import numpy as np

from gcs_coloc.core.error_ellipse import eigenvalue_mean_and_radius, horizontal_sigma_m
from gcs_coloc.core.integrity.epoch_tests.epoch import MIN_INFORMATION_PER_M2, Epoch, Past
from gcs_coloc.core.integrity.epoch_tests.fault_tests import REST_LEVEL, Adjustment, adjust, chi2_limit, run_test
from gcs_coloc.core.integrity.epoch_tests.gross_faults import gross_faults
from gcs_coloc.core.integrity.epoch_tests.isolation import isolate
from gcs_coloc.core.measurements import Estimate, FloatArray, PositionMeasurement

_SIGNIFICANCE = 1e-6  # probability that a right fix and a true covariance differ by more
# Noncentrality at which a chi-square with 2 degrees of freedom passes its limit at 1e-3 (13.8) in all but one test of a thousand.
_DETECTABLE_NONCENTRALITY = 50.0
_MIN_RANGES = 2  # with one range half of an estimate is prediction, which has been found off and certain


class FixConsistency(Enum):
    """What a check of a fix has found."""

    NOTHING = "nothing to test it against"
    AGREES = "consistent, as far as can be tested"
    AGAINST_RANGES = "the ranges contradict it, and no other fault explains them"
    AGAINST_ESTIMATE = "the estimate contradicts it, and the ranges do not support it"
    UNRESOLVED = "ranges or estimate speak against it, or something else is wrong"
    ESTIMATE_OFF = "the ranges fit it and not the estimate"


@dataclass(frozen=True, slots=True)
class FixCheck:
    """The result of the check of one fix.

    `offset_m`: horizontal distance of the fix from where ranges put the vehicle, m; None where that is unknown. `known_m`:
    horizontal 1-sigma of the best reference that agrees with the fix, m; infinity where there is none. `ranges_know_m`: that of
    the present epoch's ranges alone, where neither they nor the estimate speak against the fix. `ranged`: there were ranges to
    test it against. `fits_now`: the ranges of the present epoch alone fit it.
    """

    finding: FixConsistency
    offset_m: float | None
    known_m: float
    ranged: bool
    fits_now: bool
    ranges_know_m: float = inf


def check_fix(
    fix: PositionMeasurement, estimate: Estimate | None, epoch: Epoch, pasts: Mapping[float, Past], suspects: Collection[int] = ()
) -> FixCheck:
    """Test a receiver's fix against the vehicle's estimate near in time, if fit for it, and the ranges.

    `epoch` is the vehicle's `star`, with the fix as its prior, `pasts` are the earlier ones to compare it with, by interval.
    `suspects` are vehicles of which something bad is known; that of the fix is one in any case.
    """
    difference_m = _difference_m(fix, estimate) if estimate is not None else None
    offset_m = float(np.hypot(*difference_m)) if difference_m is not None else None
    gross_m = gross_faults(epoch).get(fix.vehicle)
    if gross_m is not None:
        return FixCheck(FixConsistency.AGAINST_RANGES, offset_m or gross_m, inf, ranged=True, fits_now=False)
    fits = adjust(epoch, list(pasts.values())) if epoch.residuals else []
    results = [run_test(fit) if fit.residuals else None for fit in fits]
    present = results[0] if results else None
    fitting = present is not None and _agrees(fits[0], fix.vehicle)
    unresolved = False
    for number, (result, past) in enumerate(zip(results, pasts.values(), strict=False)):
        if result is None or result.is_consistent:
            continue
        isolation = isolate(epoch, past, troubled=(fix.vehicle, *suspects))
        is_possible = fix.vehicle in (isolation.possible if isolation.plausible else result.suspects)
        if number == 0:
            fitting = not is_possible
        size_m = isolation.isolated.get(fix.vehicle)
        if size_m is not None:
            return FixCheck(
                FixConsistency.AGAINST_RANGES, offset_m if offset_m is not None else size_m, inf, ranged=True, fits_now=fitting
            )
        unresolved |= is_possible
    information = fits[0].position_information(fix.vehicle) if fitting else np.zeros((2, 2))
    ranges_know_m = known_m = 1.0 / sqrt(max(_least_information_per_m2(information), MIN_INFORMATION_PER_M2))
    if estimate is not None and difference_m is not None:
        distance = _squared_distance(difference_m, fix, estimate)
        ranges_decide = float(difference_m @ information @ difference_m) >= _DETECTABLE_NONCENTRALITY
        is_range_based = estimate.ranges_in_use >= _MIN_RANGES
        if distance > chi2_limit(2, _SIGNIFICANCE):
            if ranges_decide:
                return FixCheck(FixConsistency.ESTIMATE_OFF, offset_m, known_m, ranged=True, fits_now=fitting)
            if (fits and not fitting) or is_range_based:
                return FixCheck(FixConsistency.AGAINST_ESTIMATE, offset_m, inf, ranged=bool(fits), fits_now=fitting)
            finding = FixConsistency.UNRESOLVED if unresolved else FixConsistency.AGREES
            return FixCheck(finding, offset_m, inf, ranged=bool(fits), fits_now=fitting)
        known_m = min(known_m, horizontal_sigma_m(estimate.covariance))
        unresolved |= is_range_based and not ranges_decide and distance > chi2_limit(2, REST_LEVEL)
    # Too little for an alarm may be too much for a receiver to be believed again.
    if unresolved or (present is not None and present.is_consistent and not fitting):
        return FixCheck(FixConsistency.UNRESOLVED, offset_m, inf, ranged=bool(fits), fits_now=fitting)
    finding = FixConsistency.NOTHING if estimate is None and not fits else FixConsistency.AGREES
    return FixCheck(finding, offset_m, known_m, ranged=bool(fits), fits_now=fitting, ranges_know_m=ranges_know_m)


def fits_alone(epoch: Epoch, vehicle: int) -> bool:
    """Return whether the ranges of one epoch fit a vehicle's position; True where there are none."""
    if not epoch.residuals:
        return True
    (fit,) = adjust(epoch, [(None, 0.0)])
    return _agrees(fit, vehicle)


def star(epoch: Epoch, vehicle: int, peers: Container[int]) -> Epoch:
    """Return the part of an epoch with the residuals between one vehicle and some peers."""
    residuals = tuple(r for r in epoch.residuals for end, other in (r.pair, r.pair[::-1]) if end == vehicle and other in peers)
    return Epoch(epoch.at_s, {end: epoch.priors[end] for residual in residuals for end in residual.pair}, residuals)


def _difference_m(fix: PositionMeasurement, estimate: Estimate) -> FloatArray:
    """Return fix minus estimate (2,), m, at the time of the fix."""
    at_fix = estimate.position_enu_m[:2] - estimate.velocity_enu_mps[:2] * (estimate.at_s - fix.measured_at_s)
    return np.asarray(np.array(fix.position_enu_m[:2]) - at_fix)


def _least_information_per_m2(information: FloatArray) -> float:
    """Return the information along the worst direction: the smaller eigenvalue."""
    mean, radius = eigenvalue_mean_and_radius(information.item(0), information.item(1), information.item(3), hypot)
    return mean - radius


def _squared_distance(difference_m: FloatArray, fix: PositionMeasurement, estimate: Estimate) -> float:
    """Return d' (P + sigma^2 I)^-1 d of fix minus estimate: chi-square (2) where both are right."""
    covariance = estimate.covariance[:2, :2] + fix.sigma_h_m**2 * np.eye(2)
    return float(difference_m @ np.linalg.solve(covariance, difference_m))


def _agrees(fit: Adjustment, vehicle: int) -> bool:
    """Return whether the ranges fit the vehicle's position, where nothing else contradicts them."""
    gain, rank = fit.position_gain(vehicle)
    return not rank or gain <= chi2_limit(rank, REST_LEVEL)
