"""The bytes on the wire: hand-packed frames against an independent unpacking and pymavlink's own generator."""

from __future__ import annotations

import math
import struct
from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.generator import mavparse

from sitl_fakes.fleet import Fleet
from sitl_fakes.scenario import SCENARIOS, load_scenario
from sitl_fakes.wire import peer_range_frame, ranging_beacon
from tests.unit.sitl_fakes.fakes_support import parse, scenario

DEFINITION = """<?xml version="1.0"?><mavlink><version>1</version><dialect>0</dialect><messages>
<message id="513" name="RANGING_BEACON"><description>d</description>
<field type="uint64_t" name="time_usec">d</field><field type="uint8_t" name="target_system">d</field>
<field type="uint8_t" name="target_component">d</field><field type="uint16_t" name="beacon_id">d</field>
<field type="uint32_t" name="range">d</field><field type="int32_t" name="lat">d</field><field type="int32_t" name="lon">d</field>
<field type="float" name="alt">d</field><field type="uint8_t" name="alt_type">d</field>
<field type="uint32_t" name="hacc_est">d</field><field type="uint32_t" name="vacc_est">d</field>
<field type="uint16_t" name="carrier_freq">d</field><field type="uint32_t" name="range_accuracy">d</field>
<field type="uint8_t" name="sequence">d</field><field type="uint8_t" name="status">d</field></message>
<message id="181600" name="PEER_RANGE"><description>d</description>
<field type="uint64_t" name="time_usec">d</field><field type="float" name="range">d</field>
<field type="float" name="range_std">d</field><field type="uint16_t" name="sequence">d</field>
<field type="uint8_t" name="peer_system">d</field><field type="uint8_t" name="quality">d</field>
<field type="uint8_t" name="device_id">d</field></message></messages></mavlink>"""


@pytest.fixture(scope="module")
def definitions(tmp_path_factory):
    path = tmp_path_factory.mktemp("dialect") / "definition.xml"
    path.write_text(DEFINITION)
    parsed = mavparse.MAVXML(str(path), "2.0")
    return {m.id: m for m in parsed.message}


def opened(frame, extra):
    """Take a MAVLink 2 frame apart by the book: header, checksum (bit by bit), payload filled up with zeros."""
    magic, length, incompat, compat, sequence, sysid, compid = struct.unpack_from("<7B", frame)
    message_id = int.from_bytes(frame[7:10], "little")
    assert (magic, incompat, compat, len(frame)) == (0xFD, 0, 0, length + 12)
    crc = 0xFFFF
    for byte in frame[1:-2] + bytes([extra]):
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0x8408 if crc & 1 else crc >> 1
    assert int.from_bytes(frame[-2:], "little") == crc
    return message_id, sequence, sysid, compid, frame[10:-2]


def test_peer_range_is_laid_out_as_defined(definitions):
    frame = peer_range_frame(
        sysid=4, compid=1, frame_sequence=77, time_usec=123456789012, peer_system=2, range_m=1234.5, range_std_m=0.5,
        sequence=65535, quality=90, device_id=3,
    )  # fmt: skip
    message_id, sequence, sysid, compid, payload = opened(frame, definitions[181600].crc_extra)
    assert (message_id, sequence, sysid, compid, len(payload)) == (181600, 77, 4, 1, 21)
    assert [f.name for f in definitions[181600].ordered_fields] == [
        "time_usec", "range", "range_std", "sequence", "peer_system", "quality", "device_id",
    ]  # fmt: skip
    assert struct.unpack("<QffHBBB", payload) == (123456789012, 1234.5, 0.5, 65535, 2, 90, 3)


def test_trailing_zeros_of_the_payload_are_cut(definitions):
    frame = peer_range_frame(
        sysid=4, compid=1, frame_sequence=256, time_usec=1, peer_system=2, range_m=1.0, range_std_m=0.5, sequence=3, quality=0
    )
    _, sequence, _, _, payload = opened(frame, definitions[181600].crc_extra)
    assert sequence == 0
    assert len(payload) == 19
    assert struct.unpack("<QffHBBB", payload.ljust(21, b"\0")) == (1, 1.0, 0.5, 3, 2, 0, 0)


