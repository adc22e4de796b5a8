"""Finding out, with time passed by hand and vehicles that pymavlink packs."""

from __future__ import annotations

import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.messages.inbound import Autopilot
from gcs_coloc.core.messages.outbound import ParameterRequest, StreamRequest, TimeSyncRequest
from gcs_coloc.core.telemetry.stream_requests import wanted_hz
from gcs_coloc.doctor.parameters import AT_ONCE, MOST_TRIES, OWN_TRIES, RETRY_S, ParameterReader
from gcs_coloc.doctor.survey import Survey
from gcs_coloc.mavlink.encoder import STREAM_IDS
from tests.packed_messages import peer_range
from tests.signed_frames import Signer

WANTED_HZ = {STREAM_IDS[stream]: hz for stream, hz in wanted_hz(Autopilot.ARDUPILOT).items()}


UTC_MINUS_SERVICE_S = 1_800_000_000.0
HEARTBEATS = {
    Autopilot.ARDUPILOT: mavlink.MAVLink_heartbeat_message(1, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3),
    Autopilot.PX4: mavlink.MAVLink_heartbeat_message(1, mavlink.MAV_AUTOPILOT_PX4, 128, 0, 4, 3),
}


class Field:
    """A survey from time 0 for 20 s, and vehicles that send to it."""

    def __init__(self):
        self.survey = Survey((254, 191), 0.0, 20.0, utc_minus_service_s=UTC_MINUS_SERVICE_S, asks_for_streams=True)
        self.senders = {}

    def hear(self, at_s, sysid, message, place=None, key=None):
        sender = self.senders.setdefault((sysid, place), Signer(sysid, key=key))
        self.survey.receive(sender.pack(message), place or f"address of {sysid}", at_s)

    def beat(self, at_s, *sysids, autopilot=Autopilot.ARDUPILOT, place=None):
        for sysid in sysids:
            self.hear(at_s, sysid, HEARTBEATS[autopilot], place)

    def found(self, *places):
        names = {place: f"<{place}>" for place in (*places, *(f"address of {sysid}" for sysid, _ in self.senders))}
        return self.survey.findings(names, host_is_synchronised=True).vehicles

    def asked(self, at_s, sysid=1):
        questions = [q for q in self.survey.questions(at_s) if isinstance(q.message, ParameterRequest)]
        return [(q.message.name, q.as_gcs) for q in questions if q.message.sysid == sysid]


@pytest.fixture
def field():
    return Field()


def position(lat_e7=470_000_000):
    return mavlink.MAVLink_global_position_int_message(1000, lat_e7, lat_e7 and 80_000_000, 500_000, 0, 0, 0, 0, 0)


def value(name, number, kind=mavlink.MAV_PARAM_TYPE_REAL32):
    return mavlink.MAVLink_param_value_message(name.encode(), number, kind, 100, 1)


def test_a_vehicle_is_asked_for_its_parameters_until_it_has_told_them_under_any_of_their_names(field):
    field.beat(0.0, 1)
    known = {"GPS_TYPE": 1.0, "GPS_TYPE2": 14.0, "GPS_PRIMARY": 0.0, "GPS_AUTO_SWITCH": 4.0}
    asked = set()
    for step in range(200):
        at_s = step * 0.1
        field.beat(at_s, 1)
        for name, as_gcs in field.asked(at_s):
            asked.add(name)
            assert not as_gcs
            if name in known:
                field.hear(at_s, 1, value(name, known[name]))
    assert {"GPS1_TYPE", "GPS_TYPE", "SYSID_MYGCS", "MAV_GCS_SYSID", "EK3_GPS_CHECK", "GPS_DELAY_MS2"} <= asked
    (vehicle,) = field.found()
    assert vehicle.parameters == known
    assert vehicle.answers_only_to is None


