"""The memory of the test of positions against ranges: where vehicles were held to be, and what their ranges said beyond that.

The ranges of one device to one peer within a window make one row: a median, so that single outliers accuse nobody, with a noise
that is what is stated or what is seen to scatter, whichever is more.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, deque
from dataclasses import dataclass, field
from math import dist, sqrt
from operator import attrgetter
from statistics import median

from gcs_coloc.core.integrity.lie_watch import LieWatch
from gcs_coloc.core.integrity.scene import Place, Row, Scene
from gcs_coloc.core.measurements import FloatArray, RangeMeasurement

_PLACES_KEPT = 64
_SAMPLES_KEPT = 64
_PENDING_KEPT = 20_000
_PLACE_AGE_S = 0.6
_PEERS_PER_DEVICE = 8
_LEAST_DISTANCE_M = 1.0
_MEDIAN_VARIANCE_GAIN = 1.57  # of the median of Gaussian values over that of their mean
_at_s = attrgetter("at_s")
_QUARTILES_PER_SIGMA = 1.35  # distance of a Gaussian's quartiles over its sigma


@dataclass(frozen=True, slots=True)
class RowSettings:
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


@dataclass(frozen=True, slots=True)
class Track:
    """Where a vehicle is held to be at one time: ENU (3,) in m and m/s, else as `scene.Place`."""

    at_s: float
    position_enu_m: FloatArray
    velocity_enu_mps: FloatArray
    sigma_h_m: float
    sigma_v_m: float
    free: bool


@dataclass(slots=True)
class RangeRows:
    """The last seconds of one fleet. Ranges that positions have arrived for are handed on to `watch`, if there is one."""

    settings: RowSettings = field(default_factory=RowSettings)
    watch: LieWatch | None = None
    _tracks: dict[int, deque[Track]] = field(default_factory=dict)
    _pending: deque[RangeMeasurement] = field(default_factory=lambda: deque(maxlen=_PENDING_KEPT))
    _samples: dict[tuple[int, int], deque[tuple[float, float, float]]] = field(default_factory=dict)

    def place(self, vehicle: int, track: Track) -> None:
        """Take where a vehicle is held to be. When it turns from claimed to free or back, what was heard of it is forgotten."""
        known = self._tracks.get(vehicle)
        if known is None or known[-1].free != track.free:
            known = self._tracks[vehicle] = deque(maxlen=_PLACES_KEPT)
            for pair in [pair for pair in self._samples if vehicle in pair]:
                del self._samples[pair]
            if self.watch is not None:
                self.watch.forget(vehicle)
        if not known or track.at_s > known[-1].at_s:
            known.append(track)

    def range(self, measurement: RangeMeasurement) -> None:
        """Take a range; it is compared once the positions of its time have arrived."""
        self._pending.append(measurement)

    def scene(self, now_s: float) -> Scene:
        """Return the fleet as it was in the middle of the window that ends `wait_s` ago."""
        self._compare(now_s)
        s = self.settings
        middle_s = now_s - s.wait_s - 0.5 * s.window_s
        places: dict[int, Place] = {}
        rows: list[Row] = []
        per_device: Counter[int] = Counter()
        for (i, j), kept in sorted(self._samples.items()):
            recent = [sample for sample in kept if sample[0] > now_s - s.wait_s - s.window_s]
            samples = recent if len(recent) >= s.enough_ranges else list(kept)
            if len(samples) < s.least_ranges or per_device[i] >= _PEERS_PER_DEVICE:
                continue
            a, b = self._at(i, middle_s), self._at(j, middle_s)
            if a is None or b is None or dist(a.position_enu_m, b.position_enu_m) < _LEAST_DISTANCE_M:
                continue
            places[i], places[j] = a, b
            rows.append(self._row(i, j, samples))
            per_device[i] += 1
        return Scene(middle_s, places, tuple(rows))

    def _row(self, i: int, j: int, samples: list[tuple[float, float, float]]) -> Row:
        s = self.settings
        residual_m, stated_m = median(sample[1] for sample in samples), median(sample[2] for sample in samples)
        # Where so many are late that the median is one of them, the quartiles lie far apart.
        ordered = sorted(sample[1] for sample in samples)
        quarter = len(ordered) // 4
        scatter_m = (ordered[-1 - quarter] - ordered[quarter]) / _QUARTILES_PER_SIGMA
        noise_m2 = max(stated_m, scatter_m) ** 2 * _MEDIAN_VARIANCE_GAIN / len(samples)
        return Row(i, j, residual_m, sqrt(noise_m2 + s.slow_share * stated_m**2), s.range_bias_m)

    def _compare(self, now_s: float) -> None:
        """Turn the ranges that positions have arrived for into residuals."""
        ready_s = now_s - self.settings.wait_s
        waiting = [m for m in self._pending if m.measured_at_s > ready_s]
        for m in self._pending:
            if m.measured_at_s > ready_s:
                continue
            a, b = self._at(m.from_vehicle, m.measured_at_s), self._at(m.to_vehicle, m.measured_at_s)
            if a is None or b is None:
                continue
            if self.watch is not None:
                self.watch.range(m, a, b)
            distance_m = dist(a.position_enu_m, b.position_enu_m)
            samples = self._samples.setdefault((m.from_vehicle, m.to_vehicle), deque(maxlen=_SAMPLES_KEPT))
            samples.append((m.measured_at_s, m.range_m - distance_m, m.sigma_m))
        self._pending.clear()
        self._pending.extend(waiting)
        oldest_s = ready_s - self.settings.longest_s
        for pair, samples in list(self._samples.items()):
            fresh = [sample for sample in samples if sample[0] > oldest_s]
            if fresh:
                self._samples[pair] = deque(fresh, maxlen=_SAMPLES_KEPT)
            else:
                del self._samples[pair]

    def _at(self, vehicle: int, at_s: float) -> Place | None:
        """Where a vehicle is held to have been: the track point next to the time, carried on by its velocity."""
        tracks = self._tracks.get(vehicle)
        if not tracks:
            return None
        later = bisect_left(tracks, at_s, key=_at_s)
        near = min(tracks[max(later - 1, 0)], tracks[min(later, len(tracks) - 1)], key=lambda track: abs(track.at_s - at_s))
        if abs(near.at_s - at_s) > _PLACE_AGE_S:
            return None
        position = near.position_enu_m + near.velocity_enu_mps * (at_s - near.at_s)
        return Place(position, near.sigma_h_m, near.sigma_v_m, near.free)
