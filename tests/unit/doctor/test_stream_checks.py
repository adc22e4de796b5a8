"""Messages that come too slowly, and the parameter to set: by the port that the vehicle says it has."""

from __future__ import annotations

from dataclasses import replace

import pytest
from vehicle_surveys import RECEIVER

from gcs_coloc.core.messages.inbound import Autopilot
from gcs_coloc.core.telemetry.stream_requests import wanted_hz
from gcs_coloc.doctor.finding import Severity, VehicleSurvey
from gcs_coloc.doctor.stream_checks import check
from gcs_coloc.mavlink.encoder import STREAM_IDS

WANTED_HZ = {STREAM_IDS[stream]: hz for autopilot in Autopilot for stream, hz in wanted_hz(autopilot).items()}


SLOW = {**WANTED_HZ, 33: 2.0}
ONE_PORT = {"SERIAL0_PROTOCOL": 2.0, "SERIAL0_BAUD": 115.0, "SERIAL3_PROTOCOL": 5.0}
TWO_PORTS = {"SERIAL0_PROTOCOL": 2.0, "SERIAL1_PROTOCOL": -1.0, "SERIAL2_PROTOCOL": 1.0, "SERIAL2_BAUD": 57.0}


def said(autopilot, parameters, rates_hz=SLOW, **changes):
    vehicle = VehicleSurvey(4, autopilot, parameters=parameters, rates_hz=rates_hz, **changes)
    return [finding for finding in check(vehicle) if finding.severity is not Severity.RIGHT]


def position(autopilot, parameters):
    (finding,) = said(autopilot, parameters)
    assert finding.severity is Severity.NOTE
    assert finding.text == "GLOBAL_POSITION_INT comes at 2.0 Hz, 10 Hz are wanted"
    return finding


@pytest.mark.parametrize("name", ["MAV1_POSITION", "SR0_POSITION"])
def test_the_stream_of_the_only_port_is_to_be_set_under_its_own_name(name):
    finding = position(Autopilot.ARDUPILOT, {**ONE_PORT, name: 2.0})
    assert finding.parameter == (name, 10.0)
    assert finding.remedy.startswith(f"set {name} = 10 (SERIAL0, now 2)")
    assert finding.remedy.endswith("see whether the link carries as much (SERIAL0_BAUD = 115)")


def test_of_several_ports_each_is_named_by_its_place_among_those_that_speak_mavlink():
    """SERIAL2 is the second of them: its rates are SR1_ or MAV2_."""
    finding = position(Autopilot.ARDUPILOT, {**TWO_PORTS, "SR0_POSITION": 0.0, "SR1_POSITION": 4.0})
    assert (
        "SR0_POSITION = 10 (SERIAL0, now 0) or SR1_POSITION = 10 (SERIAL2, now 4), that of the port we are on" in finding.remedy
    )
    assert finding.parameter is None
    finding = position(Autopilot.ARDUPILOT, {**TWO_PORTS, "MAV1_POSITION": 10.0, "MAV2_POSITION": 4.0})
    assert finding.remedy.startswith("set MAV2_POSITION = 10 (SERIAL2, now 4), that of the port we are on")


def test_where_the_rate_is_high_enough_the_link_is_to_blame_and_where_none_was_told_the_names_are_said():
    finding = position(Autopilot.ARDUPILOT, {**ONE_PORT, "MAV1_POSITION": 10.0})
    assert finding.parameter is None
    assert finding.remedy.startswith(
        "MAV1_POSITION = 10 asks for as much: see whether the link carries as much (SERIAL0_BAUD = 115)"
    )
    assert "SRn_POSITION" in position(Autopilot.ARDUPILOT, {}).remedy


def test_what_is_not_heard_at_all_stops_with_the_same_remedy():
    rates = {number: hz for number, hz in WANTED_HZ.items() if number != 24}
    (finding,) = said(Autopilot.ARDUPILOT, {**ONE_PORT, "MAV1_EXT_STAT": 0.0}, rates)
    assert (finding.severity, finding.parameter) == (Severity.STOP, ("MAV1_EXT_STAT", 5.0))


