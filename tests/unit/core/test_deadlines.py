"""However late and however often the engine is brought forward, its deadlines are answered with their own times."""

from __future__ import annotations

import random

from gcs_coloc.core.deadlines import CATCH_UP_S, Overrun, advance, find_overrun, without_superseded
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import GpsOverride, OperatorCommand, RouteReport
from gcs_coloc.core.messages.inbound import Autopilot, Heartbeat
from gcs_coloc.core.messages.outbound import GpsInput, Notice, RangingBeacon
from gcs_coloc.estimators.registry import load_estimator

STARTED_S = 1_795_216_162.424732


def flight() -> list:
    """A vehicle that is declared to have no GPS, and so is sent GPS_INPUT without a fix, heard once a second."""
    told = [OperatorCommand(4, STARTED_S, GpsOverride.FAILED)]
    for second in range(8):
        at_s = STARTED_S + second
        told += [Heartbeat(4, at_s, Autopilot.ARDUPILOT, True, winged=True), RouteReport(4, at_s, None)]
    return told


def polls(wakes_s: list[float]) -> list:
    """What the engine does when it is brought forward at these times besides those of the messages."""
    engine, out = Engine(load_estimator("fleet", {})), []
    calls = [(m.received_at_s, i, m) for i, m in enumerate(flight())] + [(at_s, -1, None) for at_s in wakes_s]
    for at_s, _, message in sorted(calls, key=lambda call: call[:2]):
        out += advance(engine, at_s)
        if message is not None:
            engine.receive(message)
    return [*out, *advance(engine, STARTED_S + 7.9)]


def test_when_it_is_woken_leaves_no_trace():
    rng = random.Random(3)
    plain = polls([])
    assert sum(isinstance(o, GpsInput) for _, outputs in plain for o in outputs) > 60
    for _ in range(5):
        assert polls([STARTED_S + rng.uniform(0.0, 7.9) for _ in range(300)]) == plain


def test_a_deadline_at_the_time_of_a_message_comes_after_it():
    engine = Engine(load_estimator("fleet", {}))
    engine.receive(OperatorCommand(4, STARTED_S, GpsOverride.FAILED))
    assert list(advance(engine, STARTED_S)) == []
    [(at_s, _)] = advance(engine, STARTED_S + 1e-6)
    assert at_s == STARTED_S


def test_nothing_is_due_before_the_first_message():
    engine = Engine(load_estimator("fleet", {}))
    assert list(advance(engine, STARTED_S)) == []
    assert engine.next_deadline() == float("inf")


def test_what_was_missed_in_a_hold_up_is_answered_once_in_the_present_after_all_that_arrived_in_it():
    engine = Engine(load_estimator("fleet", {}))
    for message in flight()[:3]:
        engine.receive(message)
    assert list(advance(engine, STARTED_S + 0.01))
    late_s = STARTED_S + 3600.0
    overrun = find_overrun(engine, STARTED_S + 0.01, late_s)
    assert overrun == Overrun(STARTED_S + 0.01, late_s)
    for later_s in (1.0, 1800.0, 3599.9):
        assert list(advance(engine, STARTED_S + later_s, overrun.until_s)) == []
    times = [at_s for at_s, _ in advance(engine, late_s + 0.3, overrun.until_s)]
    assert times[0] == late_s
    assert times.count(late_s) <= 2  # what vehicles wait for, then the review
    on_grid = [round((at_s - STARTED_S) / 0.1, 3) for at_s in times if at_s > late_s]
    assert on_grid == [round(step) for step in on_grid]


def test_a_service_that_is_late_by_no_more_than_it_may_leaves_nothing_out():
    engine = Engine(load_estimator("fleet", {}))
    for message in flight()[:3]:
        engine.receive(message)
    due_s = engine.next_deadline()
    assert find_overrun(engine, due_s, due_s + CATCH_UP_S) is None
    assert find_overrun(engine, due_s, due_s + CATCH_UP_S + 0.001) is not None


def test_only_the_newest_position_of_each_vehicle_is_sent():
    outputs = [o for _, outputs in polls([]) for o in outputs]
    kept = without_superseded(outputs)
    positions = [o for o in outputs if isinstance(o, GpsInput)]
    assert [o for o in kept if isinstance(o, GpsInput)] == positions[-1:]
    assert [o for o in kept if isinstance(o, Notice)] == [o for o in outputs if isinstance(o, Notice)]


def test_the_newest_range_to_each_peer_is_sent():
    ranges = [RangingBeacon(4, k, beacon, k, 500.0, 1.0, 47.0, 8.0, 500.0, 1.0, 1.0) for k, beacon in enumerate((1, 2, 3, 1))]
    assert without_superseded(list(ranges)) == ranges[1:]
