"""Range consistency: detects and identifies faulty reported positions over time.

It uses the tests of single epochs (`fault_tests`, `isolation`).

Each review tests the present epoch alone and against epochs some seconds earlier. This module has what the tests need of memory:
how many independent samples in a row isolate a vehicle, and how the solution separation decays (`detection`: who is detected).
Samples are independent where their windows do not overlap: an outlier that lasts as long as a window is in one of them only.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from math import exp, sqrt
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.integrity.detection import Detection
from gcs_coloc.core.integrity.epoch_tests.accuracy_evidence import AccuracyEvidence
from gcs_coloc.core.integrity.epoch_tests.epoch import EPOCH_TOLERANCE_S, Epoch, EpochHistory, Past
from gcs_coloc.core.integrity.epoch_tests.fault_tests import FaultTestResult, SignificanceLevels, run_tests
from gcs_coloc.core.integrity.epoch_tests.inconsistency import explain_inconsistency
from gcs_coloc.core.integrity.epoch_tests.isolation import Isolation, IsolationPersistence, isolate
from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel, clearly_smaller_noise
from gcs_coloc.core.integrity.epoch_tests.pair_outliers import Pair
from gcs_coloc.core.integrity.fault_monitor import FaultMonitor, FaultMonitorSettings
from gcs_coloc.core.integrity.range_residuals import RangeResidualBuffer, RangeResidualSettings, TrackPoint
from gcs_coloc.core.integrity.solution_separation import noise_excess_m2
from gcs_coloc.core.measurements import FloatArray, RangeMeasurement
from gcs_coloc.core.schedule import SAME_S
from gcs_coloc.core.setting_bounds import Bounds, between, check_bounds, positive

_INTERVALS = Bounds(0.0, 600.0, open_below=True)
"""0 is the present alone. Chosen: after ten minutes position errors have nothing in common, and all epochs since are kept."""
_HOLD_WINDOWS = 10.0  # without any test for so many windows a detection ends
_SMALLER_WINDOWS = 10
"""Windows in a row in which a smaller noise is clearly likelier before it counts. Chosen: lasting errors show in each of them."""
_COARSE_SIGMAS = 16.0
"""Offset of a sound receiver, in stated sigmas, at most. Chosen: four of one that states a quarter of its error."""
_COARSE_CHANGE_SIGMAS = 12.0
"""The same of the change of its offset, in sigmas of a Gauss-Markov process. Chosen: three of such a receiver. With four a walk
of 2 m/s that sets out from 1.3 m would be named after 9 s."""
_PAIRS_FAIL_FOR_S = 60.0
"""For so long after pairs were off several may be at once. Chosen: a fleet takes as long to leave buildings and hills behind."""


@dataclass(frozen=True, slots=True)
class ConsistencySettings:
    """When tests run, and what their results lead to."""

    period_s: float = positive(0.2, most=EPOCH_TOLERANCE_S)
    """Tests run so often, s. Chosen: as often as ranges and positions come. With more, intervals would have no earlier epoch."""
    intervals_s: tuple[float, ...] = (2.0, 5.0, 12.0)
    """Tested are the present, and the change since so long ago, s. Chosen: a ramp of 5 m/s shows within the first, one of 1 m/s
    within the last."""
    correlation_time_s: float = positive(30.0)
    """A fault-free position error is a Gauss-Markov process of this time, s. Source: errors of GNSS positions are correlated for
    half a minute to minutes."""
    identify_after: int = between(2, 1)
    """Independent samples in a row that isolate a vehicle before it is identified. Chosen: an outlier that lasts as long as a
    window is in one of them only."""
    detect_after: int = between(2, 1)
    """The same before vehicles among which the fault is not isolated are detected."""
    decay_time_s: float = positive(2.0)
    """Solution separation decays over so long, s. Chosen: as an estimate forgets what displaced it."""
    alert_s: float = between(30.0, 0.0)
    """While a fault is identified or detected, and for so much longer (s), it decays over `alert_decay_time_s`. Chosen: the
    correlation time of a fault-free position error."""
    alert_decay_time_s: float = positive(10.0)
    """Chosen: what remains of a fault in the estimate is gone after two or three times as long."""
    detection_hold_s: float = between(20.0, 0.0)
    """A detection by the fault monitor lasts for so long, s. Chosen: it does not come and go while a fault grows slowly."""
    residuals: RangeResidualSettings = field(default_factory=RangeResidualSettings)
    """Of the residuals of ranges."""
    levels: SignificanceLevels = field(default_factory=SignificanceLevels)
    """Of the tests of single epochs."""
    fault_monitor: FaultMonitorSettings = field(default_factory=FaultMonitorSettings)
    """Of the fault monitor."""

    def __post_init__(self) -> None:
        check_bounds(self)
        if not self.intervals_s or not all(map(_INTERVALS.admit, self.intervals_s)):
            raise ValueError(f"intervals_s must have one interval or more, each {_INTERVALS} s, not {self.intervals_s}")


@dataclass(frozen=True, slots=True)
class IdentifiedFault:
    """A vehicle whose reported position the ranges to `peers` contradict by `size_m`."""

    peers: tuple[int, ...]
    size_m: float


class _Tests(NamedTuple):
    """The tests of one epoch, alone and against earlier ones.

    `pasts` are what the epoch is tested against, `results` the results of the tests with redundancy. Both are by interval in s,
    0 for the present alone.
    """

    epoch: Epoch
    pasts: Mapping[float, Past]
    results: Mapping[float, FaultTestResult]


class RangeConsistency:
    """The consistency monitor of one fleet.

    `epoch` is the newest one, with the pairs that are ranged seldom, `stated_epoch` that with its noise as stated. `identified`
    are the faulty vehicles. `separation_m2` has, for each vehicle without prior, the second moment (2, 2) of its solution
    separation, m^2. `noise` is how much worse ranges and positions were found to be than they state.
    """

    def __init__(self, settings: ConsistencySettings | None = None) -> None:
        self.settings = settings if settings is not None else ConsistencySettings()
        self.stated_epoch = self.epoch = Epoch(float("-inf"), {}, ())
        self.identified: dict[int, IdentifiedFault] = {}
        self.separation_m2: dict[int, FloatArray] = {}
        self.noise = NoiseModel()
        self._fault_monitor = FaultMonitor(self.settings.fault_monitor, self.settings.residuals.errors)
        self._residuals = RangeResidualBuffer(self.settings.residuals, self._fault_monitor)
        self._decayed_m2: dict[int, FloatArray] = {}
        self._detection = Detection()
        s = self.settings
        self._epochs = self._no_epochs()
        self._persistence = {interval_s: IsolationPersistence() for interval_s in (0.0, *s.intervals_s)}
        self._alert_until_s: dict[int, float] = {}
        self._pairs_fail_until_s = float("-inf")
        self._shrink_due_s = float("-inf")
        self._smaller_windows = 0
        self._accuracy = AccuracyEvidence()
        self._due_s = float("-inf")
        self._tested_s = float("-inf")

    @property
    def detected(self) -> frozenset[int]:
        """The vehicles among which a fault is not isolated."""
        return self._detection.vehicles

    @property
    def also(self) -> dict[frozenset[int], float] | None:
        """Receivers in use that may be off as well, or instead, with their odds (`Detection.also`)."""
        return self._detection.also(self.epoch.reporting, self.settings.levels.margin)

    def add_position(self, vehicle: int, point: TrackPoint) -> None:
        """Add a vehicle's position. When it gains or loses its prior, its residuals so far are dropped."""
        self._residuals.add_position(vehicle, point)

    def drop(self, vehicle: int) -> None:
        """Drop the positions and residuals of a vehicle that is not in the tests any more."""
        self._residuals.drop(vehicle)

    def forget(self, vehicle: int) -> None:
        """Forget a vehicle that makes room for another one; a detection lapses by itself."""
        self.drop(vehicle)
        self.readmit(vehicle)
        self._decayed_m2.pop(vehicle, None)
        self._alert_until_s.pop(vehicle, None)

    def add_range(self, measurement: RangeMeasurement) -> None:
        """Add a range; its residual is computed once the positions of its time have arrived."""
        self._residuals.add_range(measurement)

    def add_selected(self, pair: Pair, measured_at_s: float) -> None:
        """Add that the estimator used or refused a range of a pair."""
        self._residuals.add_selected(pair, measured_at_s)

    def ranged_at_s(self, vehicle: int) -> float | None:
        """Return the time of the newest range of a vehicle, in s; None where there is none of late."""
        return self._residuals.ranged_at_s(vehicle)

    def readmit(self, vehicle: int) -> None:
        """End the exclusion of an identified vehicle."""
        self.identified.pop(vehicle, None)

    def review(self, now_s: float, doubtful: Collection[int] = (), not_used: Collection[int] = ()) -> None:
        """Run the tests if they are due.

        They update identified and detected faults, and the solution separation.

        `doubtful` are the vehicles whose receivers speak against themselves: it isolates them where the ranges leave it open.
        `not_used` are those whose positions are tested but no anchors of the estimator: only the others move its estimates.
        """
        if now_s < self._due_s:
            return
        self._due_s = now_s + self.settings.period_s - SAME_S
        whole, left = self._residuals.epoch(now_s, self._detection.vehicles), self.noise.after(self.settings.period_s)
        tests = self._test(whole, left)
        self.noise = explain_inconsistency(whole, tests.results.get(0.0), left, self.settings.levels, doubtful)
        if self.noise.pairs_off:
            self._pairs_fail_until_s = now_s + _PAIRS_FAIL_FOR_S
        self._shrink_noise(self.noise.select(whole), now_s)
        stated = self.noise.select(whole)
        if not self.identified and not self.detected:
            self.noise = self._accuracy.update(stated, self.noise, self.settings.levels, self.settings.correlation_time_s)
        self._run_fault_monitor(stated, now_s)
        tested = tests if self.noise is left else self._test(stated, self.noise)
        self._use_tests(tested, now_s, doubtful)
        not_used = self.detected.union(not_used)
        used = stated.without_priors(not_used)
        self._update_separation(self._test(used, self.noise, not_used) if used is not stated else tested, now_s)
        self.stated_epoch = self.noise.select(self._residuals.sparse_epoch(now_s, whole)).without_priors(not_used)
        self.epoch = self.noise.apply(self.stated_epoch)
        self._epochs.append(stated)
        monitored = self._fault_monitor.separation_m2(now_s)
        self.separation_m2 = {
            vehicle: max((each[vehicle] for each in (self._decayed_m2, monitored) if vehicle in each), key=_trace)
            for vehicle in self._decayed_m2.keys() | monitored.keys()
        }
        for vehicle, excess_m2 in noise_excess_m2(self.stated_epoch, self.epoch).items():
            self.separation_m2[vehicle] = self.separation_m2.get(vehicle, 0.0) + excess_m2

    def _shrink_noise(self, stated: Epoch, now_s: float) -> None:
        """Reduce the noise where the ranges have been clearly likelier with less for a while."""
        if self.noise.is_as_stated:
            self._smaller_windows = 0
        elif stated.residuals and now_s >= self._shrink_due_s:
            self._shrink_due_s = now_s + self.settings.residuals.window_s - SAME_S
            smaller = clearly_smaller_noise(stated, self.noise, self.settings.levels)
            self._smaller_windows = self._smaller_windows + 1 if smaller is not None else 0
            if smaller is not None and self._smaller_windows >= _SMALLER_WINDOWS:
                self.noise, self._smaller_windows = smaller, 0
                # Earlier epochs were kept with the pairs that were off in them.
                self._epochs = self._no_epochs()

    def _no_epochs(self) -> EpochHistory:
        return EpochHistory(self.settings.intervals_s, self.settings.correlation_time_s, self.settings.period_s)

    def _run_fault_monitor(self, epoch: Epoch, now_s: float) -> None:
        """Detect faulty peers from the ranges of denied vehicles, by the fault monitor.

        It does so only where no ranges among other vehicles can test more.
        """
        pairs, found = [residual.pair for residual in epoch.residuals], frozenset[int]()
        excluded = self.detected | self.identified.keys()
        self._fault_monitor.step(now_s - self.settings.residuals.wait_s, excluded, self.noise, pairs)
        if not any(not epoch.priors[a].no_prior and not epoch.priors[b].no_prior for a, b in pairs):
            found = self._fault_monitor.detected()
        self._detection.add_monitored(found, now_s, self.settings.detection_hold_s)

    def _test(self, stated: Epoch, noise: NoiseModel, not_used: Collection[int] = ()) -> _Tests:
        """Test an epoch with some noise, alone and against earlier ones.

        The earlier ones are taken without the positions that are not used.
        """
        epoch = noise.apply(stated)
        pasts: dict[float, Past] = {
            interval_s: (noise.apply(then.without_priors(not_used)) if then is not None else None, correlation)
            for interval_s, (then, correlation) in self._epochs.pasts(stated.at_s).items()
        }
        results = run_tests(epoch, self.settings.levels, list(pasts.values()))
        return _Tests(epoch, pasts, {at: result for at, result in zip(pasts, results, strict=True) if result is not None})

    def _use_tests(self, tests: _Tests, now_s: float, doubtful: Collection[int]) -> None:
        epoch, pasts, results = tests
        if not results:
            if now_s - self._tested_s > _HOLD_WINDOWS * self.settings.residuals.window_s:
                self._detection.end_of_tests()
            return
        self._tested_s = now_s
        self._update_faults(now_s, results, epoch, pasts, doubtful)
        if all(result.is_clear for result in results.values()):
            self._detection.end_of_tests()

    def _update_faults(
        self,
        now_s: float,
        results: Mapping[float, FaultTestResult],
        epoch: Epoch,
        pasts: Mapping[float, Past],
        doubtful: Collection[int],
    ) -> None:
        pairs_fail = now_s <= self._pairs_fail_until_s
        samples: dict[float, Isolation] = {}
        for interval_s, result in results.items():
            persistence = self._persistence[interval_s]
            if result.is_consistent:
                persistence.reset()
            elif epoch.began_s >= persistence.sampled_until_s:
                persistence.sampled_until_s = epoch.ended_s
                samples[interval_s] = isolate(epoch, pasts[interval_s], self.settings.levels, doubtful, pairs_fail=pairs_fail)
        if any(sample.is_of_one_pair for sample in samples.values()):
            self._pairs_fail_until_s = now_s + _PAIRS_FAIL_FOR_S
        identified: dict[int, float] = {}
        coarse: set[int] = set()
        for interval_s, sample in samples.items():
            persistence = self._persistence[interval_s]
            if sample.is_range_fault:
                # The positions agree without it.
                persistence.reset()
                continue
            persistence.add(sample.isolated, sample.possible if sample.plausible else results[interval_s].suspects)
            found = {
                vehicle: size_m
                for vehicle, size_m in sample.isolated.items()
                if persistence.isolated[vehicle] >= self.settings.identify_after
                and all(vehicle in each.possible for each in samples.values() if each.plausible)
            }
            spared = {v for v in found if self._may_be_coarse(v, sample, epoch, pasts[interval_s])}.difference(doubtful)
            coarse |= spared
            identified |= {vehicle: size_m for vehicle, size_m in found.items() if vehicle not in spared}
        for vehicle, size_m in identified.items():
            peers = {v for residual in epoch.residuals for v in residual.pair if vehicle in residual.pair}
            self.identified[vehicle] = IdentifiedFault(tuple(sorted(peers - identified.keys())), size_m)
        if identified:
            self._detection.remove(identified)
            for each in self._persistence.values():
                each.reset()
            return
        if coarse:
            self._detection.limit_to(coarse, now_s)
            return
        of_positions = {at: sample for at, sample in samples.items() if not sample.is_range_fault}
        suspected = {
            vehicle
            for interval_s, sample in of_positions.items()
            if not sample.isolated
            for vehicle, times in self._persistence[interval_s].possible.items()
            if times >= self.settings.detect_after
        }
        self._detection.add_samples(of_positions, suspected, now_s)

    def _may_be_coarse(self, vehicle: int, sample: Isolation, epoch: Epoch, past: Past) -> bool:
        """Return whether an isolated receiver may be sound, and only state too small an error.

        Its offset, and the change of the offset, are then no larger than such a receiver may have.
        """
        stated_m = epoch.priors[vehicle].sigma_h_m / self.noise.position_factor
        _, correlation = past
        most_change_m = _COARSE_CHANGE_SIGMAS * stated_m * sqrt(2.0 * (1.0 - correlation))
        return sample.isolated[vehicle] <= _COARSE_SIGMAS * stated_m and sample.changes_m[vehicle] <= most_change_m

    def _update_separation(self, tests: _Tests, now_s: float) -> None:
        """Update how far faults among the positions in use may have moved the vehicles without prior."""
        epoch, _, results = tests
        s, age_s, present = self.settings, now_s - epoch.at_s, results.get(0.0)
        for vehicle in {v for result in results.values() for v in result.separation_m2}:
            # What grew within an interval has grown on since the epoch.
            new = max(
                (
                    result.separation_m2[vehicle] * (1.0 + age_s / interval_s if interval_s else 1.0) ** 2
                    for interval_s, result in results.items()
                    if vehicle in result.separation_m2
                ),
                key=_trace,
            )
            if self.identified or self.detected:
                self._alert_until_s[vehicle] = now_s + s.alert_s
            is_alert = now_s < self._alert_until_s.get(vehicle, now_s)
            if is_alert and present is not None and vehicle in present.separation_m2:
                # The effect of the fault that remains in the estimate after the faulty vehicle is excluded.
                offset_m = present.offset_m(vehicle)
                new = new + np.outer(offset_m, offset_m)
            decay = exp(-s.period_s / (s.alert_decay_time_s if is_alert else s.decay_time_s))
            old = self._decayed_m2.get(vehicle)
            if old is not None and _trace(old) * decay > _trace(new):
                new = old * decay
            self._decayed_m2[vehicle] = new


def _trace(moment_m2: FloatArray) -> float:
    return float(moment_m2.item(0) + moment_m2.item(3))
