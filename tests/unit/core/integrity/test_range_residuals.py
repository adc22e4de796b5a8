"""Range residuals of one second, and their sigmas."""

import numpy as np
import pytest

from gcs_coloc.core.integrity.range_residuals import WAIT_S, RangeResidualBuffer, TrackPoint
from gcs_coloc.core.measurements import RangeMeasurement

APART_M = 1000.0


def residuals_of(ranges_m, every_s=0.2):
    residuals = RangeResidualBuffer()
    for k, range_m in enumerate(ranges_m):
        t = k * every_s
        for vehicle, east_m in ((1, 20.0 * t), (2, 20.0 * t + APART_M)):
            place = TrackPoint(t, (east_m, 0.0, 100.0), (20.0, 0.0, 0.0), 1.5, 2.0, no_prior=False)
            residuals.add_position(vehicle, place)
        residuals.add_range(RangeMeasurement(1, 2, t, t, range_m, 1.0))
    return residuals.epoch((len(ranges_m) - 1) * every_s + WAIT_S).residuals


def test_a_single_late_range_does_not_move_the_residual():
    (residual,) = residuals_of([APART_M + 2.0, APART_M + 2.1, APART_M + 80.0, APART_M + 1.9, APART_M + 2.0])
    assert residual.residual_m == pytest.approx(2.0, abs=0.11)
    # 1 m, five ranges, a median: 0.56 m, and the tenth that no averaging removes.
    assert residual.sigma_m == pytest.approx(np.sqrt(1.57 / 5 + 0.1), rel=1e-6)


def test_where_most_ranges_are_late_the_sigma_covers_the_error():
    for late_m in (10.0, 30.0, 100.0):
        (residual,) = residuals_of([APART_M, APART_M + late_m, APART_M + 0.1, APART_M + late_m, APART_M + late_m])
        assert residual.residual_m == pytest.approx(late_m)
        assert residual.residual_m < 2.6 * residual.sigma_m


def test_few_ranges_use_a_longer_window_and_too_few_make_no_residual():
    # Every 0.9 s: two in the last second, four in the last three; every 1.9 s: four in the last six.
    assert len(residuals_of([APART_M] * 6, every_s=0.9)) == 1
    assert len(residuals_of([APART_M] * 6, every_s=1.9)) == 1
    assert residuals_of([APART_M] * 6, every_s=3.1) == ()


def test_of_few_ranges_the_newest_five_count():
    # Every 0.3 s: four in the last second, ten in the last three.
    (residual,) = residuals_of([APART_M + 90.0] * 6 + [APART_M + 2.0] * 5, every_s=0.3)
    assert residual.residual_m == pytest.approx(2.0)
    assert residual.sigma_m == pytest.approx(np.sqrt(1.57 / 5 + 0.1), rel=1e-6)


def test_ranges_that_have_stopped_soon_make_no_residual():
    residuals = RangeResidualBuffer()
    for k in range(21):
        t = 0.2 * k
        for vehicle, east_m in ((1, 0.0), (2, APART_M)):
            residuals.add_position(vehicle, TrackPoint(t, (east_m, 0.0, 100.0), (0.0, 0.0, 0.0), 1.5, 2.0, no_prior=False))
        if t < 2.1:
            residuals.add_range(RangeMeasurement(1, 2, t, t, APART_M, 1.0))
    # The newest was measured 2.0 s after the start.
    assert len(residuals.epoch(3.3 + WAIT_S).residuals) == 1
    assert residuals.epoch(3.5 + WAIT_S).residuals == ()


def test_between_two_reports_a_turn_is_followed_and_a_later_range_waits_for_the_next_one():
    """One brakes by 5 m/s² from 20 m/s and tells it each second; the other one stands."""
    residuals = RangeResidualBuffer()

    def east_m(t):
        return 20.0 * t - 2.5 * t * t

    def report(t):
        residuals.add_position(1, TrackPoint(t, (east_m(t), 0.0, 100.0), (20.0 - 5.0 * t, 0.0, 0.0), 1.5, 2.0, no_prior=False))
        residuals.add_position(2, TrackPoint(t, (-APART_M, 0.0, 100.0), (0.0, 0.0, 0.0), 1.5, 2.0, no_prior=False))

    report(0.0)
    report(1.0)
    for t in (0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6):
        residuals.add_range(RangeMeasurement(1, 2, t, t, APART_M + east_m(t) + 2.0, 1.0))
    residuals.epoch(1.85)
    assert residuals.ranged_at_s(1) == {2: 1.2}
    report(2.0)
    epoch = residuals.epoch(2.05)
    assert residuals.ranged_at_s(1) == {2: 1.6}
    assert epoch.priors[1].position_enu_m == pytest.approx((east_m(1.35), 0.0, 100.0))
    (residual,) = epoch.residuals
    assert residual.residual_m == pytest.approx(2.0, abs=1e-9)
    # The residuals of 0.6 to 1.6 s agree but for the one that was extrapolated, by 0.1 m: the noise is what is stated.
    assert residual.sigma_m == pytest.approx(np.sqrt(1.57 / 6 + 0.1), rel=1e-6)


