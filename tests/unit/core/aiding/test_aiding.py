"""Who is aided and who is not, and what the operator's word on it does."""

from __future__ import annotations

import pytest
from engine_flights import StraightLine, aids, fly, settings, texts, vehicle_4

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.measurements import PositionMeasurement
from gcs_coloc.core.messages.control import AidingOverride, CommandSource, ForeignGpsInput, GpsOverride, OperatorCommand
from gcs_coloc.core.messages.inbound import Autopilot, GpsReceiver, Heartbeat
from gcs_coloc.core.messages.outbound import AidingMessage, Notice


def test_aid_off_ends_the_stream_with_no_fix_and_auto_begins_it_again():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 5.0)
    fly(engine, 5.0, 8.0, failed=[4])
    engine.receive(OperatorCommand(4, 8.0, AidingOverride.OFF))
    stream = aids(fly(engine, 8.0, 10.0, failed=[4]), 4)
    assert [a.fix_type for _, a in stream] == [1]
    assert vehicle_4(engine, 10.0).aiding == "off by the operator's override"
    engine.receive(OperatorCommand(4, 10.0, AidingOverride.AUTO))
    assert len(aids(fly(engine, 10.0, 12.0, failed=[4]), 4)) == pytest.approx(20, abs=1)


def test_aid_on_streams_to_a_healthy_vehicle_whose_own_reports_then_count_for_nothing():
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    engine.receive(OperatorCommand(4, 0.0, AidingOverride.ON))
    out = fly(engine, 0.0, 8.0)
    assert {a.fix_type for t, a in aids(out, 4) if t > 0.5} == {3}
    assert vehicle_4(engine, 8.0).gps_state == "healthy"
    assert max((m.measured_at_s for m in estimator.of(PositionMeasurement, 4)), default=0.0) < 0.5
    assert estimator.denied[-1][0] == {4}
    engine.receive(OperatorCommand(4, 8.0, AidingOverride.AUTO))
    fly(engine, 8.0, 15.0)
    assert estimator.denied[-1][0] == frozenset()
    assert max(m.measured_at_s for m in estimator.of(PositionMeasurement, 4)) > 14.5


def heard_without_a_heartbeat(engine: Engine, from_s: int, to_s: int) -> list[str]:
    """What the operator is told of a vehicle whose receiver is heard once a second, and nothing else."""
    out = []
    for at_s in range(from_s, to_s):
        engine.receive(GpsReceiver(4, float(at_s), 0, 3, 47.0, 8.0, 500.0, 10, 0.8, 0.8, 1.2, 0.2))
        out += engine.poll(at_s + 0.5)
    return [o.text for o in out if isinstance(o, Notice)]


def test_a_vehicle_that_has_just_come_is_given_time_for_its_heartbeat_before_an_alarm():
    engine = Engine(StraightLine(), settings())
    engine.receive(OperatorCommand(4, 0.0, GpsOverride.FAILED))
    assert not any("cannot be aided" in text for text in heard_without_a_heartbeat(engine, 0, 3))
    told = [text for text in heard_without_a_heartbeat(engine, 3, 6) if "cannot be aided" in text]
    assert told == ["needs aid and cannot be aided: no heartbeat of an autopilot heard yet"]


def test_who_needs_aid_again_and_still_cannot_be_aided_is_told_again():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 5.0, autopilot=Autopilot.OTHER)
    told = []
    for lost_s in (5.0, 40.0):
        out = fly(engine, lost_s, lost_s + 10.0, failed=[4], autopilot=Autopilot.OTHER)
        told.append([text for text in texts(out) if "cannot be aided" in text])
        fly(engine, lost_s + 10.0, lost_s + 35.0, autopilot=Autopilot.OTHER)
        assert vehicle_4(engine, lost_s + 35.0).gps_state == "healthy"
    assert [len(alarms) for alarms in told] == [1, 1]


def test_to_an_unknown_autopilot_nothing_is_sent_unless_a_way_is_set():
    for way, sent in (("auto", False), ("gps_input", True)):
        engine = Engine(StraightLine(), settings(aiding=AidingSettings(method=way, standby=True)))
        fly(engine, 0.0, 5.0, autopilot=Autopilot.OTHER)
        out = fly(engine, 5.0, 10.0, failed=[4], autopilot=Autopilot.OTHER)
        assert any(isinstance(o, AidingMessage) for _, o in out) is sent
        alarms = [o.text for _, o in out if isinstance(o, Notice) and "cannot be aided: its autopilot is neither" in o.text]
        assert len(alarms) == (0 if sent else 1)
        assert all("set its aiding method" in text for text in alarms)
        assert vehicle_4(engine, 10.0).aiding.startswith("sending 3D fix" if sent else "NOT SENT: its autopilot is neither")


def test_the_word_on_the_aid_leaves_the_word_on_the_gps_alone():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 2.0)
    engine.receive(OperatorCommand(4, 2.0, AidingOverride.OFF))
    seen = vehicle_4(engine, 2.0)
    assert (seen.gps_override, seen.aiding_override) == ("auto", "off")


