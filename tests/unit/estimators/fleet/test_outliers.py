from __future__ import annotations

import math

import numpy as np
import pytest
from fleet_in_flight import Fleet, circling

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import AltitudeMeasurement, Estimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.filter import FleetFilter

DENIED, SPEED_MPS = 9, 15.0
ANCHORS_M = {1: (-600.0, -500.0, 0.0), 2: (700.0, -400.0, 5.0), 3: (500.0, 600.0, 10.0), 4: (-500.0, 500.0, 15.0)}


def denied_at(t: float) -> np.ndarray:
    return np.array([-300.0 + SPEED_MPS * t, 50.0, 100.0])


class Flight:
    """Ranges of 1 m to four anchors five times a second, some of them too long; `off_m` is how wrong the start is.

    `stated_m` is the sigma that the ranging device states.
    """

    def __init__(self, seed: int, late_share: float, off_m: float = 0.0, stated_m: float = 1.0) -> None:
        self.stated_m = stated_m
        self.rng = np.random.default_rng(seed)
        self.late_share = late_share
        self.estimator = FleetFilter()
        for vehicle, place in ANCHORS_M.items():
            self.estimator.add(PositionMeasurement(vehicle, 0.0, 0.0, place, 0.3, 0.3, static=True))
        east_m, north_m, up_m = denied_at(0.0).tolist()
        start = (east_m, north_m + off_m, up_m)
        self.estimator.add(PositionMeasurement(DENIED, 0.0, 0.0, start, 1.5, 2.0, (SPEED_MPS, 0.0, 0.0), 0.3))
        self.estimator.set_denied({DENIED}, 0.0)

    def ratios(self, end_s: float) -> list[tuple[float, float]]:
        """Fly; return the errors in units of the 95 % bounds, with their times, wherever that bound is within 50 m."""
        out = []
        for k in range(1, round(end_s * 5.0)):
            t = 0.2 * k
            self.estimator.add(AltitudeMeasurement(DENIED, t, t, 100.0, 2.0))
            for p, place in ANCHORS_M.items():
                range_m = float(np.linalg.norm(denied_at(t) - place)) + self.rng.normal()
                if self.rng.random() < self.late_share:
                    range_m += self.rng.uniform(5.0, 50.0)
                self.estimator.add(RangeMeasurement(DENIED, p, t, t, range_m, self.stated_m))
            where = self.estimator.estimate(DENIED, t)
            if isinstance(where, Estimate) and (bound_m := horizontal_bound_95_m(where.covariance)) <= 50.0:
                out.append((t, math.dist(where.position_enu_m[:2], denied_at(t)[:2]) / bound_m))
        return out


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_three_of_ten_ranges_too_long_by_multipath_never_drag_it_beyond_what_is_stated(seed):
    ratios = [ratio for _, ratio in Flight(seed, late_share=0.3).ratios(38.0)]
    assert len(ratios) > 150
    assert max(ratios) < 2.0


def test_one_that_began_far_from_where_it_is_finds_back_and_is_not_sure_meanwhile():
    ratios = Flight(seed=1, late_share=0.0, off_m=60.0).ratios(12.0)
    assert max(ratio for t, ratio in ratios if t > 3.0) < 1.5
    assert any(t > 10.0 for t, _ in ratios)


def test_a_device_that_scatters_three_times_as_much_as_it_states_is_believed_less():
    # 23 % beyond the bound, at most 2.4 times it, as the scatter is proven bit by bit; 52 % and 3.1 times where it is believed.
    ratios = [ratio for seed in range(1, 7) for t, ratio in Flight(seed, late_share=0.0, stated_m=0.33).ratios(38.0) if t > 10.0]
    assert len(ratios) > 800
    assert sum(ratio > 1.0 for ratio in ratios) < 0.32 * len(ratios)
    assert max(ratios) < 2.8