def test_a_vehicle_takes_part_for_a_while_after_its_last_report():
    residuals = RangeResidualBuffer()
    for step in range(30):
        t = 0.2 * step
        if t < 2.1:
            residuals.add_position(1, TrackPoint(t, (0.0, 0.0, 100.0), (0.0, 0.0, 0.0), 1.5, 2.0, no_prior=False))
        residuals.add_position(2, TrackPoint(t, (APART_M, 0.0, 100.0), (0.0, 0.0, 0.0), 1.5, 2.0, no_prior=False))
        residuals.add_range(RangeMeasurement(1, 2, t, t, APART_M, 1.0))
        took_part = len(residuals.epoch(t).residuals) == 1
        # An epoch is 0.7 s ago, the last report was at 2.0 s; steps are of 0.2 s.
        assert took_part is (t < 2.0 + 1.5 + 0.75) or t < 1.0


def test_the_newest_and_the_oldest_range_are_so_by_their_time_and_not_by_their_arrival():
    residuals = RangeResidualBuffer()
    for t in (0.0, 0.5, 1.0):
        for vehicle, east_m in ((1, 0.0), (2, APART_M)):
            residuals.add_position(vehicle, TrackPoint(t, (east_m, 0.0, 100.0), (0.0, 0.0, 0.0), 1.5, 2.0, no_prior=False))
    for measured_s in (0.6, 1.0, 0.2, 0.4, 0.8):
        residuals.add_range(RangeMeasurement(1, 2, measured_s, 1.1, APART_M, 1.0))
    assert residuals.epoch(1.2).began_s == 0.2
    assert residuals.ranged_at_s(1) == {2: 1.0}


def test_of_many_peers_eight_count_and_those_that_did_before_go_on():
    residuals, known = RangeResidualBuffer(), range(60, 66)

    def second(from_s, ranges, detected=()):
        """Add a second of standing vehicles and of so many ranges of vehicle 1 to each peer; return who is in the epochs."""
        for t in (from_s, from_s + 0.5, from_s + 1.0):
            for vehicle in (1, *ranges):
                place = (APART_M * vehicle, 0.0, 100.0)
                residuals.add_position(vehicle, TrackPoint(t, place, (0.0, 0.0, 0.0), 1.5, 2.0, no_prior=False))
        for peer, count in ranges.items():
            for t in np.linspace(from_s + 0.1, from_s + 1.0, count).tolist():
                residuals.add_range(RangeMeasurement(1, peer, t, t, APART_M * abs(peer - 1), 1.0))
        now_s = from_s + 1.2
        dense = residuals.epoch(now_s, detected)
        assert dense.priors.keys() == {v for r in dense.residuals for v in r.pair}
        return [{r.to_vehicle for r in epoch.residuals} for epoch in (dense, residuals.sparse_epoch(now_s, dense))]

    assert second(0.0, dict.fromkeys(known, 5)) == [set(known)] * 2
    more = dict.fromkeys(range(-20, 0), 6) | dict.fromkeys((70, 71), 9)
    assert second(1.0, dict.fromkeys(known, 5) | more) == [{*known, 70, 71}] * 2
    # What the estimator goes by comes before all others: what is not tested may be off unseen.
    for peer in (-3, -7):
        residuals.add_selected((1, peer), 2.5)
    for epoch in second(2.0, dict.fromkeys(known, 5) | more):
        assert len(epoch) == 8
        assert {-3, -7} < epoch < {-3, -7, *known, 70, 71}
    # A vehicle that is detected is selected no more: it would be trusted again if it were not tested.
    for epoch in second(3.0, dict.fromkeys(known, 5) | more, detected={-9}):
        assert len(epoch) == 9
        assert -9 in epoch
    # One that is detected ranges no more of its peers in the tests than others do.
    assert [len(epoch) for epoch in second(4.0, dict.fromkeys(known, 5) | more, detected={1})] == [8, 8]
    # Six seconds later it has long selected others.
    for s in range(5, 8):
        last = second(float(s), dict.fromkeys(known, 5))
    assert second(8.0, dict.fromkeys(known, 5) | more) == [{*known, 70, 71}] * 2
    assert last == [set(known)] * 2
