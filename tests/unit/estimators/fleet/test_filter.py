from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from gcs_coloc.core.estimator import Estimator
from gcs_coloc.core.measurements import (
    AMBIGUOUS,
    AltitudeMeasurement,
    AttitudeMeasurement,
    Estimate,
    Measurement,
    NoEstimate,
    NoEstimateReason,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.estimators.fleet.ekf.outcomes import Outcome
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.settings import FleetSettings

Path3 = Callable[[float], np.ndarray]


def straight(e: float, n: float, u: float, ve: float, vn: float) -> Path3:
    return lambda t: np.array([e + ve * t, n + vn * t, u])


def circle(e: float, n: float, u: float, radius: float, speed: float) -> Path3:
    return lambda t: np.array([e + radius * math.sin(speed * t / radius), n + radius * math.cos(speed * t / radius), u])


FLEET: dict[int, Path3] = {
    1: straight(0.0, 0.0, 120.0, 18.0, 4.0),
    2: straight(1200.0, 300.0, 160.0, -3.0, 20.0),
    3: circle(300.0, 1500.0, 140.0, 400.0, 22.0),
    4: straight(600.0, 600.0, 150.0, 10.0, 15.0),
    5: circle(800.0, 200.0, 100.0, 300.0, 18.0),
}


class Flight:
    """Feeds an estimator with simulated measurements; the vehicles report positions until `lost_s`, then altitudes only."""

    def __init__(self, estimator: Estimator, denied: set[int], lost_s: float = 3.0, seed: int = 0) -> None:
        self.estimator = estimator
        self.denied = denied
        self.lost_s = lost_s
        self.rng = np.random.default_rng(seed)
        self.now_s = 0.0
        self.range_offset_m = 0.0
        self.pairs: list[tuple[int, int]] = [(s, p) for s in sorted(denied) for p in (1, 2, 3)]
        self.range_sigma_m = 1.0

    def own(self, vehicle: int, t: float) -> Measurement:
        noise = self.rng.normal(size=3)
        place = FLEET[vehicle](t)
        if vehicle in self.denied and t >= self.lost_s:
            return AltitudeMeasurement(vehicle, t, t, float(place[2]) + 0.5 + 0.2 * float(noise[2]), 2.0)
        velocity = (FLEET[vehicle](t + 0.01) - FLEET[vehicle](t - 0.01)) / 0.02
        return PositionMeasurement(vehicle, t, t, tuple((place + 0.3 * noise).tolist()), 0.5, 0.5, tuple(velocity.tolist()), 0.3)

    def run(self, until_s: float) -> None:
        while self.now_s < until_s - 1e-9:
            t = self.now_s
            if t >= self.lost_s:
                self.estimator.set_denied(self.denied, t)
            for vehicle in FLEET:
                self.estimator.add(self.own(vehicle, t))
            if round(t * 10) % 2 == 0:
                for a, b in self.pairs:
                    r = float(np.linalg.norm(FLEET[a](t) - FLEET[b](t))) + self.range_sigma_m * self.rng.normal()
                    self.estimator.add(RangeMeasurement(a, b, t, t, r + self.range_offset_m, self.range_sigma_m))
            self.now_s = round(self.now_s + 0.1, 6)

    def error_m(self, vehicle: int) -> float:
        where = self.estimator.estimate(vehicle, self.now_s)
        assert isinstance(where, Estimate), where
        return float(np.linalg.norm((where.position_enu_m - FLEET[vehicle](self.now_s))[:2]))


def test_it_meets_the_protocol():
    estimator: Estimator = FleetFilter()
    assert estimator.name == "fleet"


def test_a_vehicle_that_lost_its_gps_is_located_from_ranges_within_its_stated_error():
    flight = Flight(FleetFilter(), {4})
    squares = []
    for t in range(10, 70, 2):
        flight.run(float(t))
        where = flight.estimator.estimate(4, flight.now_s)
        assert isinstance(where, Estimate)
        e = (where.position_enu_m - FLEET[4](flight.now_s))[:2]
        squares.append(float(e @ np.linalg.solve(where.covariance[:2, :2], e)))
        assert float(np.linalg.norm(e)) < 3.0
        assert where.ranges_in_use == 3
        assert where.hdop is not None
    # Mean of 2 if honest; the epochs are correlated over some 10 s, so some six independent ones: 99.9 % lies below 5.5.
    assert np.mean(squares) < 5.5


def test_two_ranges_keep_it_and_one_keeps_it_along_itself_alone():
    sigmas_m = {}
    for n in (1, 2):
        flight = Flight(FleetFilter(), {4})
        flight.pairs = [(4, p) for p in (1, 2, 3)[:n]]
        flight.run(11.0)
        where = flight.estimator.estimate(4, 11.0)
        assert isinstance(where, Estimate)
        sigmas_m[n] = np.sqrt(np.linalg.eigvalsh(where.covariance[:2, :2]))
    assert sigmas_m[2][1] < 2.0
    # After 8 s without air data it may be a hundred metres off across the only range: nothing tells of a turn.
    assert sigmas_m[1][0] < 3.0
    assert sigmas_m[1][1] > 100.0


@pytest.mark.parametrize("n", [0, 1])
def test_without_air_data_no_range_or_one_does_not_keep_it(n: int):
    flight = Flight(FleetFilter(), {4})
    flight.pairs = [(4, 1)][:n]
    flight.run(22.0)
    where = flight.estimator.estimate(4, 22.0)
    assert isinstance(where, NoEstimate)
    assert where.reason.reason is NoEstimateReason.TOO_UNCERTAIN


def test_two_failed_vehicles_that_range_each_other_help_each_other():
    alone, together = [], []
    for seed in range(3):
        for pairs, errors in (([], alone), ([(4, 5)], together)):
            flight = Flight(FleetFilter(), {4, 5}, seed=seed)
            # Each hears two healthy ones only; what each lacks the other knows.
            flight.pairs = [(4, 1), (4, 2), (5, 2), (5, 3), *pairs]
            flight.run(30.0)
            for vehicle in (4, 5):
                where = flight.estimator.estimate(vehicle, 30.0)
                assert isinstance(where, Estimate)
                errors.append(math.sqrt(where.covariance[0, 0] + where.covariance[1, 1]))
                assert flight.error_m(vehicle) < 4.0 * errors[-1] + 1.0
    assert np.mean(together) < np.mean(alone)


def test_it_starts_cold_from_ranges_alone():
    flight = Flight(FleetFilter(), {4}, lost_s=0.0)
    where = flight.estimator.estimate(4, 0.0)
    assert isinstance(where, NoEstimate)
    flight.run(15.0)
    assert flight.error_m(4) < 5.0


def test_cold_with_two_peers_it_says_that_it_is_ambiguous():
    flight = Flight(FleetFilter(), {4}, lost_s=0.0)
    flight.pairs = [(4, 1), (4, 2)]
    flight.run(3.0)
    where = flight.estimator.estimate(4, flight.now_s)
    assert isinstance(where, NoEstimate)
    assert where.reason.reason in AMBIGUOUS


def test_a_wrong_state_is_not_kept_against_the_ranges():
    flight = Flight(FleetFilter(), {4})
    flight.run(3.0)
    # The last report before the loss was 300 m off, and stated half a metre.
    place = FLEET[4](3.0) + np.array([300.0, 0.0, 0.0])
    for k in range(40):
        t = 3.0 + 0.001 * k
        flight.estimator.add(PositionMeasurement(4, t, t, tuple(place.tolist()), 0.5, 0.5, (10.0, 15.0, 0.0), 0.3))
    flight.lost_s = 3.1
    flight.now_s = 3.1
    flight.run(10.0)
    first = flight.estimator.estimate(4, flight.now_s)
    if isinstance(first, Estimate):
        sigma = math.sqrt(first.covariance[0, 0] + first.covariance[1, 1])
        assert flight.error_m(4) < 6.0 * sigma
    flight.run(40.0)
    assert flight.error_m(4) < 5.0


def test_gross_outliers_are_refused_and_told():
    flight = Flight(FleetFilter(), {4})
    flight.run(20.0)
    flight.estimator.drain_residuals()
    t = flight.now_s
    r = float(np.linalg.norm(FLEET[4](t) - FLEET[1](t)))
    flight.estimator.add(RangeMeasurement(4, 1, t, t, r + 60.0, 1.0))
    (residual,) = flight.estimator.drain_residuals()
    assert residual.refused is not None
    assert residual.innovation_m == pytest.approx(60.0, abs=6.0)
    assert flight.error_m(4) < 3.0


def test_positions_of_a_denied_vehicle_are_no_evidence():
    flight = Flight(FleetFilter(), {4})
    flight.run(20.0)
    before = flight.estimator.estimate(4, 20.0)
    flight.estimator.add(PositionMeasurement(4, 20.0, 20.0, (0.0, 0.0, 0.0), 0.1, 0.1))
    after = flight.estimator.estimate(4, 20.0)
    assert isinstance(before, Estimate)
    assert isinstance(after, Estimate)
    np.testing.assert_array_equal(before.position_enu_m, after.position_enu_m)
    assert flight.estimator.counts()["refused: position of a denied vehicle"] == 1


def test_without_ranges_it_becomes_unknown_in_the_end():
    flight = Flight(FleetFilter(), {4})
    flight.run(10.0)
    flight.pairs = []
    flight.run(200.0)
    where = flight.estimator.estimate(4, 200.0)
    assert isinstance(where, NoEstimate)
    assert where.reason.reason is NoEstimateReason.TOO_UNCERTAIN


def test_ids_may_be_numpys_integers():
    """A data set read with numpy has them; two clusters were not merged, and their errors taken for independent."""

    def located(kind: type) -> Estimate | NoEstimate:
        estimator = FleetFilter()
        anchors = {1: (0.0, 0.0, 2.0), 2: (100.0, 0.0, 2.0), 3: (0.0, 100.0, 2.0)}
        for anchor, place in anchors.items():
            estimator.add(PositionMeasurement(kind(anchor), 0.0, 0.0, place, 0.1, 0.1, static=True))
        estimator.set_denied({kind(4)}, 0.0)
        for t in (0.2 * i for i in range(50)):
            for anchor, place in anchors.items():
                estimator.add(RangeMeasurement(kind(4), kind(anchor), t, t, math.dist((40.0 + 2.0 * t, 30.0, 10.0), place), 0.1))
        return estimator.estimate(kind(4), 9.8)

    answer, of_numpy = located(int), located(np.int64)
    assert isinstance(answer, Estimate)
    assert isinstance(of_numpy, Estimate)
    assert np.array_equal(answer.position_enu_m, of_numpy.position_enu_m)
    assert np.array_equal(answer.covariance, of_numpy.covariance)


def test_impossible_late_future_and_double_values_are_counted_and_change_nothing():
    estimator = FleetFilter()
    good = RangeMeasurement(4, 1, 10.0, 10.1, 100.0, 1.0)
    for m in (
        RangeMeasurement(4, 1, 10.0, 10.1, math.nan, 1.0),
        RangeMeasurement(4, 1, 10.0, 10.1, -3.0, 1.0),
        RangeMeasurement(4, 1, 10.0, 10.1, 1e300, 1.0),
        RangeMeasurement(4, 1, 10.0, 10.1, 100.0, 0.0),
        RangeMeasurement(4, 4, 10.0, 10.1, 100.0, 1.0),
        PositionMeasurement(1, 10.0, 10.1, (math.inf, 0.0, 0.0), 1.0, 1.0),
        AttitudeMeasurement(1, 10.0, 10.1, 0.0, 0.0, math.nan, 20.0),
        AltitudeMeasurement(4, math.nan, 10.1, 100.0, 1.0),
        good,
        good,
        RangeMeasurement(4, 1, 8.0, 10.2, 100.0, 1.0),
        RangeMeasurement(4, 1, 12.0, 10.2, 100.0, 1.0),
    ):
        estimator.add(m)
    counts = estimator.counts()
    assert counts["refused: impossible value"] == 8
    assert counts[Outcome.REFUSED_DUPLICATE] == 1
    assert counts["refused: too late"] == 1
    assert counts["refused: measured in the future"] == 1


def test_a_report_that_a_radio_held_back_counts_where_its_velocity_has_led():
    """Radios of real copters held reports back for 0.6 to 3.3 s; refused, a peer drifted 39 m and others with it."""
    estimator, velocity = FleetFilter(), (4.0, -3.0, 0.0)
    for second in range(12):
        place = (100.0 + 4.0 * second, 50.0 - 3.0 * second, 100.0)
        delay_s = 2.4 if second > 5 else 0.2
        estimator.add(PositionMeasurement(1, float(second), second + delay_s, place, 1.5, 2.0, velocity, 0.3))
    where = estimator.estimate(1, 13.4)
    assert math.dist(where.position_enu_m, (153.6, 9.8, 100.0)) < 0.5
    assert estimator.counts().get(Outcome.REFUSED_TOO_LATE, 0) == 0
    for m in (
        PositionMeasurement(1, 12.0, 16.2, (148.0, 14.0, 100.0), 1.5, 2.0, velocity, 0.3),
        PositionMeasurement(1, 14.0, 16.3, (156.0, 8.0, 100.0), 1.5, 2.0),
        PositionMeasurement(1, 14.1, 16.4, (156.4, 7.7, 100.0), 1.5, 2.0, velocity, 0.3),
        PositionMeasurement(1, 14.1, 16.6, (156.4, 7.7, 100.0), 1.5, 2.0, velocity, 0.3),
    ):
        estimator.add(m)
    assert estimator.counts()[Outcome.REFUSED_DUPLICATE] == 1, "heard again by another link"
    assert estimator.counts()[Outcome.REFUSED_TOO_LATE] == 2, "later than any radio's, and without a velocity"


def test_a_vehicle_never_heard_of_is_unknown_with_the_reason():
    where = FleetFilter().estimate(7, 0.0)
    assert isinstance(where, NoEstimate)
    assert where.reason.reason is NoEstimateReason.NOT_HEARD


def test_a_healthy_vehicle_is_answered_for_too():
    flight = Flight(FleetFilter(), {4})
    flight.run(20.0)
    for vehicle in (1, 5):  # one in the joint filter, one that nobody ranges
        assert flight.error_m(vehicle) < 2.0


def test_it_answers_for_shortly_before_the_newest_measurement():
    flight = Flight(FleetFilter(), {4})
    flight.run(20.0)
    where = flight.estimator.estimate(4, 19.6)
    assert isinstance(where, Estimate)
    assert float(np.linalg.norm((where.position_enu_m - FLEET[4](19.6))[:2])) < 3.0


def test_a_vehicle_whose_gps_is_back_is_its_own_witness_again():
    flight = Flight(FleetFilter(), {4})
    flight.run(20.0)
    flight.denied = set()
    flight.run(22.0)
    assert flight.error_m(4) < 2.0


def test_at_most_k_peers_are_used():
    estimator = FleetFilter(FleetSettings(peers_per_denied_vehicle=3))
    rng = np.random.default_rng(1)
    places = {v: np.array([*rng.uniform(-2000.0, 2000.0, 2), rng.uniform(80.0, 200.0)]) for v in range(10, 40)}
    denied_vehicle = np.array([0.0, 0.0, 100.0])
    estimator.add(PositionMeasurement(1, 0.0, 0.0, (0.0, 0.0, 100.0), 1.0, 1.0, (0.0, 0.0, 0.0), 0.3))
    estimator.set_denied({1}, 0.01)
    for k in range(1, 60):
        t = 0.1 * k
        for v, place in places.items():
            estimator.add(PositionMeasurement(v, t, t, tuple(place.tolist()), 0.5, 0.5, (0.0, 0.0, 0.0), 0.3))
            estimator.add(RangeMeasurement(1, v, t, t, float(np.linalg.norm(place - denied_vehicle)), 1.0))
    where = estimator.estimate(1, 6.0)
    assert isinstance(where, Estimate)
    assert where.ranges_in_use <= 6  # three, and those changed within the last two seconds
    assert where.hdop is not None
    assert where.hdop < 1.6
    assert estimator.counts()[Outcome.KEPT_NOT_SELECTED] > 1000
