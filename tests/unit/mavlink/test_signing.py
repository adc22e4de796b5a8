"""Signatures: what is refused, and that nothing is remembered of it. The other end is pymavlink."""

import hashlib

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from signed_frames import KEY, OTHER_KEY, TICKS, UNIX_S, Signer, heartbeat, of_unknown_id

from gcs_coloc.core.messages.outbound import GpsInput
from gcs_coloc.mavlink.decoder import MAX_BEHIND, Decoder
from gcs_coloc.mavlink.encoder import Encoder
from gcs_coloc.mavlink.signing import LATEST_TICKS, LinkSigning, Signing, Stamp

NOW_S = 50.0
MINUTE = 6_000_000
FIX = GpsInput(4, 1, 5_000_000, 0, 0, 3, 47.0, 8.0, 500.0, 1.0, 1.0, 1.0, 2.0, 3.0, 0.5, 1.0, 2.0, 9)


class End:
    """A decoder on one signed link."""

    def __init__(self, *, required=True, key=KEY, clock=True, link_id=0, **bounds):
        self.signing = Signing(key, **bounds)
        self.signing.set_clock(UNIX_S - NOW_S if clock else None)
        self.link = LinkSigning(self.signing, link_id, required)
        self.decoder = Decoder()

    def takes(self, datagram, link=None):
        """Whether the one frame of a datagram was taken."""
        return len(self.decoder.decode(datagram, NOW_S, "address", link or self.link)) == 1

    def counted(self):
        return dict(self.decoder.counts)


def altered(frame, at, flip=1):
    changed = bytearray(frame)
    changed[at] ^= flip
    return bytes(changed)


def test_frames_of_a_key_holder_are_taken_and_an_unsigned_one_is_not():
    end, vehicle = End(), Signer()
    assert all(end.takes(vehicle.pack()) for _ in range(5))
    assert not end.takes(Signer(2, key=None).pack())
    assert end.counted() == {"unsigned": 1}


def test_where_signatures_are_accepted_an_unsigned_frame_is_taken_and_a_wrong_signature_is_not():
    end = End(required=False)
    assert end.takes(Signer(2, key=None).pack())
    assert end.takes(Signer(1).pack())
    assert not end.takes(Signer(3, key=OTHER_KEY).pack())
    assert end.counted() == {"signature_wrong": 1}


def test_a_mavlink_1_frame_is_an_unsigned_one():
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    end = End()
    assert not end.takes(bytes(heartbeat().pack(sender, force_mavlink1=True)))
    assert end.counted() == {"unsigned": 1}


def test_a_radios_own_report_is_passed_over_quietly():
    end = End()
    report = mavlink.MAVLink_radio_status_message(1, 1, 1, 1, 1, 1, 1)
    assert not end.takes(Signer(51, compid=68, key=None).pack(report))
    assert end.counted() == {"unsigned_radio_status": 1}


@pytest.mark.parametrize("at", [*range(-13, 0), 5, 10])
def test_a_frame_altered_anywhere_is_refused(at):
    end, frame = End(), Signer().pack()
    assert not end.takes(altered(frame, at))
    assert end.signing.streams == 0
    assert end.takes(frame)


def test_a_forged_frame_moves_no_streams_time_and_takes_no_room():
    """pymavlink notes the time of a frame before it looks at the signature: one forged frame shuts the genuine sender out."""
    end, vehicle = End(max_streams=2), Signer()
    assert end.takes(vehicle.pack())
    for sysid in range(1, 200):
        assert not end.takes(Signer(sysid, key=OTHER_KEY, ticks=TICKS + 1000 * MINUTE).pack())
    assert end.signing.streams == 1
    assert end.takes(vehicle.pack())
    assert end.takes(Signer(2).pack())
    assert end.signing.stamp(0, NOW_S).timestamp < TICKS + 10
    assert [link.sysid for link in end.decoder.sequences.links(range(256)) if link.received] == [1, 2]


