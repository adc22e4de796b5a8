"""The consistency monitor over time: what it learns of the noise of a fleet, and forgets."""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from gcs_coloc.core.integrity import range_consistency
from gcs_coloc.core.integrity.epoch_tests.epoch import INTERVALS_S, PERIOD_S, Epoch, EpochHistory
from gcs_coloc.core.integrity.epoch_tests.fault_model import AdjustedHypothesis, FaultKind
from gcs_coloc.core.integrity.epoch_tests.isolation import Isolation
from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel
from gcs_coloc.core.integrity.range_consistency import RangeConsistency
from gcs_coloc.core.integrity.range_residuals import TrackPoint
from gcs_coloc.core.measurements import RangeMeasurement

PLACES_M = {1: (0.0, 0.0, 100.0), 2: (500.0, 20.0, 110.0), 3: (480.0, 520.0, 95.0), 4: (-30.0, 470.0, 105.0)}
BLOCKED_S = (5.0, 9.0)
DETOURS_M = {(1, 2): 15.0, (2, 3): 20.0, (1, 4): 9.0}
COARSE_M = {1: (3.5, 1.0), 2: (-3.0, 2.0), 3: (1.5, -3.5), 4: (-1.0, -3.0)}
STEP_S = 0.2


def half_of_the_pairs(at_s):
    return DETOURS_M if BLOCKED_S[0] < at_s < BLOCKED_S[1] else {}


def one_pair_of_2_after_the_other(at_s):
    return {(1, 2): 15.0} if at_s < 9.0 else {(2, 3): 22.0} if at_s > 14.0 else {}


def no_detours(_at_s):
    return {}


def no_errors(_at_s):
    return {}


def fly(monitor, until_s, seed=4, detours_m=half_of_the_pairs, errors_m=no_errors, doubtful=(), not_used=(), free=()):
    """Four vehicles that hover and range each other, some pairs past an obstacle. Yields after each review.

    `errors_m`: what the receivers of vehicles are off at a time, east and north; they state 1.5 m. The `free` have no prior.
    """
    rng = np.random.default_rng(seed)
    for step in range(1, round(until_s / STEP_S)):
        at_s = step * STEP_S
        for vehicle, place in PLACES_M.items():
            monitor.residuals.add_position(
                vehicle,
                TrackPoint(
                    at_s,
                    tuple(np.add(place, (*errors_m(at_s).get(vehicle, (0.0, 0.0)), 0.0)).tolist()),
                    (0.0, 0.0, 0.0),
                    1.5,
                    2.0,
                    vehicle in free,
                ),
            )
        for i in PLACES_M:
            for j in PLACES_M:
                if i < j:
                    detour_m = detours_m(at_s).get((i, j), 0.0)
                    range_m = (
                        float(np.linalg.norm(np.subtract(PLACES_M[i], PLACES_M[j]))) + detour_m + 0.5 * rng.standard_normal()
                    )
                    monitor.residuals.add_range(RangeMeasurement(i, j, at_s - 0.01, at_s, range_m, 0.5))
        monitor.review(at_s + 0.05, doubtful, not_used)
        yield at_s


def test_noise_that_blocked_ranges_make_likely_is_gone_a_quarter_of_a_minute_later():
    monitor = RangeConsistency()
    larger_at_s = [at_s for at_s in fly(monitor, 26.0) if not monitor.noise.is_as_stated]
    assert BLOCKED_S[0] < min(larger_at_s) < BLOCKED_S[1]
    assert max(larger_at_s) < BLOCKED_S[1] + 15.0
    assert monitor.identified == {}


def test_pairs_of_one_vehicle_that_are_blocked_in_turn_are_no_fault_of_its_receiver():
    """Noise of the blocked ranges before hides each of them in the tests of the present; then and now they are two pairs."""
    for seed in range(6):
        monitor = RangeConsistency()
        monitor.noise = NoiseModel(range_bias_m=8.0)
        for _ in fly(monitor, 26.0, seed, one_pair_of_2_after_the_other):
            assert monitor.identified == {}


