from __future__ import annotations

import math

import numpy as np

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    NoEstimateReason,
    PositionMeasurement,
    RangeMeasurement,
    Unlocated,
)
from gcs_coloc.core.reasons import StatedReason
from gcs_coloc.estimators.fleet.search.multilateration import MultilaterationProblem, solve_multilateration

LIMIT_M = 200.0


def problem(denied_vehicle, peers, *, altitude=True, velocity=(0.0, 0.0, 0.0), sigma_m=1.0, seed=0, late=()):
    rng = np.random.default_rng(seed)
    p = MultilaterationProblem(4.0)
    for k in range(20):
        t = 0.2 * k
        where = np.array(denied_vehicle) + np.array(velocity) * (t - 4.0)
        for i, peer in enumerate(peers):
            report = PositionMeasurement(i, 0.0, 0.0, peer, 0.3, 0.3, (0.0, 0.0, 0.0), 0.2)
            r = float(np.linalg.norm(where - np.array(peer))) + sigma_m * rng.normal() + (80.0 if (k, i) in late else 0.0)
            p.add_range(i, report, [report], RangeMeasurement(9, i, t, t, r, sigma_m), 0.0)
        if altitude:
            p.add_altitude(AltitudeMeasurement(9, t, t, float(where[2]) + 0.5, 2.0))
    return p


PEERS = [(0.0, 0.0, 100.0), (900.0, 100.0, 140.0), (300.0, 800.0, 90.0)]


def test_three_peers_and_the_altitude_give_the_place_within_its_stated_error():
    truth = (600.0, 500.0, 150.0)
    mean, covariance = solve_multilateration(problem(truth, PEERS, velocity=(20.0, -5.0, 0.0)), LIMIT_M)
    error = mean[:3] - truth
    assert float(error @ np.linalg.solve(covariance[:3, :3], error)) < 16.3  # 99.9 % of chi-square with 3
    assert math.sqrt(covariance[0, 0] + covariance[1, 1]) < 5.0


def test_late_ranges_do_not_mislead():
    truth = (600.0, 500.0, 150.0)
    late = {(3, 0), (7, 1), (8, 2), (15, 0), (16, 2)}
    mean, _ = solve_multilateration(problem(truth, PEERS, late=late), LIMIT_M)
    assert np.linalg.norm(mean[:2] - truth[:2]) < 3.0


def test_two_peers_are_ambiguous_and_said_to_be():
    outcome = solve_multilateration(problem((600.0, 500.0, 150.0), PEERS[:2]), LIMIT_M)
    assert isinstance(outcome, StatedReason)
    assert outcome.reason is NoEstimateReason.OTHER_PLACE


def test_collinear_peers_are_ambiguous_and_said_to_be():
    peers = [(0.0, 0.0, 100.0), (500.0, 0.0, 100.0), (1000.0, 0.0, 100.0)]
    outcome = solve_multilateration(problem((400.0, 300.0, 100.0), peers), LIMIT_M)
    assert isinstance(outcome, StatedReason)
    assert outcome.reason is NoEstimateReason.OTHER_PLACE


def test_without_altitude_a_mirror_image_above_and_below_leaves_the_height_open():
    peers = [(0.0, 0.0, 100.0), (900.0, 100.0, 100.0), (300.0, 800.0, 100.0)]
    truth = (500.0, 400.0, 180.0)
    outcome = solve_multilateration(problem(truth, peers, altitude=False), LIMIT_M)
    if isinstance(outcome, StatedReason):
        assert outcome.reason in (NoEstimateReason.OTHER_PLACE, NoEstimateReason.UNDETERMINED)
        return
    mean, covariance = outcome
    assert abs(mean[2] - truth[2]) < 3.0 * math.sqrt(covariance[2, 2])
    assert np.linalg.norm(mean[:2] - truth[:2]) < 4.0 * math.sqrt(covariance[0, 0] + covariance[1, 1])


def test_ranges_that_contradict_each_other_start_nothing():
    p = MultilaterationProblem(4.0)
    rng = np.random.default_rng(1)
    for k in range(20):
        for i, peer in enumerate(PEERS):
            report = PositionMeasurement(i, 0.0, 0.0, peer, 0.3, 0.3, (0.0, 0.0, 0.0), 0.2)
            p.add_range(i, report, [report], RangeMeasurement(9, i, 0.2 * k, 0.2 * k, float(rng.uniform(10.0, 3000.0)), 1.0), 0.0)
    assert solve_multilateration(p, LIMIT_M) == Unlocated(NoEstimateReason.CONTRADICTORY)


def test_one_peer_is_waited_upon():
    one_peer = problem((600.0, 500.0, 150.0), PEERS[:1])
    assert solve_multilateration(one_peer, LIMIT_M) == Unlocated(NoEstimateReason.FEW_RANGES, 20, 1)