@pytest.mark.parametrize("key", [None, OTHER_KEY])
def test_an_unknown_message_id_is_no_way_around_the_check(key):
    end = End()
    assert not end.takes(of_unknown_id(Signer().pack(), key))
    assert set(end.counted()) == {"unsigned" if key is None else "signature_wrong"}
    assert not any(link.received for link in end.decoder.sequences.links(range(256)))


def test_a_genuine_frame_of_unknown_id_is_verified_and_moves_its_streams_time():
    end, vehicle = End(), Signer()
    older = vehicle.pack()
    assert not end.takes(of_unknown_id(vehicle.pack()))
    assert set(end.counted()) == {"unknown_message"}
    assert not end.takes(older)
    assert end.counted()["signature_replayed"] == 1


def test_what_was_recorded_is_not_taken_again():
    end, vehicle = End(), Signer()
    frames = [vehicle.pack() for _ in range(4)]
    assert all(end.takes(frame) for frame in frames)
    assert not any(end.takes(frame) for frame in frames)
    assert end.counted() == {"signature_replayed": 3, "duplicate": 1}


def test_what_was_heard_on_one_link_cannot_be_played_back_on_another():
    end, vehicle = End(), Signer()
    other_link = LinkSigning(end.signing, 1, required=True)
    frame = vehicle.pack()
    assert end.takes(frame)
    assert not end.takes(frame, other_link)
    assert end.takes(vehicle.pack(), other_link)


@pytest.mark.parametrize(
    ("behind", "taken"), [(MINUTE, True), (MINUTE + 1, False), (1000 * MINUTE, False), (-1000 * MINUTE, True)]
)
def test_a_stream_never_heard_may_be_a_minute_behind_us(behind, taken):
    end = End()
    assert end.takes(Signer(ticks=TICKS - behind).pack()) is taken
    assert end.counted() == ({} if taken else {"signature_old": 1})
    assert end.signing.streams == int(taken)


def test_the_sources_of_what_is_rightly_signed_but_too_old_are_known_once_and_so_many_at_most():
    end, late = End(), TICKS - 2 * MINUTE
    end.decoder.decode(Signer(key=OTHER_KEY, ticks=late).pack(), NOW_S, "forger", end.link)
    assert end.decoder.pop_behind() == ()
    for sysid in range(1, 101):
        end.decoder.decode(Signer(sysid, ticks=late).pack(), NOW_S, sysid, end.link)
        end.decoder.decode(Signer(sysid, ticks=late).pack(), NOW_S, sysid, end.link)
    assert end.decoder.pop_behind() == tuple(range(1, MAX_BEHIND + 1))
    assert end.decoder.pop_behind() == ()


def test_a_vehicle_that_is_behind_is_taken_once_it_has_verified_a_frame_of_ours():
    end, encoder, vehicle = End(), Encoder(), Signer(ticks=TICKS - 1000 * MINUTE)
    assert not end.takes(vehicle.pack())
    vehicle.mav.parse_buffer(encoder.heartbeat("vehicle", end.link.stamp(NOW_S)))
    assert end.takes(vehicle.pack())


def test_how_far_the_time_of_signatures_is_ahead_of_the_hosts_clock_is_known():
    end = End()
    assert end.signing.ahead_s(NOW_S) == 0.0
    assert end.takes(Signer(ticks=TICKS + 1000 * MINUTE).pack())
    assert end.signing.ahead_s(NOW_S) == 60_000.0
    end.signing.set_clock(None)
    assert end.signing.ahead_s(NOW_S) == 0.0


def test_streams_are_told_apart_by_system_component_and_link():
    end = End()
    assert end.takes(Signer(1, ticks=TICKS + 100).pack())
    for number, other in enumerate((Signer(2), Signer(1, compid=191), Signer(1, link_id=3))):
        other.mav.seq = number  # one with equal number and checksum would be a network's copy
        assert end.takes(other.pack())
    assert not end.takes(Signer(1).pack())


