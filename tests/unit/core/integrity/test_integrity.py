"""The engine against a lying receiver, on simulated flights: who is trusted, what is said, where the denied vehicle is put."""

from math import inf

import numpy as np

from bench.integrity import walk
from bench.integrity_flights import (
    LIAR,
    SPOOFED_AT_S,
    STEP_S,
    SUBJECT,
    Flight,
    Scenario,
    error_and_bound_m,
    fly_step,
    fresh_engine,
)
from gcs_coloc.core.error_bound import horizontal_bound_95_m
from gcs_coloc.core.gps_health.gps_health import GpsState

SOUND = (GpsState.HEALTHY, GpsState.UNKNOWN)


def states(engine):
    return {v.sysid: v.health.state for v in engine.fleet}


def test_a_walked_off_peer_is_named_excluded_located_and_believed_again():
    engine, flight = fresh_engine(), Flight(Scenario(walk_mps=2.0), 1, honest_from_s=50.0)
    failed_at_s = back_at_s = None
    for step in range(round(86.0 / STEP_S)):
        t = step * STEP_S
        fly_step(engine, flight, t)
        liar = engine.fleet.get(LIAR)
        others = [state for sysid, state in states(engine).items() if sysid not in (LIAR, SUBJECT)]
        assert all(state in SOUND for state in others)
        if failed_at_s is None and liar.health.state is GpsState.FAILED:
            failed_at_s = t
            assert "its GPS position contradicts the ranges to 2, 3, 4, 100 by" in liar.health.reason
        if failed_at_s is not None and back_at_s is None and liar.health.state is GpsState.HEALTHY:
            back_at_s = t
        if failed_at_s is not None and t > failed_at_s + 5.0:
            # What was left of the lie is gone; 1.5 times the 95 % bound leaves room for GPS errors of over 1-sigma.
            error_m, bound_m = error_and_bound_m(engine, flight, t)
            assert error_m < max(1.5 * bound_m, 6.0)
    assert SPOOFED_AT_S < failed_at_s < SPOOFED_AT_S + 20.0
    # Fifteen seconds of agreement and ten of recovery at the least, and never while it lies.
    assert 75.0 <= back_at_s <= 85.0


def test_where_ranges_cannot_tell_the_liar_from_a_bad_range_nobody_is_called_a_liar():
    engine, flight = fresh_engine(), Flight(Scenario(mutual=False, walk_mps=2.0), 1)
    suspected = set()
    for step in range(round(38.0 / STEP_S)):
        fly_step(engine, flight, step * STEP_S)
        now = states(engine)
        assert all(state is not GpsState.FAILED for sysid, state in now.items() if sysid != SUBJECT)
        suspected |= {sysid for sysid, state in now.items() if state is GpsState.SUSPECT}
    assert LIAR in suspected
    assert "contradict each other" in engine.fleet.get(LIAR).health.reason


def test_a_clean_flight_accuses_nobody():
    engine, flight = fresh_engine(), Flight(Scenario(), 3)
    for step in range(round(60.0 / STEP_S)):
        fly_step(engine, flight, step * STEP_S)
        assert all(state in SOUND for sysid, state in states(engine).items() if sysid != SUBJECT)


def test_with_mutual_ranges_a_liar_is_excluded_before_the_subject_is_off_its_bound():
    """Twelve draws, all in time; `python -m bench integrity` counts 200."""
    for seed in range(12):
        seen = walk((Scenario(walk_mps=2.0), seed))
        assert seen.excluded_after_s < 10.0
        assert seen.passed_after_s == inf


def test_while_a_lie_is_not_named_yet_the_bound_says_what_it_may_have_done():
    engine, flight = fresh_engine(), Flight(Scenario(walk_mps=2.0), 1)
    grew = False
    for step in range(round((SPOOFED_AT_S + 12.0) / STEP_S)):
        t = step * STEP_S
        fly_step(engine, flight, t)
        if t > SPOOFED_AT_S and engine.fleet.get(LIAR).health.state is GpsState.HEALTHY:
            own_m = horizontal_bound_95_m(engine.estimator.estimate(SUBJECT, t).covariance)
            grew |= error_and_bound_m(engine, flight, t)[1] > 1.2 * own_m
    assert grew


def test_a_doubt_fades_once_the_liar_is_gone_and_the_estimate_agrees_with_the_ranges():
    """The bound is again no wider than in the same flight without a lie, where small chances of one are in it, too."""
    bounds_m = []
    for walk_mps in (2.0, 0.0):
        engine, flight = fresh_engine(), Flight(Scenario(walk_mps=walk_mps), 1, honest_from_s=50.0)
        for step in range(round(120.0 / STEP_S)):
            t = step * STEP_S
            fly_step(engine, flight, t)
        bounds_m.append(error_and_bound_m(engine, flight, t)[1])
    assert bounds_m[0] < 1.05 * bounds_m[1]


def test_with_ranges_from_the_subject_only_the_bound_grows_with_the_lie_and_the_liar_is_suspected():
    """Eight draws, all in time; `python -m bench integrity` counts 200."""
    seen = [walk((Scenario(mutual=False, walk_mps=2.0), seed)) for seed in range(8)]
    assert all(w.excluded_after_s < w.passed_after_s for w in seen)


def test_in_clean_flight_with_ranges_from_the_subject_only_the_bound_is_little_wider_for_what_might_be():
    engine, flight, wider = fresh_engine(), Flight(Scenario(mutual=False), 2), []
    for step in range(round(120.0 / STEP_S)):
        t = step * STEP_S
        fly_step(engine, flight, t)
        if t > 20.0:
            own_m = horizontal_bound_95_m(engine.estimator.estimate(SUBJECT, t).covariance)
            wider.append(error_and_bound_m(engine, flight, t)[1] / own_m)
    assert np.mean(wider) < 1.2
