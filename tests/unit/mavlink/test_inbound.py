"""Frames packed by pymavlink's own generated code become the core's messages; impossible ones are refused with a reason."""

import math
from dataclasses import fields, replace

import pytest
from packed_messages import (
    NOW_S,
    UNIX_US,
    debug_vect,
    global_position,
    gps_raw,
    heartbeat,
    named_value,
    pack,
    peer_range,
    ranging_beacon,
)
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20 import development

from gcs_coloc.core.measurements import VehicleClass
from gcs_coloc.core.messages.inbound import (
    Airspeed,
    Attitude,
    Autopilot,
    Beacon,
    BeaconPosition,
    EkfStatus,
    GlobalOrigin,
    GlobalPosition,
    GpsReceiver,
    Heartbeat,
    Interference,
    PeerRange,
    Pressure,
    ReceiverIntegrity,
    SystemHealth,
    SystemTime,
    TimeBase,
    TimeSyncAnswer,
    VtolState,
)
from gcs_coloc.core.stations.node_id import station_node
from gcs_coloc.mavlink.decoder import Decoder


def decode(message, **kwargs):
    """The core's message of one packed message, and the counts."""
    decoder = Decoder()
    (frame,) = decoder.decode(pack(message, **kwargs), NOW_S)
    return frame.message, dict(decoder.counts)


A_RANGE = PeerRange(
    sysid=1,
    received_at_s=NOW_S,
    peer=3,
    range_m=812.5,
    sigma_m=0.25,
    measured_at_s=61.25,
    time_base=TimeBase.BOOT,
    sequence=None,
    line_of_sight=None,
    device_id=0,
)


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


def beat(
    autopilot: Autopilot, mode: str, *, armed: bool = False, vehicle_class: VehicleClass | None = VehicleClass.PLANE
) -> Heartbeat:
    winged = vehicle_class is VehicleClass.PLANE
    return Heartbeat(1, NOW_S, autopilot, armed=armed, winged=winged, mode=mode, vehicle_class=vehicle_class)