def test_ranging_beacon_is_laid_out_as_defined(definitions):
    message = ranging_beacon(time_usec=99, peer_system=2, range_m=1234.5678, range_std_m=0.25, sequence=300)
    message_id, _, _, _, payload = opened(message.pack(mavlink.MAVLink(None, 4, 1)), definitions[513].crc_extra)
    names = [f.name for f in definitions[513].ordered_fields]
    values = dict(zip(names, struct.unpack("<QIiifIIIHHBBBBB", payload.ljust(45, b"\0")), strict=True))
    assert message_id == 513
    assert math.isnan(values.pop("alt"))
    assert values == {
        "time_usec": 99, "range": 1234568, "lat": 2**31 - 1, "lon": 2**31 - 1, "hacc_est": 2**32 - 1, "vacc_est": 2**32 - 1,
        "range_accuracy": 250, "beacon_id": 2, "carrier_freq": 0, "target_system": 0, "target_component": 0, "alt_type": 0,
        "sequence": 44, "status": 0,
    }  # fmt: skip


RATES_HZ = {
    "HEARTBEAT": 1, "SYS_STATUS": 2, "SYSTEM_TIME": 1, "GPS_RAW_INT": 5, "GPS2_RAW": 5, "ATTITUDE": 10,
    "GLOBAL_POSITION_INT": 10, "VFR_HUD": 5, "EKF_STATUS_REPORT": 2, "UNKNOWN_181600": 10,
}  # fmt: skip


def test_each_message_comes_at_its_rate_and_pymavlink_reads_every_frame():
    fleet = Fleet(scenario(), 1)
    out = fleet.advance(20.0)
    messages = parse(out, sysid=1)
    for kind, rate in RATES_HZ.items():
        assert sum(m.get_type() == kind for m in messages) == pytest.approx(20 * rate, abs=1), kind
    assert {m.get_type() for m in messages} == set(RATES_HZ)
    assert {m.get_type() for m in parse(out, sysid=2)} == set(RATES_HZ) - {"UNKNOWN_181600"}
    assert {d.payload[5] for d in out if d.sysid == 1} == {1}
    sequences = [d.payload[4] for d in out if d.sysid == 1]
    assert sequences == [k % 256 for k in range(len(sequences))]


def test_what_the_messages_say_is_what_is_so():
    fleet = Fleet(scenario(wind={"speed_mps": 5.0, "from_deg": 270.0}), 1)
    fleet.advance(9.5)
    last = {m.get_type(): m for m in parse(fleet.advance(10.0), sysid=2)} | {
        m.get_type(): m for m in parse(fleet.advance(11.0), "HEARTBEAT", 2)
    }
    truth = fleet.truth()[2]
    position, beat, raw = last["GLOBAL_POSITION_INT"], last["HEARTBEAT"], last["GPS_RAW_INT"]
    assert (beat.type, beat.autopilot, beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED) == (1, 3, 128)
    east, north, up = fleet.frame.to_enu(position.lat * 1e-7, position.lon * 1e-7, position.alt * 1e-3)
    # At most 1.1 s of flight at 22 m/s passed between the message and the truth; the estimate is good to about a metre.
    assert math.dist((east, north), (truth.east_m, truth.north_m)) < 1.1 * 30.0
    assert up == pytest.approx(truth.up_m, abs=2.0)
    assert position.relative_alt == pytest.approx(200_000, abs=2000)
    assert position.vx / 100.0 == pytest.approx(truth.vn_mps, abs=1.0)
    assert position.vy / 100.0 == pytest.approx(truth.ve_mps, abs=1.0)
    assert raw.alt_ellipsoid - raw.alt == 48_000
    assert (raw.fix_type, raw.satellites_visible, raw.h_acc, raw.v_acc, raw.vel_acc) == (6, 10, 500, 500, 100)
    assert raw.vel / 100.0 == pytest.approx(math.hypot(truth.vn_mps, truth.ve_mps), abs=0.5)
    assert last["VFR_HUD"].groundspeed == pytest.approx(math.hypot(truth.vn_mps, truth.ve_mps), abs=1.0)
    assert last["VFR_HUD"].airspeed == pytest.approx(22.0, abs=3.0)
    assert last["ATTITUDE"].roll == pytest.approx(truth.roll_rad, abs=0.2)
    assert (last["GPS2_RAW"].fix_type, last["GPS2_RAW"].eph) == (1, 65535)


