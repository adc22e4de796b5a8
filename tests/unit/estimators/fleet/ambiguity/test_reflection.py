from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import (
    AMBIGUOUS,
    AltitudeMeasurement,
    NoEstimate,
    NoEstimateReason,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.estimators.fleet.ambiguity.reflection import mixture, only_motion_separates, vertical_plane_through_line
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster, ClusterSet
from gcs_coloc.estimators.fleet.ekf.records import VehicleRecord
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.initialisation import block_from_estimate
from gcs_coloc.estimators.fleet.settings import FleetSettings

STEP_S = 0.2
LINE = {1: (0.0, -500.0), 2: (0.0, 500.0), 3: (0.0, 1500.0)}
ASIDE = {9: (900.0, 300.0)}
LOST_S = 3.0
UNTIL_S = 60.0


def track(kind: str, side: float) -> np.ndarray:
    """East and north every STEP_S of a flight at 20 m/s that comes up to the line of the peers (east = 0) and ...

    ... flies on straight, turns back at it, turns along and back, or weaves over it.
    """
    heading, place, places = math.radians(80.0), np.array([-300.0, 700.0]), []
    for k in range(round(UNTIL_S / STEP_S) + 1):
        t = k * STEP_S
        places.append(place * (side, 1.0))
        rate_degps = {
            "straight": 0.0,
            "bounce": -8.0 if 10.0 < t < 30.0 else 0.0,
            "graze": 8.0 if 8.0 < t < 20.0 else 0.0,
            "weave": 6.0 * math.sin(2.0 * math.pi * t / 40.0),
        }[kind]
        heading += math.radians(rate_degps) * STEP_S
        place = place + 20.0 * STEP_S * np.array([math.sin(heading), math.cos(heading)])
    return np.array(places)


@dataclass
class Flown:
    """Squared errors in sigmas and errors in m where an answer was given, by time in s; the reasons where not."""

    squares: dict[float, float]
    errors_m: dict[float, float]
    reasons: list[NoEstimateReason]


@cache
def fly(kind: str, seed: int, in_line: int, aside_from_s: float = math.inf) -> Flown:
    """Fly with ranges of 2 m to some peers in line, and from a time on to one beside it too. Flown once for all tests."""
    peers = dict(list(LINE.items())[:in_line])
    rng = np.random.default_rng(seed)
    where = track(kind, 1.0 if seed % 2 else -1.0)
    estimator = FleetFilter()
    flown = Flown({}, {}, [])
    for k, here in enumerate(where[:-1]):
        t = round(k * STEP_S, 6)
        for v, place in (peers | ASIDE).items():
            report = (place[0] + rng.normal(), place[1] + rng.normal(), 100.0)
            estimator.add(PositionMeasurement(v, t, t, report, 1.0, 1.0, (0.0, 0.0, 0.0), 0.3))
        if t < LOST_S:
            ve, vn = ((where[k + 1] - here) / STEP_S).tolist()
            e, n = (here + rng.normal(size=2)).tolist()
            estimator.add(PositionMeasurement(4, t, t, (e, n, 120.0), 1.0, 1.0, (ve, vn, 0.0), 0.3))
            continue
        estimator.set_denied({4}, t)
        estimator.add(AltitudeMeasurement(4, t, t, 120.0 + 0.3 * rng.normal(), 1.0))
        for v, place in (peers | (ASIDE if t >= aside_from_s else {})).items():
            r = math.dist((*here, 120.0), (*place, 100.0)) + 2.0 * rng.normal()
            estimator.add(RangeMeasurement(4, v, t, t, r, 2.0))
        answer = estimator.estimate(4, t)
        if isinstance(answer, NoEstimate):
            flown.reasons.append(answer.reason.reason)
            continue
        d = answer.position_enu_m[:2] - here
        flown.errors_m[t] = float(np.hypot(*d))
        flown.squares[t] = float(d @ np.linalg.solve(answer.covariance[:2, :2], d))
    return flown


@pytest.mark.parametrize("kind", ["straight", "bounce", "graze", "weave"])
def test_beside_a_line_of_peers_the_wrong_side_is_never_stated_with_confidence(kind):
    flights = [fly(kind, seed, 2 + seed // 2 % 2) for seed in range(6)]
    squares = np.concatenate([list(f.squares.values()) for f in flights])
    # Two degrees of freedom: 36 is six sigmas, 1e-8 by chance. Of the mean, 2 if honest, flights of 60 s have some seven
    # independent parts each: 45 parts leave it below 2.9 with 99.9 %.
    assert squares.max() < 36.0
    assert squares.mean() < 2.9
    for f in flights:
        assert set(f.reasons) <= {*AMBIGUOUS, NoEstimateReason.TOO_UNCERTAIN}


def test_a_turn_at_the_line_leaves_both_sides_possible_and_a_straight_crossing_does_not():
    turned, straight = fly("bounce", 2, len(LINE)), fly("straight", 2, len(LINE))
    assert not AMBIGUOUS.isdisjoint(turned.reasons)
    assert straight.reasons == []
    assert max(straight.errors_m.values()) < 20.0


@pytest.mark.parametrize("seed", range(4))
def test_a_peer_beside_the_line_decides_within_seconds(seed):
    flown = fly("bounce", seed, len(LINE), aside_from_s=50.0)
    assert min(t for t in flown.errors_m if t >= 50.0) < 53.0
    after = [e for t, e in flown.errors_m.items() if t >= 53.0]
    # Some 2 m of range noise averaged over seconds, dilution below 3.
    assert len(after) == round((UNTIL_S - 53.0) / STEP_S)
    assert max(after) < 15.0


def beside(peers: list[tuple[float, float]], north_m: float, sigma_m: float) -> Cluster:
    """A denied vehicle 4, at east 0, whose position is known to `sigma_m`, and peers that are known to a metre."""
    records = {4: VehicleRecord(denied_vehicle=True, last_range_s=dict.fromkeys(range(10, 10 + len(peers)), 0.0))}
    records |= {10 + i: VehicleRecord() for i in range(len(peers))}
    clusters = ClusterSet(FleetSettings(), records)
    own = np.array([0.0, north_m, 100.0, 0.0, 0.0, 0.0]), np.diag([0.1, sigma_m, 0.1, 1.0, 1.0, 0.1]) ** 2
    clusters.initialise(4, *block_from_estimate(*own, FleetSettings()), 0.0)
    for i, (e, n) in enumerate(peers):
        state = np.array([e, n, 100.0, 0.0, 0.0, 0.0]), np.diag([1.0, 1.0, 1.0, 0.1, 0.1, 0.1]) ** 2
        clusters.initialise(10 + i, *block_from_estimate(*state, FleetSettings()), 0.0)
        clusters.merge(4, 10 + i)
    return clusters[4]


STRAIGHT = [(-200.0, 0.0), (-60.0, 0.0), (60.0, 0.0), (160.0, 0.0)]
BENT = [(-200.0, 10.0), (-60.0, -10.0), (60.0, 10.0), (160.0, -10.0)]
GROUP = [(40.0, 2.0), (44.0, -2.0), (48.0, 2.0), (52.0, -2.0)]


def test_peers_on_a_line_leave_the_side_to_the_motion():
    cluster = beside(STRAIGHT, 10.0, 8.0)
    line = vertical_plane_through_line(cluster, 4, 0.0)
    assert line is not None
    assert only_motion_separates(cluster, frozenset({4}), 0.0, line)


def test_a_bent_line_has_a_second_place_within_reach_of_an_uncertain_vehicle_and_its_ranges_decide():
    cluster = beside(BENT, 10.0, 8.0)
    line = vertical_plane_through_line(cluster, 4, 0.0)
    assert line is not None
    assert not only_motion_separates(cluster, frozenset({4}), 0.0, line)
    assert vertical_plane_through_line(beside(BENT, 10.0, 2.0), 4, 0.0) is None


def test_one_near_peer_off_the_line_moves_the_line():
    """Its range is curved most, so its place says where the line is, and what that moves is no bend."""
    peers = [(-200.0, 0.0), (-120.0, 0.0), (30.0, 15.0), (160.0, 0.0)]
    assert vertical_plane_through_line(beside(peers, 20.0, 6.0), 4, 0.0) is not None


def test_a_group_of_peers_far_away_leaves_one_place():
    assert vertical_plane_through_line(beside(GROUP, 0.0, 8.0), 4, 0.0) is None


def test_a_vehicle_beside_a_line_is_on_either_side_where_its_curved_ranges_reach_the_other_one():
    """In a flight beside two peers this was a fix for 45 s on the wrong side, up to 548 m off."""
    estimator, aside_m = FleetFilter(), 45.0
    for k in range(61):
        t = round(k * STEP_S, 6)
        for v in (1, 2):
            estimator.add(PositionMeasurement(v, t, t, (*LINE[v], 100.0), 1.0, 1.0, (0.0, 0.0, 0.0), 0.3))
        here = (aside_m, 15.0 * t - 100.0, 120.0)
        if t < 2.0:
            estimator.add(PositionMeasurement(4, t, t, here, 10.0, 1.0, (0.0, 15.0, 0.0), 0.3))
            continue
        estimator.set_denied({4}, t)
        estimator.add(AltitudeMeasurement(4, t, t, 120.0, 1.0))
        for v in (1, 2):
            estimator.add(RangeMeasurement(4, v, t, t, math.dist(here, (*LINE[v], 100.0)), 1.0))
    answer = estimator.estimate(4, 12.0)
    assert isinstance(answer, NoEstimate) or horizontal_bound_95_m(answer.covariance) > aside_m


def test_of_a_mixture_of_three_the_likeliest_counts_most_and_none_is_beyond_three_sigmas():
    means = [np.array([0.0, 0.0]), np.array([30.0, 0.0]), np.array([0.0, -40.0])]
    mean, covariance = mixture(means, [np.eye(2)] * 3, [0.0, -4.0, -6.0])
    shares = np.exp([0.0, -4.0, -6.0]) / np.exp([0.0, -4.0, -6.0]).sum()
    assert mean == pytest.approx([30.0 * shares[1], -40.0 * shares[2]])
    nis = [float((each - mean) @ np.linalg.solve(covariance, each - mean)) for each in means]
    assert max(nis) <= 9.0
    # The order in which they are named is of no account to the mean, and of little to how far it is widened.
    again = mixture(means[::-1], [np.eye(2)] * 3, [-6.0, -4.0, 0.0])
    assert again[0] == pytest.approx(mean)
    assert again[1] == pytest.approx(covariance, rel=0.1)


@pytest.mark.parametrize("log_odds", [-8.0, -3.0, -1.0, 0.0, 2.0, 9.0])
def test_a_mixture_of_two_is_that_of_the_textbook_with_a_least_spread(log_odds):
    a, b, share = np.array([0.0, 0.0]), np.array([3.0, 4.0]), 1.0 / (1.0 + np.exp(-log_odds))
    mean, covariance = mixture([a, b], [np.eye(2), 4.0 * np.eye(2)], [0.0, log_odds])
    less = min(share, 1.0 - share)
    spread = max(less * (1.0 - less), ((1.0 - less) / 3.0) ** 2)
    assert mean == pytest.approx(share * b)
    assert covariance == pytest.approx((1.0 - share) * np.eye(2) + 4.0 * share * np.eye(2) + spread * np.outer(b, b))
