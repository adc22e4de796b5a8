"""One trial: a drawn flight through the real engine, judged at every sample against the truth."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from enum import StrEnum
from math import inf
from pathlib import Path

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.deadlines import advance
from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.gps_health.gps_health import DISTRUSTED, GpsState
from gcs_coloc.core.measurements import Estimate
from gcs_coloc.core.messages.outbound import GpsInput
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.runtime.files import writing
from gcs_coloc.study.integrity.flight_classes import CLASSES
from gcs_coloc.study.integrity.simulated_fleet import SimulatedFleet

FLIGHT_S = 240.0
"""Length of a flight; chosen: three minutes and a half without GPS, as long as the batteries of most emergencies."""
TIME_TO_ALERT_S = 6.0
"""A fix that is wrong for no longer counts as alerted. Source: time to alert of an approach with vertical guidance (ICAO)."""
SAMPLE_S = 0.2
"""Every vehicle is sampled so often. Chosen: as often as the fleet is reviewed."""
_DEFAULTS = AidingSettings()
_FIX_LASTS_S = 0.35
"""A fix counts as stated for so long after its message: three periods and a half at 10 Hz."""
_SAME_EVENT_S = 10.0
"""Samples of one kind and vehicle closer than this are one event."""
_SETTLED_S = 5.0
"""After the loss of its fix a vehicle counts as under aid from here on; chosen: detection and the first fix."""
_BEGUN_S = 15.0
"""Sound vehicles count from here on: their states begin as unknown."""
_FAR_BEYOND = 3.0
"""Bounds that an error may not exceed: 1 in 3,000,000 of Gaussian errors is beyond three 95 % bounds."""


class EventKind(StrEnum):
    """What may never happen."""

    BEYOND_BOUNDS = "beyond_bounds"
    """An error beyond three times the 95 % bound, with a fix."""
    BEYOND_HPL = "beyond_hpl"
    """An error beyond the protection level, with a fix."""
    BEYOND_ALERT_LIMIT = "beyond_alert_limit"
    """An error beyond the alert limit, with a fix."""
    SOUND_FAILED = "sound_failed"
    """A vehicle with a sound receiver is FAILED."""
    ESTIMATOR_FAILED = "estimator_failed"
    """The estimator raised an exception, or gave an answer that is none: its aid stops, and nothing else would tell."""


@dataclass(slots=True)
class TrialEvent:
    """One event of a vehicle: from when to when, and the largest error in it.

    `bound_m` is the 95 % bound, or the protection level, at that error. `lasted_s` is the longest time at a stretch. `detail`
    says in words what happened where there is no error.
    """

    kind: EventKind
    sysid: int
    from_s: float
    until_s: float
    error_m: float
    bound_m: float
    lasted_s: float = 0.0
    detail: str = ""


@dataclass(slots=True)
class TrialScore:
    """What one flight came to; times in s, summed over vehicles.

    `under_aid_s`: vehicles without a fix of their own; `fix_s` of it with a fix, whose error was within the 95 % bound for
    `covered_s`, and whose squares sum to `squares_m2s`. `hpl_s`, `hpl_m_s`: fixes of any vehicle with a protection level, and the
    levels; `events` are of any vehicle, too.
    `alerts_s`: for each faulty receiver the time until its vehicle was no longer trusted, None where it never was.
    """

    name: str
    seed: int
    under_aid_s: float = 0.0
    fix_s: float = 0.0
    covered_s: float = 0.0
    squares_m2s: float = 0.0
    hpl_s: float = 0.0
    hpl_m_s: float = 0.0
    sound_s: float = 0.0
    distrusted_s: float = 0.0
    alerts_s: list[float | None] = field(default_factory=list)
    events: list[TrialEvent] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class TrialSample:
    """One vehicle at one time: its state, and its estimate against the truth.

    `has_fix`: it is sent a fix. `error_m` (horizontal), `bound_m` (95 %) and `hpl_m` are None where there is no such value.
    """

    at_s: float
    sysid: int
    gps_state: str
    reason: str
    has_fix: bool
    is_sound: bool
    error_m: float | None
    bound_m: float | None
    hpl_m: float | None
    inhibit: str


Trace = Callable[[TrialSample], None]


def fly_trial(
    name: str, seed: int, estimator: str = "fleet", trace: Trace | None = None, duration_s: float = FLIGHT_S
) -> TrialScore:
    """Fly one draw of a class through a fresh engine and return what it came to."""
    fleet = SimulatedFleet(CLASSES[name], seed, duration_s)
    return fly_fleet(fleet, EngineSettings(request_streams=False), TrialScore(name, seed), estimator, trace)


def fly_fleet(
    fleet: SimulatedFleet, settings: EngineSettings, score: TrialScore, estimator: str = "fleet", trace: Trace | None = None
) -> TrialScore:
    """Fly a fleet through a fresh engine, add what it came to to the score, and return it."""
    return _Trial(fleet, settings, score, estimator, trace).run()


def write_trace(name: str, seed: int, estimator: str, path: Path) -> TrialScore:
    """Fly one draw and write every sample of every vehicle as CSV.

    Raises:
        UsageError: the file cannot be written.
    """
    with writing(path, ""), path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [column.name for column in fields(TrialSample)])
        writer.writeheader()
        return fly_trial(name, seed, estimator, lambda sample: writer.writerow(asdict(sample)))


class _Trial:
    def __init__(
        self, fleet: SimulatedFleet, settings: EngineSettings, score: TrialScore, estimator: str, trace: Trace | None
    ) -> None:
        self._fleet, self._score, self._trace = fleet, score, trace
        self._engine = Engine(load_estimator(estimator, {}), settings)
        self._fix_at_s: dict[int, float] = {}
        self._failed: set[int] = set()
        self._distrusted_at_s: dict[int, float] = {}
        self._open: dict[tuple[EventKind, int], TrialEvent] = {}
        self._stretch_s: dict[tuple[EventKind, int], float] = {}

    def run(self) -> TrialScore:
        fleet, engine = self._fleet, self._engine
        sample_s = fleet.drawn.backlog_s + SAMPLE_S
        while True:
            at_s, message = fleet.pop()
            while sample_s <= min(at_s, fleet.duration_s):
                self._poll(sample_s)
                self._sample(sample_s)
                sample_s += SAMPLE_S
            if at_s > fleet.duration_s:
                break
            if message is not None:
                self._poll(at_s)
                engine.receive(message)
        for fault, count in engine.estimator.faults.items():
            event = TrialEvent(
                EventKind.ESTIMATOR_FAILED, fleet.denied[0], 0.0, fleet.duration_s, 0.0, 0.0, detail=f"{fault}, {count} times"
            )
            self._score.events.append(event)
        found_s = self._distrusted_at_s
        self._score.alerts_s = [found_s[v] - fleet.fault_at_s if v in found_s else None for v in fleet.spoofed()]
        return self._score

    def _poll(self, until_s: float) -> None:
        for at_s, outputs in advance(self._engine, until_s, held_up_until_s=0.0):
            for output in outputs:
                if isinstance(output, GpsInput):
                    self._fix_at_s[output.sysid] = at_s if output.fix_type >= 3 else -inf
                self._fleet.deliver(output, at_s)

    def _sample(self, at_s: float) -> None:
        fleet = self._fleet
        for sysid in (*fleet.denied, *fleet.peers):
            state = self._engine.gps_state(sysid)
            is_sound = sysid in fleet.peers and sysid not in fleet.rebooted and not fleet.is_spoofed(sysid, at_s)
            if is_sound and at_s > _BEGUN_S:
                self._score_sound(sysid, state, at_s)
            elif state in DISTRUSTED and fleet.is_spoofed(sysid, at_s):
                self._distrusted_at_s.setdefault(sysid, at_s)
            self._score_fix(sysid, state, at_s, is_sound=is_sound)

    def _score_sound(self, sysid: int, state: GpsState, at_s: float) -> None:
        self._score.sound_s += SAMPLE_S
        if state in DISTRUSTED:
            self._score.distrusted_s += SAMPLE_S
        if state is GpsState.FAILED:
            if sysid not in self._failed:
                detail = self._engine.gps_health.reason(sysid)
                self._score.events.append(TrialEvent(EventKind.SOUND_FAILED, sysid, at_s, at_s, 0.0, 0.0, 0.0, detail))
            self._failed.add(sysid)
        else:
            self._failed.discard(sysid)

    def _score_fix(self, sysid: int, state: GpsState, at_s: float, *, is_sound: bool) -> None:
        fleet, score = self._fleet, self._score
        has_fix = at_s - self._fix_at_s.get(sysid, -inf) <= _FIX_LASTS_S
        is_denied = sysid in fleet.denied and at_s > fleet.lost_at_s + _SETTLED_S
        score.under_aid_s += SAMPLE_S * is_denied
        if not has_fix and self._trace is None:
            return  # an estimate costs more than all else of a sample
        sent_s = at_s - _DEFAULTS.lag_s  # the time of the fix that is sent now
        where = self._engine.estimate(sysid, sent_s)
        error_m, bound_m, hpl_m = None, None, None
        if isinstance(where, Estimate) and self._engine.frame is not None:
            place = self._engine.frame.geodetic_from_enu(*where.position_enu_m.tolist())
            error_m, bound_m = fleet.error_m(sysid, sent_s, *place), horizontal_bound_95_m(where.covariance)
            hpl_m = where.protection.horizontal_m if where.protection is not None else None
        if self._trace is not None:
            inhibit, reason = str(self._engine.decision(sysid).inhibit or ""), self._engine.gps_health.reason(sysid)
            self._trace(TrialSample(at_s, sysid, state.value, reason, has_fix, is_sound, error_m, bound_m, hpl_m, inhibit))
        if not has_fix or error_m is None or bound_m is None:
            return
        if is_denied:
            score.fix_s += SAMPLE_S
            score.covered_s += SAMPLE_S * (error_m <= bound_m)
            score.squares_m2s += SAMPLE_S * error_m**2
        if hpl_m is not None:
            score.hpl_s += SAMPLE_S
            score.hpl_m_s += SAMPLE_S * hpl_m
        wrong = {
            EventKind.BEYOND_BOUNDS: error_m > _FAR_BEYOND * bound_m,
            EventKind.BEYOND_HPL: hpl_m is not None and error_m > hpl_m,
            EventKind.BEYOND_ALERT_LIMIT: error_m > _DEFAULTS.alert_limit_m,
        }
        for kind, happens in wrong.items():
            if happens:
                self._add(kind, sysid, at_s, error_m, hpl_m if kind is EventKind.BEYOND_HPL and hpl_m is not None else bound_m)

    def _add(self, kind: EventKind, sysid: int, at_s: float, error_m: float, bound_m: float) -> None:
        key = (kind, sysid)
        event = self._open.get(key)
        if event is None or at_s - event.until_s > _SAME_EVENT_S:
            event = self._open[key] = TrialEvent(kind, sysid, at_s, at_s, error_m, bound_m)
            self._stretch_s[key] = at_s
            self._score.events.append(event)
        elif at_s - event.until_s > 1.5 * SAMPLE_S:
            self._stretch_s[key] = at_s
        event.until_s = at_s
        event.lasted_s = max(event.lasted_s, at_s - self._stretch_s[key])
        if error_m > event.error_m:
            event.error_m, event.bound_m = error_m, bound_m