def one_pair_then_half_of_them_and_then_all_of_4(at_s):
    """The last detours are within 4 m of those of a place 28 m beside that of 4."""
    return (
        {(2, 3): 15.0}
        if at_s < 4.0
        else {}
        if at_s < 5.0
        else {(1, 2): 14.6, (2, 3): 11.9, (1, 3): 9.4, (1, 4): 7.9}
        if at_s < 9.0
        else {}
        if at_s < 14.0
        else {(1, 4): 24.8, (2, 4): 27.0, (3, 4): 10.8}
    )


@pytest.mark.parametrize("seed", range(3))
def test_where_pairs_fail_a_vehicle_that_is_behind_an_obstacle_from_all_is_not_named(seed):
    """As 903 of the trials' class copters-blocked: noise that blocked ranges made likely is no lasting error of theirs."""
    monitor = RangeConsistency()
    for _ in fly(monitor, 24.0, seed, one_pair_then_half_of_them_and_then_all_of_4):
        assert not monitor.identified
    assert 4 in monitor.detected


def test_what_one_interval_rules_out_holds_when_another_one_is_sampled_later(monkeypatch):
    """The present leaves open which receiver is off, the changes leave one or its pair; they are sampled at different times."""
    everyone, seen = tuple(PLACES_M), set()

    def explain(now, past, *_, **__):
        of_present = past[0] is None
        seen.add((now.at_s, of_present))
        faults = [(FaultKind.POSITIONS, (v,)) for v in (everyone if of_present else (4,))]
        faults += [] if of_present else [(FaultKind.PAIR, (1, 4))]
        return Isolation(everyone, tuple(AdjustedHypothesis(*fault, 1.0, 1.0, 3, 30.0) for fault in faults))

    monkeypatch.setattr(range_consistency, "isolate", explain)
    monitor = RangeConsistency()
    walk = fly(monitor, 24.0, detours_m=no_detours, errors_m=lambda at_s: {4: (max(at_s - 14.0, 0.0) * 3.0, 0.0)})
    assert {monitor.detected for at_s in walk if at_s > 18.0} == {frozenset({4})}
    times = {of_present: {at_s for at_s, each in seen if each is of_present} for of_present in (True, False)}
    assert times[True] - times[False]


def test_what_was_detected_does_not_change_after_it_was_read():
    monitor = RangeConsistency()
    read = [monitor.detected for _ in fly(monitor, 12.0)]
    assert all(isinstance(detected, frozenset) for detected in read)


def test_receivers_that_are_all_off_by_twice_what_they_state_are_found_coarse_and_none_is_named():
    monitor = RangeConsistency()
    for _ in fly(monitor, 90.0, detours_m=no_detours, errors_m=lambda _: COARSE_M):
        assert monitor.identified == {}
        assert monitor.detected == frozenset()
    assert monitor.noise.position_factor > 1.5


def receiver_4_is_off_by(size_m, since_s=0.0):
    return lambda at_s: {4: (0.8 * size_m, 0.6 * size_m)} if at_s >= since_s else {}


@dataclass(frozen=True)
class Found:
    """What the monitor has found after a review."""

    identified: frozenset[int]
    detected: frozenset[int]
    also: dict[frozenset[int], float] | None


@cache
def found_of_one_always_off_by(size_m):
    """What is found in 30 s of a receiver that is off from the beginning: flown once for all tests."""
    monitor = RangeConsistency()
    return [
        Found(frozenset(monitor.identified), monitor.detected, monitor.also)
        for _ in fly(monitor, 30.0, detours_m=no_detours, errors_m=receiver_4_is_off_by(size_m))
    ]


@pytest.mark.parametrize("size_m", [12.0, 16.0])
def test_a_receiver_that_has_always_been_a_little_off_is_not_trusted_but_not_named(size_m):
    """It may state a quarter of its error and be sound: 603 and 616 of the trials' class optimistic-gnss, 7 m off at 1.4 m.

    The larger one is isolated in comparison with earlier ranges as well, as 708 was, 10 m off at 1.3 m.
    """
    found = found_of_one_always_off_by(size_m)
    assert len(found) == round(30.0 / STEP_S) - 1
    assert not any(each.identified for each in found)
    assert found[-1].detected == {4}


