"""Whom a frame is addressed to, held against what pymavlink packs."""

import random

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.mavlink.framing import EVERYBODY, Target, read_frame, target_of
from tests.signed_frames import Signer, heartbeat, of_unknown_id

ADDRESSED = sorted(
    (cls for cls in mavlink.mavlink_map.values() if "target_system" in cls.ordered_fieldnames), key=lambda cls: cls.id
)


def packed(message, **flags) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=255, srcComponent=190), **flags))


@pytest.mark.parametrize("cls", ADDRESSED, ids=lambda cls: cls.msgname)
def test_every_addressed_message_tells_its_target(cls):
    rng = random.Random(cls.id)
    zeros = bytearray(cls.unpacker.size)
    decoder = mavlink.MAVLink(None)
    for at in range(len(zeros)):
        payload = bytearray(zeros)
        payload[at] = value = rng.randrange(1, 256)
        frame = framed(cls, bytes(payload))
        theirs = decoder.decode(bytearray(frame))
        want = Target(theirs.target_system, getattr(theirs, "target_component", 0))
        assert target_of(read_frame(frame, 0)) == want
        if want != EVERYBODY:
            assert value in want


def framed(cls, payload: bytes) -> bytes:
    """A MAVLink 2 frame of a payload, checksum and all, by pymavlink's own checksum."""
    payload = payload.rstrip(b"\0") or b"\0"
    header = bytes((0xFD, len(payload), 0, 0, 0, 255, 190)) + cls.id.to_bytes(3, "little")
    crc = mavlink.x25crc(header[1:] + payload + bytes((cls.crc_extra,))).crc
    return header + payload + crc.to_bytes(2, "little")


def test_a_joystick_is_meant_for_its_one_vehicle():
    manual = mavlink.MAVLink_manual_control_message(7, 0, 0, 0, 0, 0)
    assert target_of(read_frame(packed(manual), 0)) == Target(7, 0)


def test_mavlink_1_has_targets_as_well():
    request = mavlink.MAVLink_param_request_read_message(3, 1, b"GPS1_TYPE", -1)
    assert target_of(read_frame(packed(request, force_mavlink1=True), 0)) == Target(3, 1)


def test_what_has_no_target_or_is_unknown_is_for_everybody():
    assert target_of(read_frame(packed(heartbeat()), 0)) == EVERYBODY
    assert target_of(read_frame(of_unknown_id(Signer(255).pack()), 0)) == EVERYBODY