@pytest.mark.parametrize(
    ("parameters", "parameter", "words"),
    [
        (
            {"MAV_0_CONFIG": 101.0, "MAV_0_RATE": 1200.0, "MAV_0_MODE": 0.0, "SER_TEL1_BAUD": 57600.0},
            ("MAV_0_RATE", 0.0),
            (
                "set MAV_0_RATE = 0 (TELEM1, now 1200 bytes/s; 0 is half of what its baud rate carries); "
                "if that does not help, see whether the link carries as much (SER_TEL1_BAUD = 57600)"
            ),
        ),
        (
            {"MAV_1_CONFIG": 1000.0, "MAV_1_RATE": 100000.0, "MAV_1_MODE": 7.0},
            ("MAV_1_MODE", 2.0),
            "(instance 1, Onboard; now 7, Minimal)",
        ),
        (
            {"MAV_0_CONFIG": 101.0, "MAV_0_RATE": 1200.0, "MAV_0_MODE": 1.0},
            None,
            "MAV_0_MODE = 2 (TELEM1, Onboard; now 1, Custom)",
        ),
        ({"MAV_0_CONFIG": 101.0, "MAV_0_RATE": 0.0, "MAV_0_MODE": 2.0}, None, "MAV_n_RATE and MAV_n_MODE of its instance"),
        ({"MAV_0_CONFIG": 0.0, "MAV_0_RATE": 1200.0}, None, "MAV_n_RATE and MAV_n_MODE of its instance"),
    ],
)
def test_of_px4_the_rate_and_the_mode_of_each_instance_that_is_on_are_looked_at(parameters, parameter, words):
    finding = position(Autopilot.PX4, parameters)
    assert finding.parameter == parameter
    assert words in finding.remedy


def test_a_port_that_speaks_mavlink_1_is_named():
    (finding,) = said(Autopilot.ARDUPILOT, TWO_PORTS, WANTED_HZ, is_mavlink_1=True)
    assert (finding.severity, finding.parameter) == (Severity.NOTE, ("SERIAL2_PROTOCOL", 2.0))
    assert "carries no PEER_RANGE" in finding.text
    (finding,) = said(Autopilot.PX4, {}, WANTED_HZ, is_mavlink_1=True)
    assert "MAV_PROTO_VER = 2" in finding.remedy


@pytest.mark.parametrize(
    ("autopilot", "words"),
    [
        (Autopilot.ARDUPILOT, "wait for its EKF; if its receiver has a fix, EK3_GPS_CHECK may refuse the accuracy"),
        (Autopilot.PX4, "wait for its EKF; if its receiver has a fix, EKF2_REQ_EPH, EKF2_REQ_EPV or EKF2_REQ_SACC may refuse"),
        (Autopilot.OTHER, "wait for its EKF"),
    ],
)
def test_where_the_autopilot_has_no_position_its_own_parameters_are_named(autopilot, words):
    (finding,) = said(autopilot, {}, {k: hz for k, hz in WANTED_HZ.items() if k != 33}, empty=frozenset({33}))
    assert finding.severity is Severity.STOP
    assert finding.remedy.startswith(words)


@pytest.mark.parametrize(("number", "severity"), [(24, Severity.STOP), (30, Severity.NOTE), (2, Severity.NOTE)])
def test_impossible_values_of_another_message_are_not_taken_for_a_want_of_position(number, severity):
    (finding,) = said(Autopilot.ARDUPILOT, {}, {k: hz for k, hz in WANTED_HZ.items() if k != number}, empty=frozenset({number}))
    assert finding.severity is severity
    assert finding.text.endswith(" has impossible values and is not used")


@pytest.mark.parametrize(("parameters", "notes"), [({"GPS2_TYPE": 0.0}, 0), ({"GPS_TYPE2": 0.0}, 0), ({"GPS2_TYPE": 14.0}, 1)])
def test_a_receiver_that_is_switched_off_is_not_missed_on_the_link(parameters, notes):
    without = {number: hz for number, hz in WANTED_HZ.items() if number != 124}
    assert len(said(Autopilot.ARDUPILOT, parameters, without)) == notes


def test_a_px4_that_has_had_no_fix_is_told_to_wait_for_one_and_its_link_is_not_blamed():
    silent = {number: hz for number, hz in WANTED_HZ.items() if number != 33}
    (cold,) = said(Autopilot.PX4, {}, silent, receiver=replace(RECEIVER, fix_type=1))
    assert cold.severity is Severity.STOP
    assert "a PX4 sends none before the first fix of its receiver, which has none now" in cold.text
    assert cold.remedy.startswith("wait for its first fix")
    for autopilot, receiver in (
        (Autopilot.PX4, RECEIVER),
        (Autopilot.PX4, None),
        (Autopilot.ARDUPILOT, replace(RECEIVER, fix_type=1)),
    ):
        (linked,) = said(autopilot, {}, silent, receiver=receiver)
        assert linked.text == "GLOBAL_POSITION_INT is not heard"
        assert "link" in linked.remedy
