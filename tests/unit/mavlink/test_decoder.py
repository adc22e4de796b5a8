"""Frames packed by pymavlink's own generated code become the core's messages; impossible ones are refused with a reason."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.messages import (
    Airspeed,
    Attitude,
    Autopilot,
    EkfStatus,
    GlobalPosition,
    GpsReceiver,
    Heartbeat,
    PeerRange,
    SystemHealth,
    SystemTime,
    TimeBase,
    TimeSyncAnswer,
)
from gcs_coloc.mavlink._generated import gcs_coloc as ours
from gcs_coloc.mavlink.decoder import Decoder
from gcs_coloc.recorder.tlog import TlogReader
from tests.recordings import recording

NOW_S = 12.5
UNIX_US = 1_700_000_000_250_000


def pack(message, sysid=1, compid=1, sequence=0, **kwargs):
    mav = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=compid)
    mav.seq = sequence
    return message.pack(mav, **kwargs)


def decode(message, **kwargs):
    """The core's message of one packed message, and the counts."""
    decoder = Decoder()
    (frame,) = decoder.decode(pack(message, **kwargs), NOW_S)
    return frame.message, dict(decoder.counts)


def heartbeat(kind=mavlink.MAV_TYPE_FIXED_WING, autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base_mode=0):
    return mavlink.MAVLink_heartbeat_message(kind, autopilot, base_mode, 0, 4, 3)


def global_position(**changes):
    fields = {"time_boot_ms": 61_250, "lat": -353_632_621, "lon": 1_491_652_374, "alt": 584_190, "relative_alt": 100}
    fields |= {"vx": 1500, "vy": -250, "vz": -30, "hdg": 35_000}
    return mavlink.MAVLink_global_position_int_message(**(fields | changes))


def gps_raw(**changes):
    fields = {
        "time_usec": UNIX_US,
        "fix_type": 6,
        "lat": -353_632_621,
        "lon": 1_491_652_374,
        "alt": 584_190,
        "eph": 121,
        "epv": 200,
    }
    fields |= {"vel": 2200, "cog": 0, "satellites_visible": 10, "h_acc": 300, "v_acc": 450, "vel_acc": 120}
    return mavlink.MAVLink_gps_raw_int_message(**(fields | changes))


def peer_range(**changes):
    fields = {"time_usec": 61_250_000, "range": 812.5, "range_std": 0.25, "sequence": 65_535, "peer_system": 3}
    fields |= {"quality": 80, "device_id": 2}
    return ours.MAVLink_peer_range_message(**(fields | changes))


def ranging_beacon(**changes):
    fields = {
        "time_usec": 61_250_000,
        "target_system": 0,
        "target_component": 0,
        "beacon_id": 3,
        "range": 812_500,
        "lat": 0,
        "lon": 0,
    }
    fields |= {
        "alt": math.nan,
        "alt_type": 0,
        "hacc_est": 0,
        "vacc_est": 0,
        "carrier_freq": 0,
        "range_accuracy": 250,
        "sequence": 200,
    }
    return ours.MAVLink_ranging_beacon_message(**(fields | {"status": 0} | changes))


def named_value(name=b"RNG3", value=812.5, boot_ms=61_250):
    return mavlink.MAVLink_named_value_float_message(boot_ms, name, value)


def debug_vect(name=b"RNG3", time_usec=61_250_000, x=812.5, y=0.25, z=80.0):
    return mavlink.MAVLink_debug_vect_message(name, time_usec, x, y, z)


A_RANGE = PeerRange(
    sysid=1,
    received_at_s=NOW_S,
    peer_sysid=3,
    range_m=812.5,
    sigma_m=0.25,
    measured_at_s=61.25,
    time_base=TimeBase.BOOT,
    sequence=None,
    line_of_sight=None,
    device_id=0,
)


def with_changes(message, **changes):
    fields = {name: getattr(message, name) for name in message.__slots__}
    return type(message)(**(fields | changes))


EKF_FIELDS = dict.fromkeys(
    ["velocity_variance", "pos_horiz_variance", "pos_vert_variance", "compass_variance", "terrain_alt_variance"], 0.1
)
ESTIMATOR_FIELDS = dict.fromkeys(
    ["vel_ratio", "pos_horiz_ratio", "pos_vert_ratio", "mag_ratio", "hagl_ratio", "tas_ratio", "pos_horiz_accuracy"], 0.1
) | {"pos_vert_accuracy": 0.1, "time_usec": 5}
SYS_STATUS_FIELDS = dict.fromkeys(
    ["load", "voltage_battery", "current_battery", "battery_remaining", "drop_rate_comm", "errors_comm"]
    + [f"errors_count{n}" for n in range(1, 5)],
    0,
)


