"""What we send is what pymavlink, as an independent peer, reads."""

import dataclasses
import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.aiding.methods.gps_input import no_fix
from gcs_coloc.core.messages.outbound import GpsInput, Stream, StreamRequest, TimeSyncRequest
from gcs_coloc.mavlink.encoder import MAX_DESTINATIONS, Encoder

FIX = GpsInput(
    sysid=4,
    gps_id=1,
    time_usec=61_250_000,
    gps_week=2400,
    gps_time_of_week_ms=345_678_200,
    fix_type=3,
    lat_deg=-35.36326215,
    lon_deg=149.16523745,
    alt_msl_m=584.25,
    hdop=1.5,
    vdop=2.5,
    vn_mps=-12.5,
    ve_mps=18.25,
    vd_mps=0.75,
    speed_accuracy_mps=0.5,
    horiz_accuracy_m=6.25,
    vert_accuracy_m=9.5,
    satellites=7,
)


def received(packed):
    (message,) = mavlink.MAVLink(None).parse_buffer(packed)
    return message


def test_a_request_for_the_time_holds_ours_and_no_other():
    got = received(Encoder().encode(TimeSyncRequest(4, 1_780_000_000_123_456_789), "vehicle 4"))
    assert (got.get_type(), got.tc1, got.ts1) == ("TIMESYNC", 0, 1_780_000_000_123_456_789)


def test_gps_input_holds_every_value_in_the_wires_unit():
    got = received(Encoder().encode(FIX, "vehicle 4")).to_dict()
    lat, lon = got.pop("lat"), got.pop("lon")
    assert (lat, lon) == (round(FIX.lat_deg * 1e7), round(FIX.lon_deg * 1e7))
    assert abs(lat / 1e7 - FIX.lat_deg) <= 0.5001e-7
    assert got == {
        "mavpackettype": "GPS_INPUT",
        "time_usec": 61_250_000,
        "gps_id": 1,
        "ignore_flags": mavlink.GPS_INPUT_IGNORE_FLAG_VEL_VERT,
        "time_week_ms": 345_678_200,
        "time_week": 2400,
        "fix_type": 3,
        "alt": 584.25,
        "hdop": 1.5,
        "vdop": 2.5,
        "vn": -12.5,
        "ve": 18.25,
        "vd": 0.75,
        "speed_accuracy": 0.5,
        "horiz_accuracy": 6.25,
        "vert_accuracy": 9.5,
        "satellites_visible": 7,
        "yaw": 0,
    }


def test_stream_request_is_a_command_to_the_vehicles_autopilot():
    got = received(Encoder().encode(StreamRequest(sysid=4, stream=Stream.SECOND_RECEIVER, interval_us=100_000), "vehicle 4"))
    assert (got.get_type(), got.target_system, got.target_component, got.command) == ("COMMAND_LONG", 4, 1, 511)
    assert (got.param1, got.param2, got.param7, got.confirmation) == (124.0, 100_000.0, 0.0, 0)


def test_heartbeat_says_that_we_are_no_autopilot():
    got = received(Encoder().heartbeat("vehicle 4"))
    assert (got.type, got.autopilot, got.system_status, got.base_mode, got.mavlink_version) == (
        18,
        8,
        mavlink.MAV_STATE_ACTIVE,
        0,
        3,
    )


def test_own_ids_are_254_and_191_unless_set():
    default, other = received(Encoder().heartbeat("a")), received(Encoder(sysid=255, compid=190).heartbeat("a"))
    assert (default.get_srcSystem(), default.get_srcComponent()) == (254, 191)
    assert (other.get_srcSystem(), other.get_srcComponent()) == (255, 190)


def test_frames_are_numbered_for_each_destination():
    encoder = Encoder()
    to_a = [received(encoder.heartbeat("a")).get_seq() for _ in range(258)]
    assert to_a == [*range(256), 0, 1]
    assert received(encoder.encode(FIX, "b")).get_seq() == 0
    assert received(encoder.encode(FIX, "a")).get_seq() == 2


def test_numbers_of_many_destinations_are_bounded_and_a_lively_one_keeps_its_own():
    encoder = Encoder()
    for number in range(2 * MAX_DESTINATIONS):
        encoder.heartbeat(number)
        lively = received(encoder.heartbeat("lively")).get_seq()
    assert lively == (2 * MAX_DESTINATIONS - 1) & 0xFF
    assert len(encoder._next_sequence) <= MAX_DESTINATIONS


@pytest.mark.parametrize(
    "impossible",
    [
        {"lat_deg": math.nan},
        {"lat_deg": 90.1},
        {"lon_deg": -180.1},
        {"alt_msl_m": math.inf},
        {"alt_msl_m": 1e39},
        {"ve_mps": math.nan},
        {"horiz_accuracy_m": math.inf},
        {"gps_week": 70_000},
        {"satellites": -1},
    ],
)
def test_impossible_fix_is_never_sent(impossible):
    with pytest.raises(ValueError, match="GPS_INPUT"):
        Encoder().encode(dataclasses.replace(FIX, **impossible), "vehicle 4")


@pytest.mark.parametrize("fix", [FIX, no_fix(4, 1)], ids=["fix", "no fix"])
def test_the_vertical_velocity_is_ignored_from_the_first_message(fix):
    """ArduPilot's driver keeps `have_vertical_velocity` once any message without the flag has set it."""
    got = received(Encoder().encode(fix, "vehicle 4"))
    assert got.ignore_flags == mavlink.GPS_INPUT_IGNORE_FLAG_VEL_VERT == 16


def texts_of(frames):
    return [received(frame) for frame in frames]


def test_a_short_text_is_one_message_of_the_vehicles_system_and_our_component():
    [message] = texts_of(Encoder(sysid=4, compid=191).status_text(4, "UAV4: GPS lost, located within 4 m", "a tool"))
    assert (message.get_srcSystem(), message.get_srcComponent()) == (4, 191)
    assert (message.severity, message.text, message.id, message.chunk_seq) == (4, "UAV4: GPS lost, located within 4 m", 0, 0)


@pytest.mark.parametrize("length", [50, 51, 99, 100, 101, 251])
def test_a_long_text_comes_in_pieces_that_join_to_it(length):
    text, encoder = "".join(chr(ord("a") + number % 26) for number in range(length)), Encoder(sysid=4)
    for _ in range(2):
        messages = texts_of(encoder.status_text(2, text, "a tool"))
        assert "".join(message.text for message in messages) == text
    assert [message.chunk_seq for message in messages] == list(range(len(messages)))
    assert len({message.id for message in messages}) == 1
    if length > 50:
        assert messages[0].id == 2  # each text its own
        assert len(messages[-1].text) < 50  # its end is seen
