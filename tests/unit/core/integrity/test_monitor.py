"""The engine against a spoofed receiver in simulated flights: GPS states, notices, estimates."""

from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations
from math import dist, inf

import numpy as np
from scipy.optimize import fsolve

from bench.integrity import walk
from bench.integrity_flights import (
    DENIED,
    FAULTY,
    SPOOFED_AT_S,
    STEP_S,
    Flight,
    Scenario,
    error_and_bound_m,
    fly_step,
    fresh_engine,
)
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.integrity.monitor import IntegrityMonitor
from gcs_coloc.core.integrity.protection_level import Exposure
from gcs_coloc.core.integrity.report import ReviewedVehicle
from gcs_coloc.core.measurements import Estimate, NoEstimate, NoEstimateReason, PositionMeasurement, RangeMeasurement

SOUND = (GpsState.HEALTHY, GpsState.UNKNOWN)


def states(engine):
    return {v: engine.gps_state(v) for v in engine.sysids()}


@dataclass(frozen=True)
class Moment:
    """What one step of a flight came to; `found`: error and bound of the denied vehicle, `own_m`: the filter's bound alone."""

    t: float
    states: dict[int, GpsState]
    reason: str
    found: tuple[float, float] | None
    own_m: float


@cache
def drifted(walk_mps: float) -> list[Moment]:
    """Flight 1, whose peer is walked off from 20 to 50 s, to 86 s: flown once for all tests."""
    engine, flight = fresh_engine(), Flight(Scenario(walk_mps=walk_mps), 1, fault_free_from_s=50.0)
    moments = []
    for step in range(round(86.0 / STEP_S)):
        t = step * STEP_S
        fly_step(engine, flight, t)
        if t > SPOOFED_AT_S:
            found, own_m = (
                error_and_bound_m(engine, flight, t),
                horizontal_bound_95_m(engine.estimator.estimate(DENIED, t).covariance),
            )
        else:
            found, own_m = None, inf
        moments.append(Moment(t, states(engine), engine.gps_health.reason(FAULTY), found, own_m))
    return moments


def test_a_drifting_peer_is_identified_excluded_located_and_readmitted():
    failed_at_s = back_at_s = None
    for moment in drifted(2.0):
        t, state = moment.t, moment.states.get(FAULTY)
        others = [state for sysid, state in moment.states.items() if sysid not in (FAULTY, DENIED)]
        assert all(state in SOUND for state in others)
        if failed_at_s is None and state is GpsState.FAILED:
            failed_at_s = t
            assert "its GPS position contradicts the ranges to 2, 3, 4, 100 by" in moment.reason
        if failed_at_s is not None and back_at_s is None and state is GpsState.HEALTHY:
            back_at_s = t
        if failed_at_s is not None and t > failed_at_s + 5.0:
            # What was left of the fault is gone; 1.5 times the 95 % bound leaves room for GPS errors of over 1-sigma.
            error_m, bound_m = moment.found
            assert error_m < max(1.5 * bound_m, 6.0)
    assert SPOOFED_AT_S < failed_at_s < SPOOFED_AT_S + 20.0
    # A second of agreement and ten of recovery at the least, and never while it faults.
    assert 61.0 <= back_at_s <= 75.0


def test_where_ranges_cannot_isolate_a_fault_nobody_is_identified():
    engine, flight = fresh_engine(), Flight(Scenario(mutual=False, walk_mps=2.0), 1)
    detected = set()
    for step in range(round(38.0 / STEP_S)):
        fly_step(engine, flight, step * STEP_S)
        now = states(engine)
        assert all(state is not GpsState.FAILED for sysid, state in now.items() if sysid != DENIED)
        detected |= {sysid for sysid, state in now.items() if state is GpsState.SUSPECT}
    assert FAULTY in detected
    assert "contradict each other" in engine.gps_health.reason(FAULTY)