def test_a_stream_is_forgotten_only_when_nothing_recorded_of_it_could_be_taken():
    end = End(max_streams=2)
    first, second, third = Signer(1), Signer(2), Signer(3)
    recorded = first.pack()
    assert end.takes(recorded)
    assert end.takes(second.pack())
    assert not end.takes(third.pack())
    assert end.counted() == {"signature_streams_full": 1}
    end.signing.set_clock(UNIX_S - NOW_S + 61.0)
    assert end.takes(third.pack(ticks=TICKS + MINUTE + 1))
    assert end.signing.streams == 2
    assert not end.takes(recorded)
    assert end.counted()["signature_old"] == 1


def test_nobody_wears_out_the_counter():
    end = End()
    assert not end.takes(Signer(ticks=LATEST_TICKS + 1).pack())
    assert end.counted() == {"signature_future": 1}
    assert end.takes(Signer(ticks=LATEST_TICKS).pack())
    assert end.signing.stamp(0, NOW_S).timestamp == LATEST_TICKS + 1 < 2**48


def test_our_stamps_always_increase_and_follow_the_clock_and_the_latest_heard():
    end = End()
    assert [end.signing.stamp(link, NOW_S).timestamp for link in (0, 1, 0)] == [TICKS, TICKS + 1, TICKS + 2]
    assert end.signing.stamp(0, NOW_S + 1.0).timestamp == TICKS + 100_000
    end.signing.set_clock(UNIX_S - NOW_S - 3600.0)
    assert end.signing.stamp(0, NOW_S).timestamp == TICKS + 100_001
    assert end.takes(Signer(ticks=TICKS + 5 * MINUTE).pack())
    assert end.signing.stamp(0, NOW_S).timestamp == TICKS + 5 * MINUTE + 1


def test_without_a_clock_of_its_own_the_service_takes_the_vehicles_time():
    end = End(clock=False)
    assert end.signing.stamp(0, NOW_S).timestamp == 1
    assert end.takes(Signer().pack())
    assert end.signing.stamp(0, NOW_S).timestamp == TICKS + 1


@pytest.mark.parametrize("length", [0, 31, 33])
def test_a_key_has_32_bytes(length):
    with pytest.raises(ValueError, match="32 bytes"):
        Signing(bytes(length))


def test_a_stamp_does_not_show_its_key():
    assert str(KEY) not in repr(Stamp(KEY, 0, 1))
    assert "timestamp=1" in repr(Stamp(KEY, 0, 1))


def test_pymavlink_takes_what_we_sign_and_refuses_what_we_do_not():
    end, encoder = End(link_id=7), Encoder()
    peer = mavlink.MAVLink(None)
    peer.signing.secret_key, peer.signing.timestamp = KEY, TICKS
    for _ in range(3):
        (got,) = peer.parse_buffer(encoder.encode(FIX, "vehicle", end.link.stamp(NOW_S)))
        assert (got.get_type(), got.get_signed(), got.fix_type) == ("GPS_INPUT", True, 3)
    assert list(peer.signing.stream_timestamps) == [(7, 254, 191)]
    assert peer.parse_buffer(encoder.heartbeat("vehicle", end.link.stamp(NOW_S)))[0].get_signed()
    with pytest.raises(mavlink.MAVError, match="Invalid signature"):
        peer.parse_buffer(encoder.encode(FIX, "vehicle"))


def test_our_signature_is_the_one_of_the_specification():
    frame = Encoder().heartbeat("vehicle", Stamp(KEY, 5, TICKS))
    assert frame[2] == 1
    assert frame[-13:-6] == bytes([5]) + TICKS.to_bytes(6, "little")
    assert frame[-6:] == hashlib.sha256(KEY + frame[:-6]).digest()[:6]
