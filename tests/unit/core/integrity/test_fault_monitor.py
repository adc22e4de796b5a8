"""The fault monitor: from ranges to detected faults and solution separation."""

from __future__ import annotations

from math import cos, sin

import numpy as np
import pytest

from gcs_coloc.core.integrity import fault_monitor, range_residuals
from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, PositionPrior, RangeResidual
from gcs_coloc.core.integrity.epoch_tests.noise_model import AS_STATED, NoiseModel
from gcs_coloc.core.integrity.fault_filters import FaultFilters
from gcs_coloc.core.integrity.fault_monitor import FaultMonitor, expected_separation_m2
from gcs_coloc.core.integrity.range_consistency import RangeConsistency
from gcs_coloc.core.integrity.range_residuals import TrackPoint
from gcs_coloc.core.measurements import RangeMeasurement

STEP_S, APART_M = 0.2, 800.0
DENIED, FAULTY = 100, 1
AROUND = {1: 0.1, 2: 1.7, 3: 3.0, 4: 4.8}


def place(east_m, north_m, no_prior=False):
    return PositionPrior((east_m, north_m, 100.0), 0.0 if no_prior else 1.5, 2.0, no_prior)


class Flight:
    """A denied vehicle at the origin among standing peers; from 20 s on the reported position of peer 1 drifts away."""

    def __init__(self, monitor, seed=1, around=AROUND, towards=0.1, reversed_for=()):
        self.monitor, self.rng, self.around, self.towards, self.reversed_for = (
            monitor,
            np.random.default_rng(seed),
            around,
            towards,
            reversed_for,
        )

    def fly(
        self,
        from_s,
        to_s,
        walk_mps=0.0,
        excluded=(),
        own_no_prior=True,
        device_m=0.0,
        noise=AS_STATED,
        tested=(),
        detour_m=0.0,
        own_m=0.0,
    ):
        for step in range(round(from_s / STEP_S), round(to_s / STEP_S)):
            t = step * STEP_S
            for peer, a in self.around.items():
                drawn_off_m = max(t - 20.0, 0.0) * walk_mps if peer == FAULTY else 0.0
                reported = place(
                    APART_M * cos(a) + drawn_off_m * cos(self.towards), APART_M * sin(a) + drawn_off_m * sin(self.towards)
                )
                range_m = APART_M + device_m + (detour_m if peer == FAULTY else 0.0) + float(self.rng.standard_normal())
                own = place(own_m * cos(self.towards), own_m * sin(self.towards), no_prior=own_no_prior)
                ends = [(DENIED, own), (peer, reported)]
                (i, at_i), (j, at_j) = reversed(ends) if peer in self.reversed_for else ends
                self.monitor.add_range(RangeMeasurement(i, j, t, t, range_m, 1.0), at_i, at_j)
            self.monitor.step(t, excluded, noise, tested)
        return t


def test_a_drifting_peer_is_detected_whoever_ranges_and_the_separation_points_along_its_line_of_sight():
    for reversed_for in ((), (1, 2, 3, 4)):
        monitor = FaultMonitor()
        flight = Flight(monitor, reversed_for=reversed_for)
        t = flight.fly(0.0, 20.0)
        assert monitor.detected() == frozenset()
        before_m2 = float(np.trace(monitor.separation_m2(t)[DENIED]))
        t = flight.fly(20.0, 30.0, walk_mps=2.0)
        assert monitor.detected() == {FAULTY}
        values, axes = np.linalg.eigh(monitor.separation_m2(t)[DENIED])
        # 20 m along the line, of which least squares hands on a half.
        assert 25.0 < values[1] < 200.0
        assert abs(axes[:, 1] @ (cos(0.1), sin(0.1))) > 0.9
        assert before_m2 < 2.0


def test_an_excluded_peer_is_left_out_and_nobody_else_is_detected():
    monitor = FaultMonitor()
    flight = Flight(monitor, around={**AROUND, 5: 2.4})
    flight.fly(0.0, 20.0)
    flight.fly(20.0, 30.0, walk_mps=2.0)
    t = flight.fly(30.0, 60.0, walk_mps=2.0, excluded={FAULTY})
    assert monitor.detected() == frozenset()
    assert float(np.trace(monitor.separation_m2(t)[DENIED])) < 2.0