def test_among_six_peers_that_one_vehicle_ranges_a_drifting_one_is_suspected_alone_and_the_vehicle_is_located():
    """Others are suspected with it at first, and no longer than the ranges allow that they are at fault. The error stays within
    the protection level, which is of the others alone: that of all would grow with the fault.
    """
    engine, flight = fresh_engine(), Flight(Scenario(peers=6, mutual=False, walk_mps=2.0), 2)
    suspected = set()
    for step in range(round(62.0 / STEP_S)):
        t = step * STEP_S
        fly_step(engine, flight, t)
        now = {sysid for sysid, state in states(engine).items() if state is GpsState.SUSPECT}
        suspected |= now
        if t > 50.0:
            assert now == {FAULTY}
            error_m, _ = error_and_bound_m(engine, flight, t)
            assert error_m < engine.estimate(DENIED, t).protection.horizontal_m < AidingSettings().alert_limit_m
    assert len(suspected) > 1


def test_a_fault_free_flight_identifies_nobody():
    for moment in drifted(0.0):
        assert all(state in SOUND for sysid, state in moment.states.items() if sysid != DENIED)


def test_with_mutual_ranges_a_fault_is_excluded_before_the_denied_vehicle_leaves_its_bound():
    """Three draws, all in time; `python -m bench integrity` counts 200."""
    for seed in range(3):
        seen = walk((Scenario(walk_mps=2.0), seed))
        assert seen.excluded_after_s < 10.0
        assert seen.passed_after_s == inf


def test_before_identification_the_bound_contains_the_solution_separation():
    healthy = [
        moment
        for moment in drifted(2.0)
        if SPOOFED_AT_S < moment.t < SPOOFED_AT_S + 12.0 and moment.states[FAULTY] is GpsState.HEALTHY
    ]
    assert any(moment.found[1] > 1.2 * moment.own_m for moment in healthy)


def test_the_separation_decays_once_the_fault_is_gone():
    """The bound is again no wider than in the same flight without a fault, where small probabilities of one are in it, too."""
    assert drifted(2.0)[-1].found[1] < 1.05 * drifted(0.0)[-1].found[1]


def test_with_ranges_from_the_denied_vehicle_only_the_fault_is_detected_in_time():
    """Two draws, both in time; `python -m bench integrity` counts 200."""
    seen = [walk((Scenario(mutual=False, walk_mps=2.0), seed)) for seed in range(2)]
    assert all(w.excluded_after_s < w.passed_after_s for w in seen)


def test_in_fault_free_flight_with_few_ranges_the_bound_is_little_inflated():
    engine, flight, wider = fresh_engine(), Flight(Scenario(mutual=False), 2), []
    for step in range(round(60.0 / STEP_S)):
        t = step * STEP_S
        fly_step(engine, flight, t)
        if t > 20.0:
            own_m = horizontal_bound_95_m(engine.estimator.estimate(DENIED, t).covariance)
            wider.append(error_and_bound_m(engine, flight, t)[1] / own_m)
    assert np.mean(wider) < 1.2


def test_who_is_suspect_is_tested_but_counts_as_no_anchor_in_the_level():
    places_m = {1: (0.0, 0.0, 100.0), 2: (500.0, 20.0, 110.0), 3: (480.0, 520.0, 95.0), 4: (-30.0, 470.0, 105.0)}
    monitor, frame = IntegrityMonitor(), LocalFrame(47.0, 8.0, 500.0)
    vehicles = [ReviewedVehicle(v, GpsState.HEALTHY, is_trusted=v != 4, is_witness=True, is_automatic=True) for v in places_m]
    for step in range(1, 20):
        t = 0.2 * step
        for v, place in places_m.items():
            monitor.add_position(PositionMeasurement(v, t, t, place, 1.5, 2.4, (0.0, 0.0, 0.0), 0.3))
            for peer in range(v + 1, 5):
                monitor.add_range(
                    RangeMeasurement(v, peer, t - 0.01, t, float(np.linalg.norm(np.subtract(place, places_m[peer]))), 0.5)
                )
        monitor.review(t + 0.05, vehicles, frame)
    assert 4 in monitor.epoch.priors
    assert monitor.epoch.reporting == {1, 2, 3}


