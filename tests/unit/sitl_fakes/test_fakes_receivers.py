"""What the autopilot takes of GPS_INPUT: each of ArduPilot's gates refuses alone, and the rest of the driver's ways."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from sitl_fakes.fleet import Fleet
from tests.unit.sitl_fakes.fakes_support import EXACT, GroundStation, aid, ekf_uses_a_position, gps_input, lost, parse, scenario

IGNORE_ALT, IGNORE_VEL_HORIZ, IGNORE_VEL_VERT, IGNORE_ACCURACIES = 1, 8, 16, 32 | 64 | 128


TO_ALIGN_ANEW_S = 16.0
"""EKF3 checks a receiver again when it has used none for 10 s."""


def flown(params=None, from_s=6.0, until_s=12.0, **message):
    """Vehicle 1 loses its GPS at 5 s and is sent GPS_INPUT from a time on; returns the fleet and what it said."""
    vehicles = [{"sysid": 1, "waypoints": [[0, 0], [0, 20000]], "params": params or {}, "ranges_to": []}]
    fleet = Fleet(scenario(vehicle=vehicles, fault=[lost(1)], dead_reckoning=EXACT), 1)
    out = fleet.advance(from_s) + aid(fleet, 1, from_s, until_s, **message)
    return fleet, out


def test_good_gps_input_is_taken_after_the_loss():
    fleet, out = flown()
    assert fleet.truth()[1].source == "gps2 injected"
    assert fleet.truth()[1].aid_refusal is None
    last = parse(out, "GPS2_RAW", 1)[-1]
    assert (last.fix_type, last.satellites_visible, last.h_acc, last.v_acc, last.vel_acc) == (3, 7, 2000, 3000, 500)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        ({"fix_type": 2}, "no 3D fix"),
        ({"gps_id": 0}, "no 3D fix"),
        ({"gps_id": 2}, "no 3D fix"),
        ({"satellites_visible": 5}, "too few satellites"),
        ({"hdop": 2.6}, "HDOP too high"),
        ({"ignore_flags": 2}, "HDOP too high"),
        ({"speed_accuracy": 1.6}, "speed accuracy too coarse"),
        ({"horiz_accuracy": 7.6}, "horizontal accuracy too coarse"),
        ({"vert_accuracy": 11.3}, "vertical accuracy too coarse"),
        ({"interval_s": 0.22}, "messages too seldom"),
        ({"lat": 2147483647}, "no 3D fix"),
        ({"vn": math.nan}, "no 3D fix"),
    ],
)
def test_each_gate_alone_refuses(message, reason):
    fleet, out = flown(from_s=TO_ALIGN_ANEW_S, until_s=30.0, **message)
    assert not ekf_uses_a_position(out, 1)
    assert fleet.truth()[1].aid_refusal == reason
    # A 3D fix that EKF3 refuses is flown by without it.
    assert fleet.truth()[1].source == ("dead_reckoning" if reason == "no 3D fix" else "gps2 injected")


@pytest.mark.parametrize(
    "message",
    [
        {"satellites_visible": 6},
        {"hdop": 2.4},
        {"speed_accuracy": 1.4},
        {"horiz_accuracy": 7.4},
        {"vert_accuracy": 11.2},
        {"interval_s": 0.2},
        {"fix_type": 4},
        {"ignore_flags": IGNORE_ACCURACIES, "horiz_accuracy": 99.0, "vert_accuracy": 99.0, "speed_accuracy": 99.0},
    ],
)
def test_just_inside_each_gate_is_taken(message):
    fleet, out = flown(from_s=TO_ALIGN_ANEW_S, until_s=30.0, **message)
    assert ekf_uses_a_position(out, 1)
    assert fleet.truth()[1].source == "gps2 injected"


@pytest.mark.parametrize(
    ("params", "message", "taken"),
    [
        ({"EK3_GPS_CHECK": 23}, {"horiz_accuracy": 30.0, "vert_accuracy": 30.0}, True),
        ({"EK3_GPS_CHECK": 23}, {"speed_accuracy": 1.6}, False),
        ({"EK3_GPS_CHECK": 30}, {"satellites_visible": 4}, True),
        ({"EK3_GPS_CHECK": 29}, {"hdop": 5.0}, True),
        ({"EK3_GPS_CHECK": 27}, {"speed_accuracy": 3.0}, True),
        ({"EK3_CHECK_SCALE": 100}, {"horiz_accuracy": 6.0}, False),
        ({"EK3_CHECK_SCALE": 200}, {"horiz_accuracy": 9.9, "speed_accuracy": 1.9, "vert_accuracy": 14.9}, True),
        ({"GPS2_TYPE": 0}, {}, False),
        ({"GPS2_TYPE": 1}, {}, False),
        ({"GPS_AUTO_SWITCH": 0}, {}, False),
        ({"GPS_AUTO_SWITCH": 0, "GPS_PRIMARY": 1}, {}, True),
        ({"GPS_AUTO_SWITCH": 1}, {}, True),
        ({"GPS1_TYPE": 14, "GPS2_TYPE": 0, "GPS_AUTO_SWITCH": 0}, {"gps_id": 0}, True),
        ({"MAV_OPTIONS": 1}, {}, True),
        ({"MAV_OPTIONS": 1, "MAV_GCS_SYSID": 254}, {}, False),
    ],
)
def test_the_parameters_decide(params, message, taken):
    fleet, out = flown(params=params, from_s=TO_ALIGN_ANEW_S, until_s=22.0, **message)
    assert ekf_uses_a_position(out, 1) == taken
    refused_by_ekf = not taken and any(name.startswith("EK3_") for name in params)
    assert fleet.truth()[1].source.endswith("injected") == (taken or refused_by_ekf)


def test_with_auto_switch_4_a_healthy_receiver_is_kept_and_with_1_a_better_looking_one_captures_the_plane():
    for switch, source in ((4, "gps1"), (1, "gps2 injected")):
        vehicles = [{"sysid": 1, "waypoints": [[0, 0], [0, 20000]], "params": {"GPS_AUTO_SWITCH": switch}}]
        fleet = Fleet(scenario(vehicle=vehicles), 1)
        fleet.advance(5.0)
        aid(fleet, 1, 5.0, 18.0, fix_type=6, satellites_visible=12, shift_east_m=150.0)
        assert fleet.truth()[1].source == source


def test_a_stopped_stream_lingers_for_four_seconds_and_then_the_plane_dead_reckons():
    fleet, _ = flown()
    out = fleet.advance(12.9)
    assert fleet.truth()[1].source == "gps2 injected"
    out += fleet.advance(18.0)
    fixes = [m.fix_type for m in parse(out, "GPS2_RAW", 1)]
    assert fixes.count(3) == pytest.approx(20, abs=1)
    assert fixes[-5:] == [1] * 5
    assert fleet.truth()[1].source == "dead_reckoning"


def test_a_jittered_stream_of_fresh_messages_stays_healthy_and_one_that_stutters_does_not():
    fleet, _ = flown()
    gcs, at = GroundStation(), 12.0
    for interval in np.tile([0.02, 0.18], 10):
        at += float(interval)
        fleet.advance(at)
        fleet.deliver(1, gcs.pack(gps_input(fleet, 1)), at)
    fleet.advance(at + 0.1)
    assert fleet.truth()[1].aid_refusal is None
    for _ in range(3):
        at += 0.3
        fleet.advance(at)
        fleet.deliver(1, gcs.pack(gps_input(fleet, 1)), at)
    fleet.advance(at + 0.1)
    assert fleet.truth()[1].aid_refusal == "messages too seldom"


def along_error_m(fleet):
    t = fleet.truth()[1]
    return t.estimate_north_m - t.north_m


def test_the_data_are_taken_to_be_a_tenth_of_a_second_old():
    """22 m/s northwards: data that are true now, not 0.1 s ago, put the aircraft 2.2 m ahead of itself."""
    fleet, _ = flown()
    assert abs(along_error_m(fleet)) < 1.0
    gcs = GroundStation()
    for k in range(1, 151):
        at = 12.0 + 0.1 * k
        fleet.advance(at)
        t = fleet.truth()[1]
        lat, lon, _ = fleet.frame.to_lla(t.east_m, t.north_m, t.up_m)
        fleet.deliver(1, gcs.pack(gps_input(fleet, 1, lat=round(lat * 1e7), lon=round(lon * 1e7))), at)
    fleet.advance(27.02)
    assert along_error_m(fleet) == pytest.approx(2.2, abs=0.5)


def test_ignored_velocity_is_fused_as_zero_and_spoils_the_estimate():
    fleet, _ = flown(until_s=60.0, ignore_flags=IGNORE_VEL_HORIZ | IGNORE_VEL_VERT)
    t = fleet.truth()[1]
    assert math.hypot(t.estimate_east_m - t.east_m, t.estimate_north_m - t.north_m) > 10.0


def test_ignored_altitude_is_zero_in_gps2_raw():
    _, out = flown(ignore_flags=IGNORE_ALT)
    assert parse(out, "GPS2_RAW", 1)[-1].alt == 0


def test_a_step_of_the_position_is_refused_then_flown_by_without_ekf3_and_then_taken_over():
    fleet, _ = flown()
    off_m, texts = [], []
    for begin_s, end_s in pairwise((12.0, 14.0, 21.0, 24.0)):
        out = aid(fleet, 1, begin_s, end_s, shift_east_m=334.0)
        t = fleet.truth()[1]
        off_m.append(t.estimate_east_m - t.east_m)
        texts.append([m.text for m in parse(out, "STATUSTEXT", 1)])
    assert abs(off_m[0]) < 10.0
    assert min(off_m[1:]) > 250.0
    assert texts[1:] == [["AHRS: DCM active"], ["AHRS: EKF3 active"]]
