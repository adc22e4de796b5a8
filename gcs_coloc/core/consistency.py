"""Keeps the claimed positions and the ranges of the last seconds, tests them against each other, and remembers who lied.

The test itself is `exclusion.judge`. Here is what it needs of memory: where vehicles were when a range was measured, a
median over a window (so that single outliers accuse nobody), the streaks that an accusation takes, and its end.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from statistics import median

import numpy as np

from gcs_coloc.core.exclusion import Kind, Levels, Place, Row, Verdict, judge
from gcs_coloc.core.measurements import FloatArray, RangeMeasurement

_PLACES_KEPT = 64
_SAMPLES_KEPT = 64
_PENDING_KEPT = 20_000
_PLACE_AGE_S = 0.6
_PEERS_PER_DEVICE = 8
_LEAST_DISTANCE_M = 1.0
_MEDIAN_VARIANCE_GAIN = 1.57  # of the median of Gaussian values over that of their mean


@dataclass(frozen=True, slots=True)
class ConsistencySettings:
    """The test of claimed positions against ranges.

    A test is made every `every_s` of the ranges of the last `window_s`, once positions have had `wait_s` to arrive. A liar is
    accused after `accuse_after` tests in a row that point at it alone, those among whom it cannot be told are suspected
    after `suspect_after`. A row counts from `least_ranges` ranges on. `range_bias_m` is the 1-sigma of what all ranges of a pair
    have in common, `slow_share` the share of their stated variance that no averaging removes.
    """

    every_s: float = 0.2
    window_s: float = 1.4
    wait_s: float = 0.3
    accuse_after: int = 3
    suspect_after: int = 4
    least_ranges: int = 3
    range_bias_m: float = 0.3
    slow_share: float = 0.1
    levels: Levels = field(default_factory=Levels)


@dataclass(frozen=True, slots=True)
class Track:
    """Where a vehicle is held to be at one time: ENU (3,) in m and m/s, else as `exclusion.Place`."""

    at_s: float
    position_enu_m: FloatArray
    velocity_enu_mps: FloatArray
    sigma_h_m: float
    sigma_v_m: float
    free: bool


@dataclass(frozen=True, slots=True)
class Accusation:
    """A vehicle whose claimed position the ranges to `peers` contradict by `size_m`."""

    peers: tuple[int, ...]
    size_m: float


@dataclass(slots=True)
class RangeConsistency:
    """The memory of one fleet. `accused` are the identified liars, `suspected` those among whom one cannot be told."""

    settings: ConsistencySettings = field(default_factory=ConsistencySettings)
    accused: dict[int, Accusation] = field(default_factory=dict)
    suspected: frozenset[int] = frozenset()
    last: Verdict | None = None
    _tracks: dict[int, deque[Track]] = field(default_factory=dict)
    _pending: deque[RangeMeasurement] = field(default_factory=lambda: deque(maxlen=_PENDING_KEPT))
    _rows: dict[tuple[int, int], deque[tuple[float, float, float]]] = field(default_factory=dict)
    _due_s: float = float("-inf")
    _told_s: float = float("-inf")
    _pointed_at: Counter[int] = field(default_factory=Counter)
    _among: Counter[int] = field(default_factory=Counter)

    def place(self, vehicle: int, track: Track) -> None:
        """Take where a vehicle is held to be. When it turns from claimed to free or back, what was heard of it is forgotten."""
        known = self._tracks.get(vehicle)
        if known is None or known[-1].free != track.free:
            known = self._tracks[vehicle] = deque(maxlen=_PLACES_KEPT)
            for pair in [pair for pair in self._rows if vehicle in pair]:
                del self._rows[pair]
        if not known or track.at_s > known[-1].at_s:
            known.append(track)

    def range(self, measurement: RangeMeasurement) -> None:
        """Take a range; it is compared once the positions of its time have arrived."""
        self._pending.append(measurement)

    def acquit(self, vehicle: int) -> None:
        """Take an accusation back."""
        self.accused.pop(vehicle, None)

    def review(self, now_s: float) -> None:
        """Make the test if one is due, and move accusations and suspicions on."""
        if now_s < self._due_s:
            return
        self._due_s = now_s + self.settings.every_s
        self._compare(now_s)
        places, rows = self._scene(now_s)
        self.last = verdict = judge(places, rows, self.settings.levels)
        if verdict is None:
            if now_s - self._told_s > 10.0 * self.settings.window_s:
                self.suspected = frozenset()
            return
        self._told_s = now_s
        if verdict.consistent:
            self._pointed_at.clear()
            self._among.clear()
            if verdict.clear:
                self.suspected = frozenset()
            return
        self._weigh(verdict, rows)

    def _weigh(self, verdict: Verdict, rows: list[Row]) -> None:
        kinds = {s.kind for s in verdict.possible}
        liars = {s.vehicles[0]: s for s in verdict.possible if s.kind is Kind.VEHICLE}
        if kinds and Kind.VEHICLE not in kinds:
            # A bad range accuses nobody: the positions around it agree with each other without it.
            self._pointed_at.clear()
            self._among.clear()
            return
        among = frozenset(liars) if liars else verdict.involved
        self._among = Counter({v: self._among[v] + 1 for v in among})
        alone = next(iter(liars)) if kinds == {Kind.VEHICLE} and len(liars) == 1 else None
        self._pointed_at = Counter({alone: self._pointed_at[alone] + 1}) if alone is not None else Counter()
        if alone is not None and self._pointed_at[alone] >= self.settings.accuse_after:
            peers = {v for row in rows for v in (row.from_vehicle, row.to_vehicle) if alone in (row.from_vehicle, row.to_vehicle)}
            self.accused[alone] = Accusation(tuple(sorted(peers - {alone})), liars[alone].size_m)
            self.suspected = frozenset()
            self._among.clear()
            self._pointed_at.clear()
        else:
            self.suspected |= {v for v, n in self._among.items() if n >= self.settings.suspect_after}

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
            distance_m = float(np.linalg.norm(a.position_enu_m - b.position_enu_m))
            pair = (m.from_vehicle, m.to_vehicle)
            samples = self._rows.setdefault(pair, deque(maxlen=_SAMPLES_KEPT))
            samples.append((m.measured_at_s, m.range_m - distance_m, m.sigma_m))
        self._pending.clear()
        self._pending.extend(waiting)
        oldest_s = ready_s - self.settings.window_s
        for pair, samples in list(self._rows.items()):
            fresh = [sample for sample in samples if sample[0] > oldest_s]
            if fresh:
                self._rows[pair] = deque(fresh, maxlen=_SAMPLES_KEPT)
            else:
                del self._rows[pair]

    def _scene(self, now_s: float) -> tuple[dict[int, Place], list[Row]]:
        s = self.settings
        middle_s = now_s - s.wait_s - 0.5 * s.window_s
        places: dict[int, Place] = {}
        rows: list[Row] = []
        per_device: Counter[int] = Counter()
        for (i, j), samples in sorted(self._rows.items()):
            if len(samples) < s.least_ranges or per_device[i] >= _PEERS_PER_DEVICE:
                continue
            a, b = self._at(i, middle_s), self._at(j, middle_s)
            if a is None or b is None or np.linalg.norm(a.position_enu_m - b.position_enu_m) < _LEAST_DISTANCE_M:
                continue
            sigma_m = median(sample[2] for sample in samples)
            variance_m2 = sigma_m**2 * (_MEDIAN_VARIANCE_GAIN / len(samples) + s.slow_share) + s.range_bias_m**2
            places[i], places[j] = a, b
            rows.append(Row(i, j, median(sample[1] for sample in samples), float(np.sqrt(variance_m2))))
            per_device[i] += 1
        return places, rows

    def _at(self, vehicle: int, at_s: float) -> Place | None:
        """Where a vehicle is held to have been: the track point next to the time, carried on by its velocity."""
        tracks = self._tracks.get(vehicle)
        if not tracks:
            return None
        near = min(tracks, key=lambda track: abs(track.at_s - at_s))
        if abs(near.at_s - at_s) > _PLACE_AGE_S:
            return None
        position = near.position_enu_m + near.velocity_enu_mps * (at_s - near.at_s)
        return Place(position, near.sigma_h_m, near.sigma_v_m, near.free)
