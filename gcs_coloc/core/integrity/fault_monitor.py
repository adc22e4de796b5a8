"""Fault monitor of the peers that range denied vehicles: which of them are faulty?

It also bounds how far each possible fault may have displaced the denied vehicle.

All ranges between a denied vehicle and one peer since the last step make one `LineOfSightResidual`; `FaultFilters` has the
hypotheses.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from math import hypot, sqrt
from statistics import median

import numpy as np

from gcs_coloc.core.integrity.epoch_tests.epoch import COLOURED_SHARE, RANGE_BIAS_M, Epoch, PositionPrior
from gcs_coloc.core.integrity.epoch_tests.noise_model import AS_STATED, NoiseModel
from gcs_coloc.core.integrity.epoch_tests.pair_outliers import Pair, unordered
from gcs_coloc.core.integrity.fault_filters import FaultFilters, LineOfSightResidual
from gcs_coloc.core.measurements import FloatArray, RangeMeasurement, Vector3

_MIN_DISTANCE_M = 1.0  # below it the direction of a range is noise
_MAX_PEERS = 8  # chosen: bounds the number of filters of one vehicle
_EXPECTED_STEP_S, _EXPECTED_STEPS = 3.0, 5
"""Steps of an expected separation. Chosen: it is settled after 12 s; in 15 flights it came to 0.5 to 1.7 of the mean of those
that were found, 1.1 in the median."""
_FULL_WEIGHT_PROBABILITY = 0.1
"""A fault this likely counts in full in the covariance, a less likely one in proportion. Chosen: a 95 % bound may leave out what
is less than 5 % likely; here half of that counts."""
_MIN_NO_FAULT_PROBABILITY = 1e-4
"""Below this probability that nobody is faulty the likeliest vehicles are detected. Chosen: a false detection takes anchors away,
so it is to be rare."""
_MAX_MISSED_PROBABILITY = 0.01
"""So many are detected that all others together are less likely than this. Chosen: one detection in a hundred may miss."""
_MIN_PEERS = 3  # with fewer peers nothing is tested. Source: a place has two unknowns; two ranges leave no redundancy
_FORGET_AFTER_S = 30.0  # chosen: the correlation time of a fault-free position error


@dataclass(slots=True)
class _PeerRanges:
    """The ranges to one peer since the last step.

    Residuals and stated sigmas (m) are those of all ranges, priors and baseline (m) those of the newest.
    """

    residuals_m: list[float]
    sigmas_m: list[float]
    peer_prior: PositionPrior
    own_sigma_v_m: float
    baseline_m: Vector3


@dataclass(slots=True)
class _DeniedVehicle:
    """One denied vehicle: its filters, its ranges by peer since the last step, the peers that are off."""

    filters: FaultFilters = field(default_factory=FaultFilters)
    ranges: dict[int, _PeerRanges] = field(default_factory=dict)
    off: frozenset[int] = frozenset()


class FaultMonitor:
    """The fault monitor of one fleet. Add ranges with the priors of both ends, then call `step`."""

    def __init__(self) -> None:
        self._denied: dict[int, _DeniedVehicle] = {}

    def add_range(self, m: RangeMeasurement, a: PositionPrior, b: PositionPrior) -> None:
        """Add a range with the priors of its ends at its time; it counts where only one of them has none."""
        if a.no_prior == b.no_prior:
            return
        vehicle, peer, own, prior = (m.from_vehicle, m.to_vehicle, a, b) if a.no_prior else (m.to_vehicle, m.from_vehicle, b, a)
        (e, n, u), (peer_e, peer_n, peer_u) = own.position_enu_m, prior.position_enu_m
        baseline_m = e - peer_e, n - peer_n, u - peer_u
        distance_m = hypot(*baseline_m)
        if distance_m < _MIN_DISTANCE_M:
            return
        by_peer = self._denied.setdefault(vehicle, _DeniedVehicle()).ranges
        ranges = by_peer.setdefault(peer, _PeerRanges([], [], prior, own.sigma_v_m, baseline_m))
        ranges.residuals_m.append(m.range_m - distance_m)
        ranges.sigmas_m.append(m.sigma_m)
        ranges.peer_prior, ranges.own_sigma_v_m, ranges.baseline_m = prior, own.sigma_v_m, baseline_m

    def step(self, at_s: float, excluded: Collection[int], noise: NoiseModel = AS_STATED, tested: Collection[Pair] = ()) -> None:
        """Update the filters with the ranges up to a time, without those to excluded peers.

        A vehicle without ranges for `_FORGET_AFTER_S` is dropped. `noise` is how much worse ranges and positions were found to
        be than they state. Of more than `_MAX_PEERS` peers those of the `tested` pairs come first: they locate the vehicle.
        """
        for vehicle, denied in self._denied.items():
            by_peer, filters = denied.ranges, denied.filters
            if not by_peer:
                continue
            denied.ranges = {}
            denied.off = frozenset(peer for peer in by_peer if unordered((vehicle, peer)) in noise.isolated_pairs)
            filters.exclude(excluded)
            staying = filters.staying(at_s)
            of_tests = {b if a == vehicle else a for a, b in tested if vehicle in (a, b)}
            # Then those that are in the filters, then those with the most ranges: forged ones take no place from either.
            order = {
                peer: (peer not in of_tests, peer not in staying, -len(by_peer[peer].residuals_m) if peer in by_peer else 0)
                for peer in [*staying, *by_peer]
                if peer not in excluded
            }
            kept = sorted(order, key=order.__getitem__)[:_MAX_PEERS]
            filters.retain(kept)
            included = sorted(by_peer.keys() & kept)
            if included and at_s > filters.at_s:
                filters.update({peer: self._residual(by_peer[peer], noise) for peer in included}, at_s)
        self._denied = {v: denied for v, denied in self._denied.items() if at_s - denied.filters.at_s <= _FORGET_AFTER_S}

    def drop(self, vehicle: int) -> None:
        """Drop the filters of a vehicle that has gained or lost its prior."""
        self._denied.pop(vehicle, None)

    def separation_m2(self, now_s: float) -> Mapping[int, FloatArray]:
        """Return the solution separation (2, 2) of each denied vehicle, m^2.

        It is the second moment of the vehicle's displacement over all faults, each with its weight. Where a pair is off the
        estimator may have refused its ranges: then they have displaced nothing, however long they are.
        """
        return {vehicle: _separation_m2(denied.filters, now_s, denied.off) for vehicle, denied in self._redundant()}

    def detected(self) -> frozenset[int]:
        """Return the vehicles one of which is faulty; none for a denied vehicle's own ranging device."""
        detected = set[int]()
        for _, denied in self._redundant():
            probabilities = denied.filters.probabilities()
            if sum(probability for _, probability in probabilities) < 1.0 - _MIN_NO_FAULT_PROBABILITY:
                continue
            left = 1.0
            for faulty, probability in sorted(probabilities, key=lambda each: -each[1]):
                if left < _MAX_MISSED_PROBABILITY or (faulty is None and left == 1.0):
                    break
                left -= probability
                detected |= {faulty} if faulty is not None else set()
        return frozenset(detected)

    def _redundant(self) -> Iterable[tuple[int, _DeniedVehicle]]:
        return ((vehicle, denied) for vehicle, denied in self._denied.items() if len(denied.filters.peers) >= _MIN_PEERS)

    def _residual(self, r: _PeerRanges, noise: NoiseModel) -> LineOfSightResidual:
        count = len(r.residuals_m)
        coloured = COLOURED_SHARE * (1.0 - 1.0 / count)
        noise_m = median(r.sigmas_m) * sqrt(1.0 / count + coloured)
        bias_m = hypot(RANGE_BIAS_M, noise.lasting_m(hypot(*r.baseline_m)))
        unit, position_sigma_m = _line_of_sight(r.baseline_m, noise.prior(r.peer_prior), r.own_sigma_v_m, bias_m)
        return LineOfSightResidual(median(r.residuals_m), noise_m, position_sigma_m, unit)


