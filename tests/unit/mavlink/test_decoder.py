"""Whose frames are taken, which are passed over or refused, and that a recorded flight decodes as pymavlink decodes it."""

import pytest
from packed_messages import NOW_S, heartbeat, pack, peer_range
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.messages.inbound import (
    Airspeed,
    Attitude,
    GlobalPosition,
    GpsReceiver,
)
from gcs_coloc.mavlink.decoder import Decoder
from gcs_coloc.recorder.tlog import TlogReader
from tests.recordings import recording


def test_only_autopilots_heartbeats_are_told_as_such():
    decoder = Decoder()
    datagram = pack(heartbeat()) + pack(heartbeat(kind=18, autopilot=8), compid=191)
    assert [(f.compid, f.is_autopilot_heartbeat) for f in decoder.decode(datagram, NOW_S)] == [(1, True), (191, False)]


def test_what_describes_the_vehicle_is_taken_from_its_autopilot_only():
    """A gimbal's ATTITUDE is not the vehicle's; a companion computer's range is as good as any."""
    decoder = Decoder()
    attitude = mavlink.MAVLink_attitude_message(61_250, 0.5, -0.25, 3.0, 1, 1, 1)
    gimbal = mavlink.MAV_COMP_ID_GIMBAL
    assert decoder.decode(pack(attitude, compid=gimbal), NOW_S) == []
    assert decoder.counts["not_from_autopilot"] == 1
    assert decoder.decode(pack(peer_range(), compid=gimbal, sequence=1), NOW_S)[0].message is not None


def test_autopilot_with_a_component_id_of_its_own_is_believed_after_its_heartbeat():
    decoder = Decoder()
    attitude = mavlink.MAVLink_attitude_message(61_250, 0.5, -0.25, 3.0, 1, 1, 1)
    assert decoder.decode(pack(attitude, compid=50), NOW_S) == []
    decoder.decode(pack(heartbeat(), compid=50, sequence=1), NOW_S)
    assert decoder.decode(pack(attitude, compid=50, sequence=2), NOW_S)[0].message is not None


def test_a_flood_of_forged_heartbeats_keeps_no_autopilot_out():
    decoder = Decoder()
    for sysid in range(1, 250):
        decoder.decode(b"".join(pack(heartbeat(), sysid=sysid, compid=compid) for compid in range(2, 10)), NOW_S)
    attitude = mavlink.MAVLink_attitude_message(61_250, 0.5, -0.25, 3.0, 1, 1, 1)
    (_, found) = decoder.decode(pack(heartbeat(), sysid=250, compid=50) + pack(attitude, sysid=250, compid=50, sequence=1), NOW_S)
    assert isinstance(found.message, Attitude)


@pytest.mark.parametrize("announced", [{"kind": 0, "autopilot": 0}, {"kind": 0}, {"kind": 2, "autopilot": 12}])
def test_script_beside_an_autopilot_is_none_whatever_its_heartbeat_says(announced):
    """A companion's script often announces itself as generic, or as what it was copied from; the aid's way hangs on it."""
    decoder = Decoder()
    attitude = mavlink.MAVLink_attitude_message(61_250, 0.5, -0.25, 3.0, 1, 1, 1)
    assert decoder.decode(pack(heartbeat(**announced), compid=191), NOW_S)[0].is_autopilot_heartbeat
    assert decoder.decode(pack(heartbeat()), NOW_S)[0].is_autopilot_heartbeat
    beside = decoder.decode(pack(heartbeat(**announced), compid=191, sequence=1) + pack(attitude, compid=191, sequence=2), NOW_S)
    assert [frame.message for frame in beside] == [None]
    assert decoder.counts["not_from_autopilot"] == 1
    assert decoder.decode(pack(heartbeat(**announced), sysid=2, compid=191), NOW_S)[0].is_autopilot_heartbeat


