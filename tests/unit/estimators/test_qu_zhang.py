import math
from dataclasses import replace

import numpy as np
import pytest
from fleet_in_flight import FOUR, Fleet, circling, straight
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs_coloc.core.errors import EstimatorError
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Estimate,
    PositionMeasurement,
    RangeMeasurement,
    Unknown,
)
from gcs_coloc.estimators.base import Estimator
from gcs_coloc.estimators.cv import nis
from gcs_coloc.estimators.qu_zhang import QuZhang
from gcs_coloc.estimators.qu_zhang_settings import QuZhangSettings

STEP_S = 0.2


def fly(estimator: QuZhang, fleet: Fleet, start_s: float, end_s: float, subjects: tuple[int, ...] = ()) -> None:
    estimator.set_subjects(subjects, start_s)
    for k in range(round((end_s - start_s) / STEP_S)):
        for measurement in fleet.round(start_s + k * STEP_S, subjects):
            estimator.add(measurement)


def located(estimator: QuZhang, vehicle: int, at_s: float) -> Estimate:
    answer = estimator.estimate(vehicle, at_s)
    assert isinstance(answer, Estimate), answer
    return answer


def why_unknown(estimator: QuZhang, vehicle: int, at_s: float) -> str:
    answer = estimator.estimate(vehicle, at_s)
    assert isinstance(answer, Unknown), answer
    return answer.reason


def error_m(answer: Estimate, fleet: Fleet) -> float:
    return float(np.linalg.norm(answer.position_enu_m - fleet.at(answer.vehicle, answer.at_s)))


def test_it_meets_the_protocol() -> None:
    estimator: Estimator = QuZhang()

    assert estimator.name == "qu_zhang"
    assert isinstance(estimator.estimate(7, 0.0), Unknown)


def test_a_healthy_vehicle_is_where_its_receiver_says() -> None:
    fleet, estimator = Fleet(), QuZhang()
    fly(estimator, fleet, 0.0, 20.0)
    answer = located(estimator, 1, 20.0)

    assert error_m(answer, fleet) < 3.0
    assert answer.velocity_enu_mps == pytest.approx([0.0, 20.0, 0.0], abs=4.0)
    assert answer.ranges_in_use == 0
    assert answer.hdop is None


def test_a_vehicle_that_loses_gps_is_carried_on_in_three_dimensions() -> None:
    fleet, estimator = Fleet(), QuZhang()
    fly(estimator, fleet, 0.0, 20.0)
    fly(estimator, fleet, 20.0, 80.0, subjects=(4,))
    answer = located(estimator, 4, 80.0)

    assert error_m(answer, fleet) < 4.0
    assert answer.velocity_enu_mps == pytest.approx([3.0, 21.0, 0.0], abs=2.0)
    assert answer.ranges_in_use == 3
    assert answer.hdop is not None
    assert 1.0 < answer.hdop < 3.0
    assert np.array_equal(answer.covariance, answer.covariance.T)
    assert np.linalg.eigvalsh(answer.covariance).min() > 0.0


def test_it_starts_cold_from_ranges_and_waits_until_fixes_agree() -> None:
    fleet, estimator = Fleet(), QuZhang()
    fly(estimator, fleet, 0.0, 0.3, subjects=(4,))
    reason = why_unknown(estimator, 4, 0.3)
    fly(estimator, fleet, 0.4, 5.0, subjects=(4,))

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
            estimator = QuZhang(QuZhangSettings(lasting_peer_errors=lasts))
            fly(estimator, fleet, 0.0, 2.0)
            fly(estimator, fleet, 2.0, 7.0, subjects=(4,))
            answer = located(estimator, 4, 6.8)
            into.append(nis((answer.position_enu_m - fleet.at(4, 6.8))[:2], answer.covariance[:2, :2]))

    assert 0.5 < np.mean(honest) < 3.3
    assert np.mean(white) > 2 * np.mean(honest)


