"""The ways to aid besides GPS_INPUT, and parameters: what pymavlink, as an independent peer, reads."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.messages.outbound import ExternalPosition, GlobalPositionSensor, ParameterRequest, ParameterSet
from gcs_coloc.mavlink.encoder import Encoder

EXTERNAL = ExternalPosition(sysid=4, sent_s=123.5, lat_deg=-35.36326215, lon_deg=149.16523745, accuracy_m=12.25)
SENSOR = GlobalPositionSensor(
    sysid=4, time_usec=1_780_000_000_123_456, lat_deg=47.00000015, lon_deg=-8.5, alt_msl_m=530.5, eph_m=6.25, epv_m=9.5
)


def received(message):
    (got,) = mavlink.MAVLink(None).parse_buffer(Encoder().encode(message, "vehicle 4"))
    return got


def test_an_external_position_is_an_addressed_command_without_an_altitude():
    got = received(EXTERNAL)
    assert (got.get_type(), got.command, got.target_system, got.target_component) == ("COMMAND_INT", 43003, 4, 1)
    assert (got.frame, got.x, got.y) == (mavlink.MAV_FRAME_GLOBAL, -353632622, 1491652374)
    assert (got.param1, got.param2, got.param3) == (123.5, 0.0, 12.25)
    assert math.isnan(got.z)


def test_a_global_position_sensor_message_holds_every_value_in_the_wires_unit():
    got = received(SENSOR)
    assert (got.get_type(), got.get_msgId(), got.target_system, got.target_component) == ("GLOBAL_POSITION_SENSOR", 296, 4, 1)
    assert (got.time_usec, got.processing_time, got.lat, got.lon) == (1_780_000_000_123_456, 0, 470000002, -85000000)
    assert (got.alt, got.eph, got.epv) == (530.5, 6.25, 9.5)
    assert math.isnan(got.alt_ellipsoid)


def test_parameters_are_asked_for_by_name_and_set_with_their_type():
    asked, order = received(ParameterRequest(4, "EK3_GPS_CHECK")), received(ParameterSet(4, "GPS_PRIMARY", 1.0, 2))
    assert (asked.get_type(), asked.target_system, asked.target_component) == ("PARAM_REQUEST_READ", 4, 1)
    assert (asked.param_id, asked.param_index) == ("EK3_GPS_CHECK", -1)
    assert (order.get_type(), order.target_system, order.target_component) == ("PARAM_SET", 4, 1)
    assert (order.param_id, order.param_value, order.param_type) == ("GPS_PRIMARY", 1.0, mavlink.MAV_PARAM_TYPE_INT8)


@pytest.mark.parametrize(
    "impossible",
    [
        replace(EXTERNAL, lat_deg=90.1),
        replace(EXTERNAL, accuracy_m=math.nan),
        replace(EXTERNAL, sent_s=math.inf),
        replace(SENSOR, lon_deg=180.1),
        replace(SENSOR, alt_msl_m=math.nan),
        replace(SENSOR, eph_m=0.0),
        ParameterSet(4, "GPS_PRIMARY", math.nan, 2),
    ],
)
def test_what_is_impossible_is_never_sent(impossible):
    with pytest.raises(ValueError, match="cannot be encoded"):
        Encoder().encode(impossible, "vehicle 4")