def test_frames_that_are_none_of_our_business_are_counted():
    decoder = Decoder()
    assert decoder.decode(pack(mavlink.MAVLink_ping_message(0, 1, 0, 0)), NOW_S) == []
    assert decoder.decode(pack(heartbeat(), sysid=0), NOW_S) == []
    assert decoder.decode(pack(heartbeat(), sysid=254, compid=191), NOW_S) == []
    assert decoder.decode(b"\xfd\x01\x00\x00\x05\x01\x01\x11\x22\x33\x07\x12\x34", NOW_S) == []
    assert dict(decoder.counts) == {"not_wanted": 1, "invalid_value:header.sysid": 1, "echo": 1, "unknown_message": 1}


def test_own_ids_are_a_setting():
    decoder = Decoder(own_sysid=200, own_compid=5)
    assert decoder.decode(pack(heartbeat(), sysid=200, compid=5), NOW_S) == []
    assert len(decoder.decode(pack(heartbeat(), sysid=254, compid=191), NOW_S)) == 1


def test_copied_datagram_is_used_once_for_each_address():
    decoder = Decoder()
    datagram = pack(peer_range())
    assert len(decoder.decode(datagram, NOW_S, "direct")) == 1
    assert decoder.decode(datagram, NOW_S, "direct") == []
    assert len(decoder.decode(datagram, NOW_S, "by a router")) == 1
    assert dict(decoder.counts) == {"duplicate": 1}


def test_recorded_flight_decodes_as_pymavlink_decodes_it():
    decoder, reference = Decoder(), mavlink.MAVLink(None)
    compared = 0
    for number, record in enumerate(TlogReader(recording("arduplane/flight.tlog"))):
        if number % 10:
            continue
        frames = decoder.decode(record.frame, record.unix_s)
        (sent,) = reference.parse_buffer(record.frame)
        if not frames:
            continue
        (frame,) = frames
        message = frame.message
        assert (frame.sysid, frame.compid, frame.sequence) == (sent.get_srcSystem(), sent.get_srcComponent(), sent.get_seq())
        if isinstance(message, GlobalPosition):
            assert (message.lat_deg, message.lon_deg, message.vn_mps) == (sent.lat / 1e7, sent.lon / 1e7, sent.vx / 1e2)
            assert (message.alt_msl_m, message.boot_s, message.vd_mps) == (sent.alt / 1e3, sent.time_boot_ms / 1e3, sent.vz / 1e2)
        elif isinstance(message, GpsReceiver) and message.receiver == 0:
            assert (message.fix_type, message.satellites, message.lat_deg) == (
                sent.fix_type,
                sent.satellites_visible,
                sent.lat / 1e7 if sent.fix_type >= 2 else 0.0,
            )
            assert message.h_acc_m == (sent.h_acc / 1e3 or None)
        elif isinstance(message, Attitude):
            assert (message.roll_rad, message.pitch_rad, message.yaw_rad) == (sent.roll, sent.pitch, sent.yaw)
        elif isinstance(message, Airspeed):
            assert message.airspeed_mps == sent.airspeed
        else:
            continue
        compared += 1
    assert compared > 5000
    assert set(decoder.counts) == {"not_wanted"}


def test_px4s_own_copy_of_a_companions_debug_vect_is_a_duplicate():
    """PX4 forwards the companion's, and sends the vector again once a second as component 1, by its own clock."""
    decoder = Decoder()

    def ranges(compid: int, time_usec: int) -> list[float]:
        message = mavlink.MAVLink_debug_vect_message(b"RNG2", time_usec, 120.0, 1.0, -1.0)
        frame = bytes(message.pack(mavlink.MAVLink(None, srcSystem=4, srcComponent=compid)))
        return [f.message.range_m for f in decoder.decode(frame, 5.0) if f.message is not None]

    assert ranges(1, 1_000_000) == [120.0]  # of a script of the autopilot's own
    assert ranges(191, 2_000_000) == [120.0]
    assert ranges(1, 3_000_000) == []
    assert decoder.counts == {"duplicate": 1}