def test_of_its_ports_only_those_that_speak_mavlink_are_asked_for_their_rates(field):
    known = {"SERIAL0_PROTOCOL": 2.0, "SERIAL1_PROTOCOL": 5.0, "SERIAL2_PROTOCOL": 1.0, "SR1_POSITION": 4.0}
    asked = set()
    for step in range(200):
        field.beat(step * 0.1, 1)
        for name, _ in field.asked(step * 0.1):
            asked.add(name)
            if name in known:
                field.hear(step * 0.1, 1, value(name, known[name]))
    assert {"SERIAL7_PROTOCOL", "MAV1_EXTRA1", "SR0_EXTRA1", "MAV2_POSITION", "SERIAL0_BAUD", "SERIAL2_BAUD"} <= asked
    assert not asked & {"MAV3_POSITION", "SR2_POSITION", "SERIAL1_BAUD", "MAV_0_CONFIG"}
    assert field.found()[0].parameters == known


def test_who_speaks_mavlink_1_though_we_do_not_is_found(field):
    for step in range(20):
        field.beat(step * 1.0, 1, 2)
        old = mavlink.MAVLink(None, srcSystem=2, srcComponent=1)
        old.seq = step
        field.survey.receive(HEARTBEATS[Autopilot.ARDUPILOT].pack(old, force_mavlink1=True), "address of 2", step * 1.0 + 0.5)
    for step in range(10, 20):
        old = mavlink.MAVLink(None, srcSystem=3, srcComponent=1)
        old.seq = step
        field.survey.receive(HEARTBEATS[Autopilot.ARDUPILOT].pack(old, force_mavlink1=True), "address of 1", step * 1.0 + 0.5)
    assert [(v.sysid, v.is_mavlink_1) for v in field.found("address of 1")] == [(1, False), (2, False), (3, True)]


def test_questions_are_few_at_a_time_and_end():
    reader = ParameterReader(Autopilot.ARDUPILOT)
    tries = {}
    for step in range(1000):
        names = reader.due(step * 0.1)
        assert len(names) <= AT_ONCE
        for name in names:
            tries[name] = tries.get(name, 0) + 1
    assert set(tries.values()) == {MOST_TRIES}
    assert reader.due(1000.0) == []


def test_who_does_not_answer_us_is_asked_as_a_ground_station_and_that_is_found(field):
    for step in range(int((OWN_TRIES + 3) * RETRY_S * 10)):
        at_s = step * 0.1
        field.beat(at_s, 1)
        for name, as_gcs in field.asked(at_s):
            if as_gcs and name == "MAV_OPTIONS":
                field.hear(at_s, 1, value(name, 1.0))
    (vehicle,) = field.found()
    assert vehicle.parameters == {"MAV_OPTIONS": 1.0}
    assert vehicle.answers_only_to == 255


def test_the_time_is_asked_and_the_streams_that_are_missing_are_requested(field):
    questions = []
    for step in range(100):
        field.beat(step * 0.1, 1)
        questions += [q.message for q in field.survey.questions(step * 0.1)]
    assert sum(isinstance(q, TimeSyncRequest) for q in questions) == 10
    assert {STREAM_IDS[q.stream] for q in questions if isinstance(q, StreamRequest)} == {*WANTED_HZ, 441}
    assert not field.found()[0].answers_timesync
    field.hear(10.0, 1, mavlink.MAVLink_timesync_message(5_000, 1))
    assert field.found()[0].answers_timesync


def test_rates_are_those_of_the_second_half(field):
    for step in range(200):
        at_s = step * 0.1
        field.beat(at_s, 1)
        if at_s >= 10.0 and step % 2 == 0:
            field.hear(at_s, 1, position())
    (vehicle,) = field.found()
    assert vehicle.rates_hz[33] == pytest.approx(5.0)
    assert 24 not in vehicle.rates_hz


def test_a_position_of_zero_zero_is_heard_and_holds_nothing(field):
    for step in range(200):
        field.beat(step * 0.1, 1)
        field.hear(step * 0.1, 1, position(0))
    (vehicle,) = field.found()
    assert vehicle.empty == {33}
    assert 33 not in vehicle.rates_hz


