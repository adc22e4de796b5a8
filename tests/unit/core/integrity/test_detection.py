"""Who is detected while a fault is not isolated, and what else may be off: by samples, over time."""

from math import exp

import pytest

from gcs_coloc.core.integrity.detection import Detection
from gcs_coloc.core.integrity.epoch_tests.fault_model import AdjustedHypothesis, FaultKind
from gcs_coloc.core.integrity.epoch_tests.isolation import Isolation

ALL = (1, 2, 3, 4, 5)
MARGIN = 10.0
RULED_OUT = exp(-0.5 * MARGIN)


def sample(*explanations):
    """What one epoch shows: each explanation's vehicles and cost, the best first."""
    return Isolation(
        ALL, tuple(AdjustedHypothesis(FaultKind.POSITIONS, vehicles, cost, cost, 2, 30.0) for vehicles, cost in explanations)
    )


def add(detection, samples, suspected, now_s, elsewhere=()):
    """Add samples; `elsewhere` is whom the last samples of other intervals allow, which are not due."""
    explained = [*elsewhere, *(each.possible for each in samples.values())]
    detection.add_samples(samples, explained, suspected, now_s)


ONE_OR_TWO = sample(((1,), 5.0), ((2,), 6.0))


def test_without_a_detection_nothing_may_be_off():
    detection = Detection()
    assert detection.vehicles == frozenset()
    assert detection.also(ALL, MARGIN) is None


def test_who_may_be_at_fault_in_all_samples_is_detected_and_the_rest_is_ruled_out_by_the_margin():
    detection = Detection()
    add(detection, {0.0: ONE_OR_TWO, 2.0: sample(((1,), 5.0), ((3,), 6.0))}, {1, 2, 3}, 10.0)
    assert detection.vehicles == {1}
    assert detection.also(ALL, MARGIN) == {frozenset((v,)): RULED_OUT for v in (2, 3, 4, 5)}
    assert detection.also((1, 2), MARGIN) == {frozenset((2,)): RULED_OUT}


def test_the_last_sample_of_an_interval_that_is_not_due_counts_as_well():
    detection = Detection()
    add(detection, {0.0: sample(*(((vehicle,), 5.0) for vehicle in ALL))}, ALL, 10.0, [frozenset({1})])
    assert detection.vehicles == {1}


def test_where_no_vehicle_explains_all_samples_each_that_is_suspected_is_detected():
    detection = Detection()
    add(detection, {0.0: sample(((1,), 5.0)), 2.0: sample(((2,), 5.0))}, {1, 2}, 10.0)
    assert detection.vehicles == {1, 2}


def test_who_was_ruled_out_is_detected_for_six_seconds_more_and_one_who_is_possible_again_goes_on():
    detection = Detection()
    add(detection, {0.0: ONE_OR_TWO}, {1, 2}, 10.0)
    add(detection, {0.0: sample(((1,), 5.0))}, {1}, 15.9)
    assert detection.vehicles == {1, 2}
    add(detection, {0.0: sample(((1,), 5.0))}, {1}, 16.0)
    assert detection.vehicles == {1}
    add(detection, {}, (), 100.0)
    assert detection.vehicles == {1}


def test_what_may_be_off_besides_is_kept_by_interval_until_its_next_sample():
    detection = Detection()
    with_3 = sample(((1,), 5.0), ((1, 3), 7.0))
    add(detection, {0.0: with_3}, {1}, 10.0)
    add(detection, {5.0: sample(((1,), 5.0))}, {1}, 11.0)
    assert detection.also(ALL, MARGIN)[frozenset((3,))] == pytest.approx(exp(-1.0))
    add(detection, {0.0: sample(((1,), 5.0))}, {1}, 12.0)
    assert detection.also(ALL, MARGIN)[frozenset((3,))] == RULED_OUT


def test_of_several_intervals_the_larger_odds_count():
    detection = Detection()
    add(detection, {0.0: sample(((1,), 5.0), ((1, 3), 6.0)), 2.0: sample(((1,), 5.0), ((1, 3), 9.0))}, {1}, 10.0)
    assert detection.also(ALL, MARGIN)[frozenset((3,))] == pytest.approx(exp(-0.5))


def test_what_the_fault_monitor_names_lasts_beyond_the_end_of_the_tests_and_then_ends():
    detection = Detection()
    add(detection, {0.0: ONE_OR_TWO}, {1, 2}, 10.0)
    detection.add_monitored({4}, 10.0, 20.0)
    assert detection.vehicles == {1, 2, 4}
    detection.end_of_tests()
    assert detection.vehicles == {4}
    detection.add_monitored((), 30.0, 20.0)
    detection.end_of_tests()
    assert detection.vehicles == frozenset()


def test_it_can_be_limited_to_some_and_ends_once_the_fault_is_identified():
    detection = Detection()
    add(detection, {0.0: sample(((1,), 5.0), ((1, 3), 6.0))}, {1, 2}, 10.0)
    detection.limit_to({2}, 11.0)
    assert detection.vehicles == {2}
    assert detection.also(ALL, MARGIN) == {frozenset((v,)): RULED_OUT for v in (1, 3, 4, 5)}
    detection.remove({2})
    assert detection.vehicles == frozenset()
    assert detection.also(ALL, MARGIN) is None


def test_who_is_identified_is_named_by_nobody_any_more_and_others_that_the_fault_monitor_names_go_on_throughout():
    detection, seen = Detection(), []
    add(detection, {0.0: ONE_OR_TWO}, {1, 2}, 10.0)
    detection.add_monitored({1, 4}, 10.0, 20.0)
    for end in (lambda: detection.limit_to({2}, 11.0), lambda: detection.remove({1})):
        end()
        seen.append(detection.vehicles)
        detection.add_monitored((), 12.0, 20.0)
        seen.append(detection.vehicles)
    assert seen == [{1, 2, 4}] * 2 + [{4}] * 2