def test_it_keeps_up_with_a_turn_and_knows_its_error() -> None:
    # A 25 m/s turn of 100 m radius: 6.2 m/s^2. Error beyond 4 sigma in no epoch.
    paths = {**FOUR, 4: circling((700, 500), 100.0, 25.0, 110.0)}
    fleet, estimator = Fleet(paths=paths, sigma_range_m=2.0), QuZhang()
    fly(estimator, fleet, 0.0, 5.0)
    estimator.set_subjects([4], 5.0)
    normalised = []
    for k in range(200):
        t = 5.0 + k * STEP_S
        for measurement in fleet.round(t, (4,)):
            estimator.add(measurement)
        answer = located(estimator, 4, t)
        normalised.append(nis((answer.position_enu_m - fleet.at(4, t))[:2], answer.covariance[:2, :2]))

    assert max(normalised) < 16.0
    assert np.mean(normalised) < 4.0


def test_ranges_at_different_instants_are_brought_together() -> None:
    # Noise-free: three ranges 0.1 s apart at 200 m/s would be off by tens of metres if taken as one instant.
    paths = {**FOUR, 4: straight((700, -500, 110), (120, 160, 0))}
    fleet = Fleet(paths=paths, sigma_position_m=1e-3, sigma_range_m=1e-3, sigma_altitude_m=1e-3)
    estimator = QuZhang()
    fly(estimator, fleet, 0.0, 3.0)
    estimator.set_subjects([4], 3.0)
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
    fleet, estimator = Fleet(), QuZhang()
    fly(estimator, fleet, 0.0, 5.0)
    estimator.set_subjects([4], 5.0)
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
    fleet, estimator = Fleet(), QuZhang()
    fly(estimator, fleet, 0.0, 20.0)
    estimator.set_subjects([4], 20.0)
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
    assert f"ranges to {len(peers)} of the 3 peers" in late if peers else "no fix for 30.2 s: no ranges yet" in late
    assert estimator.counts().get("fix used", 0) == 0


def test_collinear_peers_give_no_fix_and_the_reason() -> None:
    line = {
        1: straight((0, 0, 100), (0, 20, 0)),
        2: straight((1500, 0, 100), (0, 20, 0)),
        3: straight((600, 3, 100), (0, 20, 0)),
        4: straight((700, 500, 110), (3, 21, 0)),
    }
    fleet, estimator = Fleet(paths=line), QuZhang()
    fly(estimator, fleet, 0.0, 5.0)
    fly(estimator, fleet, 5.0, 25.0, subjects=(4,))

    assert "nearly in one line" in why_unknown(estimator, 4, 25.0)


def test_of_four_peers_with_one_lying_range_the_three_that_agree_are_used() -> None:
    paths = {**FOUR, 5: straight((1400, 1500, 120), (0, 20, 0))}
    fleet, estimator = Fleet(paths=paths), QuZhang()
    fly(estimator, fleet, 0.0, 5.0)
    estimator.set_subjects([4], 5.0)
    for k in range(100):
        t = 5.0 + k * STEP_S
        for vehicle in (1, 2, 3, 5):
            estimator.add(fleet.position(vehicle, t))
        estimator.add(fleet.altitude(4, t))
        for peer in (1, 2, 3, 5):
            estimator.add(fleet.range(4, peer, t, error_m=150.0 if peer == 1 else 0.0))

    assert error_m(located(estimator, 4, 24.8), fleet) < 5.0
    refused = {one.to_vehicle: one.refused for one in estimator.take_residuals()}
    assert refused[1] == "not among the three of the fix"
    assert refused[2] is None


def test_three_circles_that_do_not_meet_are_no_fix() -> None:
    fleet, estimator = Fleet(), QuZhang()
    fly(estimator, fleet, 0.0, 5.0)
    estimator.set_subjects([4], 5.0)
    for one in fleet.round(5.0, (4,)):
        estimator.add(replace(one, range_m=one.range_m + 80.0) if isinstance(one, RangeMeasurement) else one)

    assert estimator.counts()["epoch without a fix"] == 1
    refused = {one.to_vehicle: one.refused for one in estimator.take_residuals()}
    assert str(refused[1]).startswith("the ranges do not meet")


