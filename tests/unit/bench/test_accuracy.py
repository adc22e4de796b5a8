"""What the benchmark calls the filter's model is that model; its links and its peers do what they say."""

import numpy as np
import pytest

from bench import accuracy_model
from bench.accuracy_flights import RANGE_SIGMA_M, Case, Links, record
from bench.accuracy_model import ModelCase, bounds_rms_m, draw
from bench.accuracy_peers import FilterpyEkf, FilterpyUkf, installed
from bench.accuracy_runs import anees, band_95, rmse_m, run_estimator
from gcs_coloc.core.measurements import PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.ekf._kernels import Transition
from gcs_coloc.estimators.fleet.ekf.state import SIZE
from sitl_fakes.guidance import PAPER_ROUTES

TEN_SECONDS = Case(rate_hz=5.0, duration_s=10.0)


def test_the_mean_of_the_drawn_motion_is_the_filters_own():
    turn_radps, step_s, turn_time_s = 0.07, 0.2, 3.0
    velocity = np.array([[[40.0, -30.0, 1.0]]])
    moved = accuracy_model._move(velocity, np.array([[turn_radps]]), step_s, turn_time_s)
    state = np.zeros(SIZE)
    state[3:6] = velocity[0, 0]
    effective_radps = turn_radps * turn_time_s * (1.0 - np.exp(-step_s / turn_time_s)) / step_s
    after = Transition().set_motion(state.tolist(), step_s, effective_radps, in_wind=False)
    np.testing.assert_allclose(moved.way[0, 0], after[:3], rtol=1e-12)
    np.testing.assert_allclose(moved.velocity[0, 0], [*after[3:5], velocity[0, 0, 2]], rtol=1e-12)


def test_averaging_the_information_over_draws_never_gives_more_than_the_bounds_along_each():
    # Inverse matrices are convex: the inverse of the mean information is at most the mean of the inverses.
    posterior_m, along_m = bounds_rms_m(draw(ModelCase(5.0, 4.0, 10.0, 30.0), 12, seed=3))
    assert 1.0 < posterior_m <= along_m < 15.0


def test_one_draw_has_one_bound():
    posterior_m, along_m = bounds_rms_m(draw(ModelCase(5.0, 4.0, 2.0, 6.0), 1, seed=3))
    assert posterior_m == pytest.approx(along_m, rel=1e-6)


def test_draws_start_on_the_papers_routes_with_the_stated_noise():
    draws = draw(ModelCase(5.0, 4.0, 2.0, 6.0), 40, seed=1)
    np.testing.assert_array_equal(draws.places_m[0, 0, :, :2], [route[0] for route in PAPER_ROUTES])
    distance = np.linalg.norm(draws.places_m[:, :, 3:] - draws.places_m[:, :, :3], axis=-1)
    # 40 draws x 51 epochs x 3 pairs: 6120 values, and a slow part of 6 % of sigma; 5 % is over five standard errors.
    assert (draws.ranges_m - distance).std() == pytest.approx(RANGE_SIGMA_M, rel=0.05)


def test_telemetry_arrives_in_order_late_with_gaps_and_stamps_on_the_services_clock():
    links = Links()
    ideal = record(TEN_SECONDS, 1).measurements
    late = record(Case(rate_hz=5.0, duration_s=10.0, links=links), 1).measurements
    arrived = [m.arrived_at_s for m in late]
    assert arrived == sorted(arrived)
    # Binomial with n = len(ideal): four standard deviations about the share that is kept.
    n, kept = len(ideal), 1.0 - links.lost_share
    assert abs(len(late) - n * kept) < 4.0 * np.sqrt(n * kept * links.lost_share)
    delays = np.array([m.arrived_at_s - m.measured_at_s for m in late])
    assert delays.min() > -1e-6
    assert delays.max() < links.jitter_s + 0.001
    # Stamps are late by the least delay of the sender's link and no more: clock offsets of seconds are gone.
    lag = [m.measured_at_s % 0.2 for m in late if isinstance(m, PositionMeasurement)]
    assert min(lag) > links.min_delay_s[0] - 0.001


def test_failed_vehicles_range_each_other_once_and_only_where_asked():
    two = {"rate_hz": 5.0, "duration_s": 1.0, "failed": (4, 5), "fifth": True}

    def pairs(mutual: bool) -> list[tuple[int, int]]:
        recording = record(Case(**two, mutual=mutual), 1)
        return [(m.from_vehicle, m.to_vehicle) for m in recording.measurements if isinstance(m, RangeMeasurement)]

    assert pairs(mutual=True).count((4, 5)) == 5
    assert (5, 4) not in pairs(mutual=True)
    assert (4, 5) not in pairs(mutual=False)


def test_peers_agree_where_ranges_are_long():
    recording = record(Case(rate_hz=5.0, duration_s=30.0), 2)
    ekf, ukf = (run_estimator(recording, peer()).tracks[4] for peer in (FilterpyEkf, FilterpyUkf))
    np.testing.assert_allclose(ekf.error_m, ukf.error_m, atol=0.5)
    assert rmse_m([ekf]) < RANGE_SIGMA_M
    assert 0.1 < anees([ekf]) < band_95(1)[1]


@pytest.mark.skipif(not installed("stonesoup"), reason="Stone Soup is not installed")
def test_stone_soup_and_filterpy_are_the_same_filter():
    from bench.accuracy_stonesoup import StoneSoupEkf

    recording = record(TEN_SECONDS, 1)
    ours, theirs = (run_estimator(recording, peer()).tracks[4] for peer in (FilterpyEkf, StoneSoupEkf))
    np.testing.assert_allclose(ours.error_m, theirs.error_m, atol=1e-5)


@pytest.mark.skipif(not installed("gtsam"), reason="GTSAM is not installed")
def test_the_smoother_is_near_the_filter():
    from bench.accuracy_gtsam import GtsamSmoother

    recording = record(TEN_SECONDS, 1)
    filtered, smoothed = (run_estimator(recording, peer()).tracks[4] for peer in (FilterpyEkf, GtsamSmoother))
    assert abs(rmse_m([filtered]) - rmse_m([smoothed])) < 1.0