@pytest.mark.parametrize(
    ("sent", "expected"),
    [
        (heartbeat(base_mode=128), beat(Autopilot.ARDUPILOT, "MANUAL", armed=True)),
        (
            heartbeat(autopilot=mavlink.MAV_AUTOPILOT_PX4, base_mode=127),
            beat(Autopilot.PX4, "0"),
        ),
        (
            heartbeat(autopilot=mavlink.MAV_AUTOPILOT_PPZ),
            beat(Autopilot.OTHER, "0"),
        ),
        (
            heartbeat(mavlink.MAV_TYPE_QUADROTOR),
            beat(Autopilot.ARDUPILOT, "STABILIZE", vehicle_class=VehicleClass.MULTIROTOR),
        ),
        (
            heartbeat(mavlink.MAV_TYPE_GROUND_ROVER),
            beat(Autopilot.ARDUPILOT, "MANUAL", vehicle_class=VehicleClass.GROUND),
        ),
        (
            heartbeat(mavlink.MAV_TYPE_SURFACE_BOAT),
            beat(Autopilot.ARDUPILOT, "MANUAL", vehicle_class=VehicleClass.BOAT),
        ),
        (
            heartbeat(mavlink.MAV_TYPE_AIRSHIP, autopilot=mavlink.MAV_AUTOPILOT_PX4),
            beat(Autopilot.PX4, "0", vehicle_class=None),
        ),
        (mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_MC, 2), VtolState(1, NOW_S, on_rotors=True)),
        (
            mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_TRANSITION_TO_MC, 2),
            VtolState(1, NOW_S, on_rotors=True),
        ),
        (
            mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_TRANSITION_TO_FW, 2),
            VtolState(1, NOW_S, on_rotors=False),
        ),
        (mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_FW, 2), VtolState(1, NOW_S, on_rotors=False)),
        (
            heartbeat(mavlink.MAV_TYPE_VTOL_TILTROTOR),
            beat(Autopilot.ARDUPILOT, "MANUAL"),
        ),
        (
            global_position(),
            GlobalPosition(1, NOW_S, 61.25, -35.3632621, 149.1652374, 584.19, vn_mps=15.0, ve_mps=-2.5, vd_mps=-0.3),
        ),
        (
            gps_raw(),
            GpsReceiver(1, NOW_S, 0, 6, -35.3632621, 149.1652374, 584.19, 10, 1.21, 0.3, 0.45, 0.12, velocity_ne_mps=(22.0, 0.0)),
        ),
        (
            mavlink.MAVLink_gps2_raw_message(
                UNIX_US, 3, 10, 20, 30_000, 150, 200, 0, 0, 255, 0, 0, h_acc=300, v_acc=450, vel_acc=120, alt_ellipsoid=1, yaw=9
            ),
            GpsReceiver(1, NOW_S, 1, 3, 1e-6, 2e-6, 30.0, None, 1.5, 0.3, 0.45, 0.12, None, -29.999, (0.0, 0.0)),
        ),
        (
            development.MAVLink_gnss_integrity_message(1, 0, 2, 2, 3, 3, 120, 180, 255, 255, 255, 255),
            ReceiverIntegrity(1, NOW_S, 1, Interference.MITIGATED, Interference.DETECTED, raim_failed=True),
        ),
        (
            development.MAVLink_gnss_integrity_message(0, 127, 4, 0, 9, 2, 65535, 65535, 255, 255, 255, 255),
            ReceiverIntegrity(1, NOW_S, 0, Interference.UNKNOWN, Interference.UNKNOWN, raim_failed=False),
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
            SystemHealth(1, NOW_S, gps_present=True, gps_enabled=True, gps_healthy=False, battery_percent=0),
        ),
        (
            mavlink.MAVLink_sys_status_message(
                onboard_control_sensors_present=0xFFFFFFDF,
                onboard_control_sensors_enabled=0xFFFFFFDF,
                onboard_control_sensors_health=0x20,
                **SYS_STATUS_FIELDS,
            ),
            SystemHealth(1, NOW_S, gps_present=False, gps_enabled=False, gps_healthy=True, battery_percent=0),
        ),
        # The flags that ArduPlane sent 1 s before and 10 s after it lost its GPS, and each family's bit for glitches.
        (mavlink.MAVLink_ekf_status_report_message(flags=831, **EKF_FIELDS), EkfStatus(1, NOW_S, True, False, False)),
        (mavlink.MAVLink_ekf_status_report_message(flags=303, **EKF_FIELDS), EkfStatus(1, NOW_S, False, False, False)),
        (mavlink.MAVLink_ekf_status_report_message(flags=128 + 32768, **EKF_FIELDS), EkfStatus(1, NOW_S, False, True, True)),
        (mavlink.MAVLink_ekf_status_report_message(flags=1024, **EKF_FIELDS), EkfStatus(1, NOW_S, False, False, False)),
        (
            mavlink.MAVLink_estimator_status_message(flags=16 + 512 + 1024, **ESTIMATOR_FIELDS),
            EkfStatus(1, NOW_S, True, False, True, global_position_aided=True, horizontally_aided=False),
        ),
        (
            mavlink.MAVLink_estimator_status_message(flags=128 + 32768, **ESTIMATOR_FIELDS),
            EkfStatus(1, NOW_S, False, True, False, global_position_aided=False, horizontally_aided=False),
        ),
        (
            mavlink.MAVLink_scaled_pressure_message(time_boot_ms=2500, press_abs=987.5, press_diff=0.1, temperature=2150),
            Pressure(1, NOW_S, 2.5, 987.5),
        ),
        # PX4 at rest on the ground: a constant position beside an absolute one.
        (
            mavlink.MAVLink_estimator_status_message(flags=128 + 16 + 1, **ESTIMATOR_FIELDS),
            EkfStatus(1, NOW_S, True, False, False, global_position_aided=False, horizontally_aided=False),
        ),
        (
            mavlink.MAVLink_gps_global_origin_message(471234567, 85432109, 488125),
            GlobalOrigin(1, NOW_S, 47.1234567, 8.5432109, 488.125),
        ),
        (peer_range(), replace(A_RANGE, sequence=65_535, line_of_sight=0.8, device_id=2)),
        (ranging_beacon(), replace(A_RANGE, sequence=200, peer=station_node(3), beacon=Beacon(3, None))),
        (
            ranging_beacon(lat=471234567, lon=85432109, alt=488.0, alt_type=1, hacc_est=500, vacc_est=0xFFFFFFFF),
            replace(
                A_RANGE,
                sequence=200,
                peer=station_node(3),
                beacon=Beacon(3, BeaconPosition(47.1234567, 8.5432109, 488.0, True, 0.5, None)),
            ),
        ),
        (ranging_beacon(beacon_id=1), replace(A_RANGE, sequence=200, peer=station_node(1), beacon=Beacon(1, None))),
        (
            peer_range(peer_system=0, peer_type=1, peer_station=3),
            replace(A_RANGE, sequence=65_535, line_of_sight=0.8, device_id=2, peer=station_node(3)),
        ),
        (
            peer_range(peer_system=0, peer_system_id=70_000),
            replace(A_RANGE, sequence=65_535, line_of_sight=0.8, device_id=2, peer=70_000),
        ),
        (named_value(name=b"STN0"), replace(A_RANGE, sigma_m=None, peer=station_node(0))),
        (debug_vect(name=b"STN3"), replace(A_RANGE, line_of_sight=0.8, peer=station_node(3))),
        (named_value(), replace(A_RANGE, sigma_m=None)),
        (debug_vect(), replace(A_RANGE, line_of_sight=0.8)),
    ],
    ids=lambda value: getattr(value, "msgname", ""),
)
def test_message_is_decoded_in_the_cores_units(sent, expected):
    got, counts = decode(sent)
    assert type(got) is type(expected)
    for name in (field.name for field in fields(expected)):
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
        (named_value(name=b"RNG254"), {"peer": 254}),
        (named_value(name=b"RNG7\x00junk"), {"peer": 7}),
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
        (peer_range(peer_system=3, peer_system_id=70_000), "PEER_RANGE.peer_system_id"),
        (peer_range(quality=101), "PEER_RANGE.quality"),
        (peer_range(time_usec=2**64 - 1), "PEER_RANGE.time_usec"),
        (ranging_beacon(range=0xFFFFFFFF), "RANGING_BEACON.range"),
        (ranging_beacon(range=0), "RANGING_BEACON.range"),
        (ranging_beacon(lat=0, lon=0), "RANGING_BEACON.lat_lon_zero"),
        (ranging_beacon(lat=471234567), "RANGING_BEACON.lon"),
        (ranging_beacon(lat=471234567, lon=85432109, alt=math.inf), "RANGING_BEACON.alt"),
        (ranging_beacon(lat=471234567, lon=85432109, alt=488.0, alt_type=2), "RANGING_BEACON.alt_type"),
        (peer_range(peer_type=2), "PEER_RANGE.peer_type"),
        (debug_vect(name=b"STN65536"), "DEBUG_VECT.name"),
        (named_value(name=b"RNG0"), "NAMED_VALUE_FLOAT.name"),
        (named_value(name=b"RNG1"), "NAMED_VALUE_FLOAT.name"),
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
        heartbeat(kind=49, autopilot=mavlink.MAV_AUTOPILOT_GENERIC),  # a radio, which pymavlink does not know by name yet
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


