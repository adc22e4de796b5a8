"""Tests claimed positions against ranges, for what they are and for how they changed, and remembers who lied.

One test is `exclusion.judge_all`'s: of the present scene alone, and against scenes of some seconds ago. Here is what they need of
memory: the streaks that an accusation takes, its end, and how long a doubt about a position lasts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import exp

import numpy as np

from gcs_coloc.core.integrity.epoch import Epoch
from gcs_coloc.core.integrity.epoch_history import EpochHistory
from gcs_coloc.core.integrity.fault_monitor import FaultMonitor, FaultMonitorSettings
from gcs_coloc.core.integrity.fault_tests import FaultKind, FaultTestResult, SignificanceLevels, run_tests
from gcs_coloc.core.integrity.range_residuals import RangeResidualBuffer, RangeResidualSettings, ReportedTrack
from gcs_coloc.core.measurements import FloatArray, RangeMeasurement
from gcs_coloc.core.tick_schedule import SAME_S


@dataclass(frozen=True, slots=True)
class ConsistencySettings:
    """The test of claimed positions against ranges.

    A test is made every `every_s`: of the present, and of its change since each of `intervals_s` ago, in which an honest error
    wanders as a Gauss-Markov process of `wander_time_s` does. A liar is accused after `accuse_after` tests in a row that point
    at it alone, those among whom it cannot be told are suspected after `suspect_after`. A doubt about a position fades over
    `doubt_time_s`; while somebody is accused or suspected, and for `watched_s` more, it fades over `watched_time_s`. Whom the
    lines to a vehicle without GPS speak against is suspected for `suspected_s` since.
    """

    every_s: float = 0.2
    intervals_s: tuple[float, ...] = (2.0, 5.0, 12.0)
    wander_time_s: float = 30.0
    accuse_after: int = 3
    suspect_after: int = 6
    doubt_time_s: float = 2.0
    watched_s: float = 30.0
    watched_time_s: float = 10.0
    suspected_s: float = 20.0
    rows: RangeResidualSettings = field(default_factory=RangeResidualSettings)
    levels: SignificanceLevels = field(default_factory=SignificanceLevels)
    watch: FaultMonitorSettings = field(default_factory=FaultMonitorSettings)


@dataclass(frozen=True, slots=True)
class IdentifiedFault:
    """A vehicle whose claimed position the ranges to `peers` contradict by `size_m`."""

    peers: tuple[int, ...]
    size_m: float


@dataclass(slots=True)
class _Streak:
    """Verdicts of one kind of test in a row: who was the only possible liar, and who was among them."""

    pointed_at: Counter[int] = field(default_factory=Counter)
    among: Counter[int] = field(default_factory=Counter)

    def end(self) -> None:
        self.pointed_at.clear()
        self.among.clear()


class RangeConsistency:
    """The memory of one fleet. `accused` are the identified liars, `suspected` those among whom one cannot be told.

    `doubt_m2` has, for a vehicle that is placed by the estimator, the second moment (2, 2) of how far a fault may have moved it.
    """

    def __init__(self, settings: ConsistencySettings | None = None) -> None:
        self.settings = settings if settings is not None else ConsistencySettings()
        self.accused: dict[int, IdentifiedFault] = {}
        self.suspected: frozenset[int] = frozenset()
        self.doubt_m2: dict[int, FloatArray] = {}
        self._watch = FaultMonitor(self.settings.watch)
        self._rows = RangeResidualBuffer(self.settings.rows, self._watch)
        self._faded_m2: dict[int, FloatArray] = {}
        self._suspected_until_s: dict[int, float] = {}
        self._scenes = EpochHistory(self.settings.intervals_s, self.settings.wander_time_s, self.settings.every_s)
        self._streaks = {interval_s: _Streak() for interval_s in (0.0, *self.settings.intervals_s)}
        self._watched_until_s: dict[int, float] = {}
        self._due_s = float("-inf")
        self._told_s = float("-inf")

    def place(self, vehicle: int, track: ReportedTrack) -> None:
        """Take where a vehicle is held to be. When it turns from claimed to free or back, what was heard of it is forgotten."""
        self._rows.place(vehicle, track)

    def range(self, measurement: RangeMeasurement) -> None:
        """Take a range; it is compared once the positions of its time have arrived."""
        self._rows.range(measurement)

    def acquit(self, vehicle: int) -> None:
        """Take an accusation back."""
        self.accused.pop(vehicle, None)

    def review(self, now_s: float) -> None:
        """Make the tests if they are due, and move accusations, suspicions and doubts on."""
        if now_s < self._due_s:
            return
        self._due_s = now_s + self.settings.every_s - SAME_S
        scene = self._rows.scene(now_s)
        self._suspect(scene, now_s)
        self._test(scene, now_s)
        watched = self._watch.doubt_m2(now_s)
        self.doubt_m2 = {
            vehicle: max((doubt[vehicle] for doubt in (self._faded_m2, watched) if vehicle in doubt), key=_trace)
            for vehicle in self._faded_m2.keys() | watched.keys()
        }

    def _suspect(self, scene: Epoch, now_s: float) -> None:
        """Suspect whom the lines to a vehicle without GPS speak against, where there are no others that tell more."""
        self._watch.step(now_s - self.settings.rows.wait_s, self.suspected | self.accused.keys())
        if not any(not scene.places[a].free and not scene.places[b].free for a, b in (row.pair for row in scene.rows)):
            self._suspected_until_s |= dict.fromkeys(self._watch.suspects(), now_s + self.settings.suspected_s)
        self._suspected_until_s = {v: until_s for v, until_s in self._suspected_until_s.items() if until_s > now_s}
        self.suspected |= self._suspected_until_s.keys()

    def _test(self, scene: Epoch, now_s: float) -> None:
        verdicts = self._verdicts(scene)
        self._scenes.append(scene)
        if not verdicts:
            if now_s - self._told_s > 10.0 * self.settings.rows.window_s:
                self._clear()
            return
        self._told_s = now_s
        self._doubt(verdicts, scene, now_s)
        for interval_s, verdict in verdicts.items():
            self._weigh(verdict, scene, self._streaks[interval_s])
        if all(verdict.clear for verdict in verdicts.values()):
            self._clear()

    def _clear(self) -> None:
        self.suspected = frozenset(self._suspected_until_s)

    def _verdicts(self, scene: Epoch) -> dict[float, FaultTestResult]:
        """Return the verdict of each test that can tell something, by its interval; 0 for the test of the present alone."""
        if not scene.rows:
            return {}
        pasts = self._scenes.before(scene.at_s)
        verdicts = dict(zip(pasts, run_tests(scene, self.settings.levels, list(pasts.values())), strict=True))
        return {interval_s: verdict for interval_s, verdict in verdicts.items() if verdict is not None}

    def _weigh(self, verdict: FaultTestResult, scene: Epoch, streak: _Streak) -> None:
        kinds = {s.kind for s in verdict.possible}
        liars = {s.vehicles[0]: s for s in verdict.possible if s.kind is FaultKind.VEHICLE}
        if verdict.consistent or (kinds and FaultKind.VEHICLE not in kinds):
            # A bad range accuses nobody: the positions around it agree with each other without it.
            streak.end()
            return
        among = frozenset(liars) if liars else verdict.involved
        streak.among = Counter({v: streak.among[v] + 1 for v in among})
        alone = next(iter(liars)) if kinds == {FaultKind.VEHICLE} and len(liars) == 1 else None
        streak.pointed_at = Counter({alone: streak.pointed_at[alone] + 1}) if alone is not None else Counter()
        if alone is not None and streak.pointed_at[alone] >= self.settings.accuse_after:
            peers = {v for row in scene.rows for v in row.pair if alone in row.pair}
            self.accused[alone] = IdentifiedFault(tuple(sorted(peers - {alone})), liars[alone].size_m)
            self.suspected = frozenset()
            for each in self._streaks.values():
                each.end()
        else:
            self.suspected |= {v for v, n in streak.among.items() if n >= self.settings.suspect_after}

    def _doubt(self, verdicts: Mapping[float, FaultTestResult], scene: Epoch, now_s: float) -> None:
        s = self.settings
        for vehicle in {v for verdict in verdicts.values() for v in verdict.doubt_m2}:
            # What came about within an interval has gone on for as long as the scene is old.
            age_s = now_s - scene.at_s
            new = max(
                (
                    verdict.doubt_m2[vehicle] * (1.0 + age_s / interval_s if interval_s else 1.0) ** 2
                    for interval_s, verdict in verdicts.items()
                    if vehicle in verdict.doubt_m2
                ),
                key=_trace,
            )
            if self.accused or self.suspected:
                self._watched_until_s[vehicle] = now_s + s.watched_s
            watched = now_s < self._watched_until_s.get(vehicle, now_s)
            present = verdicts.get(0.0)
            if watched and present is not None and vehicle in present.offset_m:
                # What is left of the fault in the estimate, when the liar is not asked any more.
                new = new + np.outer(present.offset_m[vehicle], present.offset_m[vehicle])
            fade = exp(-s.every_s / (s.watched_time_s if watched else s.doubt_time_s))
            old = self._faded_m2.get(vehicle)
            if old is not None and _trace(old) * fade > _trace(new):
                new = old * fade
            self._faded_m2[vehicle] = new


def _trace(moment_m2: FloatArray) -> float:
    return float(moment_m2.item(0) + moment_m2.item(3))
