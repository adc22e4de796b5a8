"""Which ranges the estimator of Qu & Zhang makes a fix of, and what it says where there can be none."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fleet_in_flight import FOUR, Fleet, straight
from hypothesis import given, settings
from hypothesis import strategies as st
from qu_zhang_in_flight import STEP_S, error_m, fly, located, why_unknown

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.estimators.qu_zhang.filter import QuZhangFilter
from gcs_coloc.estimators.qu_zhang.settings import QuZhangSettings


def test_ranges_at_different_instants_are_brought_together() -> None:
    # Noise-free: three ranges 0.1 s apart at 200 m/s would be off by tens of metres if taken as one instant.
    paths = {**FOUR, 4: straight((700, -500, 110), (120, 160, 0))}
    fleet = Fleet(paths=paths, sigma_position_m=1e-3, sigma_range_m=1e-3, sigma_altitude_m=1e-3)
    estimator = QuZhangFilter()
    fly(estimator, fleet, 0.0, 3.0)
    estimator.set_denied([4], 3.0)
    for k in range(30):
        t = 3.0 + 0.2 * k
        for vehicle in (1, 2, 3):
            estimator.add(fleet.position(vehicle, t))
        estimator.add(fleet.altitude(4, t))
        for i, peer in enumerate((1, 2, 3)):
            estimator.add(fleet.range(peer, 4, t + 0.1 * i - 0.2))

    assert estimator.counts()["fix used"] >= 25
    assert error_m(located(estimator, 4, 8.8), fleet) < 0.5


def test_ranges_whose_latencies_differ_still_meet_in_their_epoch() -> None:
    fleet, estimator = Fleet(), QuZhangFilter()
    fly(estimator, fleet, 0.0, 5.0)
    estimator.set_denied([4], 5.0)
    sent = []
    for k in range(100):
        t = 5.0 + 0.1 * k
        sent += [fleet.position(vehicle, t) for vehicle in (1, 2, 3)] + [fleet.altitude(4, t)]
        sent += [fleet.range(peer, 4, t, latency_s=latency) for peer, latency in ((1, 0.05), (2, 0.25), (3, 0.45))]
    for measurement in sorted(sent, key=lambda one: one.arrived_at_s):
        estimator.add(measurement)

    assert estimator.counts()["fix used"] >= 95
    assert error_m(located(estimator, 4, 14.9), fleet) < 4.0


@pytest.mark.parametrize("peers", [(1, 2), (1,), ()])
def test_with_fewer_than_three_peers_it_predicts_then_says_unknown(peers: tuple[int, ...]) -> None:
    fleet, estimator = Fleet(), QuZhangFilter()
    fly(estimator, fleet, 0.0, 20.0)
    estimator.set_denied([4], 20.0)
    for k in range(150):
        t = 20.0 + k * STEP_S
        for vehicle in (1, 2, 3):
            estimator.add(fleet.position(vehicle, t))
        estimator.add(fleet.altitude(4, t))
        for peer in peers:
            estimator.add(fleet.range(4, peer, t))
        if k == 25:
            early = located(estimator, 4, t)
    late = why_unknown(estimator, 4, 50.0)

    assert error_m(early, fleet) < 4.0 * math.sqrt(np.trace(early.covariance[:2, :2]))
    assert early.ranges_in_use == 0
    assert f"ranges to {len(peers)} of the 3 peers" in late if peers else "no fix from ranges for 30.2 s: no ranges yet" in late
    assert estimator.counts().get("fix used", 0) == 0


def test_collinear_peers_give_no_fix_and_the_reason() -> None:
    line = {
        1: straight((0, 0, 100), (0, 20, 0)),
        2: straight((1500, 0, 100), (0, 20, 0)),
        3: straight((600, 3, 100), (0, 20, 0)),
        4: straight((700, 500, 110), (3, 21, 0)),
    }
    fleet, estimator = Fleet(paths=line), QuZhangFilter()
    fly(estimator, fleet, 0.0, 5.0)
    fly(estimator, fleet, 5.0, 25.0, denied=(4,))

    assert "nearly in one line" in why_unknown(estimator, 4, 25.0)


def test_of_four_peers_with_one_wrong_range_the_three_that_agree_are_used() -> None:
    paths = {**FOUR, 5: straight((1400, 1500, 120), (0, 20, 0))}
    fleet, estimator = Fleet(paths=paths), QuZhangFilter()
    fly(estimator, fleet, 0.0, 5.0)
    estimator.set_denied([4], 5.0)
    for k in range(100):
        t = 5.0 + k * STEP_S
        for vehicle in (1, 2, 3, 5):
            estimator.add(fleet.position(vehicle, t))
        estimator.add(fleet.altitude(4, t))
        for peer in (1, 2, 3, 5):
            estimator.add(fleet.range(4, peer, t, error_m=150.0 if peer == 1 else 0.0))

    assert error_m(located(estimator, 4, 24.8), fleet) < 5.0
    refused = {one.to_vehicle: one.refused for one in estimator.drain_residuals()}
    assert refused[1] == "not among the three of the fix"
    assert refused[2] is None


def test_three_circles_that_do_not_meet_are_no_fix() -> None:
    fleet, estimator = Fleet(), QuZhangFilter()
    fly(estimator, fleet, 0.0, 5.0)
    estimator.set_denied([4], 5.0)
    for one in fleet.round(5.0, (4,)):
        estimator.add(replace(one, range_m=one.range_m + 80.0) if isinstance(one, RangeMeasurement) else one)

    assert estimator.counts()["epoch without a fix"] == 1
    refused = {one.to_vehicle: one.refused for one in estimator.drain_residuals()}
    assert str(refused[1]).startswith("the ranges do not meet")


def test_a_peer_without_fresh_positions_is_not_used() -> None:
    fleet, estimator = Fleet(), QuZhangFilter()
    fly(estimator, fleet, 0.0, 5.0)
    estimator.set_denied([4], 5.0)
    for k in range(100):
        t = 5.0 + k * STEP_S
        for measurement in fleet.round(t, (4,)):
            if not (isinstance(measurement, PositionMeasurement) and measurement.vehicle == 3):
                estimator.add(measurement)

    assert "vehicle 3 has no fresh position" in why_unknown(estimator, 4, 25.0)


def test_one_report_of_a_fixed_anchor_is_enough() -> None:
    paths = {i: straight(place, (0, 0, 0)) for i, place in enumerate([(0, 0, 2), (90, 0, 3), (40, 80, 4)], start=1)}
    fleet = Fleet(paths={**paths, 4: straight((10, 10, 10), (0.5, 0.5, 0))}, sigma_range_m=0.1, sigma_position_m=0.05)
    estimator = QuZhangFilter()
    for vehicle in (1, 2, 3):
        estimator.add(replace(fleet.position(vehicle, 0.0), static=True))
    estimator.set_denied([4], 0.0)
    for k in range(300):
        t = k * STEP_S
        estimator.add(fleet.altitude(4, t))
        for peer in (1, 2, 3):
            estimator.add(fleet.range(4, peer, t))

    assert error_m(located(estimator, 4, 59.8), fleet) < 1.5
    assert located(estimator, 1, 59.8).velocity_enu_mps == pytest.approx([0.0, 0.0, 0.0])


def test_without_a_height_of_its_own_it_says_so() -> None:
    fleet, estimator = Fleet(), QuZhangFilter()
    estimator.set_denied([4], 0.0)
    for measurement in fleet.round(0.0, (4,)):
        if not isinstance(measurement, AltitudeMeasurement):
            estimator.add(measurement)

    assert "no height of its own" in why_unknown(estimator, 4, 0.0)


def test_settings_choose_the_covariance_of_a_fix() -> None:
    sigmas = {}
    for covariance in ("corrected", "published", "constant"):
        fleet, estimator = Fleet(), QuZhangFilter(QuZhangSettings(covariance=covariance, constant_sigma_m=60.0))
        fly(estimator, fleet, 0.0, 5.0)
        fly(estimator, fleet, 5.0, 20.0, denied=(4,))
        fixes = [one for one in estimator.drain_residuals() if one.to_vehicle is None]
        sigmas[covariance] = fixes[-1].sigma_m

    assert sigmas["published"] != pytest.approx(sigmas["corrected"], rel=1e-3)
    assert sigmas["constant"] > math.sqrt(2) * 60.0


place = st.tuples(st.floats(-5000, 5000), st.floats(-5000, 5000), st.floats(0, 500))


@settings(max_examples=40, deadline=None)
@given(st.lists(place, min_size=0, max_size=5), place, st.floats(0.05, 30.0))
def test_any_geometry_gives_a_definite_covariance_or_a_reason(
    peers: list[tuple[float, float, float]], own: tuple[float, float, float], sigma: float
) -> None:
    paths = {i: straight(one, (0, 10, 0)) for i, one in enumerate(peers, start=1)}
    fleet = Fleet(paths={**paths, 99: straight(own, (5, 5, 0))}, sigma_range_m=sigma)
    estimator = QuZhangFilter()
    fly(estimator, fleet, 0.0, 6.0, denied=(99,))
    answer = estimator.estimate(99, 6.0)

    if isinstance(answer, Estimate):
        assert np.linalg.eigvalsh(answer.covariance).min() > 0.0
        assert np.array_equal(answer.covariance, answer.covariance.T)
        assert np.isfinite(answer.position_enu_m).all()
        assert len(peers) >= 3
    else:
        assert answer.reason


def test_through_a_poor_geometry_it_filters_on_and_says_that_it_is_uncertain() -> None:
    # A triangle of 40 m of height, seen from 1.5 km: the fix is good to some 100 m across. Then the peers spread out again.
    def spreading(t: float) -> tuple[float, float, float]:
        return (600.0, 40.0 + max(0.0, t - 40.0) * 40.0, 100.0)

    paths = {
        1: straight((0, 0, 100), (0, 0, 0)),
        2: straight((700, 0, 100), (0, 0, 0)),
        3: spreading,
        4: straight((350, 1500, 110), (1, 0, 0)),
    }
    fleet, estimator = Fleet(paths=paths), QuZhangFilter(QuZhangSettings(max_sigma_m=40.0))
    fly(estimator, fleet, 0.0, 5.0)
    fly(estimator, fleet, 5.0, 40.0, denied=(4,))
    poor = why_unknown(estimator, 4, 39.8)
    fly(estimator, fleet, 40.0, 70.0, denied=(4,))

    assert poor.startswith("too uncertain: ")
    assert error_m(located(estimator, 4, 69.8), fleet) < 30.0
