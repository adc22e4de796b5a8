"""The engine by hand-moved time: who is aided, when, with what, and what never reaches the estimator."""

from __future__ import annotations

import numpy as np
import pytest
from engine_flights import ALT, LAT, LON, M_APART_NORTH, StraightLine, aids, fly, settings, telemetry, texts, vehicle_4

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.alarms.alarms import traffic_light
from gcs_coloc.core.clocks.utc import TABLE_GOOD_UNTIL, gps_week_and_ms
from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.core.messages.control import ClockReference, GpsOverride, OperatorCommand, RouteBlock, RouteReport
from gcs_coloc.core.messages.inbound import Attitude, Autopilot, GlobalPosition, Heartbeat, PeerRange, TimeBase, VtolState
from gcs_coloc.core.messages.outbound import AidingMessage, ExternalPosition, GpsInput, Notice, Stream, StreamRequest
from gcs_coloc.core.telemetry.stream_requests import wanted_hz


def test_a_healthy_fleet_gets_no_aid_and_its_positions_reach_the_estimator():
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    out = fly(engine, 0.0, 5.0)
    assert not [o for _, o in out if isinstance(o, GpsInput)]
    assert len(estimator.of(PositionMeasurement, 2)) >= 48
    position = estimator.of(PositionMeasurement, 2)[-1]
    assert position.sigma_h_m == pytest.approx(np.hypot(1.2, 20.0 * 0.05))  # 20 m/s at a time that is known to 50 ms
    assert position.sigma_v_m == 2.0
    assert position.velocity_enu_mps == pytest.approx((20.0, 0.0, 0.0), abs=0.01)


def test_a_failed_vehicle_is_aided_at_a_steady_ten_hertz_and_nobody_else():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 5.0)
    out = fly(engine, 5.0, 25.0, failed=[4])
    assert {o.sysid for _, o in out if isinstance(o, GpsInput)} == {4}
    times = np.array([t for t, _ in aids(out, 4)])
    assert 6.0 <= times[0] <= 6.5
    assert np.diff(times) == pytest.approx(0.1, abs=1e-9)


def test_what_a_failed_vehicle_says_of_its_own_position_never_reaches_the_estimator():
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    fly(engine, 0.0, 5.0)
    fly(engine, 5.0, 20.0, failed=[4])
    assert max(m.measured_at_s for m in estimator.of(PositionMeasurement, 4)) < 5.1
    assert len(estimator.of(AltitudeMeasurement, 4)) >= 148


def test_recovery_restores_trust_only_after_the_hysteresis_and_ends_the_stream_with_no_fix():
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    fly(engine, 0.0, 5.0)
    fly(engine, 5.0, 20.0, failed=[4])
    out = fly(engine, 20.0, 40.0)
    stream = aids(out, 4)
    assert 32.5 < stream[-1][0] < 33.5  # healthy after 10 s, handed back over 3 s more
    assert {a.fix_type for t, a in stream if 20.5 < t < 32.5} == {3}
    assert stream[-1][1].fix_type == 1
    assert min(m.measured_at_s for m in estimator.of(PositionMeasurement, 4) if m.measured_at_s > 5.1) > 29.5
    assert [s for s, _ in estimator.denied] == [frozenset({4}), frozenset()]


def test_position_and_velocity_are_those_of_a_tenth_ago_in_the_wires_units():
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    fly(engine, 0.0, 5.0)
    out = fly(engine, 5.0, 10.0, failed=[4])
    sent_at_s, aid = aids(out, 4)[-1]
    frame = engine.frame
    assert frame is not None
    assert (4, pytest.approx(sent_at_s - 0.1)) in estimator.asked
    e, n, u = frame.enu_from_geodetic(aid.lat_deg, aid.lon_deg, aid.alt_msl_m)
    assert (e, n, u) == pytest.approx((20.0 * (sent_at_s - 0.1), 3.0 * M_APART_NORTH, 30.0), abs=1e-3)
    assert (aid.vn_mps, aid.ve_mps, aid.vd_mps) == pytest.approx((0.0, 20.0, -1.0), abs=1e-3)
    assert (aid.fix_type, aid.gps_id, aid.satellites) == (3, 1, 7)
    assert (aid.horiz_accuracy_m, aid.vert_accuracy_m, aid.speed_accuracy_mps) == pytest.approx((2.0, 3.0, 0.5))
    assert (aid.hdop, aid.vdop) == pytest.approx((np.hypot(2.0, 1.0) / 2.0, 3.0 / 2.0))  # no range was heard