PARTS = {
    *("GCS", "ONBOARD_CONTROLLER", "GIMBAL", "ADSB", "CAMERA", "CHARGING_STATION", "FLARM", "SERVO", "ODID", "BATTERY"),
    *("PARACHUTE", "LOG", "OSD", "IMU", "GPS", "WINCH", "ILLUMINATOR", "GRIPPER"),
}
"""The MAV_TYPEs that are no vehicles, by name."""
KINDS = {kind: entry.name.removeprefix("MAV_TYPE_") for kind, entry in mavlink.enums["MAV_TYPE"].items()}


@pytest.mark.parametrize("kind", [kind for kind, name in KINDS.items() if name != "ENUM_END"], ids=KINDS.get)
def test_every_type_of_vehicle_is_taken_for_one_and_no_part_is(kind):
    got, _ = decode(heartbeat(kind=kind, autopilot=mavlink.MAV_AUTOPILOT_GENERIC))
    assert (got is None) is (KINDS[kind] in PARTS)


@pytest.mark.parametrize("version_1", [False, True])
def test_fields_left_off_the_wire_are_zero(version_1):
    """MAVLink 2 cuts off trailing zeros, MAVLink 1 knows no extension fields."""
    sent = gps_raw(satellites_visible=0, h_acc=0, v_acc=0, vel_acc=0)
    if version_1:
        sent.unpacker = type("BaseFields", (), {"pack": staticmethod(lambda *values: type(sent).unpacker.pack(*values)[:30])})
    got, counts = decode(sent, force_mavlink1=version_1)
    assert (got.satellites, got.h_acc_m, got.fix_type) == (0, None, 6)
    assert counts == {}


@pytest.mark.parametrize(("target", "counts"), [(0, {}), (1, {}), (254, {}), (2, {"range_of_another": 1})])
def test_a_ranging_beacon_that_is_addressed_to_another_vehicle_is_not_its_senders_range(target, counts):
    got, counted = decode(ranging_beacon(target_system=target))
    assert (got is None) is bool(counts)
    assert counted == counts


def test_fields_that_a_newer_definition_adds_are_passed_over():
    sent = heartbeat()
    sent.unpacker = type("Longer", (), {"pack": staticmethod(lambda *values: type(sent).unpacker.pack(*values) + b"\x07\x07")})
    assert decode(sent)[0] == beat(Autopilot.ARDUPILOT, "MANUAL")