@pytest.mark.parametrize(
    ("sent", "expected"),
    [
        (heartbeat(base_mode=128), Heartbeat(1, NOW_S, Autopilot.ARDUPILOT, armed=True)),
        (heartbeat(autopilot=mavlink.MAV_AUTOPILOT_PX4, base_mode=127), Heartbeat(1, NOW_S, Autopilot.PX4, armed=False)),
        (heartbeat(autopilot=mavlink.MAV_AUTOPILOT_PPZ), Heartbeat(1, NOW_S, Autopilot.OTHER, armed=False)),
        (
            global_position(),
            GlobalPosition(1, NOW_S, 61.25, -35.3632621, 149.1652374, 584.19, vn_mps=15.0, ve_mps=-2.5, vd_mps=-0.3),
        ),
        (gps_raw(), GpsReceiver(1, NOW_S, 0, 6, -35.3632621, 149.1652374, 584.19, 10, 1.21, 0.3, 0.45, 0.12)),
        (
            mavlink.MAVLink_gps2_raw_message(
                UNIX_US, 3, 10, 20, 30_000, 150, 200, 0, 0, 255, 0, 0, h_acc=300, v_acc=450, vel_acc=120, alt_ellipsoid=1, yaw=9
            ),
            GpsReceiver(1, NOW_S, 1, 3, 1e-6, 2e-6, 30.0, None, 1.5, 0.3, 0.45, 0.12),
        ),
        (mavlink.MAVLink_attitude_message(61_250, 0.5, -0.25, 3.0, 1, 1, 1), Attitude(1, NOW_S, 61.25, 0.5, -0.25, 3.0)),
        (mavlink.MAVLink_vfr_hud_message(22.5, 20, 90, 50, 100, 0), Airspeed(1, NOW_S, 22.5)),
        (mavlink.MAVLink_system_time_message(UNIX_US, 61_250), SystemTime(1, NOW_S, 61.25, 1_700_000_000.25)),
        (mavlink.MAVLink_timesync_message(61_250_000_000, 2**62 + 1), TimeSyncAnswer(1, NOW_S, 2**62 + 1, 61_250_000_000)),
        (mavlink.MAVLink_system_time_message(0, 61_250), SystemTime(1, NOW_S, 61.25, None)),
        (mavlink.MAVLink_system_time_message(61_250_000, 61_250), SystemTime(1, NOW_S, 61.25, None)),
        (
            mavlink.MAVLink_sys_status_message(
                onboard_control_sensors_present=0x20,
                onboard_control_sensors_enabled=0xFFFFFFFF,
                onboard_control_sensors_health=0xFFFFFFDF,
                **SYS_STATUS_FIELDS,
            ),
            SystemHealth(1, NOW_S, gps_present=True, gps_enabled=True, gps_healthy=False),
        ),
        # The flags that ArduPlane sent 1 s before and 10 s after it lost its GPS, and each family's bit for glitches.
        (mavlink.MAVLink_ekf_status_report_message(flags=831, **EKF_FIELDS), EkfStatus(1, NOW_S, True, False, False)),
        (mavlink.MAVLink_ekf_status_report_message(flags=303, **EKF_FIELDS), EkfStatus(1, NOW_S, False, False, False)),
        (mavlink.MAVLink_ekf_status_report_message(flags=128 + 32768, **EKF_FIELDS), EkfStatus(1, NOW_S, False, True, True)),
        (mavlink.MAVLink_ekf_status_report_message(flags=1024, **EKF_FIELDS), EkfStatus(1, NOW_S, False, False, False)),
        (mavlink.MAVLink_estimator_status_message(flags=16 + 1024, **ESTIMATOR_FIELDS), EkfStatus(1, NOW_S, True, False, True)),
        (
            mavlink.MAVLink_estimator_status_message(flags=128 + 32768, **ESTIMATOR_FIELDS),
            EkfStatus(1, NOW_S, False, True, False),
        ),
        (peer_range(), with_changes(A_RANGE, sequence=65_535, line_of_sight=0.8, device_id=2)),
        (ranging_beacon(), with_changes(A_RANGE, sequence=200)),
        (named_value(), with_changes(A_RANGE, sigma_m=None)),
        (debug_vect(), with_changes(A_RANGE, line_of_sight=0.8)),
    ],
    ids=lambda value: getattr(value, "msgname", ""),
)
def test_message_is_decoded_in_the_cores_units(sent, expected):
    got, counts = decode(sent)
    assert type(got) is type(expected)
    for name in expected.__slots__:
        want = getattr(expected, name)
        if isinstance(want, float):
            assert getattr(got, name) == pytest.approx(want, rel=1e-7, abs=1e-12), name
        else:
            assert getattr(got, name) == want, name
    assert counts == {}