def expected_separation_m2(epoch: Epoch, vehicle: int) -> FloatArray | None:
    """Return the solution separation (2, 2) that is expected of a vehicle without prior, m^2.

    It is expected where no fault and no noise has moved the vehicle: faults that the ranges have not ruled out yet still count.
    The geometry is that of an epoch, for some time. None where there are too few peers for redundancy.
    """
    residuals: dict[int, LineOfSightResidual] = {}
    for residual in epoch.residuals:
        peer = residual.to_vehicle if residual.from_vehicle == vehicle else residual.from_vehicle
        own, prior = epoch.priors[vehicle], epoch.priors[peer]
        (e, n, u), (peer_e, peer_n, peer_u) = own.position_enu_m, prior.position_enu_m
        baseline_m = e - peer_e, n - peer_n, u - peer_u
        if peer not in residuals and len(residuals) < _MAX_PEERS and hypot(*baseline_m) >= _MIN_DISTANCE_M:
            bias_m = hypot(residual.bias_m, residual.devices_m)
            unit, position_sigma_m = _line_of_sight(baseline_m, prior, own.sigma_v_m, bias_m)
            residuals[peer] = LineOfSightResidual(0.0, residual.sigma_m, position_sigma_m, unit)
    if len(residuals) < _MIN_PEERS:
        return None
    filters = FaultFilters()
    for step in range(_EXPECTED_STEPS):
        filters.update(residuals, step * _EXPECTED_STEP_S)
    return _separation_m2(filters, filters.at_s)


def _separation_m2(filters: FaultFilters, now_s: float, off: Collection[int] = ()) -> FloatArray:
    """Return the second moment (2, 2) over all weighted faults, m^2; ranges to the `off` are known wrong."""
    sum_ee = sum_en = sum_nn = 0.0
    for h in filters.hypotheses(now_s, off):
        weight, (ee, en, nn) = min(h.probability / _FULL_WEIGHT_PROBABILITY, 1.0), h.separation_m2
        sum_ee, sum_en, sum_nn = sum_ee + weight * ee, sum_en + weight * en, sum_nn + weight * nn
    return np.array([[sum_ee, sum_en], [sum_en, sum_nn]])


def _line_of_sight(
    baseline_m: Vector3, peer: PositionPrior, own_sigma_v_m: float, range_bias_m: float
) -> tuple[tuple[float, float], float]:
    """Return the horizontal direction of a baseline, and the 1-sigma of lasting errors along it, m.

    The errors are those without a fault, of both positions and of the ranges.
    """
    e, n, u = baseline_m
    distance_m = hypot(e, n, u)
    horizontal, vertical = hypot(e, n) / distance_m, abs(u) / distance_m
    sigma_m = hypot(peer.sigma_h_m * horizontal, peer.sigma_v_m * vertical, own_sigma_v_m * vertical, range_bias_m)
    return (e / distance_m, n / distance_m), sigma_m
