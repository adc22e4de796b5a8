"""The ways to aid besides GPS_INPUT, and parameters: what pymavlink, as an independent peer, reads."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.messages.outbound import (
    ExternalPosition,
    GlobalPositionSensor,
    OriginRequest,
    ParameterRequest,
    ParameterSet,
    SensorEnable,
    VisionPosition,
)
from gcs_coloc.mavlink.encoder import Encoder

EXTERNAL = ExternalPosition(sysid=4, sent_s=123.5, lat_deg=-35.36326215, lon_deg=149.16523745, accuracy_m=12.25)
SENSOR = GlobalPositionSensor(
    sysid=4, time_usec=1_780_000_000_123_456, lat_deg=47.00000015, lon_deg=-8.5, alt_msl_m=530.5, eph_m=6.25, epv_m=9.5
)
VISION = VisionPosition(4, 77, 12.5, -3.25, -40.0, (4.0, 2.25, 9.0))


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


def test_a_vision_position_holds_its_variances_on_the_diagonal_and_no_orientation():
    got = received(VISION)
    assert (got.get_type(), got.get_msgId(), got.usec) == ("VISION_POSITION_ESTIMATE", 102, 77)
    assert (got.x, got.y, got.z) == (12.5, -3.25, -40.0)
    assert all(math.isnan(angle) for angle in (got.roll, got.pitch, got.yaw))  # a yaw of 0 could be fused
    assert {i: value for i, value in enumerate(got.covariance) if value} == {0: 4.0, 6: 2.25, 11: 9.0}


def test_the_origin_is_requested_and_the_receiver_switched_by_commands_to_the_autopilot():
    got = received(OriginRequest(4))
    assert (got.target_system, got.target_component, got.command, got.param1) == (4, 1, 512, 49.0)
    got = received(SensorEnable(4, gps=False))
    assert (got.target_system, got.target_component, got.command) == (4, 1, 43006)
    assert (got.param1, got.param2, got.param3) == (0.0, 0.0, 0.0)
    assert received(SensorEnable(4, gps=True)).param3 == 1.0


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
        replace(VISION, east_m=math.nan),
        replace(VISION, variance_m2=(0.0, 1.0, 1.0)),
        ParameterSet(4, "GPS_PRIMARY", math.nan, 2),
    ],
)
def test_what_is_impossible_is_never_sent(impossible):
    with pytest.raises(ValueError, match="cannot be encoded"):
        Encoder().encode(impossible, "vehicle 4")
