"""Answers to commands and parameters, and somebody else's GPS_INPUT, as pymavlink packs them."""

from __future__ import annotations

import math
import struct

import pytest
from pymavlink.dialects.v10 import ardupilotmega as mavlink1
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.messages.control import ForeignGpsInput
from gcs_coloc.core.messages.inbound import CommandOutcome, CommandResult, ParameterValue, VehicleCommand
from gcs_coloc.mavlink.decoder import Decoder

FIX = mavlink.MAVLink_gps_input_message(0, 1, 0, 0, 0, 3, 470000000, 80000000, 500.0, 1.0, 1.0, 0, 0, 0, 0.5, 2.0, 3.0, 10)

ACCEPTED = CommandResult(4, 5.0, VehicleCommand.EXTERNAL_POSITION_ESTIMATE, CommandOutcome.ACCEPTED)


def decoded(message, sysid=4, compid=1, **options):
    decoder = Decoder(**options)
    frames = decoder.decode(bytes(message.pack(mavlink.MAVLink(None, srcSystem=sysid, srcComponent=compid))), 5.0)
    return [frame.message for frame in frames], dict(decoder.counts)


def test_the_answer_to_a_command_is_taken_from_the_autopilot_alone():
    ack = mavlink.MAVLink_command_ack_message(43003, 4, target_system=254, target_component=191)
    assert decoded(ack) == ([CommandResult(4, 5.0, VehicleCommand.EXTERNAL_POSITION_ESTIMATE, CommandOutcome.FAILED)], {})
    assert decoded(ack, compid=100) == ([], {"not_from_autopilot": 1})


@pytest.mark.parametrize(
    ("target", "ours"),
    [
        ((254, 191), True),
        ((0, 0), True),
        ((254, 0), True),
        ((255, 190), False),
        ((254, 190), False),
        ((255, 0), False),
        ((0, 190), False),
    ],
)
def test_the_answer_to_another_ground_stations_command_is_not_taken_for_ours(target, ours):
    ack = mavlink.MAVLink_command_ack_message(43003, 0, target_system=target[0], target_component=target[1])
    taken, counts = decoded(ack)
    assert (taken, counts) == (([ACCEPTED], {}) if ours else ([None], {"answer_to_another": 1}))


def test_an_answer_in_mavlink_1_has_no_address_and_is_taken():
    ack = mavlink1.MAVLink_command_ack_message(43003, 0)
    frame = bytes(ack.pack(mavlink1.MAVLink(None, srcSystem=4, srcComponent=1)))
    assert (frame[0], frame[1]) == (0xFE, 3)
    assert [taken.message for taken in Decoder().decode(frame, 5.0)] == [ACCEPTED]


@pytest.mark.parametrize("name", [b"GPS_PRIMARY", b"SIXTEEN_LETTERS_"])
def test_a_parameter_is_taken_with_its_name_and_type(name):
    message = mavlink.MAVLink_param_value_message(name, 1.0, 2, 900, 17)
    assert decoded(message) == ([ParameterValue(4, 5.0, name.decode(), 1.0, 2)], {})


@pytest.mark.parametrize("number", [1, 3, 115_200, -1, -40])
def test_an_integer_of_px4_arrives_as_its_four_bytes_and_one_of_ardupilot_as_a_float(number):
    (as_float,) = struct.unpack("<f", struct.pack("<i", number))
    for value in (as_float, float(number)):
        message = mavlink.MAVLink_param_value_message(b"EKF2_AGP0_ID", value, 6, 900, 17)
        assert decoded(message) == ([ParameterValue(4, 5.0, "EKF2_AGP0_ID", float(number), 6)], {})


def test_a_parameter_that_is_no_number_or_has_no_name_is_none():
    assert decoded(mavlink.MAVLink_param_value_message(b"GPS_PRIMARY", math.nan, 6, 900, 17)) == ([None], {})
    messages, counts = decoded(mavlink.MAVLink_param_value_message(b"\xff\xfe", 1.0, 2, 900, 17))
    assert (messages, counts) == ([None], {"invalid_value:PARAM_VALUE.param_id": 1})


def test_somebody_elses_gps_input_is_noted_with_the_receiver_that_it_feeds():
    assert decoded(FIX, sysid=255, compid=190) == ([ForeignGpsInput(255, 5.0, gps_id=1)], {})


def test_our_own_system_id_from_another_component_is_refused_but_for_gps_input():
    heartbeat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    assert decoded(heartbeat, sysid=254, compid=190) == ([], {"own_sysid": 1})
    assert decoded(FIX, sysid=254, compid=190) == ([ForeignGpsInput(254, 5.0, gps_id=1)], {})
    assert decoded(FIX, sysid=254, compid=191) == ([], {"echo": 1})
    assert decoded(heartbeat, sysid=255, compid=190, own_sysid=255) == ([], {"own_sysid": 1})
    assert decoded(heartbeat, sysid=254, compid=192, has_other_service=True) == ([], {"other_service": 1})
