"""Integrity: how soon a faulty peer is excluded, what it does until then, and how often a sound one is excluded."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, isfinite

import numpy as np

from bench.accuracy_runs import on_all_cores
from bench.figures import Figure
from bench.integrity_flights import DENIED, SPOOFED_AT_S, STEP_S, Flight, Scenario, error_and_bound_m, fly_step, fresh_engine
from gcs_coloc.core.gps_health.gps_health import GpsState

_GIVEN_UP_S = 60.0
_FLIGHT_S = 300.0
_WALKED = Scenario(walk_mps=2.0)
_ONLY_ITS_OWN = replace(_WALKED, mutual=False)
_WALKS = (
    ("mutual ranges", _WALKED, 1.0),
    ("mutual ranges, four others", replace(_WALKED, peers=5), 0.1),
    ("mutual ranges, 5 m/s", replace(_WALKED, walk_mps=5.0), 0.2),
    ("mutual ranges, 0.5 m/s", replace(_WALKED, walk_mps=0.5), 0.2),
    ("mutual ranges, 20 m at once", replace(_WALKED, walk_mps=0.0, jump_m=20.0), 0.1),
    ("only the denied vehicle's ranges", _ONLY_ITS_OWN, 1.0),
    ("only the denied vehicle's ranges, eight peers", replace(_WALKED, mutual=False, peers=8), 0.1),
)
_ONLY_ITS_OWN_CLEAN = Scenario(mutual=False)
_CLEAN = (
    ("mutual ranges", Scenario(lost=False), 0.4),
    ("a denied vehicle", Scenario(), 0.2),
    ("10 % of ranges late by multipath", Scenario(late_share=0.1), 0.1),
    ("white GPS noise", Scenario(gps_white_share=1.0), 0.05),
    ("GPS of 3 m that wanders within 15 s", Scenario(gps_sigma_m=3.0, gps_time_s=15.0), 0.05),
    ("GPS of 0.5 m, ranges of 0.3 m", Scenario(gps_sigma_m=0.5, range_sigma_m=0.3, radius_m=(60.0, 200.0)), 0.05),
    ("three peers, ranges of 5 m", Scenario(peers=3, range_sigma_m=5.0), 0.05),
    ("steep turns", Scenario(radius_m=(60.0, 120.0)), 0.05),
    ("only the denied vehicle's ranges", _ONLY_ITS_OWN_CLEAN, 0.1),
    ("only the denied vehicle's ranges, 10 % late", replace(_ONLY_ITS_OWN_CLEAN, late_share=0.1), 0.1),
    ("eight peers, only the denied vehicle's ranges", replace(_ONLY_ITS_OWN_CLEAN, peers=8), 0.05),
)


@dataclass(frozen=True, slots=True)
class Walk:
    """One faulty peer: when it was trusted no more, and when before the vehicle's error passed 1.5 x its bound; inf: never."""

    excluded_after_s: float
    passed_after_s: float


def measure(quick: bool) -> list[Figure]:
    """Exclusion of a faulty peer, and false exclusion in clean flight."""
    runs, hours = (6, 0.5) if quick else (200, 10.0)
    walks = [_exclusion(name, scenario, max(round(runs * share), 4)) for name, scenario, share in _WALKS]
    return [*walks, *_false_exclusions(hours)]


def _exclusion(name: str, scenario: Scenario, runs: int) -> Figure:
    walks = on_all_cores(f"peer spoofed: {name}", walk, [(scenario, seed) for seed in range(runs)])
    kept = float(np.mean([w.excluded_after_s < w.passed_after_s for w in walks]))
    passed = float(np.mean([isfinite(w.passed_after_s) for w in walks]))
    median_s = float(np.median([w.excluded_after_s for w in walks]))
    what = f"{scenario.walk_mps:g} m/s" if scenario.walk_mps else "a step"
    return Figure(
        f"peer spoofed, {what}: {name}, {runs} runs",
        f"excluded in time in {kept:.1%}, error passed the bound first in {passed:.1%}; median after {median_s:.1f} s",
        ">= 95 % before the denied vehicle's error passes 1.5 x its 95 % bound",
        kept >= 0.95,
    )


def walk(task: tuple[Scenario, int]) -> Walk:
    """Fly one draw (scenario, seed) until the faulty peer is trusted no more, at most 40 s after it began."""
    scenario, seed = task
    engine, flight = fresh_engine(), Flight(scenario, seed)
    passed_s = inf
    for step in range(round(_GIVEN_UP_S / STEP_S)):
        t = step * STEP_S
        fly_step(engine, flight, t)
        if t <= SPOOFED_AT_S:
            continue
        found = error_and_bound_m(engine, flight, t)
        if found is not None and found[0] > 1.5 * found[1]:
            passed_s = min(passed_s, t)
        if engine.gps_state(1) is not GpsState.HEALTHY:
            return Walk(t - SPOOFED_AT_S, passed_s - SPOOFED_AT_S)
    return Walk(inf, passed_s - SPOOFED_AT_S)


def _false_exclusions(hours: float) -> list[Figure]:
    flights, tasks = [], []
    for name, scenario, share in _CLEAN:
        vehicles = scenario.peers + (not scenario.lost)
        count = max(round(hours * share * 3600.0 / vehicles / _FLIGHT_S), 1)
        flights.append((name, count, vehicles))
        tasks += [(scenario, 1000 + seed) for seed in range(count)]
    excluded = iter(on_all_cores("clean flights", false_exclusions, tasks))
    figures, total, vehicle_hours = [], 0, 0.0
    for name, count, vehicles in flights:
        here, share_h = sum(next(excluded) for _ in range(count)), count * vehicles * _FLIGHT_S / 3600.0
        total, vehicle_hours = total + here, vehicle_hours + share_h
        figures.append(Figure(f"clean flight, {share_h:.1f} vehicle-hours: {name}", f"{here} excluded"))
    goal = total < max(0.1 * vehicle_hours, 1.0) if vehicle_hours >= 10.0 or total else None
    figures.append(Figure(f"false exclusions in {vehicle_hours:.1f} vehicle-hours", str(total), "< 1 in 10 vehicle-hours", goal))
    return figures


def false_exclusions(task: tuple[Scenario, int]) -> int:
    """How often a vehicle with GPS was trusted no more in five minutes of one draw (scenario, seed)."""
    scenario, seed = task
    engine, flight = fresh_engine(), Flight(scenario, seed)
    excluded, distrusted = 0, frozenset[int]()
    for step in range(round(_FLIGHT_S / STEP_S)):
        fly_step(engine, flight, step * STEP_S)
        now = frozenset(v for v in engine.sysids() if engine.gps_state(v) not in (GpsState.HEALTHY, GpsState.UNKNOWN))
        excluded += len((now - distrusted) - ({DENIED} if scenario.lost else frozenset()))
        distrusted = now
    return excluded