def test_a_vehicles_own_request_for_the_time_is_no_answer():
    assert decode(mavlink.MAVLink_timesync_message(0, 5)) == (None, {})


@pytest.mark.parametrize(
    ("sent", "changes"),
    [
        (gps_raw(h_acc=0, v_acc=0, vel_acc=0), {"h_acc_m": None, "v_acc_m": None, "speed_acc_mps": None}),
        (gps_raw(eph=65535, epv=65535), {"hdop": None}),
        (gps_raw(satellites_visible=255), {"satellites": None}),
        (gps_raw(fix_type=1, lat=0, lon=0, alt=0), {"fix_type": 1, "lat_deg": 0.0, "lon_deg": 0.0}),
        (gps_raw(fix_type=0, lat=2**31 - 1, lon=2**31 - 1, alt=-(2**31)), {"fix_type": 0, "lat_deg": 0.0, "lon_deg": 0.0}),
        (peer_range(range_std=0.0), {"sigma_m": None}),
        (peer_range(quality=255), {"line_of_sight": None}),
        (peer_range(quality=0), {"line_of_sight": 0.0}),
        (peer_range(time_usec=0), {"measured_at_s": None, "time_base": TimeBase.SERVICE}),
        (peer_range(time_usec=UNIX_US), {"measured_at_s": UNIX_US / 1e6, "time_base": TimeBase.UNIX}),
        (ranging_beacon(range_accuracy=0xFFFFFFFF), {"sigma_m": None}),
        (ranging_beacon(range_accuracy=0), {"sigma_m": None}),
        (named_value(boot_ms=0), {"measured_at_s": None, "time_base": TimeBase.SERVICE}),
        (named_value(name=b"RNG254"), {"peer_sysid": 254}),
        (named_value(name=b"RNG7\x00junk"), {"peer_sysid": 7}),
        (debug_vect(y=0.0, z=-1.0), {"sigma_m": None, "line_of_sight": None}),
        (debug_vect(time_usec=UNIX_US), {"time_base": TimeBase.UNIX}),
    ],
)
def test_unknown_values_and_both_time_bases_are_told_apart(sent, changes):
    got, counts = decode(sent)
    assert {name: getattr(got, name) for name in changes} == changes
    assert counts == {}


