"""The buffer of recent positions and ranges, from which an `Epoch` with range residuals is built.

The ranges of one device to one peer within a window make one residual: their median, so that single outliers cause no alarm. Its
noise is the stated or the observed spread, whichever is larger.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import Counter, deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import chain
from math import dist, inf, sqrt
from statistics import median
from typing import NamedTuple

from gcs_coloc.core.integrity.epoch_tests.epoch import (
    COLOURED_SHARE,
    RANGE_BIAS_M,
    Epoch,
    PositionPrior,
    RangeResidual,
    height_sigma_m,
)
from gcs_coloc.core.integrity.epoch_tests.pair_outliers import Pair
from gcs_coloc.core.integrity.fault_monitor import FaultMonitor
from gcs_coloc.core.measurements import Estimate, PositionMeasurement, RangeMeasurement, Vector3

WINDOW_S = 1.0
"""A residual uses the ranges of so long, if these are `_ENOUGH_RANGES`. Chosen: five ranges at 5 Hz."""
_LONGER_WINDOW_S = 1.4  # else those of so long, if `_MIN_RANGES`; chosen: five ranges at 5 Hz, of which one or two were lost
_LONG_WINDOW_S = 3.0  # else the newest `_ENOUGH_RANGES` of so long, if `_MIN_RANGES`; chosen: three ranges at 1 Hz
_LONGEST_WINDOW_S = 6.0  # else the newest `_MIN_RANGES` of so long; chosen: three ranges at 0.5 Hz
WAIT_S = 0.2
"""An epoch ends so long ago: positions need that time to arrive. Chosen: one period of reports at 5 Hz."""
_ENOUGH_RANGES = 5  # chosen: the median of five bears two outliers
_MIN_RANGES = 3  # chosen: the median of three bears one outlier; with fewer there is no residual
_MAX_POINTS = 64  # of a track: six seconds at 10 Hz
_MAX_SAMPLES = 64  # of a pair
_MAX_PENDING = 20_000  # chosen: bounds the memory of a flood
_MAX_INTERPOLATED_S = 3.0
"""Between positions so far apart a track is interpolated. Chosen: a plane of 15 m/s in a turn at 1 g is 0.9 m off halfway."""
_MAX_EXTRAPOLATED_S = 0.3
"""A range so long after a position counts at once, a later one once the next position has come. Chosen: a turn at 1 g is off by
0.4 m after it."""
_MAX_WAIT_S = 3.0  # a range waits so long for it; chosen: the longest interval that is interpolated
_MAX_SILENCE_S = 1.5
"""So long after its last position a vehicle takes part. Chosen: positions every two seconds, 0.2 s late; the ranges before it
are tested, so it need not be exact."""
_PLACED_SOON_S = 0.6
"""Ranges of a vehicle without a position wait so long for its first. Chosen: it bounds what forged ones cost."""
_MAX_PEERS_PER_DEVICE = 8  # chosen: bounds the size of the adjustment; as many as the fleet filter uses
_SELECTED_S = 5.0  # chosen: an estimator that changes its peers every two seconds has ranged those of the last choice since
_MIN_DISTANCE_M = 1.0  # below it the direction of a range is noise
_MEDIAN_VARIANCE_RATIO = 1.57  # pi / 2: variance of a Gaussian sample's median over that of its mean
_QUARTILE_DISTANCE_SIGMAS = 1.35  # distance of a Gaussian's quartiles, in sigmas


class TrackPoint(NamedTuple):
    """Position and velocity of a vehicle at one time, ENU in m and m/s; the rest as in `PositionPrior`."""

    at_s: float
    position_enu_m: Vector3
    velocity_enu_mps: Vector3
    sigma_h_m: float
    sigma_v_m: float
    no_prior: bool

    @classmethod
    def of_report(cls, m: PositionMeasurement) -> TrackPoint | None:
        """Return a reported position, which is a prior; None where it has no velocity."""
        if m.velocity_enu_mps is None:
            return None
        return cls(m.measured_at_s, m.position_enu_m, m.velocity_enu_mps, m.sigma_h_m, m.sigma_v_m, no_prior=False)

    @classmethod
    def of_estimate(cls, where: Estimate, now_s: float, sigma_h_m: float, *, no_prior: bool) -> TrackPoint:
        """Return where the estimator has a vehicle."""
        (e, n, u), (ve, vn, vu) = where.position_enu_m.tolist(), where.velocity_enu_mps.tolist()
        return cls(now_s, (e, n, u), (ve, vn, vu), sigma_h_m, height_sigma_m(where.covariance), no_prior)


class _Track:
    """The recent track of one vehicle, with a prior or without one throughout; the oldest point first."""

    __slots__ = ("_points", "_times_s", "no_prior")

    def __init__(self, no_prior: bool) -> None:
        self.no_prior = no_prior
        self._times_s: list[float] = []
        self._points: list[TrackPoint] = []

    def append(self, point: TrackPoint) -> None:
        """Append a point that is newer than all before; an older one is ignored."""
        if self._times_s and point.at_s <= self._times_s[-1]:
            return
        self._times_s.append(point.at_s)
        self._points.append(point)
        if len(self._points) > _MAX_POINTS:
            del self._times_s[0], self._points[0]

    def at(self, at_s: float, max_extrapolated_s: float = _MAX_EXTRAPOLATED_S) -> PositionPrior | None:
        """Return the prior at a time between two points or so long after the newest; None where none is near."""
        times_s = self._times_s
        later = bisect_left(times_s, at_s)
        if 0 < later < len(times_s) and times_s[later] - times_s[later - 1] <= _MAX_INTERPOLATED_S:
            return _interpolate(self._points[later - 1], self._points[later], at_s)
        nearest = later
        if later and (later == len(times_s) or at_s - times_s[later - 1] <= times_s[later] - at_s):
            nearest -= 1
        since_s = at_s - times_s[nearest]
        if since_s > max_extrapolated_s or since_s < -_PLACED_SOON_S:
            return None
        _, (e, n, u), (ve, vn, vu), sigma_h_m, sigma_v_m, no_prior = self._points[nearest]
        return PositionPrior((e + ve * since_s, n + vn * since_s, u + vu * since_s), sigma_h_m, sigma_v_m, no_prior)


def _interpolate(before: TrackPoint, after: TrackPoint, at_s: float) -> PositionPrior:
    """Return the prior between two points of a track: the cubic with their positions and velocities."""
    (e0, n0, u0), (ve0, vn0, vu0) = before.position_enu_m, before.velocity_enu_mps
    (e1, n1, u1), (ve1, vn1, vu1) = after.position_enu_m, after.velocity_enu_mps
    interval_s = after.at_s - before.at_s
    s = (at_s - before.at_s) / interval_s
    # Source: Hermite's basis polynomials.
    b = s * s * (3.0 - 2.0 * s)
    a, va, vb = 1.0 - b, interval_s * s * (1.0 - s) ** 2, interval_s * s * s * (s - 1.0)
    nearer = before if s <= 0.5 else after
    return PositionPrior(
        (
            a * e0 + b * e1 + va * ve0 + vb * ve1,
            a * n0 + b * n1 + va * vn0 + vb * vn1,
            a * u0 + b * u1 + va * vu0 + vb * vu1,
        ),
        nearer.sigma_h_m,
        nearer.sigma_v_m,
        nearer.no_prior,
    )


_Sample = tuple[float, float, float]  # of a range: its time (s), observed minus computed (m), its 1-sigma (m)


def _is_silent(samples: list[_Sample], now_s: float) -> bool:
    """Return whether a pair has no new ranges: it delays no test of the others."""
    newest_s = samples[-1][0]
    interval_s = newest_s - samples[-2][0] if len(samples) > 1 else 0.0
    return now_s - WAIT_S - newest_s >= max(_LONGER_WINDOW_S, interval_s)


@dataclass(slots=True)
class RangeResidualBuffer:
    """The positions and ranges of one fleet in the last seconds.

    A range whose positions have arrived also goes to the fault monitor, where there is one.
    """

    fault_monitor: FaultMonitor | None = None
    _tracks: dict[int, _Track] = field(default_factory=dict)
    _pending: deque[RangeMeasurement] = field(default_factory=lambda: deque(maxlen=_MAX_PENDING))
    _samples: dict[Pair, list[_Sample]] = field(default_factory=dict)
    _pairs: frozenset[Pair] = frozenset()
    _selected_s: dict[Pair, float] = field(default_factory=dict)
    _detected: frozenset[int] = frozenset()

    def add_position(self, vehicle: int, point: TrackPoint) -> None:
        """Add a vehicle's position. When it gains or loses its prior, its residuals so far are dropped."""
        track = self._tracks.get(vehicle)
        if track is None or track.no_prior != point.no_prior:
            self.drop(vehicle)
            track = self._tracks[vehicle] = _Track(point.no_prior)
        track.append(point)

    def drop(self, vehicle: int) -> None:
        """Drop a vehicle's positions and residuals."""
        self._tracks.pop(vehicle, None)
        for pair in [pair for pair in self._samples if vehicle in pair]:
            del self._samples[pair]
        if self.fault_monitor is not None:
            self.fault_monitor.drop(vehicle)

    def add_range(self, measurement: RangeMeasurement) -> None:
        """Add a range; its residual is computed once the positions of its time have arrived."""
        self._pending.append(measurement)

    def add_selected(self, pair: Pair, measured_at_s: float) -> None:
        """Add that the estimator used or refused a range of a pair: it is to be tested before others."""
        self._selected_s[pair] = measured_at_s

    def ranged_at_s(self, vehicle: int) -> dict[int, float]:
        """Return the time of the newest range whose residual was computed, s, by the other end."""
        newest_s: dict[int, float] = {}
        for (i, j), samples in self._samples.items():
            if vehicle in (i, j):
                other = j if vehicle == i else i
                newest_s[other] = max(samples[-1][0], newest_s.get(other, -inf))
        return newest_s

    def is_testable(self, vehicle: int) -> bool:
        """Return whether a vehicle has ranges of late whose other end has a position to test them with."""
        pairs = chain(((m.from_vehicle, m.to_vehicle) for m in self._pending), self._samples)
        return any(vehicle in pair and (pair[0] if pair[1] == vehicle else pair[1]) in self._tracks for pair in pairs)

    def epoch(self, now_s: float, detected: Collection[int] = ()) -> Epoch:
        """Return the epoch in the middle of the window that ends `WAIT_S` ago.

        Ranges to `detected` vehicles stay in it: the estimator selects them no more, and untested they would be trusted again.
        """
        self._compute_residuals(now_s)
        waiting = {(m.from_vehicle, m.to_vehicle) for m in self._pending}
        dense = {pair: kept for pair, kept in self._samples.items() if pair in waiting or not _is_silent(kept, now_s)}
        self._selected_s = {pair: at_s for pair, at_s in self._selected_s.items() if now_s - at_s <= _SELECTED_S}
        self._detected = frozenset(detected)
        epoch = self._epoch(dense, now_s, _MIN_RANGES)
        self._pairs = frozenset(residual.pair for residual in epoch.residuals)
        return epoch

    def sparse_epoch(self, now_s: float, dense: Epoch) -> Epoch:
        """Return `dense`, the epoch of the same time, with the pairs that are ranged too seldom for it."""
        if len(dense.residuals) == len(self._samples):
            return dense
        return self._epoch(self._samples, now_s, 1)

    def _epoch(self, ranges: Mapping[Pair, list[_Sample]], now_s: float, min_ranges: int) -> Epoch:
        """Return the epoch of some ranges.

        Of a device with too many peers the detected ones count, and eight others: those that the estimator selects, then those
        that did in the last dense epoch, and then those with the most ranges. Forged ones push nobody out.
        """
        middle_s = now_s - WAIT_S - 0.5 * WINDOW_S
        from_s = now_s - WAIT_S - WINDOW_S
        tracked = {v: self._tracks[v].at(middle_s, _MAX_SILENCE_S) for v in {v for pair in ranges for v in pair}}
        at_middle = {vehicle: prior for vehicle, prior in tracked.items() if prior is not None}
        usable: dict[Pair, list[_Sample]] = {}
        for (i, j), kept in ranges.items():
            if i not in at_middle or j not in at_middle:
                continue
            samples = [sample for sample in kept if sample[0] > from_s]
            if len(samples) < _ENOUGH_RANGES:
                samples = [sample for sample in kept if sample[0] > from_s + WINDOW_S - _LONGER_WINDOW_S]
            if len(samples) < _MIN_RANGES:
                samples = [sample for sample in kept if sample[0] > from_s + WINDOW_S - _LONG_WINDOW_S][-_ENOUGH_RANGES:]
            if len(samples) < _MIN_RANGES:
                samples = kept[-_MIN_RANGES:]
            apart_m = dist(at_middle[i].position_enu_m, at_middle[j].position_enu_m)
            if len(samples) >= min_ranges and apart_m >= _MIN_DISTANCE_M:
                usable[i, j] = samples
        per_device: Counter[int] = Counter()
        others = [pair for pair in usable if pair[1] not in self._detected]
        for pair in sorted(others, key=lambda pair: (pair not in self._selected_s, pair not in self._pairs, -len(usable[pair]))):
            per_device[pair[0]] += 1
            if per_device[pair[0]] > _MAX_PEERS_PER_DEVICE:
                del usable[pair]
        pairs = sorted(usable)
        priors = {vehicle: at_middle[vehicle] for pair in pairs for vehicle in pair}
        residuals = tuple(self._residual(*pair, usable[pair]) for pair in pairs)
        began_s = min((samples[0][0] for samples in usable.values()), default=now_s - WAIT_S)
        ended_s = max((samples[-1][0] for samples in usable.values()), default=now_s - WAIT_S)
        return Epoch(middle_s, priors, residuals, began_s, ended_s)

    def _residual(self, i: int, j: int, samples: list[_Sample]) -> RangeResidual:
        ordered = sorted([residual_m for _, residual_m, _ in samples])
        residual_m, stated_m = median(ordered), median([sigma_m for _, _, sigma_m in samples])
        # Multipath that reaches the median also spreads the quartiles.
        quarter = len(ordered) // 4
        spread_m = (ordered[-1 - quarter] - ordered[quarter]) / _QUARTILE_DISTANCE_SIGMAS
        noise_m2 = max(stated_m, spread_m) ** 2 * _MEDIAN_VARIANCE_RATIO / len(samples)
        return RangeResidual(i, j, residual_m, sqrt(noise_m2 + COLOURED_SHARE * stated_m**2), RANGE_BIAS_M)

    def _compute_residuals(self, now_s: float) -> None:
        ready_s = now_s - WAIT_S
        waiting = []
        for m in self._pending:
            at_s = m.measured_at_s
            if at_s > ready_s:
                waiting.append(m)
                continue
            i, j = pair = m.from_vehicle, m.to_vehicle
            if i not in self._tracks or j not in self._tracks:
                if at_s >= now_s - _PLACED_SOON_S:
                    waiting.append(m)  # a vehicle that is placed soon is tested by them at once
                continue
            a, b = self._tracks[i].at(at_s), self._tracks[j].at(at_s)
            if a is None or b is None:
                if at_s > ready_s - _MAX_WAIT_S:
                    waiting.append(m)
                continue
            if self.fault_monitor is not None:
                self.fault_monitor.add_range(m, a, b)
            samples = self._samples.get(pair)
            if samples is None:
                samples = self._samples[pair] = []
            # By time: a range may be overtaken on its link.
            insort(samples, (at_s, m.range_m - dist(a.position_enu_m, b.position_enu_m), m.sigma_m))
            if len(samples) > _MAX_SAMPLES:
                del samples[0]
        self._pending.clear()
        self._pending.extend(waiting)
        oldest_s = ready_s - _LONGEST_WINDOW_S
        fresh = {pair: [sample for sample in samples if sample[0] > oldest_s] for pair, samples in self._samples.items()}
        self._samples = {pair: samples for pair, samples in fresh.items() if samples}