def test_hdop_is_the_positions_sigma_in_units_of_a_ranges_error():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 5.0)
    engine.receive(
        PeerRange(4, 5.0, 1, 3.0 * M_APART_NORTH, 0.9, None, TimeBase.BOOT, 1, None, 0)
    )  # with the peer's 1.2 m: 1.5 m
    _, aid = aids(fly(engine, 5.0, 6.5, failed=[4]), 4)[-1]
    assert (aid.hdop, aid.vdop) == pytest.approx((np.hypot(2.0, 1.0) / 1.5, 3.0 / 1.5))


def test_without_utc_the_week_is_zero_and_with_it_the_week_is_the_answers():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 5.0)
    out = fly(engine, 5.0, 8.0, failed=[4])
    assert {(a.gps_week, a.gps_time_of_week_ms, a.time_usec) for _, a in aids(out, 4)} == {(0, 0, 0)}
    engine.receive(ClockReference(8.0, 1_700_000_000.0))
    sent_at_s, aid = aids(fly(engine, 8.0, 9.0, failed=[4]), 4)[-1]
    assert (aid.gps_week, aid.gps_time_of_week_ms) == gps_week_and_ms(1_700_000_000.0 + sent_at_s - 0.1)
    assert aid.time_usec == pytest.approx((1_700_000_000.0 + sent_at_s - 0.1) * 1e6, abs=1.0)


def test_an_old_leap_second_table_is_told_once():
    engine = Engine(StraightLine(), settings())
    for t in (0.0, 1.0):
        engine.receive(ClockReference(t, TABLE_GOOD_UNTIL.timestamp()))
    notices = [o for o in engine.poll(1.0) if isinstance(o, Notice)]
    assert len(notices) == 1
    assert "leap second" in notices[0].text


@pytest.mark.parametrize("cause", ["unknown", "uncertain"])
def test_a_position_that_is_unknown_or_too_uncertain_is_never_claimed_as_a_fix(cause):
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    fly(engine, 0.0, 5.0)
    if cause == "unknown":
        estimator.unknown = "no ranges"
    else:
        estimator.sigma_m = 10.0  # protection level beyond 50 m
    out = fly(engine, 5.0, 10.0, failed=[4])
    assert len(aids(out, 4)) > 35
    assert {a.fix_type for _, a in aids(out, 4)} == {1}
    reasons = [o.text for _, o in out if isinstance(o, Notice) and "not located" in o.text]
    assert len(reasons) == 1
    estimator.unknown, estimator.sigma_m = None, 4.0
    back = aids(fly(engine, 10.0, 14.0, failed=[4]), 4)
    # What has only not been located yet is located at once; a bound that was beyond the limit must stay within it for 1 s.
    expected_s = 10.0 if cause == "unknown" else 11.0
    assert min(t for t, a in back if a.fix_type == 3) == pytest.approx(expected_s, abs=0.21)


def test_the_level_of_a_healthy_vehicle_grows_while_nothing_is_heard_of_it():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 5.0)
    fly(engine, 5.0, 7.5, sysids=[2, 3, 4])
    silent, heard = (engine.estimate(sysid, 7.5) for sysid in (1, 2))
    assert isinstance(silent, Estimate)
    assert isinstance(heard, Estimate)
    assert silent.protection.horizontal_m - heard.protection.horizontal_m > 0.5 * 9.8 * 2.5**2