def test_what_ranges_alone_have_begun_is_not_stated_before_they_were_tested():
    """A real ArduPlane whose ranges to one peer were 25 m too long was found 23 m off, with a protection level of 12 m."""
    places_m = {1: (0.0, 0.0, 100.0), 2: (500.0, 20.0, 110.0), 3: (480.0, 520.0, 95.0), 4: (200.0, 300.0, 105.0)}
    monitor, frame = IntegrityMonitor(), LocalFrame(47.0, 8.0, 500.0)
    sound = [ReviewedVehicle(v, GpsState.HEALTHY, is_trusted=True, is_witness=True, is_automatic=True) for v in (1, 2, 3)]
    lost = ReviewedVehicle(4, GpsState.FAILED, is_trusted=False, is_witness=False, is_automatic=True)
    covariance = np.diag([1.0, 1.0, 4.0, 0.3, 0.3, 0.3])
    stated = {}
    for step in range(1, 12):
        t = 0.2 * step
        for v in (1, 2, 3):
            monitor.add_position(PositionMeasurement(v, t, t, places_m[v], 1.5, 2.4, (0.0, 0.0, 0.0), 0.3))
            range_m = float(np.linalg.norm(np.subtract(places_m[4], places_m[v])))
            monitor.add_range(RangeMeasurement(4, v, t - 0.01, t, range_m, 0.5))
        found = Estimate(4, t, np.array(places_m[4]), np.zeros(3), covariance, 1.2, 3) if t > 1.1 else None
        report = monitor.review(t + 0.05, [*sound, replace(lost, estimate=found)], frame)
        if found is not None:
            stated[round(t, 1)] = monitor.protect(report, found, Exposure(delay_is_known=True, shown_until_s=None))
    first, *_, last = stated.values()
    assert isinstance(first, NoEstimate)
    assert first.reason.reason is NoEstimateReason.UNTESTED
    # The ranges from before it was found test it, two reviews later.
    assert isinstance(stated[1.6], Estimate)
    assert last.protection.horizontal_m > 12.0


def test_the_place_of_a_receiver_that_is_named_is_stated_when_ranges_have_tested_it():
    """Real planes, one drawn off by 150 m: its first fix was 124 m off with a level of 22 m, by its own false reports alone."""
    places_m = {1: (0.0, 0.0, 100.0), 2: (500.0, 20.0, 110.0), 3: (480.0, 520.0, 95.0), 4: (-30.0, 470.0, 105.0)}
    places_m[5] = (200.0, 260.0, 100.0)
    monitor, frame = IntegrityMonitor(), LocalFrame(47.0, 8.0, 500.0)
    vehicles = {v: ReviewedVehicle(v, GpsState.HEALTHY, is_trusted=True, is_witness=True, is_automatic=True) for v in places_m}
    covariance = np.diag([1.0, 1.0, 4.0, 0.3, 0.3, 0.3])
    stated = []
    for step in range(1, 60):
        t = 0.2 * step
        for v, (e, n, u) in places_m.items():
            claimed = (e + 150.0, n, u) if v == 5 and t > 4.0 else (e, n, u)
            monitor.add_position(PositionMeasurement(v, t, t, claimed, 1.5, 2.4, (0.0, 0.0, 0.0), 0.3))
            for peer in range(v + 1, 6):
                monitor.add_range(RangeMeasurement(v, peer, t - 0.01, t, dist(places_m[v], places_m[peer]), 0.5))
        report = monitor.review(t + 0.05, list(vehicles.values()), frame)
        if 5 in report.faults and report.faults[5].is_identified:
            found = Estimate(5, t, np.array(places_m[5]) + 100.0, np.zeros(3), covariance, 1.2, 4)
            stated.append(monitor.protect(report, found, Exposure(delay_is_known=True, shown_until_s=None)))
            vehicles[5] = replace(vehicles[5], gps_state=GpsState.FAILED, is_trusted=False, is_witness=False, estimate=found)
    assert isinstance(stated[0], NoEstimate)
    assert stated[0].reason.reason is NoEstimateReason.UNTESTED
    assert isinstance(stated[-1], Estimate)
    assert all(each.protection.horizontal_m > 100.0 for each in stated if isinstance(each, Estimate))


