"""The fleet filter's prediction of a loss of GPS, against what the same filter states once the vehicle is denied."""

from __future__ import annotations

from dataclasses import replace
from math import atan2, hypot, inf, nan

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.estimator import LossQuery
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Estimate,
    Measurement,
    NoEstimate,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet import loss_prediction
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.loss_prediction import step_lengths_s
from gcs_coloc.estimators.fleet.settings import FleetSettings

LOST_S, HORIZON_S, HEIGHT_SIGMA_M = 10.0, 30.0, 2.0
GEOMETRIES = {
    "around": ((800.0, 100.0), (-500.0, 700.0), (-300.0, -800.0), (300.0, 900.0)),
    "three": ((800.0, 100.0), (-500.0, 700.0), (-300.0, -800.0)),
    "two": ((800.0, 100.0), (-500.0, 700.0)),
    "aside": ((1500.0, 100.0), (1200.0, 900.0), (900.0, -1100.0)),
    "ten": tuple((900.0 * np.cos(k), 700.0 * np.sin(k)) for k in range(10)),
}


class Flight:
    """Vehicle 1 and its peers fly north side by side at 20 m/s; noise as it is stated."""

    def __init__(self, geometry: str, *, air_data: bool, rate_hz: float, seed: int = 1, most_peers: int = 8) -> None:
        self.filter = FleetFilter(FleetSettings(peers_per_denied_vehicle=most_peers))
        self.ranges: list[RangeMeasurement] = []
        self._places = {1: (0.0, 0.0), **{2 + k: place for k, place in enumerate(GEOMETRIES[geometry])}}
        self._air_data, self._every = air_data, round(10.0 / rate_hz)
        self._rng = np.random.default_rng(seed)
        self._errors = {v: self._rng.normal(0.0, 1.0, 2) for v in self._places}
        for v in self._places:
            self.filter.add(VehicleClassReport(v, 0.0, 0.0, VehicleClass.PLANE))

    def fly(self, from_s: float, until_s: float, denied: bool) -> None:
        for k in range(round(10.0 * from_s), round(10.0 * until_s)):
            for m in self._measured(k, k / 10.0, denied):
                self.filter.add(m)

    def _at(self, v: int, t: float) -> np.ndarray:
        e, n = self._places[v]
        return np.array([e, n + 20.0 * t, 100.0 + 10.0 * v])

    def _measured(self, k: int, t: float, denied: bool) -> list[Measurement]:
        out: list[Measurement] = []
        for v in self._places:
            e, n, u = self._at(v, t).tolist()
            if not (denied and v == 1):
                de, dn = self._errors[v] + self._rng.normal(0.0, 0.2, 2)
                out.append(PositionMeasurement(v, t, t, (e + de, n + dn, u), 1.1, 1.8, (0.0, 20.0, 0.0), 0.3))
        if denied:
            # Before the loss its height is that of its position reports.
            out.append(AltitudeMeasurement(1, t, t, 110.0 + self._rng.normal(0.0, 0.2), HEIGHT_SIGMA_M))
        if self._air_data:
            out.append(AttitudeMeasurement(1, t, t, 0.0, 0.0, atan2(0.0, 20.0), hypot(0.0, 20.0)))
        if k % self._every == 0:
            for v in self._places.keys() - {1}:
                metres = float(np.linalg.norm(self._at(1, t) - self._at(v, t)) + self._rng.normal())
                self.ranges.append(RangeMeasurement(1, v, t, t, metres, 1.0))
                out.append(self.ranges[-1])
        return out


def predict(
    flight: Flight, ranges: list[RangeMeasurement], height_sigma_m: float = HEIGHT_SIGMA_M
) -> list[Estimate | NoEstimate]:
    return flight.filter.predict_loss(LossQuery(1, LOST_S, HORIZON_S, ranges, height_sigma_m=height_sigma_m))


def sigma_m(answer: Estimate | NoEstimate) -> float:
    assert isinstance(answer, Estimate)
    return horizontal_sigma_m(answer.covariance)