def test_px4_sends_the_bits_of_an_integer(field):
    field.beat(0.0, 1, autopilot=Autopilot.PX4)
    (as_float,) = struct.unpack("<f", struct.pack("<i", 7))
    field.hear(0.1, 1, value("EKF2_AGP_CTRL", as_float, mavlink.MAV_PARAM_TYPE_INT32))
    field.hear(0.2, 1, value("EKF2_REQ_EPH", 3.5))
    (vehicle,) = field.found()
    assert vehicle.autopilot is Autopilot.PX4
    assert vehicle.parameters == {"EKF2_AGP_CTRL": 7.0, "EKF2_REQ_EPH": 3.5}


def test_two_autopilots_behind_one_address_are_found(field):
    field.beat(0.0, 1, 2, place="a router")
    field.beat(0.0, 3)
    assert [v.others_there for v in field.found("a router")] == [(2,), (1,), ()]


def test_a_system_id_that_two_use_is_found_and_one_that_moved_is_none(field):
    for step in range(10):
        field.beat(step * 1.0, 1, place="here")
        field.beat(step * 1.0, 1, place="there")
        field.beat(step * 1.0, 2, place="at first" if step < 5 else "later")
    twice, moved = field.found("here", "there", "at first", "later")
    assert twice.is_claimed_twice
    assert twice.addresses == ("<here>", "<there>")
    assert not moved.is_claimed_twice


def test_two_autopilots_with_one_system_id_at_one_address_are_told_by_their_clocks(field):
    field.beat(0.0, 1, 2)
    for step in range(16):
        for sysid, boot_ms in ((1, 60_000), (1, 900_000), (2, 60_000)):
            field.hear(step * 0.9 + 0.1, sysid, mavlink.MAVLink_system_time_message(0, boot_ms + step * 900))
    assert [v.has_two_clocks for v in field.found()] == [True, False]


def test_ranges_count_for_both_ends_whoever_measured_and_a_single_one_for_nobody(field):
    field.beat(0.0, 1, 2, 3)
    for _ in range(2):
        field.hear(0.5, 1, mavlink.MAVLink_named_value_float_message(1000, b"RNG2", 123.0))
    field.hear(0.5, 3, mavlink.MAVLink_named_value_float_message(1000, b"RNG1", 123.0))
    assert [v.peers for v in field.found()] == [{2}, {1}, set()]


def test_ranges_without_a_time_stamp_are_noticed_of_whoever_measured_them(field):
    field.beat(0.0, 1, 2, 3)
    for k in range(2):
        field.hear(0.5 + 0.1 * k, 1, peer_range(peer_system=2, time_usec=0, sequence=k))
        field.hear(0.5 + 0.1 * k, 2, peer_range(peer_system=1, sequence=k))
    field.hear(0.5, 3, peer_range(peer_system=1, time_usec=0))
    assert [v.has_unstamped_ranges for v in field.found()] == [True, False, False]


def test_the_vehicles_utc_is_held_against_the_hosts(field):
    field.beat(0.0, 1)
    field.hear(2.0, 1, mavlink.MAVLink_system_time_message(round((UTC_MINUS_SERVICE_S + 2.0 + 30.0) * 1e6), 5000))
    assert field.found()[0].utc_minus_host_s == pytest.approx(30.0, abs=1e-3)


def test_signed_frames_are_noticed_and_who_is_no_autopilot_is_no_vehicle(field):
    field.beat(0.0, 1)
    assert not field.found()[0].is_signed
    field.hear(0.5, 1, HEARTBEATS[Autopilot.ARDUPILOT], place="signed", key=bytes(32))
    gcs = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    field.hear(0.5, 255, gcs)
    (vehicle,) = field.found("signed")
    assert vehicle.is_signed


@pytest.mark.parametrize("junk", [b"", b"\xfd\xff\x00\x00", bytes(300)])
def test_junk_is_passed_over(field, junk):
    field.survey.receive(junk, "somewhere", 0.0)
    assert field.found() == ()