def test_while_a_fault_is_detected_each_position_in_use_may_be_off_by_the_odds_that_rule_it_out():
    assert RangeConsistency().also is None
    found = found_of_one_always_off_by(12.0)[-1]
    assert found.detected == {4}
    assert all(found.also[frozenset((vehicle,))] >= 1.0 / 150.0 for vehicle in (1, 2, 3))


def test_a_position_that_is_not_used_is_tested_but_is_none_of_those_that_the_level_is_of():
    monitor = RangeConsistency()
    for _ in fly(monitor, 6.0, detours_m=no_detours, not_used=(4,)):
        assert monitor.epoch.reporting <= {1, 2, 3}
        assert monitor.stated_epoch.reporting <= {1, 2, 3}
    assert monitor.epoch.reporting == {1, 2, 3}
    for at_s in fly(monitor, 20.0, detours_m=no_detours, errors_m=receiver_4_is_off_by(40.0), not_used=(4,)):
        if at_s > 15.0:
            assert monitor.identified.keys() == {4}


@pytest.mark.parametrize(("size_m", "since_s"), [(30.0, 0.0), (12.0, 15.0)])
def test_a_receiver_is_named_that_is_far_off_or_that_has_changed(size_m, since_s):
    monitor = RangeConsistency()
    errors_m = receiver_4_is_off_by(size_m, since_s)
    walk = fly(monitor, since_s + 8.0, detours_m=no_detours, errors_m=errors_m)
    assert next(at_s for at_s in walk if monitor.identified.keys() == {4}) > since_s


def receiver_4_wanders_by(size_m):
    """Off by so much, to all sides in turns: 1.4 times as far from where it was 12 s before."""

    def errors_m(at_s):
        angle = 2.0 * math.pi * at_s / 48.0
        return {4: (size_m * math.cos(angle), size_m * math.sin(angle))}

    return errors_m


def test_what_a_named_receiver_would_have_moved_is_no_error_of_an_estimate_that_did_not_follow_it():
    """1 is where it is held to be. With 4 in the adjustment it would be tens of metres off, also when 4 is named."""
    monitor = RangeConsistency()
    walk = fly(monitor, 16.0, detours_m=no_detours, errors_m=lambda at_s: {4: (120.0 * (at_s > 8.0), 0.0)}, free={1})
    assert next(at_s for at_s in walk if monitor.identified) < 14.0
    assert monitor.identified.keys() == {4}
    assert math.sqrt(np.trace(monitor.separation_m2[1])) < 5.0


def test_a_receiver_that_wanders_as_a_coarse_one_does_is_not_named():
    """901 of the trials' class optimistic-gnss: 8.8 m within 12 s, with 1.3 m stated."""
    monitor, detected = RangeConsistency(), []
    for at_s in fly(monitor, 40.0, detours_m=no_detours, errors_m=receiver_4_wanders_by(8.0)):
        assert monitor.identified == {}
        if at_s > 10.0:
            detected.append(monitor.detected)
    assert sum(each == {4} for each in detected) > 0.5 * len(detected)


def test_a_receiver_that_speaks_against_itself_is_named_however_little_it_is_off():
    monitor = RangeConsistency()
    for _ in fly(monitor, 10.0, detours_m=no_detours, errors_m=receiver_4_is_off_by(12.0), doubtful=(4,)):
        pass
    assert monitor.identified.keys() == {4}


def test_each_interval_has_an_earlier_epoch_even_where_one_is_missing():
    for missing in range(60):
        history = EpochHistory()
        for number in range(80):
            if number != missing:
                history.append(Epoch(number * PERIOD_S, {}, ()))
        assert history.pasts(80 * PERIOD_S).keys() == {0.0, *INTERVALS_S}
