"""Frames are found among any bytes, and nothing that is no frame hides one."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.mavlink import framing
from gcs_coloc.mavlink.framing import StreamFramer, split
from gcs_coloc.mavlink.refusals import Counts


def sender(sysid=1):
    return mavlink.MAVLink(None, srcSystem=sysid, srcComponent=1)


def heartbeat(mav=None, **kwargs):
    return mavlink.MAVLink_heartbeat_message(1, 3, 81, 7, 4, 3).pack(mav or sender(), **kwargs)


def attitude(mav=None, **kwargs):
    return mavlink.MAVLink_attitude_message(1000, 0.1, 0.2, 0.3, 0.0, 0.0, 0.5).pack(mav or sender(), **kwargs)


def found(data):
    counts = Counts()
    frames, dealt_with = split(data, counts, ended=True)
    assert dealt_with == len(data)
    return [raw.frame for raw in frames], dict(counts)


def unknown_frame(payload=b"\x07" * 9):
    """A whole MAVLink 2 frame of a message id that no dialect of ours holds."""
    return bytes([0xFD, len(payload), 0, 0, 5, 1, 1, 0x11, 0x22, 0x33]) + payload + b"\x12\x34"


@pytest.mark.parametrize("version_1", [False, True])
def test_header_and_payload_are_read_in_both_versions(version_1):
    mav = sender(sysid=42)
    mav.seq = 200
    message = mavlink.MAVLink_attitude_message(1000, 0.1, 0.2, 0.3, 0.0, 0.0, 0.5)
    packed = message.pack(mav, force_mavlink1=version_1)
    (raw,) = split(packed, Counts(), ended=True)[0]
    assert (raw.is_known, raw.message_id, raw.sysid, raw.compid, raw.sequence) == (True, 30, 42, 1, 200)
    assert raw.payload == bytes(message.get_payload())
    assert raw.checksum == message.get_crc()


def test_several_frames_in_a_datagram_are_all_found():
    mav = sender()
    datagram = heartbeat(mav) + attitude(mav, force_mavlink1=True) + attitude(mav)
    frames, counts = found(datagram)
    assert b"".join(frames) == datagram
    assert len(frames) == 3
    assert counts == {}


def test_signed_frame_is_taken_with_its_signature_block():
    mav = sender()
    mav.signing.secret_key = b"k" * 32
    mav.signing.sign_outgoing = True
    signed = attitude(mav)
    assert signed[2] == framing.INCOMPAT_SIGNED
    assert found(signed + heartbeat()) == ([signed, heartbeat()], {})


@pytest.mark.parametrize(
    "garbage",
    [
        b"\x00" * 40,
        b"\xfd\xff\x00\x00",  # states 255 bytes of payload, more than there are
        b"\xfe\x10",
        b"\xfd" * 30,
        b"\xfd\x09\x00\x00\x05\x01\x01\x11\x22\x33",  # an unknown message that would end within the good frame
        bytes(range(256)),
    ],
)
def test_good_frame_behind_garbage_is_found(garbage):
    frames, counts = found(garbage + attitude() + heartbeat())
    assert frames == [attitude(), heartbeat()]
    assert counts["garbage_bytes"] == len(garbage)


def test_frame_with_bad_crc_is_counted_and_hides_nothing_behind_it():
    bad = bytearray(attitude())
    bad[14] ^= 1
    frames, counts = found(bytes(bad) + heartbeat())
    assert frames == [heartbeat()]
    assert counts == {"bad_crc": 1, "garbage_bytes": len(bad)}


def test_frame_inside_a_bad_frame_is_found():
    inner = heartbeat()
    outer = bytes([0xFD, len(inner) + 4, 0, 0, 0, 1, 1, 30, 0, 0]) + inner + b"\0\0\0\0" + b"\x00\x00"
    frames, counts = found(outer)
    assert frames == [inner]
    assert counts["bad_crc"] == 1


def test_frame_within_the_payload_of_a_good_frame_is_not_taken():
    """A file transfer or a tunnel may carry MAVLink frames as its data."""
    payload = list(heartbeat().ljust(251, b"\x01"))
    carrier = mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, payload).pack(sender())
    assert found(carrier) == ([carrier], {})


@pytest.mark.parametrize(
    ("pattern", "fault"),
    [(b"\xfe\x01", "bad_crc"), (b"\xfd\xfd", "unknown_incompat_flags"), (b"\xfe\xff", "unverifiable")],
)
def test_datagram_made_to_keep_us_busy_is_dropped_after_so_many_false_starts(pattern, fault):
    busy = pattern * 30_000
    frames, counts = found(heartbeat() + busy + heartbeat())
    assert frames == [heartbeat()]
    assert counts == {
        fault: framing.MAX_FALSE_STARTS + 1,
        "rest_dropped": 1,
        "garbage_bytes": len(busy) + len(heartbeat()),
    }


def test_truncated_frame_is_counted():
    frames, counts = found(heartbeat() + attitude()[:-1])
    assert frames == [heartbeat()]
    assert counts["truncated"] >= 1


@pytest.mark.parametrize(
    ("flags", "refusal"),
    [
        (0x02, "system_id_32_bit"),
        (0x04, "system_id_32_bit"),
        (0x07, "system_id_32_bit"),
        (0x08, "unknown_incompat_flags"),
        (0x0A, "unknown_incompat_flags"),
    ],
)
def test_incompatibility_flags_that_are_not_read_are_counted_by_name(flags, refusal):
    strange = bytearray(attitude())
    strange[2] = flags
    frames, counts = found(bytes(strange) + heartbeat())
    assert frames == [heartbeat()]
    assert {name: counts[name] for name in ("system_id_32_bit", "unknown_incompat_flags") if counts.get(name)} == {refusal: 1}


def test_unknown_message_is_stepped_over_where_a_frame_or_the_end_follows():
    raws, _ = split(unknown_frame() + heartbeat() + unknown_frame(), Counts(), ended=True)
    assert [raw.is_known for raw in raws] == [False, True, False]


def test_unknown_message_followed_by_neither_is_garbage():
    frames, counts = found(unknown_frame() + b"\x00" + heartbeat())
    assert frames == [heartbeat()]
    assert counts["unverifiable"] == 1


def test_stream_in_pieces_of_any_size_gives_the_same_frames():
    mav = sender()
    frames = [heartbeat(mav), attitude(mav), attitude(mav, force_mavlink1=True)] * 5
    noisy = b"\x13\xfd" + b"".join(frames[:7]) + b"\xfe\x03noise" + b"".join(frames[7:])
    for size in (1, 2, 3, 7, 50, 1000):
        framer = StreamFramer(Counts())
        got = [frame for start in range(0, len(noisy), size) for frame in framer.feed(noisy[start : start + size])]
        # The noise may state a length beyond the end; more of the stream sets the rest free.
        got += framer.feed(b"\0" * framing.MAX_FRAME_LENGTH)
        assert got == frames, size


def test_stream_passes_unknown_messages_on_once_the_next_frame_begins():
    framer = StreamFramer(Counts())
    assert framer.feed(unknown_frame()) == []
    assert framer.feed(heartbeat()[:1]) == [unknown_frame()]


def test_stream_holds_back_no_more_than_one_frame():
    framer = StreamFramer(Counts())
    for _ in range(200):
        framer.feed(b"\xfd\xff\x00" * 100)
        assert len(framer._pending) <= framing.MAX_FRAME_LENGTH


def test_stream_goes_on_however_much_noise_there_is():
    """What comes on a line that we were told to listen to is not hostile, only noisy."""
    noise = b"\xfd\xfd" * framing.MAX_FALSE_STARTS
    assert StreamFramer(Counts()).feed(noise + heartbeat()) == [heartbeat()]


def test_stream_counts_what_a_datagram_counts():
    bad = bytearray(attitude())
    bad[14] ^= 1
    noisy = b"\x01\x02" + bytes(bad) + heartbeat() + b"\x00"
    in_stream, in_datagram = Counts(), Counts()
    StreamFramer(in_stream).feed(noisy)
    split(noisy, in_datagram, ended=True)
    assert dict(in_stream) == dict(in_datagram) == {"garbage_bytes": 3 + len(bad), "bad_crc": 1}
