"""Range consistency: detects and identifies faulty reported positions over time.

Each review tests the present epoch alone and against epochs some seconds earlier. This module has what the tests need of memory:
how many independent samples in a row isolate a vehicle, and how the solution separation decays (`detection`: who is detected).
Samples are independent where their windows do not overlap: an outlier that lasts as long as a window is in one of them only.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import exp, inf, sqrt
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.gps_health.evidence import FaultReason, PositionFault
from gcs_coloc.core.integrity.detection import Detection
from gcs_coloc.core.integrity.epoch_tests.epoch import INTERVALS_S, MIN_SIGMA_M, PERIOD_S, Epoch, EpochHistory, Past
from gcs_coloc.core.integrity.epoch_tests.fault_tests import RULED_OUT_MARGIN, WELL_PLACED_SIGMA_M, FaultTestResult, run_tests
from gcs_coloc.core.integrity.epoch_tests.gross_faults import gross_faults, without_ranges_of
from gcs_coloc.core.integrity.epoch_tests.isolation import Isolation, IsolationPersistence, isolate
from gcs_coloc.core.integrity.epoch_tests.noise_evidence import AccuracyEvidence, SmallerNoise, explain_inconsistency
from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel
from gcs_coloc.core.integrity.fault_monitor import FaultMonitor
from gcs_coloc.core.integrity.range_residuals import WAIT_S, WINDOW_S, RangeResidualBuffer
from gcs_coloc.core.integrity.solution_separation import noise_excess_m2
from gcs_coloc.core.integrity.unisolated_ranges import UnisolatedRanges
from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.core.schedule import SAME_S
from gcs_coloc.core.stations.node_id import is_station

_IDENTIFY_AFTER = 2
"""Independent samples in a row that isolate a vehicle before it is identified. Chosen: an outlier that lasts as long as a window
is in one of them only."""
_DETECT_AFTER = 2  # the same before vehicles among which the fault is not isolated are detected
_DECAY_TIME_S = 2.0  # solution separation decays over so long; chosen: as an estimate forgets what displaced it
_ALERT_S = 30.0
"""While a fault is identified or detected, and for so much longer, it decays over `_ALERT_DECAY_TIME_S`, unless all that is
detected is identified and the remaining ranges confirm the estimate. Chosen: the correlation time of a fault-free position
error."""
_ALERT_DECAY_TIME_S = 10.0  # chosen: what remains of a fault in the estimate is gone after two or three times as long
_DETECTION_HOLD_S = 20.0
"""A detection by the fault monitor lasts for so long. Chosen: it does not come and go while a fault grows slowly."""
_HOLD_WINDOWS = 10.0  # without any test for so many windows a detection ends
_COARSE_SIGMAS = 16.0
"""Offset of a sound receiver, in stated sigmas, at most. Chosen: four of one that states a quarter of its error."""
_COARSE_CHANGE_SIGMAS = 12.0
"""The same of the change of its offset, in sigmas of a Gauss-Markov process. Chosen: three of such a receiver. With four a walk
of 2 m/s that sets out from 1.3 m would be named after 9 s."""
_PAIRS_FAIL_FOR_S = 60.0
"""For so long after pairs were off several may be at once. Chosen: a fleet takes as long to leave buildings and hills behind."""
_STATION_RIGHT_S = 60.0  # chosen: nothing moves a station back; ranges that fit it for less passed it where they show nothing


class _Tests(NamedTuple):
    """The tests of one epoch, alone and against earlier ones.

    `pasts` are what the epoch is tested against, `results` the results of the tests with redundancy. Both are by interval in s,
    0 for the present alone.
    """

    epoch: Epoch
    pasts: Mapping[float, Past]
    results: Mapping[float, FaultTestResult]


@dataclass(slots=True)
class _Node:
    """What the tests have found of one vehicle or station.

    `fault`: it is identified. `right_since_s`: since when its receiver has been right again. `decayed_m2`: what the tests left of
    its solution separation, until `alert_until_s` with the slower decay.
    """

    fault: PositionFault | None = None
    right_since_s: float = inf
    decayed_m2: FloatArray | None = None
    alert_until_s: float = -inf


class RangeConsistency:
    """The consistency monitor of one fleet.

    `residuals` is the buffer that positions and ranges are added to. `epoch` is the newest epoch, with the pairs that are ranged
    seldom, `stated_epoch` that with its noise as stated. `separation_m2` has, for each vehicle without prior, the second moment
    (2, 2) of its solution separation, m^2. `noise` is how much worse ranges and positions were found to be than they state.
    `unisolated` has the ranges that may be off while it is open which.
    """

    def __init__(self) -> None:
        self._fault_monitor = FaultMonitor()
        self.residuals = RangeResidualBuffer(self._fault_monitor)
        self.stated_epoch = self.epoch = Epoch(float("-inf"), {}, ())
        self.separation_m2: dict[int, FloatArray] = {}
        self.noise = NoiseModel()
        self.unisolated = UnisolatedRanges()
        self._nodes: defaultdict[int, _Node] = defaultdict(_Node)
        self._detection = Detection()
        self._epochs = EpochHistory()
        self._persistence = {interval_s: IsolationPersistence() for interval_s in (0.0, *INTERVALS_S)}
        self._grossly_off = IsolationPersistence()
        self._pairs_fail_until_s = float("-inf")
        self._smaller_noise = SmallerNoise()
        self._accuracy = AccuracyEvidence()
        self._due_s = float("-inf")
        self._tested_s = float("-inf")

    @property
    def identified(self) -> dict[int, PositionFault]:
        """The faulty vehicles and stations that were not readmitted."""
        return {node: found.fault for node, found in self._nodes.items() if found.fault is not None}

    @property
    def detected(self) -> frozenset[int]:
        """The vehicles among which a fault is not isolated."""
        return self._detection.vehicles

    @property
    def also(self) -> dict[frozenset[int], float] | None:
        """Receivers in use that may be off as well, or instead, with their odds (`Detection.also`)."""
        return self._detection.also(self.epoch.reporting, RULED_OUT_MARGIN)

    def forget(self, vehicle: int) -> None:
        """Forget a vehicle that makes room for another one; a detection lapses by itself."""
        self.residuals.drop(vehicle)
        self._nodes.pop(vehicle, None)
        self.unisolated.forget(vehicle)

    def readmit(self, right: Collection[int], now_s: float) -> None:
        """Readmit the identified nodes whose receiver is right now; a station only once it was for a while."""
        for node in self.identified:
            found = self._nodes[node]
            found.right_since_s = min(found.right_since_s, now_s) if node in right else inf
            if now_s - found.right_since_s >= (_STATION_RIGHT_S if is_station(node) else 0.0):
                found.fault, found.right_since_s = None, inf

    def review(self, now_s: float, doubtful: Collection[int] = (), not_used: Collection[int] = ()) -> None:
        """Run the tests if they are due: they update the faults and the solution separation.

        `doubtful` are the vehicles whose receivers speak against themselves: it isolates them where the ranges leave it open.
        `not_used` are those whose positions are tested but no anchors of the estimator: only the others move its estimates.
        """
        if now_s < self._due_s:
            return
        self._due_s = now_s + PERIOD_S - SAME_S
        whole, left = self.residuals.epoch(now_s, self.detected), self.noise.after(PERIOD_S)
        off = gross_faults(whole)
        self._identify_gross_faults(off, whole)
        whole = without_ranges_of(whole, off)
        tests = self._test(whole, left)
        self.noise = self._find_noise(whole, tests.results.get(0.0), left, now_s, doubtful)
        self.unisolated.add(self.noise, now_s)
        stated = self.noise.select(whole)
        self._run_fault_monitor(stated, now_s)
        tests = tests if self.noise is left else self._test(stated, self.noise)
        self._update_faults(tests, now_s, doubtful)
        not_used = self.detected.union(self.identified, not_used)
        used = (self.noise.expose(whole) if self.noise.unisolated else stated).without_priors(not_used)
        tests = self._test(used, self.noise, not_used) if used is not stated else tests
        self._update_decayed(tests, now_s, whole.reporting)
        sparse = self.residuals.sparse_epoch(now_s, whole)
        self.stated_epoch = self.noise.expose(without_ranges_of(sparse, gross_faults(sparse))).without_priors(not_used)
        self.epoch = self.noise.apply(self.stated_epoch)
        self._epochs.append(stated)
        self._update_separation(now_s)

    def _test(self, stated: Epoch, noise: NoiseModel, not_used: Collection[int] = ()) -> _Tests:
        """Test an epoch with some noise, alone and against earlier ones without the positions not used."""
        epoch = noise.apply(stated)
        pasts: dict[float, Past] = {
            interval_s: (noise.apply(then.without_priors(not_used)) if then is not None else None, correlation)
            for interval_s, (then, correlation) in self._epochs.pasts(stated.at_s).items()
        }
        results = run_tests(epoch, list(pasts.values()))
        return _Tests(epoch, pasts, {at: result for at, result in zip(pasts, results, strict=True) if result is not None})

    def _find_noise(
        self, whole: Epoch, present: FaultTestResult | None, left: NoiseModel, now_s: float, doubtful: Collection[int]
    ) -> NoiseModel:
        """Return what is `left` of the noise, changed where the epoch and its test alone (`present`) show it."""
        noise = explain_inconsistency(whole, present, left, doubtful, self.unisolated.known(now_s))
        if noise.pairs_off:
            self._pairs_fail_until_s = now_s + _PAIRS_FAIL_FOR_S
        smaller = self._smaller_noise.update(noise.select(whole), noise, now_s)
        if smaller is not None:
            # Earlier epochs were kept with the pairs that were off in them.
            noise, self._epochs = smaller, EpochHistory()
        is_fault_free = not self.identified and not self.detected
        return self._accuracy.update(noise.select(whole), noise) if is_fault_free else noise

    def _run_fault_monitor(self, epoch: Epoch, now_s: float) -> None:
        """Run the fault monitor; it detects only where no ranges among other vehicles can test more."""
        pairs, found = [residual.pair for residual in epoch.residuals], frozenset[int]()
        self._fault_monitor.step(now_s - WAIT_S, self.detected | self.identified.keys(), self.noise, pairs)
        if not any(not epoch.priors[a].no_prior and not epoch.priors[b].no_prior for a, b in pairs):
            found = self._fault_monitor.detected()
        self._detection.add_monitored(found, now_s, _DETECTION_HOLD_S)

    def _update_faults(self, tests: _Tests, now_s: float, doubtful: Collection[int]) -> None:
        """Identify and detect faulty vehicles by the samples that are due."""
        results = tests.results
        if results:
            self._tested_s = now_s
            samples = self._isolate(tests, now_s, doubtful)
            identified, coarse = self._persistent(samples, tests, doubtful)
            if identified:
                self._identify(identified, tests.epoch)
            elif coarse:
                self._detection.limit_to(coarse, now_s)
            else:
                self._detect(samples, results.keys(), now_s)
        is_over = not results and now_s - self._tested_s > _HOLD_WINDOWS * WINDOW_S
        if is_over or (results and all(result.is_clear for result in results.values())):
            self._detection.end_of_tests()

    def _isolate(self, tests: _Tests, now_s: float, doubtful: Collection[int]) -> dict[float, Isolation]:
        """Return what explains each contradiction, by interval in s, where an independent sample is due."""
        epoch, pasts, results = tests
        pairs_fail = now_s <= self._pairs_fail_until_s
        samples: dict[float, Isolation] = {}
        for interval_s, result in results.items():
            persistence = self._persistence[interval_s]
            if result.is_consistent:
                persistence.reset()
            elif epoch.began_s > persistence.sampled_until_s:
                persistence.sampled_until_s = epoch.ended_s
                samples[interval_s] = isolate(epoch, pasts[interval_s], doubtful, pairs_fail=pairs_fail)
        if any(sample.is_of_one_pair for sample in samples.values()):
            self._pairs_fail_until_s = now_s + _PAIRS_FAIL_FOR_S
        return samples

    def _persistent(
        self, samples: Mapping[float, Isolation], tests: _Tests, doubtful: Collection[int]
    ) -> tuple[dict[int, float], set[int]]:
        """Return the vehicles that enough samples isolate, with offsets in m, and those spared as coarse."""
        identified: dict[int, float] = {}
        coarse: set[int] = set()
        for interval_s, sample in samples.items():
            persistence = self._persistence[interval_s]
            if sample.is_range_fault:
                # The positions agree without it.
                persistence.reset()
                continue
            persistence.add(sample, tests.results[interval_s].suspects)
            for vehicle, size_m in sample.isolated.items():
                is_in_all = all(vehicle in each.possible for each in samples.values() if each.plausible)
                if persistence.isolated[vehicle] < _IDENTIFY_AFTER or not is_in_all:
                    continue
                if vehicle not in doubtful and self._may_be_coarse(vehicle, sample, tests.epoch, tests.pasts[interval_s]):
                    coarse.add(vehicle)
                else:
                    identified[vehicle] = size_m
        return identified, coarse

    def _identify_gross_faults(self, found: Mapping[int, float], whole: Epoch) -> None:
        """Identify the vehicles that enough independent samples show to be grossly off."""
        seen = self._grossly_off
        if whole.began_s > seen.sampled_until_s:
            seen.sampled_until_s = whole.ended_s
            seen.isolated = Counter({vehicle: seen.isolated[vehicle] + 1 for vehicle in found})
            persistent = {vehicle: size_m for vehicle, size_m in found.items() if seen.isolated[vehicle] >= _IDENTIFY_AFTER}
            if persistent:
                self._identify(persistent, whole)

    def _identify(self, identified: Mapping[int, float], epoch: Epoch) -> None:
        for vehicle, size_m in identified.items():
            peers = {v for residual in epoch.residuals for v in residual.pair if vehicle in residual.pair}
            others = tuple(sorted(peers - identified.keys()))
            self._nodes[vehicle].fault = PositionFault(FaultReason.CONTRADICTS_RANGES, size_m, others)
        self._detection.remove(identified)
        for persistence in self._persistence.values():
            persistence.reset()

    def _detect(self, samples: Mapping[float, Isolation], tested: Collection[float], now_s: float) -> None:
        """Detect the vehicles that the samples allow to be at fault.

        The intervals that are `tested` (s) are sampled at different times: what the last sample of each allows counts.
        """
        of_positions = {at: sample for at, sample in samples.items() if not sample.is_range_fault}
        suspected = {
            vehicle
            for interval_s, sample in of_positions.items()
            if not sample.isolated
            for vehicle, times in self._persistence[interval_s].possible.items()
            if times >= _DETECT_AFTER
        }
        last = (self._persistence[interval_s].explained for interval_s in tested)
        explained = [vehicles for vehicles in last if vehicles is not None]
        self._detection.add_samples(of_positions, explained, suspected, now_s)

    def _may_be_coarse(self, vehicle: int, sample: Isolation, epoch: Epoch, past: Past) -> bool:
        """Return whether an isolated receiver may be sound, by its offset and the change of that."""
        stated_m = epoch.priors[vehicle].sigma_h_m / self.noise.position_factor
        _, correlation = past
        most_change_m = _COARSE_CHANGE_SIGMAS * stated_m * sqrt(2.0 * (1.0 - correlation))
        return sample.isolated[vehicle] <= _COARSE_SIGMAS * stated_m and sample.changes_m[vehicle] <= most_change_m

    def _update_decayed(self, tests: _Tests, now_s: float, reporting: frozenset[int]) -> None:
        """Update how far faults among the positions in use may have moved the vehicles without prior.

        The `reporting` are in the epoch where they report themselves, also without prior: that is no separation of an estimate.
        """
        epoch, _, results = tests
        age_s, present = now_s - epoch.at_s, results.get(0.0)
        is_faulty = bool(self.identified or self.detected)
        for vehicle in {v for result in results.values() for v in result.separation_m2} - reporting:
            # What grew within an interval has grown on since the epoch.
            new = max(
                (
                    result.separation_m2[vehicle] * (1.0 + age_s / interval_s if interval_s else 1.0) ** 2
                    for interval_s, result in results.items()
                    if vehicle in result.separation_m2
                ),
                key=_trace,
            )
            found = self._nodes[vehicle]
            if is_faulty:
                found.alert_until_s = now_s + _ALERT_S
            is_alert = now_s < found.alert_until_s
            if is_alert and present is not None and vehicle in present.separation_m2:
                # The effect of the fault that remains in the estimate after the faulty vehicle is excluded.
                offset_m = present.offset_m(vehicle)
                new = new + np.outer(offset_m, offset_m)
            is_confirmed = present is not None and vehicle in present.separation_m2 and present.confirms(vehicle)
            is_lasting = is_alert and (bool(self.detected) or not is_confirmed)
            decay = exp(-PERIOD_S / (_ALERT_DECAY_TIME_S if is_lasting else _DECAY_TIME_S))
            old = found.decayed_m2
            if old is not None and is_confirmed and not self.detected:
                # Positions that are kilometres off have left the estimate where the ranges place it without them.
                old = old * min(1.0, WELL_PLACED_SIGMA_M**2 / max(_trace(old), MIN_SIGMA_M**2))
            found.decayed_m2 = old * decay if old is not None and _trace(old) * decay > _trace(new) else new

    def _update_separation(self, now_s: float) -> None:
        """Take the larger separation of tests and fault monitor, with what noise beyond the stated one adds."""
        monitored = self._fault_monitor.separation_m2(now_s)
        tested = {node: found.decayed_m2 for node, found in self._nodes.items() if found.decayed_m2 is not None}
        self.separation_m2 = {
            vehicle: max((each[vehicle] for each in (tested, monitored) if vehicle in each), key=_trace)
            for vehicle in tested.keys() | monitored.keys()
        }
        for vehicle, excess_m2 in noise_excess_m2(self.stated_epoch, self.epoch).items():
            self.separation_m2[vehicle] = self.separation_m2.get(vehicle, 0.0) + excess_m2


def _trace(moment_m2: FloatArray) -> float:
    return float(moment_m2.item(0) + moment_m2.item(3))