def test_once_the_faulty_one_is_named_ranges_that_confirm_an_estimate_end_its_inflation():
    """A denied copter among five real ones on poor radios, one 50 m off: ten seconds after it was named, 260 m for 3 m."""
    places_m = {1: (0.0, 0.0, 100.0), 2: (500.0, 20.0, 110.0), 3: (480.0, 520.0, 95.0), 4: (-30.0, 470.0, 105.0)}
    places_m |= {5: (200.0, -160.0, 100.0), 6: (250.0, 240.0, 100.0)}
    monitor, frame = IntegrityMonitor(), LocalFrame(47.0, 8.0, 500.0)
    vehicles = [ReviewedVehicle(v, GpsState.HEALTHY, is_trusted=True, is_witness=True, is_automatic=True) for v in range(1, 6)]
    covariance = np.diag([1.0, 1.0, 4.0, 0.3, 0.3, 0.3])
    sigmas_m, named_at_s = {}, inf
    for step in range(1, 120):
        t = 0.2 * step
        for v in range(1, 7):
            e, n, u = places_m[v]
            is_heard = t > 10.0 or step % 24 == v  # each in turn at first, so that few are ever known at one time
            if v != 6 and is_heard:
                claimed = (e + 50.0, n, u) if v == 5 and t > 4.0 else (e, n, u)
                monitor.add_position(PositionMeasurement(v, t, t, claimed, 1.5, 2.4, (0.0, 0.0, 0.0), 0.3))
            for peer in range(v + 1, 7):
                monitor.add_range(RangeMeasurement(v, peer, t - 0.01, t, dist(places_m[v], places_m[peer]), 0.5))
        found = Estimate(6, t, np.array(places_m[6]), np.zeros(3), covariance, 1.2, 5)
        lost = ReviewedVehicle(6, GpsState.FAILED, is_trusted=False, is_witness=False, is_automatic=True, estimate=found)
        report = monitor.review(t + 0.05, [*vehicles, lost], frame)
        sigmas_m[t] = float(np.sqrt(np.trace(report.separation_m2.get(6, np.zeros((2, 2))))))
        if 5 in report.faults and report.faults[5].is_identified:
            named_at_s = min(named_at_s, t)
    assert max(sigmas_m.values()) > 20.0
    assert named_at_s < 13.0
    assert max(sigma_m for t, sigma_m in sigmas_m.items() if t > named_at_s + 10.0) < 0.2 * max(sigmas_m.values())


def test_where_it_is_open_which_pair_is_off_the_level_counts_each_of_them():
    """As in a recorded flight of two lost ArduPlanes whose ranges to each other are 25 m too long.

    The filter follows them, and refuses those to the first peer: 44 m off, the level was 24 m.
    """
    places_m = {1: (-160.0, -273.0, 0.0), 2: (-28.0, -1349.0, 56.0), 3: (-688.0, -1213.0, 91.0), 4: (-707.0, -551.0, 16.0)}
    ranges_m = {(a, b): dist(places_m[a], places_m[b]) + 25.0 * ((a, b) == (3, 4)) for a, b in combinations(places_m, 2)}

    def residuals_m(east_north):
        return [dist((*east_north, 16.0), places_m[peer]) - ranges_m[peer, 4] for peer in (2, 3)]

    followed_m = {3: places_m[3], 4: (*fsolve(residuals_m, places_m[4][:2]).tolist(), 16.0)}
    error_m = dist(followed_m[4], places_m[4])
    assert error_m > 30.0
    monitor, frame = IntegrityMonitor(), LocalFrame(47.0, 8.0, 500.0)
    sound = [ReviewedVehicle(v, GpsState.HEALTHY, is_trusted=True, is_witness=True, is_automatic=True) for v in (1, 2)]
    covariance = np.diag([1.0, 1.0, 4.0, 0.3, 0.3, 0.3])
    for step in range(1, 40):
        t = 0.2 * step
        for v in (1, 2):
            monitor.add_position(PositionMeasurement(v, t, t, places_m[v], 0.8, 2.4, (0.0, 0.0, 0.0), 0.3))
        for (a, b), range_m in ranges_m.items():
            monitor.add_range(RangeMeasurement(a, b, t - 0.01, t, range_m, 0.5))
        found = {v: Estimate(v, t, np.array(at), np.zeros(3), covariance, 1.2, 2) for v, at in followed_m.items()}
        lost = [
            ReviewedVehicle(v, GpsState.FAILED, is_trusted=False, is_witness=False, is_automatic=True, estimate=found[v])
            for v in found
        ]
        report = monitor.review(t + 0.05, [*sound, *lost], frame)
        if t > 3.0:
            stated = monitor.protect(report, found[4], Exposure(delay_is_known=True, shown_until_s=None))
            assert not report.faults
            assert horizontal_bound_95_m(stated.covariance) > error_m
            assert stated.protection.horizontal_m > AidingSettings().alert_limit_m