@pytest.mark.parametrize("rate_hz", [10.0, 1.0])
@pytest.mark.parametrize("air_data", [True, False])
@pytest.mark.parametrize("geometry", list(GEOMETRIES))
def test_the_predicted_sigma_is_what_the_filter_states_half_a_minute_later(geometry: str, air_data: bool, rate_hz: float) -> None:
    flight = Flight(geometry, air_data=air_data, rate_hz=rate_hz)
    flight.fly(0.0, LOST_S, denied=False)
    predicted = predict(flight, flight.ranges)
    flight.filter.set_denied([1], LOST_S)
    assert sigma_m(predicted[0]) == pytest.approx(sigma_m(flight.filter.estimate(1, LOST_S)), rel=0.05)
    flight.fly(LOST_S, LOST_S + HORIZON_S - 1.0, denied=True)
    sigmas_m = []
    for at_s in np.arange(LOST_S + HORIZON_S - 1.0, LOST_S + HORIZON_S + 1.0, 0.1).tolist():
        # Between two ranges it grows: the mean counts.
        flight.fly(at_s, at_s + 0.1, denied=True)
        sigmas_m.append(sigma_m(flight.filter.estimate(1, at_s)))
    reached = flight.filter.estimate(1, LOST_S + HORIZON_S)
    assert isinstance(reached, Estimate)
    assert sigma_m(predicted[-1]) == pytest.approx(np.mean(sigmas_m), rel=0.12)
    assert predicted[-1].at_s == LOST_S + HORIZON_S
    assert predicted[-1].hdop == pytest.approx(reached.hdop, rel=0.05)


@pytest.mark.parametrize(("air_data", "answer"), [(True, Estimate), (False, NoEstimate)])
def test_one_neighbour_keeps_a_vehicle_with_air_data_alone(air_data: bool, answer: type) -> None:
    flight = Flight("two", air_data=air_data, rate_hz=5.0)
    flight.fly(0.0, LOST_S, denied=False)
    assert isinstance(predict(flight, [m for m in flight.ranges if m.to_vehicle == 2])[-1], answer)


def test_to_predict_leaves_the_filter_as_it_is() -> None:
    asked, other = (Flight("around", air_data=True, rate_hz=5.0) for _ in range(2))
    for flight in (asked, other):
        flight.fly(0.0, LOST_S, denied=False)
        if flight is asked:
            predict(flight, flight.ranges)
        flight.filter.set_denied([1], LOST_S)
        flight.fly(LOST_S, LOST_S + 5.0, denied=True)
    mine, others = (flight.filter.estimate(1, LOST_S + 5.0) for flight in (asked, other))
    assert isinstance(mine, Estimate)
    assert isinstance(others, Estimate)
    assert mine.position_enu_m.tolist() == others.position_enu_m.tolist()
    assert mine.covariance.tolist() == others.covariance.tolist()
    assert asked.filter.counts() == other.filter.counts()


