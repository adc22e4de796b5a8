"""The engine against a lying receiver, on simulated flights: who is trusted, what is said, where the subject is put."""

from bench.integrity import LIAR, SPOOFED_AT_S, STEP_S, SUBJECT, Flight, error_and_bound_m, fly_step, fresh_engine
from gcs_coloc.core.health import GpsState

SOUND = (GpsState.HEALTHY, GpsState.UNKNOWN)


def states(engine):
    return {v.sysid: v.health.state for v in engine.fleet}


def test_a_walked_off_peer_is_named_excluded_located_and_believed_again():
    engine, flight = fresh_engine(), Flight(1, mutual=True, lost=True, spoofed_until_s=50.0)
    failed_at_s = back_at_s = None
    for step in range(round(86.0 / STEP_S)):
        t = step * STEP_S
        fly_step(engine, flight, t)
        liar = engine.fleet.get(LIAR)
        others = [state for sysid, state in states(engine).items() if sysid not in (LIAR, SUBJECT)]
        assert all(state in SOUND for state in others)
        if failed_at_s is None and liar.health.state is GpsState.FAILED:
            failed_at_s = t
            assert "its GPS position contradicts the ranges to 2, 3, 4, 5 by" in liar.health.reason
        if failed_at_s is not None and back_at_s is None and liar.health.state is GpsState.HEALTHY:
            back_at_s = t
        if failed_at_s is not None and t > failed_at_s + 5.0:
            # What was left of the lie is gone; 1.5 times the 95 % bound leaves room for GPS errors of over 1-sigma.
            error_m, bound_m = error_and_bound_m(engine, flight, t)
            assert error_m < max(1.5 * bound_m, 6.0)
    assert SPOOFED_AT_S < failed_at_s < SPOOFED_AT_S + 20.0
    # Five seconds of agreement and ten of recovery at the least, and never while it lies.
    assert 65.0 <= back_at_s <= 85.0


def test_where_ranges_cannot_tell_the_liar_from_a_bad_range_nobody_is_called_a_liar():
    engine, flight = fresh_engine(), Flight(1, mutual=False, lost=True, spoofed_until_s=60.0)
    suspected = set()
    for step in range(round(38.0 / STEP_S)):
        fly_step(engine, flight, step * STEP_S)
        now = states(engine)
        assert all(state is not GpsState.FAILED for sysid, state in now.items() if sysid != SUBJECT)
        suspected |= {sysid for sysid, state in now.items() if state is GpsState.SUSPECT}
    assert LIAR in suspected
    assert "contradict each other" in engine.fleet.get(LIAR).health.reason


def test_a_clean_flight_accuses_nobody():
    engine, flight = fresh_engine(), Flight(3, mutual=True, lost=True, spoofed_until_s=0.0)
    for step in range(round(60.0 / STEP_S)):
        fly_step(engine, flight, step * STEP_S)
        assert all(state in SOUND for sysid, state in states(engine).items() if sysid != SUBJECT)