def test_it_finds_back_from_a_wrong_state() -> None:
    # Its receiver was captured and 400 m off before it was declared failed.
    fleet = Fleet(lasting={4: (400.0, 0.0, 0.0)})
    estimator = QuZhang()
    fly(estimator, fleet, 0.0, 5.0)
    fly(estimator, fleet, 5.0, 15.0, subjects=(4,))

    assert error_m(located(estimator, 4, 14.8), fleet) < 5.0


def test_while_fixes_are_refused_it_is_not_confident() -> None:
    fleet = Fleet(lasting={4: (400.0, 0.0, 0.0)})
    estimator = QuZhang()
    fly(estimator, fleet, 0.0, 5.0)
    fly(estimator, fleet, 5.0, 6.6, subjects=(4,))
    answer = estimator.estimate(4, 6.6)

    assert isinstance(answer, Unknown) or error_m(answer, fleet) < 6 * math.sqrt(np.trace(answer.covariance[:2, :2]))


def test_a_peer_without_fresh_positions_is_not_used() -> None:
    fleet, estimator = Fleet(), QuZhang()
    fly(estimator, fleet, 0.0, 5.0)
    estimator.set_subjects([4], 5.0)
    for k in range(100):
        t = 5.0 + k * STEP_S
        for measurement in fleet.round(t, (4,)):
            if not (isinstance(measurement, PositionMeasurement) and measurement.vehicle == 3):
                estimator.add(measurement)

    assert "vehicle 3 has no fresh position" in why_unknown(estimator, 4, 25.0)


def test_one_report_of_a_fixed_anchor_is_enough() -> None:
    paths = {i: straight(place, (0, 0, 0)) for i, place in enumerate([(0, 0, 2), (90, 0, 3), (40, 80, 4)], start=1)}
    fleet = Fleet(paths={**paths, 4: straight((10, 10, 10), (0.5, 0.5, 0))}, sigma_range_m=0.1, sigma_position_m=0.05)
    estimator = QuZhang()
    for vehicle in (1, 2, 3):
        estimator.add(replace(fleet.position(vehicle, 0.0), static=True))
    estimator.set_subjects([4], 0.0)
    for k in range(300):
        t = k * STEP_S
        estimator.add(fleet.altitude(4, t))
        for peer in (1, 2, 3):
            estimator.add(fleet.range(4, peer, t))

    assert error_m(located(estimator, 4, 59.8), fleet) < 1.5
    assert located(estimator, 1, 59.8).velocity_enu_mps == pytest.approx([0.0, 0.0, 0.0])


def test_without_a_height_of_its_own_it_says_so() -> None:
    fleet, estimator = Fleet(), QuZhang()
    estimator.set_subjects([4], 0.0)
    for measurement in fleet.round(0.0, (4,)):
        if not isinstance(measurement, AltitudeMeasurement):
            estimator.add(measurement)

    assert "no height of its own" in why_unknown(estimator, 4, 0.0)


def test_the_position_of_a_vehicle_without_gps_never_enters() -> None:
    fleet, estimator = Fleet(), QuZhang()
    fly(estimator, fleet, 0.0, 5.0)
    estimator.set_subjects([4], 5.0)
    before = located(estimator, 4, 5.0)
    estimator.add(replace(fleet.position(4, 5.0), position_enu_m=(9e3, 9e3, 9e3)))
    after = located(estimator, 4, 5.0)

    assert after.position_enu_m.tolist() == before.position_enu_m.tolist()
    assert estimator.counts()["position of a vehicle without GPS"] == 1


def test_a_receiver_that_comes_back_begins_anew_and_can_fail_again() -> None:
    fleet, estimator = Fleet(), QuZhang()
    fly(estimator, fleet, 0.0, 5.0)
    fly(estimator, fleet, 5.0, 15.0, subjects=(4,))
    estimator.set_subjects([], 15.0)
    between = located(estimator, 4, 15.0)
    estimator.set_subjects([4], 15.1)
    again = located(estimator, 4, 15.1)
    fly(estimator, fleet, 15.2, 20.0)
    healthy = located(estimator, 4, 20.0)

    assert error_m(between, fleet) < 5.0
    assert error_m(again, fleet) < 5.0
    assert error_m(healthy, fleet) < 3.0
    assert healthy.ranges_in_use == 0