def test_the_clocks_are_the_vehicles_own():
    vehicles = [{"sysid": 1, "waypoints": [[0, 0], [0, 1e4]], "boot_offset_s": 1000.0, "clock_drift_ppm": 50.0, "ranges_to": []}]
    fleet = Fleet(scenario(vehicle=vehicles), 1, unix_epoch_s=1_800_000_000.0)
    out = fleet.advance(100.0)
    last = parse(out, "SYSTEM_TIME")[-1]
    at_s = last.time_unix_usec * 1e-6 - 1_800_000_000.0
    assert 98.9 < at_s <= 100.0
    assert last.time_boot_ms * 1e-3 - 1000.0 == pytest.approx(at_s * (1.0 + 50e-6), abs=2e-3)


@pytest.mark.parametrize("seed", [1, 2])
def test_ranges_are_measured_between_the_true_positions(seed):
    ranging = {"sigma_m": 0.5}
    fleet = Fleet(scenario(ranging=ranging), seed)
    errors = []
    for k in range(1, 101):
        out = fleet.advance(k * 0.1 - 0.1)
        frames = [d.payload for d in out if d.payload[7:10] == (181600).to_bytes(3, "little")]
        one, two = fleet.truth()[1], fleet.truth()[2]
        true_m = math.dist((one.east_m, one.north_m, one.up_m), (two.east_m, two.north_m, two.up_m))
        for frame in frames:
            time_usec, measured, sigma, _, peer, quality, _ = struct.unpack("<QffHBBB", frame[10:-2].ljust(21, b"\0"))
            assert (peer, quality, sigma) == (2, 255, 0.5)
            assert time_usec > 0
            errors.append(measured - true_m)
    # 100 draws of sigma 0.5: four standard errors of mean and of sigma.
    assert abs(sum(errors) / len(errors)) < 4 * 0.05
    assert 0.35 < math.sqrt(sum(e * e for e in errors) / len(errors)) < 0.65
    assert len(errors) == 100


def test_the_other_range_formats():
    beacons = Fleet(scenario(ranging={"message": "ranging_beacon", "time_base": "unix"}), 1, unix_epoch_s=1.8e9).advance(1.0)
    frames = [d.payload for d in beacons if d.payload[7:10] == (513).to_bytes(3, "little")]
    assert len(frames) == 11
    time_usec, range_mm = struct.unpack_from("<QI", frames[5], 10)
    assert time_usec == 1_800_000_000_500_000
    assert range_mm == pytest.approx(1_005_000, abs=3000)
    named = parse(Fleet(scenario(ranging={"message": "named_value"}), 1).advance(1.0), "NAMED_VALUE_FLOAT")
    assert len(named) == 11
    assert {m.name for m in named} == {"RNG2"}
    assert named[0].value == pytest.approx(1005.0, abs=3.0)


def test_raw_positions_carry_the_receivers_own_white_noise_and_filtered_ones_do_not():
    """Table 1's set-up: 15 m of white noise on each report. 40 s at 10 Hz: sigma known to 3.5 %, checked to four of those."""
    sigma = {}
    for mode in ("raw", "filtered"):
        gps = {"rate_hz": 10.0, "sigma_h_m": 15.0, "sigma_v_m": 15.0, "sigma_velocity_mps": 0.5, "correlation_time_s": 0.0}
        vehicles = [{"sysid": 1, "waypoints": [[0, 0], [0, 20000]], "params": {"EK3_GPS_CHECK": 23}}]
        fleet = Fleet(scenario(vehicle=vehicles, gps=gps, global_position=mode), 7)
        fleet.advance(10.0)
        errors = []
        for k in range(1, 2001):
            for m in parse(fleet.advance(10.0 + 0.02 * k), "GLOBAL_POSITION_INT", 1):
                t = fleet.truth()[1]
                east, north, _ = fleet.frame.to_enu(m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3)
                errors.append((east - t.east_m, north - t.north_m))
        assert len(errors) == 400
        flat = [x for pair in errors for x in pair]
        sigma[mode] = math.sqrt(sum(x * x for x in flat) / len(flat))
        lag = sum(a[0] * b[0] for a, b in pairwise(errors)) / sum(a[0] ** 2 for a in errors)
        assert (abs(lag) < 0.2) == (mode == "raw")
    assert sigma["raw"] == pytest.approx(15.0, rel=0.14)
    assert sigma["filtered"] < 5.0


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others():
    path = SCENARIOS / "uwb.toml"

    def bytes_of(seed, chunks):
        fleet = Fleet(load_scenario(path), seed)
        return [(d.sysid, d.due_s, d.payload) for end in chunks for d in fleet.advance(end)]

    once = bytes_of(3, [10.0])
    assert once == bytes_of(3, [0.5 * k for k in range(1, 21)])
    assert once != bytes_of(4, [10.0])
