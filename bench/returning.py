"""Receivers that come back: whether right ones are believed as soon as ever, and those that are elsewhere never."""

from __future__ import annotations

from dataclasses import replace
from math import inf, isfinite

import numpy as np
from scipy.stats import beta

from bench.accuracy_runs import on_all_cores
from bench.figures import Figure
from bench.integrity_flights import DENIED, STEP_S, Flight, Scenario, fly_step, fresh_engine
from gcs_coloc.core.gps_health.gps_health import GpsHealthSettings, GpsState
from gcs_coloc.core.messages.control import RouteReport
from gcs_coloc.core.messages.inbound import Autopilot, Heartbeat

_STEADY_S = GpsHealthSettings().steady_after_s
_BACK_S = 40.0
_WATCHED_S = 60.0
_IN_TIME_S = GpsHealthSettings().recover_after_s + 2.0 * STEP_S
_RIGHT = Scenario(mutual=False, returns_at_s=_BACK_S)
_OFF = replace(_RIGHT, return_jump_m=200.0)
_RIGHT_FLIGHTS = (
    ("only its own ranges", _RIGHT),
    ("ranges among all", replace(_RIGHT, mutual=True)),
    ("three peers", replace(_RIGHT, peers=3)),
    ("two peers", replace(_RIGHT, peers=2)),
    ("one peer", replace(_RIGHT, peers=1)),
    ("10 % of ranges late by multipath", replace(_RIGHT, late_share=0.1)),
    ("30 % of ranges 5 to 50 m late", replace(_RIGHT, late_share=0.3, late_m=50.0)),
    ("three peers, ranges of 5 m", replace(_RIGHT, peers=3, range_sigma_m=5.0)),
    ("white GPS noise", replace(_RIGHT, gps_white_share=1.0)),
    ("GPS of 3 m that wanders within 15 s", replace(_RIGHT, gps_sigma_m=3.0, gps_time_s=15.0)),
    ("GPS of 0.5 m, ranges of 0.3 m", replace(_RIGHT, gps_sigma_m=0.5, range_sigma_m=0.3, radius_m=(60.0, 200.0))),
    ("steep turns", replace(_RIGHT, radius_m=(60.0, 120.0))),
)
_WRONG_FLIGHTS = (
    ("200 m off, only its own ranges", _OFF),
    ("200 m off, ranges among all", replace(_OFF, mutual=True)),
    ("200 m off, three peers", replace(_OFF, peers=3)),
    ("200 m off, two peers", replace(_OFF, peers=2)),
    ("200 m off, one peer", replace(_OFF, peers=1)),
    ("200 m off, 30 % of ranges late", replace(_OFF, late_share=0.3, late_m=50.0)),
    ("25 m off", replace(_OFF, return_jump_m=25.0)),
    ("walked off at 2 m/s", replace(_RIGHT, return_walk_mps=2.0)),
    ("walked off at 1 m/s", replace(_RIGHT, return_walk_mps=1.0)),
    ("walked off at 0.5 m/s", replace(_RIGHT, return_walk_mps=0.5)),
)


def measure(quick: bool) -> list[Figure]:
    """Fly draws of each, and count. The band of a share is the exact 95 % one (Clopper and Pearson)."""
    runs = 3 if quick else 30
    figures, late, flown = [], 0, 0
    for name, scenario in _RIGHT_FLIGHTS:
        healthy_s = [healthy for healthy, _ in _flights(name, scenario, runs)]
        delayed = sum(healthy > _IN_TIME_S for healthy in healthy_s)
        late, flown = late + delayed, flown + runs
        text = f"healthy after {np.median(healthy_s):.1f} s (median); {delayed} of {runs} later than {_IN_TIME_S:g} s"
        figures.append(Figure(f"comes back right: {name}", text))
    most = float(beta.ppf(0.975, late + 1, flown - late))
    figures.append(Figure(f"delayed of {flown} that come back right", f"{late}: at most {most:.1%} are", "none", late == 0))
    for name, scenario in _WRONG_FLIGHTS:
        times = _flights(name, scenario, runs)
        believed = sum(isfinite(healthy) and healthy < found for healthy, found in times)
        found_s = np.array([found for _, found in times])
        when = f"{np.median(found_s):.1f} s (median), {found_s.max():.1f} s at most"
        text = f"found wrong after {when}; healthy before that in {believed} of {runs}"
        figures.append(Figure(f"comes back: {name}", text))
    return figures


def _flights(name: str, scenario: Scenario, runs: int) -> list[tuple[float, float]]:
    return list(on_all_cores(f"returning: {name}", fly, [(scenario, seed) for seed in range(runs)]))


def fly(task: tuple[Scenario, int]) -> tuple[float, float]:
    """Fly one draw (scenario, seed), aided. Return after how long its receiver was believed, and was not (any more), in seconds.

    The latter counts when it is found wrong while it recovers, or is suspected or failed after it was believed. Until its fix has
    been steady it is failed in any case.
    """
    scenario, seed = task
    engine, flight = fresh_engine(), Flight(scenario, seed)
    healthy_s = inf
    for step in range(round((_BACK_S + _WATCHED_S) / STEP_S)):
        t = step * STEP_S
        engine.receive(Heartbeat(DENIED, t, Autopilot.ARDUPILOT, True, winged=True))
        engine.receive(RouteReport(DENIED, t, None))
        fly_step(engine, flight, t)
        if t < _BACK_S + 2.0 * STEP_S:
            continue
        state = engine.gps_state(DENIED)
        if state is GpsState.HEALTHY and healthy_s == inf:
            healthy_s = t - _BACK_S
            if not (scenario.return_jump_m or scenario.return_walk_mps):
                break
        elif state in (GpsState.FAILED, GpsState.SUSPECT) and t > _BACK_S + _STEADY_S + 2.0 * STEP_S:
            return healthy_s, t - _BACK_S
    return healthy_s, inf