def test_settings_choose_the_covariance_of_a_fix() -> None:
    sigmas = {}
    for covariance in ("corrected", "published", "constant"):
        fleet, estimator = Fleet(), QuZhang(QuZhangSettings(covariance=covariance, constant_sigma_m=60.0))
        fly(estimator, fleet, 0.0, 5.0)
        fly(estimator, fleet, 5.0, 20.0, subjects=(4,))
        fixes = [one for one in estimator.take_residuals() if one.to_vehicle is None]
        sigmas[covariance] = fixes[-1].sigma_m

    assert sigmas["published"] != pytest.approx(sigmas["corrected"], rel=1e-3)
    assert sigmas["constant"] > math.sqrt(2) * 60.0


@pytest.mark.parametrize(
    ("bad", "text"),
    [
        ({"covariance": "guessed"}, "covariance is 'guessed'"),
        ({"q_m2ps2": 0.0}, "q_m2ps2 is 0.0"),
        ({"max_sigma_m": math.nan}, "max_sigma_m is nan"),
        ({"gate_probability": 1.0}, "below 1"),
        ({"gate_patience": -1}, "gate_patience"),
    ],
)
def test_settings_that_no_filter_can_work_with_are_refused(bad: dict[str, object], text: str) -> None:
    with pytest.raises(EstimatorError, match=text):
        QuZhangSettings(**bad)  # type: ignore[arg-type]


def test_impossible_values_are_counted_and_change_nothing() -> None:
    fleet, estimator = Fleet(), QuZhang()
    fly(estimator, fleet, 0.0, 5.0)
    fly(estimator, fleet, 5.0, 10.0, subjects=(4,))
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
        fleet, estimator = Fleet(), QuZhang()
        fly(estimator, fleet, 0.0, 5.0)
        fly(estimator, fleet, 5.0, 10.0, subjects=(4,))
        answers.append(located(estimator, 4, 10.0))

    assert answers[0].position_enu_m.tolist() == answers[1].position_enu_m.tolist()
    assert answers[0].covariance.tolist() == answers[1].covariance.tolist()


def test_memory_stays_bounded() -> None:
    fleet, estimator = Fleet(), QuZhang()
    fly(estimator, fleet, 0.0, 1.0)
    estimator.set_subjects([4], 1.0)
    for k in range(3000):
        estimator.add(fleet.range(4, 1 + k % 2, 1.0 + 0.001 * k))

    assert len(estimator._subjects[4].gatherer._open) <= 65
    assert len(estimator.take_residuals()) <= 2000


place = st.tuples(st.floats(-5000, 5000), st.floats(-5000, 5000), st.floats(0, 500))


@settings(max_examples=40, deadline=None)
@given(st.lists(place, min_size=0, max_size=5), place, st.floats(0.05, 30.0))
def test_any_geometry_gives_a_definite_covariance_or_a_reason(
    peers: list[tuple[float, float, float]], own: tuple[float, float, float], sigma: float
) -> None:
    paths = {i: straight(one, (0, 10, 0)) for i, one in enumerate(peers, start=1)}
    fleet = Fleet(paths={**paths, 99: straight(own, (5, 5, 0))}, sigma_range_m=sigma)
    estimator = QuZhang()
    fly(estimator, fleet, 0.0, 6.0, subjects=(99,))
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
    fleet, estimator = Fleet(paths=paths), QuZhang(QuZhangSettings(max_sigma_m=40.0))
    fly(estimator, fleet, 0.0, 5.0)
    fly(estimator, fleet, 5.0, 40.0, subjects=(4,))
    poor = why_unknown(estimator, 4, 39.8)
    fly(estimator, fleet, 40.0, 70.0, subjects=(4,))

    assert poor.startswith("uncertain by")
    assert error_m(located(estimator, 4, 69.8), fleet) < 30.0
