"""The estimator of Qu & Zhang over a flight: what it carries on, finds back to, refuses and never takes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fleet_in_flight import FOUR, Fleet, circling
from qu_zhang_in_flight import STEP_S, error_m, fly, located, why_unknown

from gcs_coloc.core.estimator import Estimator
from gcs_coloc.core.measurements import (
    AttitudeMeasurement,
    NoEstimate,
)
from gcs_coloc.estimators.qu_zhang.cv_filter import nis
from gcs_coloc.estimators.qu_zhang.filter import QuZhangFilter
from gcs_coloc.estimators.qu_zhang.settings import QuZhangSettings


def test_it_meets_the_protocol() -> None:
    estimator: Estimator = QuZhangFilter()

    assert estimator.name == "qu_zhang"
    assert isinstance(estimator.estimate(7, 0.0), NoEstimate)


def test_a_healthy_vehicle_is_where_its_receiver_says() -> None:
    fleet, estimator = Fleet(), QuZhangFilter()
    fly(estimator, fleet, 0.0, 20.0)
    answer = located(estimator, 1, 20.0)

    assert error_m(answer, fleet) < 3.0
    assert answer.velocity_enu_mps == pytest.approx([0.0, 20.0, 0.0], abs=4.0)
    assert answer.ranges_in_use == 0
    assert answer.hdop is None


def test_a_vehicle_that_loses_gps_is_carried_on_in_three_dimensions() -> None:
    fleet, estimator = Fleet(), QuZhangFilter()
    fly(estimator, fleet, 0.0, 20.0)
    fly(estimator, fleet, 20.0, 80.0, denied=(4,))
    answer = located(estimator, 4, 80.0)

    assert error_m(answer, fleet) < 4.0
    assert answer.velocity_enu_mps == pytest.approx([3.0, 21.0, 0.0], abs=2.0)
    assert answer.ranges_in_use == 3
    assert answer.hdop is not None
    assert 1.0 < answer.hdop < 3.0
    assert np.array_equal(answer.covariance, answer.covariance.T)
    assert np.linalg.eigvalsh(answer.covariance).min() > 0.0


def test_it_starts_cold_from_ranges_and_waits_until_fixes_agree() -> None:
    fleet, estimator = Fleet(), QuZhangFilter()
    fly(estimator, fleet, 0.0, 0.3, denied=(4,))
    reason = why_unknown(estimator, 4, 0.3)
    fly(estimator, fleet, 0.4, 5.0, denied=(4,))

    assert "3 fixes that must agree" in reason
    assert error_m(located(estimator, 4, 5.0), fleet) < 5.0


def test_the_stated_covariance_is_honest_with_lasting_peer_errors() -> None:
    # Each run's peers are off by a constant drawn with the sigma that they state. 40 runs of 2 axes, one epoch each: the mean
    # NEES of an exact covariance has standard deviation 2 / sqrt(40) = 0.32. Stated sigmas may be larger than the error (taking
    # a lasting error for new noise as well is on the safe side) but not smaller: 2 + 4 * 0.32 = 3.3.
    honest, white = [], []
    for seed in range(40):
        rng = np.random.default_rng(1000 + seed)
        lasting = {vehicle: tuple(rng.normal(0.0, 4.0, 3).tolist()) for vehicle in (1, 2, 3, 4)}
        for lasts, into in ((True, honest), (False, white)) if seed < 15 else ((True, honest),):
            fleet = Fleet(seed=seed, sigma_position_m=0.1, lasting=lasting, stated_sigma_m=4.0)
            estimator = QuZhangFilter(QuZhangSettings(lasting_peer_errors=lasts))
            fly(estimator, fleet, 0.0, 2.0)
            fly(estimator, fleet, 2.0, 7.0, denied=(4,))
            answer = located(estimator, 4, 6.8)
            into.append(nis((answer.position_enu_m - fleet.at(4, 6.8))[:2], answer.covariance[:2, :2]))

    assert 0.5 < np.mean(honest) < 3.3
    assert np.mean(white) > 2 * np.mean(honest)


def test_it_keeps_up_with_a_turn_and_knows_its_error() -> None:
    # A 25 m/s turn of 100 m radius: 6.2 m/s^2. Error beyond 4 sigma in no epoch.
    paths = {**FOUR, 4: circling((700, 500), 100.0, 25.0, 110.0)}
    fleet, estimator = Fleet(paths=paths, sigma_range_m=2.0), QuZhangFilter()
    fly(estimator, fleet, 0.0, 5.0)
    estimator.set_denied([4], 5.0)
    normalised = []
    for k in range(200):
        t = 5.0 + k * STEP_S
        for measurement in fleet.round(t, (4,)):
            estimator.add(measurement)
        answer = located(estimator, 4, t)
        normalised.append(nis((answer.position_enu_m - fleet.at(4, t))[:2], answer.covariance[:2, :2]))

    assert max(normalised) < 16.0
    assert np.mean(normalised) < 4.0


def test_it_finds_back_from_a_wrong_state() -> None:
    # Its receiver was captured and 400 m off before it was declared failed.
    fleet = Fleet(lasting={4: (400.0, 0.0, 0.0)})
    estimator = QuZhangFilter()
    fly(estimator, fleet, 0.0, 5.0)
    fly(estimator, fleet, 5.0, 15.0, denied=(4,))

    assert error_m(located(estimator, 4, 14.8), fleet) < 5.0


def test_while_fixes_are_refused_it_is_not_confident() -> None:
    fleet = Fleet(lasting={4: (400.0, 0.0, 0.0)})
    estimator = QuZhangFilter()
    fly(estimator, fleet, 0.0, 5.0)
    fly(estimator, fleet, 5.0, 6.6, denied=(4,))
    answer = estimator.estimate(4, 6.6)

    assert isinstance(answer, NoEstimate) or error_m(answer, fleet) < 6 * math.sqrt(np.trace(answer.covariance[:2, :2]))


def test_the_position_of_a_vehicle_without_gps_never_enters() -> None:
    fleet, estimator = Fleet(), QuZhangFilter()
    fly(estimator, fleet, 0.0, 5.0)
    estimator.set_denied([4], 5.0)
    before = located(estimator, 4, 5.0)
    estimator.add(replace(fleet.position(4, 5.0), position_enu_m=(9e3, 9e3, 9e3)))
    after = located(estimator, 4, 5.0)

    assert after.position_enu_m.tolist() == before.position_enu_m.tolist()
    assert estimator.counts()["position of a vehicle without GPS"] == 1


def test_a_receiver_that_comes_back_begins_anew_and_can_fail_again() -> None:
    fleet, estimator = Fleet(), QuZhangFilter()
    fly(estimator, fleet, 0.0, 5.0)
    fly(estimator, fleet, 5.0, 15.0, denied=(4,))
    estimator.set_denied([], 15.0)
    between = located(estimator, 4, 15.0)
    estimator.set_denied([4], 15.1)
    again = located(estimator, 4, 15.1)
    fly(estimator, fleet, 15.2, 20.0)
    healthy = located(estimator, 4, 20.0)

    assert error_m(between, fleet) < 5.0
    assert error_m(again, fleet) < 5.0
    assert error_m(healthy, fleet) < 3.0
    assert healthy.ranges_in_use == 0


def test_impossible_values_are_counted_and_change_nothing() -> None:
    fleet, estimator = Fleet(), QuZhangFilter()
    fly(estimator, fleet, 0.0, 5.0)
    fly(estimator, fleet, 5.0, 10.0, denied=(4,))
    before = located(estimator, 4, 10.0)
    good, position, altitude = fleet.range(4, 1, 10.0), fleet.position(1, 10.0), fleet.altitude(4, 10.0)
    bad = [
        replace(good, range_m=math.nan),
        replace(good, range_m=-1.0),
        replace(good, sigma_m=0.0),
        replace(good, to_vehicle=4),
        replace(position, position_enu_m=(math.inf, 0.0, 0.0)),
        replace(position, sigma_h_m=-1.0),
        replace(altitude, up_m=math.nan),
        AttitudeMeasurement(4, math.nan, 10.0, 0.0, 0.0, 0.0, None),
    ]
    for measurement in bad:
        estimator.add(measurement)
    estimator.add(replace(altitude, measured_at_s=1e6))

    after = located(estimator, 4, 10.0)
    assert after.position_enu_m.tolist() == before.position_enu_m.tolist()
    assert estimator.counts()["impossible value"] == len(bad)
    assert estimator.counts()["measured in the future"] == 1


def test_the_same_calls_give_the_same_answer_to_the_last_bit() -> None:
    answers = []
    for _ in range(2):
        fleet, estimator = Fleet(), QuZhangFilter()
        fly(estimator, fleet, 0.0, 5.0)
        fly(estimator, fleet, 5.0, 10.0, denied=(4,))
        answers.append(located(estimator, 4, 10.0))

    assert answers[0].position_enu_m.tolist() == answers[1].position_enu_m.tolist()
    assert answers[0].covariance.tolist() == answers[1].covariance.tolist()


def test_memory_stays_bounded() -> None:
    fleet, estimator = Fleet(), QuZhangFilter()
    fly(estimator, fleet, 0.0, 1.0)
    estimator.set_denied([4], 1.0)
    for k in range(3000):
        estimator.add(fleet.range(4, 1 + k % 2, 1.0 + 0.001 * k))

    assert len(estimator._denied[4].gatherer._open) <= 65
    assert len(estimator.drain_residuals()) <= 2000