def test_the_level_of_a_denied_vehicle_grows_from_its_last_attitude_on():
    """An attitude that is 1 s old, or was 1 s under way, shows nothing of what a vehicle has done since."""
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 5.0)
    fly(engine, 5.0, 10.0, failed=[4])
    for sysid in (3, 4):
        for step in range(100, 110):
            for message in telemetry(sysid, step / 10, fix_type=1 if sysid == 4 else 3):
                if not (sysid == 4 and isinstance(message, Attitude)):
                    engine.receive(message)
    engine.poll(11.0)
    before, after = (engine.estimate(4, at_s) for at_s in (9.9, 10.9))
    assert isinstance(before, Estimate)
    assert isinstance(after, Estimate)
    assert after.protection.horizontal_m - before.protection.horizontal_m == pytest.approx(0.5 * 9.8, rel=0.01)


def test_refused_air_data_are_told_once_and_do_not_bound_what_a_vehicle_without_ranges_does():
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    fly(engine, 0.0, 5.0)
    used = fly(engine, 5.0, 10.0, failed=[4])
    assert not any("pitot" in text for text in texts(used))
    sound = engine.estimate(4, 10.0)
    estimator.refuses_air_data = True
    refused = fly(engine, 10.0, 14.0, failed=[4])
    assert [text for text in texts(refused) if "pitot" in text] == [
        "its airspeed and heading contradict its way over ground: not used; is its pitot tube clear?"
    ]
    blind = engine.estimate(4, 10.0)
    assert isinstance(sound, Estimate)
    assert isinstance(blind, Estimate)
    assert blind.protection.horizontal_m > sound.protection.horizontal_m
    estimator.refuses_air_data = False
    again = [text for text in texts(fly(engine, 14.0, 18.0, failed=[4])) if "airspeed" in text]
    assert again == ["its airspeed and heading agree with its way over ground again: used"]


def test_an_attitude_that_the_estimator_has_not_used_shows_no_motion():
    """Of a real plane the attitude in a turn was refused: it was 51 m off at a protection level of 39 m."""
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    fly(engine, 0.0, 5.0)
    fly(engine, 5.0, 10.0, failed=[4])
    used = engine.estimate(4, 10.0)
    estimator.air_data_at_s = 8.5
    older = engine.estimate(4, 10.0)
    assert isinstance(used, Estimate)
    assert isinstance(older, Estimate)
    assert older.protection.horizontal_m - used.protection.horizontal_m > 10.0


@pytest.mark.parametrize(
    ("blocking", "words"),
    [
        (RouteReport(4, 7.0, RouteBlock.SHARED_ADDRESS, (3,)), "vehicles 3 and 4 are heard from one address"),
        (Heartbeat(4, 7.0, Autopilot.PX4, True, winged=True), "PX4"),
    ],
)
def test_a_vehicle_that_cannot_be_reached_or_takes_no_gps_input_gets_nothing_and_the_reason_is_shown(blocking, words):
    engine = Engine(StraightLine(), settings(aiding=AidingSettings(method="gps_input")))
    fly(engine, 0.0, 5.0)
    fly(engine, 5.0, 7.0, failed=[4])
    engine.receive(blocking)
    last = [o for o in engine.poll(7.0) if isinstance(o, GpsInput)]
    assert [o.fix_type for o in last] == [1]
    assert not [o for o in engine.poll(7.5) if isinstance(o, GpsInput)]
    assert words in next(v.aiding for v in engine.snapshot(7.5).vehicles if v.sysid == 4)


def test_why_there_is_no_position_is_told_once_in_the_reason_of_a_vehicle():
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    fly(engine, 0.0, 5.0)
    estimator.unknown = "the peers are asleep"
    fly(engine, 5.0, 10.0, failed=[4])
    _, reason = traffic_light(vehicle_4(engine, 10.0), 0.0)
    assert reason.endswith("Located nowhere: the peers are asleep; sending no fix")