@pytest.mark.parametrize("own_m", [0.0, -20.0], ids=["refused", "followed"])
def test_a_pair_that_is_off_counts_by_how_far_the_estimate_has_followed_it(own_m):
    monitor, noise = FaultMonitor(), NoiseModel(pairs_off=frozenset({(FAULTY, DENIED)}))
    flight = Flight(monitor, around={**AROUND, 5: 2.4, 6: 5.5})
    t = flight.fly(0.0, 20.0, detour_m=50.0, own_m=own_m, noise=noise)
    separation_m = np.sqrt(np.trace(monitor.separation_m2(t)[DENIED]))
    assert separation_m == pytest.approx(abs(own_m), abs=3.0)


def test_lasting_errors_that_are_known_displace_nobody_and_a_drift_beside_them_is_still_detected():
    """A device 4 m off among three peers: the separation is 12 m in one of seven draws; not with its error known."""
    left_m = {AS_STATED: [], NoiseModel(device_bias_m=4.0): []}
    for noise, of_noise in left_m.items():
        for seed in range(1, 8):
            monitor = FaultMonitor()
            t = Flight(monitor, seed=seed, around={1: 0.1, 2: 2.2, 3: 4.3}).fly(0.0, 60.0, device_m=4.0, noise=noise)
            of_noise.append(np.sqrt(np.trace(monitor.separation_m2(t)[DENIED])))
        flight = Flight(FaultMonitor())
        flight.fly(0.0, 20.0, device_m=4.0, noise=noise)
        flight.fly(20.0, 50.0, walk_mps=2.0, device_m=4.0, noise=noise)
        assert flight.monitor.detected() == {FAULTY}
    as_stated_m, known_m = left_m.values()
    assert max(as_stated_m) > 10.0
    assert max(known_m) < 3.0


def test_the_errors_of_ranges_are_those_of_the_residuals_of_epochs(monkeypatch):
    """Lasting errors of 5 m are set once and known to both: the fault monitor cannot rule out smaller faults then."""
    separation_m2 = []
    for range_bias_m in (0.3, 5.0):
        monkeypatch.setattr(fault_monitor, "RANGE_BIAS_M", range_bias_m)
        monkeypatch.setattr(range_residuals, "RANGE_BIAS_M", range_bias_m)
        consistency = RangeConsistency()
        for step in range(150):
            t = step * STEP_S
            for vehicle, prior in (
                (DENIED, place(0.0, 0.0)),
                *((p, place(APART_M * cos(a), APART_M * sin(a))) for p, a in AROUND.items()),
            ):
                at_m = prior.position_enu_m
                consistency.residuals.add_position(
                    vehicle, TrackPoint(t, at_m, (0.0, 0.0, 0.0), 1.5, 2.0, no_prior=vehicle == DENIED)
                )
            for peer in AROUND:
                consistency.residuals.add_range(RangeMeasurement(DENIED, peer, t, t, APART_M, 1.0))
            consistency.review(t + 0.01)
        assert {residual.bias_m for residual in consistency.epoch.residuals} == {range_bias_m}
        separation_m2.append(float(np.trace(consistency.separation_m2[DENIED])))
    assert separation_m2[1] > 2.0 * separation_m2[0]


def test_three_peers_are_needed_and_ranges_between_reported_positions_do_not_count():
    monitor = FaultMonitor()
    t = Flight(monitor, around={1: 0.1, 2: 1.7}).fly(0.0, 40.0, walk_mps=5.0)
    assert monitor.detected() == frozenset()
    assert monitor.separation_m2(t) == {}
    monitor = FaultMonitor()
    t = Flight(monitor).fly(0.0, 40.0, walk_mps=5.0, own_no_prior=False)
    assert monitor.separation_m2(t) == {}


