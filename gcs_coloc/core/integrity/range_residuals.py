"""The memory of the test of positions against ranges: where vehicles were held to be, and what their ranges said beyond that.

The ranges of one device to one peer within a window make one row: a median, so that single outliers accuse nobody, with a noise
that is what is stated or what is seen to scatter, whichever is more.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, deque
from dataclasses import dataclass, field
from math import dist, sqrt
from statistics import median
from typing import NamedTuple

from gcs_coloc.core.integrity.epoch import Epoch, PositionPrior, RangeResidual
from gcs_coloc.core.integrity.fault_monitor import FaultMonitor
from gcs_coloc.core.measurements import RangeMeasurement, Vector3

_PLACES_KEPT = 64
_SAMPLES_KEPT = 64
_PENDING_KEPT = 20_000
_PLACE_AGE_S = 0.6
_PEERS_PER_DEVICE = 8
_LEAST_DISTANCE_M = 1.0
_MEDIAN_VARIANCE_GAIN = 1.57  # of the median of Gaussian values over that of their mean
_QUARTILES_PER_SIGMA = 1.35  # distance of a Gaussian's quartiles over its sigma


@dataclass(frozen=True, slots=True)
class RangeResidualSettings:
    """How ranges become rows.

    A row has the ranges of the last `window_s` if these are `enough_ranges`, else of the last `longest_s`, once positions have
    had `wait_s` to arrive, and counts from `least_ranges` on.
    `range_bias_m` is the 1-sigma of what all ranges of a pair have in common, `slow_share` the share of their stated variance
    that no averaging removes.
    """

    window_s: float = 1.0
    longest_s: float = 1.4
    wait_s: float = 0.2
    enough_ranges: int = 5
    least_ranges: int = 3
    range_bias_m: float = 0.3
    slow_share: float = 0.1


class ReportedTrack(NamedTuple):
    """Where a vehicle is held to be at one time: ENU in m and m/s, else as `scene.Place`."""

    at_s: float
    position_enu_m: Vector3
    velocity_enu_mps: Vector3
    sigma_h_m: float
    sigma_v_m: float
    free: bool


class _Tracks:
    """Where one vehicle was held to be of late, claimed or free throughout; the oldest first."""

    __slots__ = ("_times_s", "_tracks", "free")

    def __init__(self, free: bool) -> None:
        self.free = free
        self._times_s: list[float] = []
        self._tracks: list[ReportedTrack] = []

    def append(self, track: ReportedTrack) -> None:
        """Take one that is newer than all before; others say nothing."""
        if self._times_s and track.at_s <= self._times_s[-1]:
            return
        self._times_s.append(track.at_s)
        self._tracks.append(track)
        if len(self._tracks) > _PLACES_KEPT:
            del self._times_s[0], self._tracks[0]

    def at(self, at_s: float) -> PositionPrior | None:
        """Where the vehicle is held to have been: the track point next to the time, carried on by its velocity."""
        times_s = self._times_s
        nearest = bisect_left(times_s, at_s)
        if nearest and (nearest == len(times_s) or at_s - times_s[nearest - 1] <= times_s[nearest] - at_s):
            nearest -= 1
        since_s = at_s - times_s[nearest]
        if abs(since_s) > _PLACE_AGE_S:
            return None
        _, (e, n, u), (ve, vn, vu), sigma_h_m, sigma_v_m, free = self._tracks[nearest]
        return PositionPrior((e + ve * since_s, n + vn * since_s, u + vu * since_s), sigma_h_m, sigma_v_m, free)


_Sample = tuple[float, float, float]  # of a range: its time (s), what it is beyond the distance of the places (m), its 1-sigma


@dataclass(slots=True)
class RangeResidualBuffer:
    """The last seconds of one fleet. Ranges that positions have arrived for are handed on to `watch`, if there is one."""

    settings: RangeResidualSettings = field(default_factory=RangeResidualSettings)
    watch: FaultMonitor | None = None
    _tracks: dict[int, _Tracks] = field(default_factory=dict)
    _pending: deque[RangeMeasurement] = field(default_factory=lambda: deque(maxlen=_PENDING_KEPT))
    _samples: dict[tuple[int, int], list[_Sample]] = field(default_factory=dict)

    def place(self, vehicle: int, track: ReportedTrack) -> None:
        """Take where a vehicle is held to be. When it turns from claimed to free or back, what was heard of it is forgotten."""
        known = self._tracks.get(vehicle)
        if known is None or known.free != track.free:
            known = self._tracks[vehicle] = _Tracks(track.free)
            for pair in [pair for pair in self._samples if vehicle in pair]:
                del self._samples[pair]
            if self.watch is not None:
                self.watch.forget(vehicle)
        known.append(track)

    def range(self, measurement: RangeMeasurement) -> None:
        """Take a range; it is compared once the positions of its time have arrived."""
        self._pending.append(measurement)

    def scene(self, now_s: float) -> Epoch:
        """Return the fleet as it was in the middle of the window that ends `wait_s` ago."""
        self._compare(now_s)
        s = self.settings
        middle_s = now_s - s.wait_s - 0.5 * s.window_s
        from_s = now_s - s.wait_s - s.window_s
        held = {vehicle: self._tracks[vehicle].at(middle_s) for vehicle in {v for pair in self._samples for v in pair}}
        places: dict[int, PositionPrior] = {}
        rows: list[RangeResidual] = []
        per_device: Counter[int] = Counter()
        for (i, j), kept in sorted(self._samples.items()):
            a, b = held[i], held[j]
            if a is None or b is None or per_device[i] >= _PEERS_PER_DEVICE:
                continue
            recent = [sample for sample in kept if sample[0] > from_s]
            samples = recent if len(recent) >= s.enough_ranges else kept
            if len(samples) < s.least_ranges or dist(a.position_enu_m, b.position_enu_m) < _LEAST_DISTANCE_M:
                continue
            places[i], places[j] = a, b
            rows.append(self._row(i, j, samples))
            per_device[i] += 1
        return Epoch(middle_s, places, tuple(rows))

    def _row(self, i: int, j: int, samples: list[_Sample]) -> RangeResidual:
        s = self.settings
        ordered = sorted([residual_m for _, residual_m, _ in samples])
        residual_m, stated_m = median(ordered), median([sigma_m for _, _, sigma_m in samples])
        # Where so many are late that the median is one of them, the quartiles lie far apart.
        quarter = len(ordered) // 4
        scatter_m = (ordered[-1 - quarter] - ordered[quarter]) / _QUARTILES_PER_SIGMA
        noise_m2 = max(stated_m, scatter_m) ** 2 * _MEDIAN_VARIANCE_GAIN / len(samples)
        return RangeResidual(i, j, residual_m, sqrt(noise_m2 + s.slow_share * stated_m**2), s.range_bias_m)

    def _compare(self, now_s: float) -> None:
        """Turn the ranges that positions have arrived for into residuals."""
        ready_s = now_s - self.settings.wait_s
        waiting = []
        for m in self._pending:
            at_s = m.measured_at_s
            if at_s > ready_s:
                waiting.append(m)
                continue
            i, j = pair = m.from_vehicle, m.to_vehicle
            if i not in self._tracks or j not in self._tracks:
                continue
            a, b = self._tracks[i].at(at_s), self._tracks[j].at(at_s)
            if a is None or b is None:
                continue
            if self.watch is not None:
                self.watch.range(m, a, b)
            known = self._samples.get(pair)
            if known is None:
                known = self._samples[pair] = []
            known.append((at_s, m.range_m - dist(a.position_enu_m, b.position_enu_m), m.sigma_m))
            if len(known) > _SAMPLES_KEPT:
                del known[0]
        self._pending.clear()
        self._pending.extend(waiting)
        oldest_s = ready_s - self.settings.longest_s
        fresh = {pair: [sample for sample in samples if sample[0] > oldest_s] for pair, samples in self._samples.items()}
        self._samples = {pair: samples for pair, samples in fresh.items() if samples}
