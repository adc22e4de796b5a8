"""What the vehicles do when spoken to: parameters, message rates, TIMESYNC, faults at run time, hostile datagrams."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fakes.fleet import Fleet
from sitl_fakes.parameters import DEFAULTS
from tests.unit.sitl_fakes.fakes_support import GroundStation, parse, scenario


def said(fleet, message, kind, after_s=0.1, sysid=1, gcs=None):
    """Send one message to a vehicle and return the messages of a kind that it sends within a time."""
    at = fleet.now_s
    fleet.deliver(sysid, (gcs or GroundStation()).pack(message), at)
    return parse(fleet.advance(at + after_s), kind, sysid)


@pytest.fixture
def fleet():
    fleet = Fleet(scenario(), 1)
    fleet.advance(2.0)
    return fleet


def command(number, *params, target=1):
    return mavlink.MAVLink_command_long_message(target, 1, number, 0, *[*params, *[0.0] * (7 - len(params))])


def test_the_parameter_list_is_whole(fleet):
    values = said(fleet, mavlink.MAVLink_param_request_list_message(1, 1), "PARAM_VALUE")
    assert {m.param_id: m.param_value for m in values} == {**DEFAULTS["ardupilot"], "SYSID_THISMAV": 1.0}
    assert [m.param_index for m in values] == list(range(len(DEFAULTS["ardupilot"])))
    assert {m.param_count for m in values} == {len(DEFAULTS["ardupilot"])}


def test_parameters_are_read_by_name_and_by_index_and_unknown_ones_are_passed_over(fleet):
    by_name = said(fleet, mavlink.MAVLink_param_request_read_message(1, 1, b"GPS2_TYPE", -1), "PARAM_VALUE")
    assert [(m.param_id, m.param_value) for m in by_name] == [("GPS2_TYPE", 14.0)]
    by_index = said(fleet, mavlink.MAVLink_param_request_read_message(1, 1, b"", by_name[0].param_index), "PARAM_VALUE")
    assert [m.param_id for m in by_index] == ["GPS2_TYPE"]
    assert said(fleet, mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1), "PARAM_VALUE") == []
    assert said(fleet, mavlink.MAVLink_param_request_read_message(1, 1, b"", 9999), "PARAM_VALUE") == []


def test_param_set_takes_effect_live_and_is_confirmed(fleet):
    done = said(fleet, mavlink.MAVLink_param_set_message(1, 1, b"GPS2_TYPE", 0.0, 6), "PARAM_VALUE")
    assert [(m.param_id, m.param_value) for m in done] == [("GPS2_TYPE", 0.0)]
    assert parse(fleet.advance(4.0), "GPS2_RAW", 1) == []
    assert len(parse(fleet.advance(5.0), "GPS2_RAW", 2)) > 0
    assert said(fleet, mavlink.MAVLink_param_set_message(1, 1, b"GPS2_TYPE", math.nan, 6), "PARAM_VALUE") == []
    own = said(fleet, mavlink.MAVLink_param_set_message(1, 1, b"SYSID_THISMAV", 9.0, 6), "PARAM_VALUE")
    assert [m.param_value for m in own] == [1.0]


def test_messages_for_others_and_from_strangers_are_passed_over(fleet):
    assert said(fleet, mavlink.MAVLink_param_request_list_message(2, 1), "PARAM_VALUE") == []
    said(fleet, mavlink.MAVLink_param_set_message(1, 1, b"MAV_OPTIONS", 1.0, 6), "PARAM_VALUE")
    read = mavlink.MAVLink_param_request_read_message(1, 1, b"MAV_OPTIONS", -1)
    assert said(fleet, read, "PARAM_VALUE", gcs=GroundStation(254, 191)) == []
    assert len(said(fleet, read, "PARAM_VALUE", gcs=GroundStation(255, 190))) == 1


def test_message_rates_are_set_and_acknowledged(fleet):
    set_interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    acks = said(fleet, command(set_interval, 33, 200_000), "COMMAND_ACK")
    assert [(m.command, m.result, m.target_system, m.target_component) for m in acks] == [(set_interval, 0, 255, 190)]
    start = fleet.now_s
    assert len(parse(fleet.advance(start + 10.0), "GLOBAL_POSITION_INT", 1)) == pytest.approx(50, abs=1)
    assert said(fleet, command(set_interval, 33, -1.0), "COMMAND_ACK")[0].result == 0
    assert parse(fleet.advance(fleet.now_s + 2.0), "GLOBAL_POSITION_INT", 1) == []
    assert said(fleet, command(set_interval, 33, 0.0), "COMMAND_ACK")[0].result == 0
    assert len(parse(fleet.advance(fleet.now_s + 2.0), "GLOBAL_POSITION_INT", 1)) == pytest.approx(20, abs=1)
    assert said(fleet, command(set_interval, 9999, 1e5), "COMMAND_ACK")[0].result == mavlink.MAV_RESULT_FAILED
    assert said(fleet, command(mavlink.MAV_CMD_DO_PARACHUTE), "COMMAND_ACK")[0].result == mavlink.MAV_RESULT_UNSUPPORTED


def test_a_message_can_be_asked_for_once(fleet):
    replies = said(fleet, command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_SIMSTATE), None, after_s=0.02)
    assert [m.get_type() for m in replies[:2]] == ["COMMAND_ACK", "SIMSTATE"]


def test_the_truth_is_sent_only_on_request_and_is_the_truth(fleet):
    assert parse(fleet.advance(4.0), "SIMSTATE") == []
    for message_id in (mavlink.MAVLINK_MSG_ID_SIMSTATE, mavlink.MAVLINK_MSG_ID_SIM_STATE):
        said(fleet, command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 20_000), "COMMAND_ACK")
    out = fleet.advance(fleet.now_s + 0.02)
    truth, simstate, sim_state = fleet.truth()[1], parse(out, "SIMSTATE")[-1], parse(out, "SIM_STATE")[-1]
    assert (simstate.lat * 1e-7, simstate.lng * 1e-7) == pytest.approx((truth.lat_deg, truth.lon_deg), abs=1e-7)
    assert (sim_state.lat_int * 1e-7, sim_state.lon_int * 1e-7) == pytest.approx((truth.lat_deg, truth.lon_deg), abs=1e-7)
    assert (sim_state.alt, sim_state.vn, sim_state.ve) == pytest.approx((truth.alt_msl_m, truth.vn_mps, truth.ve_mps), abs=0.05)
    assert math.hypot(sim_state.q1, sim_state.q2, sim_state.q3, sim_state.q4) == pytest.approx(1.0)
    assert 2.0 * math.atan2(sim_state.q4, sim_state.q1) == pytest.approx(sim_state.yaw, abs=1e-3)
    asked_at_start = Fleet(scenario(truth_messages=True), 1).advance(2.0)
    assert len(parse(asked_at_start, "SIMSTATE", 1)) == pytest.approx(20, abs=1)


def test_timesync_is_answered_with_the_boot_clock(fleet):
    replies = said(fleet, mavlink.MAVLink_timesync_message(0, 987654321), "TIMESYNC")
    boot_ms = parse(fleet.advance(fleet.now_s + 1.0), "SYSTEM_TIME", 1)[0].time_boot_ms
    assert [m.ts1 for m in replies] == [987654321]
    assert replies[0].tc1 * 1e-6 == pytest.approx(boot_ms, abs=1200)
    assert said(fleet, mavlink.MAVLink_timesync_message(5, 5), "TIMESYNC") == []


def test_sitl_parameters_lose_jam_and_glitch_the_gps_and_give_it_back(fleet):
    def set_param(name, value):
        said(fleet, mavlink.MAVLink_param_set_message(1, 1, name, value, 9), "PARAM_VALUE")

    set_param(b"SIM_GPS1_ENABLE", 0.0)
    assert {m.fix_type for m in parse(fleet.advance(fleet.now_s + 2.0), "GPS_RAW_INT", 1)[1:]} == {1}
    set_param(b"SIM_GPS1_ENABLE", 1.0)
    assert {m.fix_type for m in parse(fleet.advance(fleet.now_s + 2.0), "GPS_RAW_INT", 1)[1:]} == {6}
    set_param(b"SIM_GPS1_JAM", 1.0)
    jammed = [m.fix_type for m in parse(fleet.advance(fleet.now_s + 30.0), "GPS_RAW_INT", 1)]
    assert set(jammed) == {1, 6}
    set_param(b"SIM_GPS1_JAM", 0.0)
    set_param(b"SIM_GPS1_GLTCH_X", 0.001)
    fleet.advance(fleet.now_s + 0.5)
    truth, raw = fleet.truth()[1], parse(fleet.advance(fleet.now_s + 0.3), "GPS_RAW_INT", 1)[0]
    assert raw.lat * 1e-7 - truth.lat_deg == pytest.approx(0.001, abs=1.5e-4)


@pytest.mark.parametrize("kind", range(1, 11))
def test_every_fault_can_be_commanded(fleet, kind):
    ack = said(fleet, command(mavlink.MAV_CMD_USER_1, kind, 0.0, 2.0, 0.0, 0.0, 0.0, 3.0), "COMMAND_ACK")
    silent_at_once = kind in (8, 9)
    assert [m.result for m in ack] == ([] if silent_at_once else [0]) or ack[0].result == 0


@pytest.mark.parametrize(
    "params",
    [(99.0,), (math.nan,), (4.0, 0.0, -5.0), (4.0, math.nan, 1.0), (8.0,), (5.0, 300.0), (6.0, 2.0, math.inf), (4.0, 0.0, 1e9)]
    + [(kind, not_a_peer) for kind in (5.0, 6.0, 7.0) for not_a_peer in (math.nan, math.inf)],
)
def test_an_impossible_fault_is_denied(fleet, params):
    assert said(fleet, command(mavlink.MAV_CMD_USER_1, *params), "COMMAND_ACK")[0].result == mavlink.MAV_RESULT_DENIED


def test_commanded_faults_are_cleared_by_command(fleet):
    said(fleet, command(mavlink.MAV_CMD_USER_1, 1.0), "COMMAND_ACK")
    assert parse(fleet.advance(fleet.now_s + 1.0), "GPS_RAW_INT", 1)[-1].fix_type == 1
    said(fleet, command(mavlink.MAV_CMD_USER_1, 0.0), "COMMAND_ACK")
    assert parse(fleet.advance(fleet.now_s + 1.0), "GPS_RAW_INT", 1)[-1].fix_type == 6


def test_garbage_never_raises_and_never_spoils_a_good_datagram(fleet):
    rng, gcs = np.random.default_rng(0), GroundStation()
    good = gcs.pack(mavlink.MAVLink_timesync_message(0, 1))
    wild = [rng.bytes(int(rng.integers(0, 400))) for _ in range(200)] + [
        b"",
        b"\xfd\xff\x00\x00",
        b"\xfe\x09",
        good[:-3],
        good[:-1] + b"\0",
    ]
    for payload in wild:
        fleet.deliver(1, payload, fleet.now_s)
    fleet.deliver(1, good, fleet.now_s)
    replies = parse(fleet.advance(fleet.now_s + 0.1), "TIMESYNC", 1)
    assert [m.ts1 for m in replies] == [1]


def test_impossible_numbers_in_good_frames_never_raise(fleet):
    gcs, nan, inf = GroundStation(), math.nan, math.inf
    messages = [
        mavlink.MAVLink_gps_input_message(
            0, 1, 0, 0, 0, 255, 2**31 - 1, -(2**31), inf, nan, inf, nan, nan, nan, nan, inf, nan, 255
        ),
        mavlink.MAVLink_gps_input_message(0, 1, 0, 0, 0, 3, 0, 0, 1e38, 1e38, 1e38, 1e38, 1e38, 1e38, 1e38, 1e38, 1e38, 255),
        mavlink.MAVLink_command_long_message(1, 1, 511, 0, nan, nan, nan, nan, nan, nan, nan),
        mavlink.MAVLink_command_long_message(1, 1, 511, 0, inf, inf, 0, 0, 0, 0, 0),
        mavlink.MAVLink_command_long_message(1, 1, 511, 0, 33, 1e-30, 0, 0, 0, 0, 0),
        mavlink.MAVLink_command_long_message(1, 1, 512, 0, inf, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_command_long_message(1, 1, 31010, 0, 5, inf, nan, nan, nan, nan, nan),
        mavlink.MAVLink_command_int_message(1, 1, 0, 43003, 0, 0, nan, nan, nan, nan, 2**31 - 1, -(2**31), nan),
        mavlink.MAVLink_param_set_message(1, 1, b"EK3_GPS_CHECK", inf, 9),
        mavlink.MAVLink_param_set_message(1, 1, b"EK3_GPS_CHECK", 3e38, 9),
        mavlink.MAVLink_param_set_message(1, 1, b"SIM_GPS1_GLTCH_X", 3e38, 9),
    ]
    for message in messages:
        fleet.deliver(1, gcs.pack(message), fleet.now_s)
        fleet.advance(fleet.now_s + 0.5)
    assert len(parse(fleet.advance(fleet.now_s + 1.0), "HEARTBEAT", 1)) == 1
