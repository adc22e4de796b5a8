"""What is told of vehicles that do not answer TIMESYNC: whole engines on hand-moved time."""

from __future__ import annotations

import pytest

from gcs_coloc.core.clocks.vehicle_clocks import TimeSettings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import ClockReference, TransmitDisabled
from gcs_coloc.core.messages.inbound import SystemTime, TimeSyncAnswer
from gcs_coloc.core.messages.outbound import Notice, TimeSyncRequest
from tests.engine_flights import StraightLine, settings, telemetry

UNIX_S = 1.8e9
VEHICLES = (1, 2)


def told(
    *,
    host: bool | None = True,
    late_s: float = 0.0,
    utc: bool = True,
    answers_until_s: float = 0.0,
    failed_from_s: float = 1e9,
    time: TimeSettings | None = None,
    on_air: bool = True,
    duration_s: float = 40.0,
) -> tuple[Engine, list[Notice]]:
    """Fly two vehicles whose links are late; what was told of TIMESYNC."""
    engine = Engine(StraightLine(), settings(time=time if time is not None else TimeSettings()))
    engine.receive(ClockReference(0.0, UNIX_S, host))
    if not on_air:
        engine.receive(TransmitDisabled(0.0))
    out = []
    for step in range(round(duration_s * 10)):
        t = step / 10
        for sysid in VEHICLES:
            for message in telemetry(sysid, t, 1 if t > failed_from_s else 3):
                engine.receive(message)
            if step % 10 == 0 and utc:
                engine.receive(SystemTime(sysid, t, t + 10.0 * sysid, UNIX_S + t - late_s))
        said = engine.poll(t)
        if t < answers_until_s:
            for ask in (o for o in said if isinstance(o, TimeSyncRequest)):
                engine.receive(TimeSyncAnswer(ask.sysid, t, ask.ts1_ns, round((t + 10.0 * ask.sysid) * 1e9)))
        out += [o for o in said if isinstance(o, Notice) and "TIMESYNC" in o.text]
    return engine, out


def test_what_nothing_shows_is_a_warning_once_for_each_vehicle():
    for without in ({"utc": False}, {"host": None}, {"host": False}):
        engine, notices = told(**without)
        assert [(n.sysid, n.level) for n in notices] == [(1, "warning"), (2, "warning")]
        assert "held to be 0.00 s late, give or take 0.05 s" in notices[0].text
        assert {v.clock_method for v in engine.snapshot(40.0).vehicles} == {"one-way"}


def test_what_its_utc_shows_is_told_and_used_before_and_after_its_gps_is_lost():
    engine, notices = told(late_s=0.65, failed_from_s=25.0)
    assert [(n.sysid, n.level) for n in notices] == [(1, "info"), (2, "info")]
    assert "by its UTC its link is 0.50 s late, give or take 0.08 s" in notices[0].text
    for vehicle in engine.snapshot(40.0).vehicles:
        assert (vehicle.clock_method, vehicle.clock_sigma_s) == ("UTC", pytest.approx(0.08, abs=0.001))
    assert engine.measurements.reported(1).measured_at_s == pytest.approx(39.4)


def test_the_utc_of_a_vehicle_without_gps_shows_nothing():
    engine, notices = told(late_s=0.65, failed_from_s=-1.0)
    assert {n.level for n in notices} == {"warning"}
    assert {v.clock_method for v in engine.snapshot(40.0).vehicles} == {"one-way"}


def test_nothing_is_told_where_timesync_is_answered_the_delay_is_set_or_nobody_is_asked():
    for known in ({"answers_until_s": 99.0}, {"time": TimeSettings(min_delay_s=0.3)}, {"on_air": False}):
        assert told(**known)[1] == []


def test_answers_that_cease_are_told_after_five_minutes():
    _, notices = told(answers_until_s=25.0, utc=False, duration_s=340.0)
    assert [n.sysid for n in notices] == [1, 2]
    assert notices[0].at_s == pytest.approx(325.0, abs=1.5)