def test_at_a_shared_address_commands_that_their_target_alone_heeds_go_on():
    engine = Engine(StraightLine(), settings(aiding=AidingSettings(method="external_position")))
    fly(engine, 0.0, 5.0)
    fly(engine, 5.0, 7.0, failed=[4])
    engine.receive(RouteReport(4, 7.0, RouteBlock.SHARED_ADDRESS, (3,)))
    out = [o for at_s in np.arange(7.0, 9.0, 0.1) for o in engine.poll(float(at_s))]
    assert {type(o) for o in out if isinstance(o, AidingMessage)} == {ExternalPosition}


def test_the_operators_word_holds_from_before_the_vehicle_is_heard():
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    engine.receive(OperatorCommand(4, 0.0, GpsOverride.FAILED))
    out = fly(engine, 0.0, 3.0)
    assert {a.fix_type for t, a in aids(out, 4) if t > 0.5} == {3}
    assert not estimator.of(PositionMeasurement, 4)
    engine.receive(OperatorCommand(4, 3.0, GpsOverride.AUTO))
    fly(engine, 3.0, 15.0)
    assert engine.snapshot(15.0).vehicles[3].gps_state == "healthy"


def test_closing_sends_a_last_no_fix_to_everyone_being_aided():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 5.0)
    fly(engine, 5.0, 10.0, failed=[3, 4])
    assert [(o.sysid, o.fix_type) for o in engine.close()] == [(3, 1), (4, 1)]
    assert engine.close() == []


def test_ranges_carry_the_time_they_were_measured_at_and_the_default_sigma():
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    fly(engine, 0.0, 2.0)
    for i in range(20):
        engine.receive(PeerRange(4, 2.0 + i / 10 + 0.3 * (i % 2), 1, 500.0, None, 77.0 + i / 10, TimeBase.BOOT, i, None, 0))
    ranges = [m for m in estimator.taken if isinstance(m, RangeMeasurement)]
    assert [m.measured_at_s for m in ranges] == pytest.approx([2.0 + i / 10 for i in range(20)])
    assert {m.sigma_m for m in ranges} == {5.0}


def test_a_range_to_a_vehicle_that_was_never_heard_is_refused_and_counted():
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    fly(engine, 0.0, 2.0)
    engine.receive(PeerRange(4, 2.0, 77, 500.0, 1.0, None, TimeBase.BOOT, 1, None, 0))
    assert not [m for m in estimator.taken if isinstance(m, RangeMeasurement)]
    assert engine.refused() == {"range_peer_unknown": 1}


def test_a_stale_range_is_refused_and_counted():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 9.0)
    engine.receive(PeerRange(4, 9.0, 1, 500.0, 1.0, 3.0, TimeBase.SERVICE, 1, None, 0))
    assert engine.refused() == {"range_too_old": 1}


def test_a_late_poll_skips_what_it_missed_and_keeps_the_grid():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 5.0)
    out = fly(engine, 5.0, 8.0, failed=[4])
    grid_s = aids(out, 4)[0][0]
    late = engine.poll(9.234)
    assert len([o for o in late if isinstance(o, GpsInput)]) == 1
    phase = (engine.aiding.next_due_s - grid_s) / 0.1
    assert phase == pytest.approx(round(phase), abs=1e-6)
    assert 9.234 < engine.aiding.next_due_s <= 9.334


def test_missing_streams_are_asked_for_ever_less_often_and_at_once_after_a_reboot():
    engine = Engine(StraightLine(), EngineSettings(request_streams=True))
    out = fly(engine, 0.0, 60.0, sysids=[1])
    asked = [(t, o) for t, o in out if isinstance(o, StreamRequest)]
    sent = {Stream.POSITION, Stream.FIRST_RECEIVER, Stream.ATTITUDE, Stream.AIRSPEED}  # by telemetry()
    assert {o.stream for _, o in asked} == wanted_hz(Autopilot.ARDUPILOT).keys() - sent | {
        Stream.RECEIVER_INTEGRITY,
        Stream.VTOL_STATE,
    }
    times = sorted({t for t, _ in asked})
    assert times == pytest.approx([4.0, 12.0, 28.0], abs=1.0)
    for i in range(80):
        t = 60.0 + i / 10
        engine.receive(GlobalPosition(1, t, 0.5 + i / 10, LAT, LON, ALT, 0.0, 0.0, 0.0))
        out = engine.poll(t)
        if any(isinstance(o, StreamRequest) for o in out):
            assert t < 65.0
            break
    else:
        pytest.fail("not asked again after the reboot")


