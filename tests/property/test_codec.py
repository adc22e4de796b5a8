"""Whatever the bytes: nothing is raised, no good frame is lost, and what goes in comes out."""

from __future__ import annotations

import math
from dataclasses import fields

from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.messages.inbound import Attitude, GlobalPosition, GpsReceiver, PeerRange, TimeBase
from gcs_coloc.core.messages.outbound import GpsInput
from gcs_coloc.mavlink._generated import gcs_coloc as ours
from gcs_coloc.mavlink.checks import InvalidValueError
from gcs_coloc.mavlink.decoder import Decoder
from gcs_coloc.mavlink.encoder import Encoder
from gcs_coloc.mavlink.framing import MAX_FRAME_LENGTH, MESSAGE_CLASSES, StreamFramer, split
from gcs_coloc.mavlink.inbound import CONVERTERS
from gcs_coloc.mavlink.refusals import Counts

OWN = (254, 190)
float32 = st.floats(width=32)
sysids = st.integers(1, 255)


def finite(low, high):
    return st.floats(low, high, width=32)


@st.composite
def wanted_frames(draw):
    """A frame with a right checksum of any message that we decode, its payload any bytes at all."""
    message_class = MESSAGE_CLASSES[draw(st.sampled_from(sorted(CONVERTERS)))]
    payload = draw(st.binary(min_size=message_class.unpacker.size, max_size=message_class.unpacker.size))
    sender = mavlink.MAVLink(None, srcSystem=draw(st.integers(0, 255)), srcComponent=draw(st.sampled_from([1, 1, 191, 0, 255])))
    sender.seq = draw(st.integers(0, 255))
    return mavlink.MAVLink_message(message_class.id, message_class.msgname)._pack(sender, message_class.crc_extra, payload)


# Payload bytes without extension fields, where a message has some: all that MAVLink 1 can carry.
SIZES_IN_VERSION_1 = {1: 31, 24: 30, 77: 3, 111: 16, 124: 35, 193: 22}


@st.composite
def frames_of_either_version(draw):
    """A frame of any message that pymavlink and we decode, of MAVLink 2 or 1, with any bytes, often many zeros, in it."""
    message_class = MESSAGE_CLASSES[draw(st.sampled_from(sorted(CONVERTERS.keys() & mavlink.mavlink_map.keys())))]
    as_version_1 = message_class.id < 256 and draw(st.booleans())
    size = message_class.unpacker.size
    size = SIZES_IN_VERSION_1.get(message_class.id, size) if as_version_1 else size
    payload = draw(st.binary(max_size=size)).ljust(size, b"\0")
    sender = mavlink.MAVLink(None, srcSystem=draw(st.integers(1, 253)), srcComponent=1)
    message = mavlink.MAVLink_message(message_class.id, message_class.msgname)
    return message._pack(sender, message_class.crc_extra, payload, force_mavlink1=as_version_1)


def assert_found_behind(garbage):
    """A good frame is found behind the garbage, unless this heads an unknown message that ends where the good frame does."""
    good = Encoder(sysid=7, compid=1).heartbeat("x")
    raws, dealt_with = split(garbage + good, Counts(), ended=True)
    assert dealt_with == len(garbage) + len(good)
    assert good in [raw.frame for raw in raws] or (not raws[-1].is_known and raws[-1].frame.endswith(good))


def all_numbers_are_finite(message):
    values = [getattr(message, field.name) for field in fields(message)]
    return all(math.isfinite(value) for value in values if isinstance(value, float))


@given(frames_of_either_version())
@settings(max_examples=500)
def test_what_is_read_straight_from_the_bytes_is_what_pymavlinks_objects_hold(frame):
    (slow,) = mavlink.MAVLink(None).parse_buffer(frame)
    values = tuple(getattr(slow, f"_{name}_raw", getattr(slow, name)) for name in slow.ordered_fieldnames)
    convert = CONVERTERS[slow.get_msgId()]
    try:
        expected = convert(slow.get_srcSystem(), 3.0, values)
    except InvalidValueError:
        expected = None
    if slow.get_type() == "COMMAND_ACK" and (slow.target_system not in (0, OWN[0]) or slow.target_component not in (0, OWN[1])):
        # An answer to another ground station.
        expected = None
    (quick,) = Decoder(own_sysid=OWN[0], own_compid=OWN[1]).decode(frame, 3.0)
    assert repr(quick.message) == repr(expected)


@given(st.binary(max_size=600))
def test_any_bytes_are_decoded_without_raising_and_accounted_for(data):
    decoder = Decoder()
    assert len(decoder.decode(data, 0.0)) <= len(data) // 8
    assert decoder.counts["garbage_bytes"] <= len(data)
    assert not data or decoder.counts


@given(st.lists(wanted_frames(), min_size=1, max_size=4))
@settings(max_examples=200)
def test_any_values_are_decoded_without_raising_and_only_possible_ones_get_in(frames):
    decoder = Decoder()
    for frame in decoder.decode(b"".join(frames), 1.0):
        message = frame.message
        if message is None:
            continue
        assert message.sysid == frame.sysid != 0
        assert all_numbers_are_finite(message)
        if isinstance(message, GlobalPosition | GpsReceiver):
            assert abs(message.lat_deg) <= 90.0
            assert abs(message.lon_deg) <= 180.0
        if isinstance(message, PeerRange):
            assert 0.0 < message.range_m <= 100_000.0
            assert message.sigma_m is None or message.sigma_m > 0.0
            assert message.peer not in (0, message.sysid)