@pytest.mark.parametrize("silent_s", [600.0, 7200.0, 40.0 * 86400.0])
def test_one_that_is_heard_again_after_minutes_hours_or_weeks_is_located_again(silent_s):
    """After weeks its variances had lost all their digits and were negative: every estimate of the fleet failed from then on."""
    centres_m = {1: (0.0, 0.0), 2: (1500.0, 0.0), 3: (300.0, 1600.0), 4: (700.0, 500.0)}
    fleet = Fleet({vehicle: circling(centre, 150.0, 15.0, 80.0 + 20.0 * vehicle) for vehicle, centre in centres_m.items()})
    estimator = FleetFilter()
    for vehicle in fleet.paths:
        estimator.add(fleet.position(vehicle, 0.0))
    estimator.set_denied({4}, 0.1)
    errors_m = []
    for begun_s in (0.2, silent_s):
        for t in np.arange(begun_s, begun_s + 20.0, 0.2).tolist():
            for measurement in fleet.round(t, (4,)):
                estimator.add(measurement)
            where = estimator.estimate(4, t)
        assert isinstance(where, Estimate)
        errors_m.append(math.dist(where.position_enu_m[:2], fleet.at(4, t)[:2]))
    assert max(errors_m) < 5.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_ranges_that_are_refused_do_not_vouch_for_each_other(seed):
    """It turns hard; the ranges to the two ahead and astern go on to fit, and those to the two aside are refused in turns."""
    peers_m = {1: (-150.0, 0.0), 2: (400.0, 10.0), 3: (60.0, 180.0), 4: (80.0, -170.0)}
    rng, estimator, turn_s, ratios = np.random.default_rng(seed), FleetFilter(), 8.0, {}
    for vehicle, place_m in peers_m.items():
        estimator.add(PositionMeasurement(vehicle, 0.0, 0.0, (*place_m, 100.0), 0.1, 0.1, static=True))
    for k in range(150):
        t = round(0.1 * k, 6)
        north_m = 4.0 * max(t - turn_s, 0.0) ** 2
        here_m = np.array([-60.0 + 15.0 * t, north_m])
        if t < 2.0:
            estimator.add(PositionMeasurement(DENIED, t, t, (*here_m.tolist(), 100.0), 0.5, 0.5, (15.0, 0.0, 0.0), 0.2))
            continue
        estimator.set_denied({DENIED}, t)
        estimator.add(AltitudeMeasurement(DENIED, t, t, 100.0, 0.5))
        peer = 1 + k % 4
        range_m = math.dist(here_m, peers_m[peer]) + 0.1 * rng.normal()
        estimator.add(RangeMeasurement(DENIED, peer, t, t, range_m, 0.1))
        where = estimator.estimate(DENIED, t)
        if isinstance(where, Estimate):
            ratios[t] = math.dist(where.position_enu_m[:2], here_m) / horizontal_bound_95_m(where.covariance)
    # Where each vouched for the other, 15 to 18 epochs were beyond three bounds, up to 6.4 times.
    assert len(ratios) > 120
    assert sum(ratio > 3.0 for ratio in ratios.values()) <= 1


def test_two_outliers_in_a_row_are_contradicted_by_ranges_used_a_moment_before():
    """A real plane among three others lost its fix for three seconds when two ranges in a row were 35 m too long."""
    rng, estimator, bounds_m = np.random.default_rng(5), FleetFilter(), []
    for vehicle in (1, 2, 3):
        estimator.add(PositionMeasurement(vehicle, 0.0, 0.0, ANCHORS_M[vehicle], 0.3, 0.3, static=True))
    for k in range(120):
        t = round(0.1 * k, 6)
        peer, here_m = 1 + k % 3, denied_at(t)
        if k < 20:
            estimator.add(PositionMeasurement(DENIED, t, t, here_m.tolist(), 0.5, 0.5, (SPEED_MPS, 0.0, 0.0), 0.2))
            continue
        estimator.set_denied({DENIED}, t)
        too_long_m = 35.0 if k in (80, 81) else 0.0
        estimator.add(AltitudeMeasurement(DENIED, t, t, 100.0, 0.5))
        estimator.add(RangeMeasurement(DENIED, peer, t, t, math.dist(here_m, ANCHORS_M[peer]) + too_long_m + rng.normal(), 1.0))
        where = estimator.estimate(DENIED, t)
        assert isinstance(where, Estimate)
        bounds_m.append(horizontal_bound_95_m(where.covariance))
    # Where neither of the two was contradicted, the bound was 29 m for a moment.
    assert max(bounds_m[30:]) < 5.0


def lost_again(*, was_wrong: bool) -> Estimate:
    """Return the estimate after one range too long at its second loss; `was_wrong`: at the first all were."""
    estimator, here_m = FleetFilter(), denied_at(0.0)
    for vehicle, place_m in ANCHORS_M.items():
        estimator.add(PositionMeasurement(vehicle, 0.0, 0.0, place_m, 0.3, 0.3, static=True))
    for begun_s, too_long_m in ((0.0, 60.0 if was_wrong else 0.0), (40.0, 60.0)):
        estimator.set_denied(set(), begun_s)
        for k in range(10):
            t = begun_s + 0.2 * k
            estimator.add(PositionMeasurement(DENIED, t, t, tuple(here_m.tolist()), 0.5, 0.5, (0.0, 0.0, 0.0), 0.2))
        estimator.set_denied({DENIED}, begun_s + 2.0)
        for k in range(7 if begun_s == 0.0 else 1):
            t, peer = begun_s + 2.1 + 0.02 * k, 1 + k % 4
            estimator.add(RangeMeasurement(DENIED, peer, t, t, math.dist(here_m, ANCHORS_M[peer]) + too_long_m, 1.0))
    where = estimator.estimate(DENIED, 42.2)
    assert isinstance(where, Estimate)
    return where


def test_ranges_refused_at_one_loss_of_gps_are_no_evidence_at_the_next():
    """Nearly all of the evidence stayed: one outlier at the next loss, minutes later, and the covariance was inflated."""
    before, anew = lost_again(was_wrong=True), lost_again(was_wrong=False)
    assert horizontal_bound_95_m(anew.covariance) < 10.0
    assert horizontal_bound_95_m(before.covariance) == pytest.approx(horizontal_bound_95_m(anew.covariance), rel=0.1)