def test_more_vehicles_than_the_bound_are_refused():
    engine = Engine(StraightLine(), settings(max_vehicles=2))
    fly(engine, 0.0, 1.0, sysids=(1, 2, 3))
    assert [v.sysid for v in engine.snapshot(1.0).vehicles] == [1, 2]
    assert engine.refused()["fleet_full"] > 10


def test_the_same_calls_give_the_same_outputs():
    runs = []
    for _ in range(2):
        engine = Engine(StraightLine(), settings())
        runs.append(fly(engine, 0.0, 5.0) + fly(engine, 5.0, 12.0, failed=[2, 4]))
    assert runs[0] == runs[1]


def test_a_stuck_ranging_device_is_named_its_ranges_are_refused_and_its_first_new_value_is_used():
    rng = np.random.default_rng(1)
    engine = Engine(StraightLine(), settings())
    said, value = [], 500.0
    for step in range(200):
        t = step * 0.1
        for sysid in (1, 4):
            for message in telemetry(sysid, t):
                engine.receive(message)
        if not 100 <= step < 150:
            value = 500.0 + float(rng.standard_normal())
        engine.receive(PeerRange(4, t, 1, value, 1.0, t, TimeBase.BOOT, step, None, 7))
        said += [(step, m) for m in engine.poll(t) if isinstance(m, Notice) and "ranging device" in m.text]
    (stuck, found), (back, again) = said
    assert 102 <= stuck <= 110
    assert (found.sysid, found.level) == (4, "warning")
    assert found.text.startswith("its ranging device 7 repeats one value, ")
    assert "m to 1: it is stuck" in found.text
    assert (back, again.text) == (150, "its ranging device 7 measures 1 again")
    assert engine.refused() == {"range_repeated": 150 - stuck}


def test_the_class_of_a_vehicle_reaches_the_estimator_once_and_when_it_changes():
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    beats = [None, VehicleClass.PLANE, VehicleClass.PLANE, None, VehicleClass.MULTIROTOR, VehicleClass.MULTIROTOR]
    for t, vehicle_class in enumerate(beats):
        engine.receive(Heartbeat(2, float(t), Autopilot.ARDUPILOT, armed=True, winged=True, vehicle_class=vehicle_class))
    told = [m for m in estimator.taken if isinstance(m, VehicleClassReport)]
    assert [(m.vehicle, m.measured_at_s, m.vehicle_class) for m in told] == [
        (2, 1.0, VehicleClass.PLANE),
        (2, 4.0, VehicleClass.MULTIROTOR),
    ]


def test_a_vtol_on_its_rotors_is_a_multirotor_to_the_estimator():
    """The HEARTBEAT of ArduPilot's QuadPlane goes on to say that it is a plane."""
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    for t, on_rotors in enumerate([False, True, True, False]):
        engine.receive(Heartbeat(2, float(t), Autopilot.ARDUPILOT, armed=True, winged=True, vehicle_class=VehicleClass.PLANE))
        engine.receive(VtolState(2, t + 0.5, on_rotors=on_rotors))
    told = [m for m in estimator.taken if isinstance(m, VehicleClassReport)]
    assert [(m.measured_at_s, m.vehicle_class) for m in told] == [
        (0.0, VehicleClass.PLANE),
        (1.5, VehicleClass.MULTIROTOR),
        (3.5, VehicleClass.PLANE),
    ]