@given(wanted_frames(), st.integers(0), st.integers(1, 255), st.integers(0, 300))
@settings(max_examples=200)
def test_damaged_frame_disturbs_no_good_neighbour(frame, where, flip, cut):
    damaged = bytearray(frame)
    damaged[where % len(frame)] ^= flip
    assert_found_behind(bytes(damaged[: max(cut, 1)]))


@given(st.binary(max_size=MAX_FRAME_LENGTH))
@settings(max_examples=300)
def test_good_frame_survives_any_garbage_before_it(garbage):
    assert_found_behind(garbage)


@given(st.lists(st.one_of(wanted_frames(), st.binary(max_size=40)), max_size=8), st.lists(st.integers(1, 50), min_size=1))
@settings(max_examples=200)
def test_stream_gives_the_same_frames_however_it_is_cut(pieces, sizes):
    stream = b"".join(pieces) + b"\0" * MAX_FRAME_LENGTH
    whole = StreamFramer(Counts()).feed(stream)
    framer, position, in_pieces = StreamFramer(Counts()), 0, []
    for number in range(len(stream)):
        size = sizes[number % len(sizes)]
        in_pieces += framer.feed(stream[position : position + size])
        position += size
        if position >= len(stream):
            break
    assert in_pieces == whole


@given(
    time_us=st.integers(1, 4 * 10**15),
    distance=finite(0.125, 65536.0),
    sigma=finite(0.0, 1000.0),
    sequence=st.integers(0, 65535),
    ids=st.tuples(sysids, sysids).filter(lambda pair: pair[0] != pair[1]),
    quality=st.one_of(st.integers(0, 100), st.just(255)),
    device=st.integers(0, 255),
)
def test_peer_range_round_trip(time_us, distance, sigma, sequence, ids, quality, device):
    sent = ours.MAVLink_peer_range_message(time_us, distance, sigma, sequence, ids[1], quality, device)
    (frame,) = Decoder(own_sysid=0).decode(sent.pack(mavlink.MAVLink(None, srcSystem=ids[0], srcComponent=1)), 2.0)
    assert frame.message == PeerRange(
        sysid=ids[0],
        received_at_s=2.0,
        peer=ids[1],
        range_m=distance,
        sigma_m=sigma or None,
        measured_at_s=time_us / 1e6,
        time_base=TimeBase.UNIX if time_us >= 10**15 else TimeBase.BOOT,
        sequence=sequence,
        line_of_sight=None if quality == 255 else quality / 100,
        device_id=device,
    )


@given(
    boot_ms=st.integers(0, 2**32 - 1),
    lat=st.integers(-900_000_000, 900_000_000),
    lon=st.integers(1, 1_800_000_000),
    alt=st.integers(-1_000_000, 100_000_000),
    velocity=st.tuples(*[st.integers(-32768, 32767)] * 3),
)
def test_global_position_round_trip(boot_ms, lat, lon, alt, velocity):
    sent = mavlink.MAVLink_global_position_int_message(boot_ms, lat, lon, alt, 0, *velocity, 0)
    (frame,) = Decoder().decode(sent.pack(mavlink.MAVLink(None, srcSystem=9, srcComponent=1)), 2.0)
    got = frame.message
    assert (round(got.lat_deg * 1e7), round(got.lon_deg * 1e7), round(got.alt_msl_m * 1e3)) == (lat, lon, alt)
    assert tuple(round(v * 1e2) for v in (got.vn_mps, got.ve_mps, got.vd_mps)) == velocity
    assert round(got.boot_s * 1e3) == boot_ms


@given(st.integers(0, 2**32 - 1), st.tuples(*[finite(-3.125, 3.125)] * 3))
def test_attitude_round_trip(boot_ms, angles):
    sent = mavlink.MAVLink_attitude_message(boot_ms, *angles, 0.0, 0.0, 0.0)
    (frame,) = Decoder().decode(sent.pack(mavlink.MAVLink(None, srcSystem=9, srcComponent=1)), 2.0)
    assert frame.message == Attitude(9, 2.0, boot_ms / 1e3, *angles)


@given(
    lat=st.floats(-90.0, 90.0),
    lon=st.floats(-180.0, 180.0),
    numbers=st.lists(finite(-10_000.0, 10_000.0), min_size=9, max_size=9),
    satellites=st.integers(0, 255),
    fix_type=st.sampled_from([1, 3]),
)
def test_gps_input_is_read_by_pymavlink_as_it_was_meant(lat, lon, numbers, satellites, fix_type):
    alt, hdop, vdop, vn, ve, vd, speed_accuracy, h_acc, v_acc = numbers
    fix = GpsInput(
        4, 1, 5_000_000, 0, 0, fix_type, lat, lon, alt, hdop, vdop, vn, ve, vd, speed_accuracy, h_acc, v_acc, satellites
    )
    (got,) = mavlink.MAVLink(None).parse_buffer(Encoder().encode(fix, "x"))
    assert abs(got.lat / 1e7 - lat) <= 0.6e-7
    assert abs(got.lon / 1e7 - lon) <= 0.6e-7
    assert [got.alt, got.hdop, got.vdop, got.vn, got.ve, got.vd] == numbers[:6]
    assert [got.speed_accuracy, got.horiz_accuracy, got.vert_accuracy] == numbers[6:]
    assert (got.satellites_visible, got.fix_type, got.yaw) == (satellites, fix_type, 0)
    assert got.ignore_flags == mavlink.GPS_INPUT_IGNORE_FLAG_VEL_VERT