@pytest.mark.parametrize("air_data", [True, False])
def test_the_few_steps_state_what_many_short_ones_would(air_data: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    flight = Flight("around", air_data=air_data, rate_hz=5.0)
    flight.fly(0.0, LOST_S, denied=False)
    few = predict(flight, flight.ranges)
    monkeypatch.setattr(loss_prediction, "step_lengths_s", lambda horizon_s: [0.25] * round(horizon_s / 0.25))
    many = predict(flight, flight.ranges)
    assert len(few) < 12 < len(many)
    assert sigma_m(few[-1]) == pytest.approx(sigma_m(many[-1]), rel=0.05)


@pytest.mark.parametrize("horizon_s", [0.5, 3.0, 30.0, 47.0])
def test_the_steps_end_at_the_horizon(horizon_s: float) -> None:
    steps_s = step_lengths_s(horizon_s)
    assert sum(steps_s) == pytest.approx(horizon_s)
    assert min(steps_s) > 0.0


def test_ranges_that_arrive_late_leave_the_motion_since_then_open() -> None:
    flight = Flight("around", air_data=False, rate_hz=5.0)
    flight.fly(0.0, LOST_S, denied=False)
    late = [replace(m, arrived_at_s=m.measured_at_s + 0.5) for m in flight.ranges]
    at_once, later = (predict(flight, ranges)[-1] for ranges in (flight.ranges, late))
    assert later.at_s == LOST_S + HORIZON_S
    assert sigma_m(later) > 1.1 * sigma_m(at_once)


def test_without_ranges_it_is_the_motion_alone_that_is_predicted() -> None:
    flight = Flight("around", air_data=False, rate_hz=5.0)
    flight.fly(0.0, LOST_S, denied=False)
    alone = predict(flight, [])
    assert isinstance(alone[0], Estimate)
    assert isinstance(alone[-1], NoEstimate)


def test_ranges_that_have_ceased_do_not_count() -> None:
    flight = Flight("around", air_data=True, rate_hz=5.0)
    flight.fly(0.0, LOST_S, denied=False)
    old = [replace(m, measured_at_s=m.measured_at_s - 6.0) for m in flight.ranges]
    alone, ceased = (predict(flight, ranges)[-1] for ranges in ([], old))
    assert sigma_m(alone) == sigma_m(ceased)


@pytest.mark.parametrize("vehicle", [1, 7])
def test_of_what_it_does_not_know_nothing_is_predicted(vehicle: int) -> None:
    flight = Flight("around", air_data=True, rate_hz=5.0)
    [answer] = FleetFilter().predict_loss(LossQuery(vehicle, 0.0, HORIZON_S, flight.ranges))
    assert isinstance(answer, NoEstimate)
    assert answer.at_s == 0.0


def test_peers_that_it_does_not_know_do_not_count() -> None:
    flight = Flight("around", air_data=True, rate_hz=5.0)
    flight.fly(0.0, LOST_S, denied=False)
    ghosts = [RangeMeasurement(1, 99, m.measured_at_s, m.arrived_at_s, m.range_m, 1.0) for m in flight.ranges]
    assert predict(flight, ghosts)[-1].hdop is None


def test_an_anchor_counts_as_a_peer_at_rest() -> None:
    flight = Flight("two", air_data=True, rate_hz=5.0)
    flight.filter.add(PositionMeasurement(-5, 0.0, 0.0, (200.0, -900.0, 10.0), 0.1, 0.1, static=True))
    flight.fly(0.0, LOST_S, denied=False)
    anchor = [RangeMeasurement(1, -5, t / 5.0, t / 5.0, 900.0 + 0.1 * (t % 3), 1.0) for t in range(50)]
    without, with_it = (predict(flight, flight.ranges + more)[-1] for more in ([], anchor))
    assert sigma_m(with_it) < 0.8 * sigma_m(without)


@pytest.mark.parametrize("value", [nan, -1.0])
def test_impossible_ranges_raise_nothing(value: float) -> None:
    flight = Flight("two", air_data=True, rate_hz=5.0)
    flight.fly(0.0, LOST_S, denied=False)
    bad = [replace(m, range_m=value) for m in flight.ranges[-9:]]
    assert predict(flight, bad)


def test_the_height_is_known_while_heights_go_on_and_no_longer_without_them() -> None:
    flight = Flight("two", air_data=True, rate_hz=5.0)
    flight.fly(0.0, LOST_S, denied=False)
    with_heights, without = (predict(flight, flight.ranges, each_m)[-1] for each_m in (HEIGHT_SIGMA_M, inf))
    flight.filter.set_denied([1], LOST_S)
    flight.fly(LOST_S, LOST_S + HORIZON_S, denied=True)
    reached = flight.filter.estimate(1, LOST_S + HORIZON_S)
    assert isinstance(reached, Estimate)
    assert isinstance(with_heights, Estimate)
    assert isinstance(without, Estimate)
    assert with_heights.covariance[2, 2] == pytest.approx(reached.covariance[2, 2], rel=0.3)
    assert without.covariance[2, 2] > 10.0 * with_heights.covariance[2, 2]


def test_without_a_height_a_peer_overhead_is_selected(monkeypatch: pytest.MonkeyPatch) -> None:
    """The filter selects it where it has no height; the prediction did without and left the height open."""
    monkeypatch.setitem(GEOMETRIES, "ten and one overhead", (*GEOMETRIES["ten"], (20.0, 10.0)))
    flight = Flight("ten and one overhead", air_data=True, rate_hz=5.0, most_peers=3)
    flight.fly(0.0, LOST_S, denied=False)
    answer = predict(flight, flight.ranges, height_sigma_m=inf)[-1]
    assert isinstance(answer, Estimate)
    assert answer.covariance[2, 2] < 3.0**2