def test_of_many_peers_eight_have_filters_and_those_that_have_them_keep_them(monkeypatch):
    peers_at = []
    update = FaultFilters.update

    def counted(filters, residuals, at_s):
        update(filters, residuals, at_s)
        peers_at.append(set(filters.peers))

    monkeypatch.setattr(FaultFilters, "update", counted)
    monitor = FaultMonitor()

    def step(at_s, times):
        for peer, count in times.items():
            for _ in range(count):
                prior = place(APART_M * cos(peer), APART_M * sin(peer))
                monitor.add_range(RangeMeasurement(DENIED, peer, at_s, at_s, APART_M, 1.0), place(0.0, 0.0, no_prior=True), prior)
        monitor.step(at_s, ())

    vehicles = dict.fromkeys(range(50, 54), 2)
    step(1.0, vehicles)
    step(2.0, vehicles | dict.fromkeys(range(-20, 0), 1) | dict.fromkeys((61, 62), 3))
    assert peers_at[-1] == {*vehicles, 61, 62, -20, -19}
    # 24 peers in turn, six in each step.
    for number in range(40):
        step(3.0 + 0.2 * number, dict.fromkeys(range(200 + number % 4 * 6, 206 + number % 4 * 6), 1))
    assert max(map(len, peers_at)) == 8
    # All have been silent for longer than they stay.
    step(20.0, dict.fromkeys(range(70, 73), 1))
    assert peers_at[-1] == {70, 71, 72}


def test_of_many_peers_those_that_are_tested_come_first_and_the_fault_of_one_is_found():
    """Eleven peers: the filter took the first eight for good, and never looked at those that came to locate the vehicle."""
    around = {peer: 0.1 + 0.57 * peer for peer in range(1, 12)}
    first, last = [(DENIED, peer) for peer in range(4, 12)], [(peer, DENIED) for peer in range(1, 9)]
    for tested, found in ((first, frozenset()), (last, {FAULTY})):
        monitor = FaultMonitor()
        flight = Flight(monitor, around=around, towards=around[FAULTY])
        flight.fly(0.0, 10.0, tested=first)
        flight.fly(10.0, 20.0, tested=tested)
        flight.fly(20.0, 30.0, walk_mps=2.0, tested=tested)
        assert monitor.detected() == found


def test_a_dropped_vehicle_and_one_without_ranges_for_half_a_minute_have_no_separation():
    monitor = FaultMonitor()
    t = Flight(monitor).fly(0.0, 30.0, walk_mps=2.0)
    assert DENIED in monitor.separation_m2(t)
    monitor.step(t + 31.0, ())
    assert monitor.separation_m2(t + 31.0) == {}
    t = Flight(monitor).fly(80.0, 82.0)
    assert DENIED in monitor.separation_m2(t)
    monitor.drop(DENIED)
    assert monitor.separation_m2(t) == {}


@pytest.mark.parametrize("around", [AROUND, {1: 0.1, 2: 1.7, 3: 3.6}, {1: 0.1, 2: 0.5, 3: 0.9, 4: 1.4}])
def test_the_expected_separation_is_what_fault_free_ranges_come_to(around):
    found_m2 = []
    for seed in range(1, 6):
        monitor = FaultMonitor()
        t = Flight(monitor, seed=seed, around=around).fly(0.0, 30.0)
        found_m2.append(np.trace(monitor.separation_m2(t)[DENIED]))
    assert np.sqrt(np.trace(expected(around))) == pytest.approx(np.sqrt(np.median(found_m2)), rel=0.5)


def test_fewer_peers_than_have_redundancy_have_no_expected_separation():
    assert expected({1: 0.1, 2: 1.7}) is None


def expected(around):
    priors = {peer: place(APART_M * cos(a), APART_M * sin(a)) for peer, a in around.items()}
    priors[DENIED] = place(0.0, 0.0, no_prior=True)
    # A median of five ranges of 1 m, with what no averaging removes.
    return expected_separation_m2(
        Epoch(0.0, priors, tuple(RangeResidual(DENIED, peer, 0.0, 0.64, 0.3) for peer in around)), DENIED
    )