@pytest.mark.parametrize(
    ("sent", "reason"),
    [
        (global_position(lat=900_000_001), "GLOBAL_POSITION_INT.lat"),
        (global_position(lat=2_147_000_000), "GLOBAL_POSITION_INT.lat"),
        (global_position(lon=-1_800_000_001), "GLOBAL_POSITION_INT.lon"),
        (global_position(lat=0, lon=0), "GLOBAL_POSITION_INT.lat_lon_zero"),
        (global_position(alt=-1_000_001), "GLOBAL_POSITION_INT.alt"),
        (global_position(alt=100_000_001), "GLOBAL_POSITION_INT.alt"),
        (gps_raw(lat=0, lon=0), "GPS_RAW_INT.lat_lon_zero"),
        (gps_raw(fix_type=9), "GPS_RAW_INT.fix_type"),
        (gps_raw(fix_type=2, lat=-900_000_001), "GPS_RAW_INT.lat"),
        (gps_raw(alt=2**31 - 1), "GPS_RAW_INT.alt"),
        (mavlink.MAVLink_attitude_message(0, math.nan, 0, 0, 0, 0, 0), "ATTITUDE.roll"),
        (mavlink.MAVLink_attitude_message(0, 0, math.inf, 0, 0, 0, 0), "ATTITUDE.pitch"),
        (mavlink.MAVLink_attitude_message(0, 0, 0, 350.0, 0, 0, 0), "ATTITUDE.yaw"),
        (mavlink.MAVLink_vfr_hud_message(-1.0, 20, 90, 50, 100, 0), "VFR_HUD.airspeed"),
        (mavlink.MAVLink_vfr_hud_message(1001.0, 20, 90, 50, 100, 0), "VFR_HUD.airspeed"),
        (mavlink.MAVLink_vfr_hud_message(math.inf, 20, 90, 50, 100, 0), "VFR_HUD.airspeed"),
        (mavlink.MAVLink_timesync_message(-1, 5), "TIMESYNC.tc1"),
        (mavlink.MAVLink_system_time_message(2**64 - 1, 0), "SYSTEM_TIME.time_unix_usec"),
        (peer_range(range=0.0), "PEER_RANGE.range"),
        (peer_range(range=-5.0), "PEER_RANGE.range"),
        (peer_range(range=1e6), "PEER_RANGE.range"),
        (peer_range(range=math.nan), "PEER_RANGE.range"),
        (peer_range(range=math.inf), "PEER_RANGE.range"),
        (peer_range(range_std=-0.1), "PEER_RANGE.range_std"),
        (peer_range(range_std=math.nan), "PEER_RANGE.range_std"),
        (peer_range(peer_system=0), "PEER_RANGE.peer_system"),
        (peer_range(peer_system=1), "PEER_RANGE.peer_system"),
        (peer_range(quality=101), "PEER_RANGE.quality"),
        (peer_range(time_usec=2**64 - 1), "PEER_RANGE.time_usec"),
        (ranging_beacon(range=0xFFFFFFFF), "RANGING_BEACON.range"),
        (ranging_beacon(range=0), "RANGING_BEACON.range"),
        (ranging_beacon(beacon_id=1), "RANGING_BEACON.beacon_id"),
        (ranging_beacon(beacon_id=256), "RANGING_BEACON.beacon_id"),
        (named_value(name=b"RNG0"), "NAMED_VALUE_FLOAT.name"),
        (named_value(name=b"RNG1"), "NAMED_VALUE_FLOAT.name"),
        (named_value(name=b"RNG256"), "NAMED_VALUE_FLOAT.name"),
        (named_value(value=math.nan), "NAMED_VALUE_FLOAT.value"),
        (debug_vect(x=-1.0), "DEBUG_VECT.x"),
        (debug_vect(y=math.nan), "DEBUG_VECT.y"),
        (debug_vect(z=math.nan), "DEBUG_VECT.z"),
        (debug_vect(z=100.5), "DEBUG_VECT.z"),
    ],
)
def test_impossible_value_is_refused_with_message_and_field(sent, reason):
    got, counts = decode(sent)
    assert got is None
    assert counts == {f"invalid_value:{reason}": 1}


@pytest.mark.parametrize(
    "sent",
    [
        heartbeat(autopilot=mavlink.MAV_AUTOPILOT_INVALID),
        heartbeat(kind=mavlink.MAV_TYPE_GCS, autopilot=mavlink.MAV_AUTOPILOT_GENERIC),
        heartbeat(kind=mavlink.MAV_TYPE_ONBOARD_CONTROLLER, autopilot=mavlink.MAV_AUTOPILOT_GENERIC),
        heartbeat(kind=mavlink.MAV_TYPE_GIMBAL, autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA),
        heartbeat(kind=mavlink.MAV_TYPE_ADSB, autopilot=mavlink.MAV_AUTOPILOT_GENERIC),
        mavlink.MAVLink_vfr_hud_message(math.nan, 20, 90, 50, 100, 0),
        named_value(name=b"volt"),
        named_value(name=b"RNG"),
        named_value(name=b"RNGx"),
        named_value(name=b"xRNG3"),
        debug_vect(name=b"\xff\xfe\x00\x00"),
    ],
)
def test_message_that_holds_nothing_for_the_core(sent):
    assert decode(sent) == (None, {})


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


@pytest.mark.parametrize("version_1", [False, True])
def test_fields_left_off_the_wire_are_zero(version_1):
    """MAVLink 2 cuts off trailing zeros, MAVLink 1 knows no extension fields."""
    sent = gps_raw(satellites_visible=0, h_acc=0, v_acc=0, vel_acc=0)
    if version_1:
        sent.unpacker = type("BaseFields", (), {"pack": staticmethod(lambda *values: type(sent).unpacker.pack(*values)[:30])})
    got, counts = decode(sent, force_mavlink1=version_1)
    assert (got.satellites, got.h_acc_m, got.fix_type) == (0, None, 6)
    assert counts == {}


def test_fields_that_a_newer_definition_adds_are_passed_over():
    sent = heartbeat()
    sent.unpacker = type("Longer", (), {"pack": staticmethod(lambda *values: type(sent).unpacker.pack(*values) + b"\x07\x07")})
    assert decode(sent)[0] == Heartbeat(1, NOW_S, Autopilot.ARDUPILOT, armed=False)


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
