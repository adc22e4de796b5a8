"""Deadlines of one fleet: whole periods after a start, and one number where several periods have a time in common."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcs_coloc.core.deadlines import advance
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import GpsOverride, OperatorCommand, RouteReport
from gcs_coloc.core.messages.inbound import Autopilot, Heartbeat
from gcs_coloc.core.messages.outbound import GpsInput
from gcs_coloc.core.schedule import TickSchedule
from gcs_coloc.estimators.registry import load_estimator

UNIX_S = 1_780_000_000.0


PERIODS_S = (1.0, 0.2, 0.125, 0.1, 1.0 / 15.0, 1.0 / 30.0)


@given(st.integers(0, 10**6), st.integers(0, 10**6), st.sampled_from(PERIODS_S), st.integers(-2, 2))
def test_the_next_time_is_later_by_a_period_at_the_most_however_close_to_one_it_is_asked_for(start_us, steps, period_s, off):
    grid = TickSchedule(UNIX_S + start_us / 1e6)
    now_s = round(grid.start_s + steps * period_s, 6) + off * 2.4e-7
    after_s = grid.after(now_s, period_s)
    assert now_s < after_s <= now_s + period_s + 2e-6
    assert (after_s - grid.start_s) / period_s == pytest.approx(round((after_s - grid.start_s) / period_s), abs=1e-4)


def test_periods_that_divide_each_other_meet_at_the_same_numbers():
    rng = random.Random(1)
    for _ in range(100):
        grid = TickSchedule(UNIX_S + rng.randrange(10**6) / 1e6)
        at_s, met = grid.start_s, []
        for _ in range(100):
            at_s = grid.after(at_s, 0.2)
            met.append(at_s)
        for period_s in (0.1, 0.05, 1.0 / 15.0):
            at_s, finer = grid.start_s, set()
            while at_s <= met[-1]:
                at_s = grid.after(at_s, period_s)
                finer.add(at_s)
            assert finer.issuperset(met)


def test_vehicles_that_lost_their_gps_at_different_times_are_sent_their_aid_at_the_same():
    engine = Engine(load_estimator("fleet", {}))
    sent_at_s: dict[int, list[float]] = {1: [], 2: [], 3: []}

    def fly(until_s: float) -> None:
        for at_s, outputs in advance(engine, until_s):
            for output in outputs:
                if isinstance(output, GpsInput):
                    sent_at_s[output.sysid].append(at_s)

    for sysid, lost_at_s in zip(sent_at_s, (UNIX_S, UNIX_S + 1.237, UNIX_S + 2.611), strict=True):
        fly(lost_at_s)
        engine.receive(Heartbeat(sysid, lost_at_s, Autopilot.ARDUPILOT, armed=True, winged=True))
        engine.receive(RouteReport(sysid, lost_at_s, None))
        engine.receive(OperatorCommand(sysid, lost_at_s, GpsOverride.FAILED))
    fly(UNIX_S + 10.0)
    # The first one when it is wanted, and all that follow with the others'.
    assert sent_at_s[2][0] == UNIX_S + 1.237
    assert set(sent_at_s[2][1:] + sent_at_s[3][1:]) <= set(sent_at_s[1])
    assert len(sent_at_s[3]) == pytest.approx(74, abs=1)


def test_a_vehicle_is_sent_its_aid_before_the_fleet_is_reviewed_at_the_same_time():
    engine = Engine(load_estimator("fleet", {}))
    engine.receive(Heartbeat(1, UNIX_S, Autopilot.ARDUPILOT, armed=True, winged=True))
    engine.receive(RouteReport(1, UNIX_S, None))
    engine.receive(OperatorCommand(1, UNIX_S, GpsOverride.FAILED))
    reviews = []
    for at_s, outputs in advance(engine, UNIX_S + 3.0):
        if engine.reviewed_at_s == at_s:
            reviews.append(at_s)
            assert not any(isinstance(output, GpsInput) for output in outputs)
            assert engine.next_aid_s() > at_s
    assert len(reviews) == 15