def test_an_override_in_force_says_where_it_came_from():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 2.0)
    engine.receive(OperatorCommand(4, 2.0, AidingOverride.OFF, CommandSource.MQTT))
    engine.receive(OperatorCommand(4, 2.0, GpsOverride.FAILED))  # of a recording that does not hold it
    seen = vehicle_4(engine, 2.0)
    assert (seen.gps_override_by, seen.aiding_override_by, seen.primary_override_by) == (None, "MQTT", None)
    engine.receive(OperatorCommand(4, 3.0, AidingOverride.AUTO, CommandSource.PAGE))
    assert vehicle_4(engine, 3.0).aiding_override_by is None


def test_the_way_of_a_single_vehicle_wins_and_one_that_it_cannot_take_is_refused_in_words():
    engine = Engine(StraightLine(), settings(aiding=AidingSettings(methods={4: "global_position_sensor"})))
    fly(engine, 0.0, 5.0)
    out = fly(engine, 5.0, 10.0, failed=[3, 4])
    assert {o.sysid for _, o in out if isinstance(o, AidingMessage)} == {3}
    assert "NOT SENT: ArduPilot does not take GLOBAL_POSITION_SENSOR" in vehicle_4(engine, 10.0).aiding


def test_the_stream_goes_on_for_a_while_after_the_gps_is_healthy_again_then_ends_with_no_fix():
    engine = Engine(StraightLine(), settings(aiding=AidingSettings(hand_back_s=6.0)))
    fly(engine, 0.0, 5.0)
    fly(engine, 5.0, 8.0, failed=[4])
    stream = aids(fly(engine, 8.0, 40.0), 4)
    # Recovering for 10 s, healthy for 6 s more.
    assert stream[-1][0] == pytest.approx(24.2, abs=0.5)
    assert [a.fix_type for _, a in stream] == [3] * (len(stream) - 1) + [1]


def test_somebody_elses_gps_input_makes_ours_stand_down_while_it_lasts_and_ten_seconds_more():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 5.0)
    fly(engine, 5.0, 8.0, failed=[4])
    out = []
    for step in range(80, 120):
        engine.receive(ForeignGpsInput(255, step / 10, gps_id=1, vehicle=4))
        out += fly(engine, step / 10, step / 10 + 0.1, failed=[4])
    assert not aids(out, 4)  # no last word either: it would interrupt the other one's fix
    assert "system 255 sends it GPS_INPUT for receiver 1: ours stands down" in texts(out)
    assert "system 255 sends it GPS_INPUT" in vehicle_4(engine, 12.0).aiding
    after = fly(engine, 12.0, 24.0, failed=[4])
    assert aids(after, 4)[0][0] == pytest.approx(21.9, abs=0.41)
    assert "nobody else has sent it GPS_INPUT for 10 s" in texts(after)
    assert 255 not in [v.sysid for v in engine.snapshot(24.0).vehicles]


@pytest.mark.parametrize(
    "other", [ForeignGpsInput(255, 8.0, gps_id=0, vehicle=4), ForeignGpsInput(255, 8.0, 1, None), ForeignGpsInput(255, 8.0, 1, 9)]
)
def test_what_feeds_another_receiver_or_another_vehicle_is_no_rival(other):
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 5.0)
    fly(engine, 5.0, 8.0, failed=[4])
    engine.receive(other)
    assert len(aids(fly(engine, 8.0, 9.0, failed=[4]), 4)) == pytest.approx(10, abs=1)


@pytest.mark.parametrize("gps_id", [0, 1])
def test_the_receiver_that_we_feed_never_counts_as_the_vehicles_own(gps_id):
    engine = Engine(StraightLine(), settings(aiding=AidingSettings(gps_id=gps_id)))
    for step in range(100):
        t = step / 10
        engine.receive(Heartbeat(4, t, Autopilot.ARDUPILOT, True, winged=True))
        for receiver, fix_type in ((gps_id, 3), (1 - gps_id, 1)):
            engine.receive(GpsReceiver(4, t, receiver, fix_type, 47.0, 8.0, 500.0, 10, 1.0, 1.0, 2.0, 0.4))
        engine.poll(t)
    seen = vehicle_4(engine, 10.0)
    assert (seen.gps_state, seen.fix_type) == ("failed", 1)


@pytest.mark.parametrize("autopilot", [Autopilot.ARDUPILOT, Autopilot.PX4])
def test_that_ranges_have_ceased_is_told_while_there_is_time_to_act(autopilot):
    """A PX4 goes into failsafe 5 s after its aid and stays in it: a word at the end of the prediction comes too late."""
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    fly(engine, 0.0, 5.0, autopilot=autopilot)
    fly(engine, 5.0, 10.0, failed=[4], autopilot=autopilot)
    estimator.ranges_in_use = 0
    out = fly(engine, 10.0, 13.0, failed=[4], autopilot=autopilot)
    [(at_s, notice)] = [(t, o) for t, o in out if isinstance(o, Notice) and "ranges have ceased" in o.text]
    assert (notice.level, at_s) == ("error", pytest.approx(11.0, abs=0.25))
    assert "sent for 9 s more" in notice.text
    assert "on prediction" in vehicle_4(engine, 13.0).aiding
    estimator.ranges_in_use = 3
    assert "its ranges have come back" in texts(fly(engine, 13.0, 14.0, failed=[4], autopilot=autopilot))
    estimator.ranges_in_use = 0
    assert [t for t in texts(fly(engine, 14.0, 26.0, failed=[4], autopilot=autopilot)) if "prediction alone" in t]
