"""What real ArduPlanes did with the service in the loop (4.7-dev, EKF3, SITL), and the fakes do as well."""

from __future__ import annotations

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fakes.fleet import STEP_S, Fleet
from tests.unit.sitl_fakes.fakes_support import (
    EXACT,
    GroundStation,
    aid,
    ekf_uses_a_position,
    error_m,
    gps_input,
    lost,
    parse,
    scenario,
)

IGNORE_VD = mavlink.GPS_INPUT_IGNORE_FLAG_VEL_VERT
STRAIGHT = {"sysid": 1, "waypoints": [[0, 0], [0, 90000]], "ranges_to": []}
LOST_S, ENDS_S = 5.0, 65.0


def aided(*, climb_mps=0.0, ignore_flags=0, **params):
    """A vehicle without GPS, in exact air data, aided with a vertical velocity that is off; its last messages."""
    table = {"vehicle": [{**STRAIGHT, "params": params}], "fault": [lost(1, LOST_S)], "dead_reckoning": EXACT}
    fleet = Fleet(scenario(**table), 1)
    gcs = GroundStation()
    fleet.deliver(1, gcs.pack(interval(mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE, 10.0)), 0.0)
    out = fleet.advance(LOST_S)
    for k in range(int((ENDS_S - LOST_S) / 0.1)):
        out += fleet.advance(LOST_S + 0.1 * k)
        vd = -(fleet.truth()[1].vu_mps + climb_mps)
        fleet.deliver(1, gcs.pack(gps_input(fleet, 1, vd=vd, ignore_flags=ignore_flags)), fleet.now_s)
    return fleet, out


def interval(message_id, rate_hz):
    set_interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    return mavlink.MAVLink_command_long_message(1, 1, set_interval, 0, message_id, 1e6 / rate_hz, 0, 0, 0, 0, 0)


def barometric_m(message):
    """Altitude of a SCALED_PRESSURE in the standard atmosphere, m."""
    return 44330.77 * (1.0 - (message.press_abs / 1013.25) ** (1.0 / 5.25588))


def test_a_vertical_velocity_moves_its_height_and_the_echo_of_it_but_not_the_barometer():
    fleet, out = aided(climb_mps=0.5)
    echoed_m = parse(out, "GLOBAL_POSITION_INT", 1)[-1].alt / 1e3
    barometer_m = barometric_m(parse(out, "SCALED_PRESSURE", 1)[-1])
    true_m = fleet.truth()[1].alt_msl_m
    assert barometer_m == pytest.approx(true_m, abs=0.1)
    assert echoed_m - true_m == pytest.approx(0.5 * 5.0, abs=0.3)  # the error times the time in which it leans on the barometer
    assert true_m < 600.0 - 2.0  # it holds the height that it believes, and flies lower by as much


@pytest.mark.parametrize(
    ("ignore_flags", "velz"), [(IGNORE_VD, 3), (0, 0)], ids=["the message says to ignore it", "EK3_SRC1_VELZ=0"]
)
def test_a_vertical_velocity_that_is_not_fused_does_nothing(ignore_flags, velz):
    fleet, out = aided(climb_mps=0.5, ignore_flags=ignore_flags, EK3_SRC1_VELZ=velz)
    assert parse(out, "GLOBAL_POSITION_INT", 1)[-1].alt / 1e3 == pytest.approx(fleet.truth()[1].alt_msl_m, abs=0.1)


def test_once_a_message_brought_a_vertical_velocity_the_flag_comes_too_late():
    table = {"vehicle": [STRAIGHT], "fault": [lost(1, LOST_S)], "dead_reckoning": EXACT}
    fleet = Fleet(scenario(**table), 1)
    fleet.advance(LOST_S)
    fleet.deliver(1, GroundStation().pack(gps_input(fleet, 1, vd=-0.5)), LOST_S)
    aid(fleet, 1, LOST_S, 40.0, vd=0.0, ignore_flags=IGNORE_VD)
    assert fleet.truth()[1].alt_msl_m < 600.0 - 2.0


def test_an_aid_whose_vertical_velocity_is_the_echo_of_its_own_height_swings_the_altitude():
    """As 0.1 flew: vd worked out of the altitude that came back, some seconds late. Real: 2.2 to 4.5 m, period 7 to 13 s."""

    def altitude_sd_m(ignore_flags):
        fleet = Fleet(scenario(vehicle=[STRAIGHT], fault=[lost(1, LOST_S)]), 1)
        gcs, climb_mps, altitudes, said_m = GroundStation(), 0.0, [], []
        fleet.advance(LOST_S)
        for k in range(1, 1500):
            said_m += [m.alt / 1e3 for m in parse(fleet.advance(LOST_S + 0.1 * k), "GLOBAL_POSITION_INT", 1)]
            if len(said_m) > 30:
                climb_mps += 0.1 * ((said_m[-1] - said_m[-20]) / 1.9 * 1.6 - climb_mps)
            fleet.deliver(1, gcs.pack(gps_input(fleet, 1, vd=-climb_mps, ignore_flags=ignore_flags)), fleet.now_s)
            altitudes.append(fleet.truth()[1].alt_msl_m)
        return float(np.std(altitudes[500:]))

    assert altitude_sd_m(0) > 2.0 * altitude_sd_m(IGNORE_VD)


@pytest.mark.parametrize(("delay_ms", "behind_s"), [(0, 0.0), (100, 0.0), (200, 0.0), (50, 0.05)])
def test_it_takes_the_data_for_no_older_than_its_buffer_of_a_tenth_of_a_second(delay_ms, behind_s):
    """Data are 0.1 s old. Where the driver announces 0.2 s (0: its default) the buffer clips it, where 0.05 s it trails."""
    vehicle = {**STRAIGHT, "params": {"GPS2_DELAY_MS": delay_ms}}
    fleet = Fleet(scenario(vehicle=[vehicle], fault=[lost(1, LOST_S)], dead_reckoning=EXACT), 1)
    fleet.advance(LOST_S)
    aid(fleet, 1, LOST_S, 40.0)
    t = fleet.truth()[1]
    assert t.north_m - t.estimate_north_m == pytest.approx(22.0 * (behind_s + STEP_S), abs=0.1)  # read at the next step


def test_it_goes_on_with_a_position_of_21_m_and_refuses_external_estimates_meanwhile():
    """The limits of EKF3 are for its alignment: 7.5 m is asked of a receiver to begin with, not of one that carries on."""
    fleet = Fleet(scenario(vehicle=[STRAIGHT], fault=[lost(1, LOST_S)]), 1)
    fleet.advance(LOST_S + 2.0)
    aid(fleet, 1, LOST_S + 2.0, 30.0, horiz_accuracy=21.0)
    assert fleet.truth()[1].source == "gps2 injected"
    late = Fleet(scenario(vehicle=[STRAIGHT], fault=[lost(1, LOST_S)]), 1)
    late.advance(LOST_S + 30.0)
    assert not ekf_uses_a_position(aid(late, 1, LOST_S + 30.0, 50.0, horiz_accuracy=21.0), 1)


def test_ranges_of_its_companion_get_through_only_where_it_forwards_what_it_does_not_know():
    def ranges(options):
        other = {"sysid": 2, "waypoints": [[500, 0], [500, 9000]]}
        vehicle = {**STRAIGHT, "ranges_to": [2], "params": {"MAV2_OPTIONS": options}}
        return parse(Fleet(scenario(vehicle=[vehicle, other]), 1).advance(5.0), "UNKNOWN_181600")

    assert ranges(0) == []
    assert len(ranges(8)) == pytest.approx(50, abs=2)


@pytest.mark.parametrize(
    ("kind", "message", "companion_link", "gets_through"),
    [
        ("px4", "peer_range", False, False),
        ("px4", "peer_range", True, True),
        ("px4", "ranging_beacon", False, True),
        ("px4", "debug_vect", False, True),
        ("ardupilot", "peer_range", True, True),
    ],
)
def test_a_px4_forwards_no_peer_range_of_its_companion_which_needs_a_link_of_its_own(kind, message, companion_link, gets_through):
    ranging = {"message": message, "companion_link": companion_link}
    params = {"MAV2_OPTIONS": 0} if kind == "ardupilot" else {}
    vehicle = {**STRAIGHT, "autopilot": kind, "ranges_to": [2], "params": params}
    other = {"sysid": 2, "waypoints": [[500, 0], [500, 9000]]}
    name = {"peer_range": "UNKNOWN_181600", "ranging_beacon": "UNKNOWN_513", "debug_vect": "DEBUG_VECT"}[message]
    got = parse(Fleet(scenario(vehicle=[vehicle, other], ranging=ranging), 1).advance(5.0), name)
    assert len(got) == (pytest.approx(50, abs=2) if gets_through else 0)


def test_a_ground_station_on_another_port_is_forwarded_by_every_vehicle():
    out = Fleet(scenario(ground_station=True), 1).advance(10.0)
    beats = [m for d in out for m in parse([d], "HEARTBEAT") if m.get_srcSystem() == 255]
    assert len(beats) == pytest.approx(20, abs=2)
    assert {m.type for m in beats} == {mavlink.MAV_TYPE_GCS}
    assert [m for m in parse(Fleet(scenario(), 1).advance(5.0), "HEARTBEAT") if m.get_srcSystem() == 255] == []


def test_without_rates_it_sends_its_heartbeat_alone_until_it_is_asked():
    rates = dict.fromkeys(("MAV1_EXTRA1", "MAV1_EXTRA2", "MAV1_EXTRA3", "MAV1_EXT_STAT", "MAV1_POSITION"), 0)
    fleet = Fleet(scenario(vehicle=[{**STRAIGHT, "params": rates}]), 1)
    assert {m.get_type() for m in parse(fleet.advance(5.0))} == {"HEARTBEAT"}
    fleet.deliver(1, GroundStation().pack(interval(mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, 5.0)), 5.0)
    assert len(parse(fleet.advance(10.0), "GPS_RAW_INT")) == pytest.approx(25, abs=1)


STEPPED = {"kind": "gps_spoofed", "vehicle": 1, "at_s": LOST_S, "until_s": 45.0, "speed_mps": 0.0, "offset_m": 200.0}


def test_a_step_of_its_receiver_is_refused_then_flown_by_after_four_seconds_and_fused_after_ten():
    """Real, after a step of 200 m: the lane switched at once, flag 32768 1.2 s later, on the receiver's fixes alone from 3.8
    to 9.9 s, at 10 s EKF3 reset to them.
    """
    fleet = Fleet(scenario(vehicle=[STRAIGHT], fault=[STEPPED], dead_reckoning=EXACT), 1)
    off, out = {}, []
    for at_s in (0.5, 1.5, 3.5, 4.5, 9.5, 10.5, 30.0):
        out += fleet.advance(LOST_S + at_s)
        off[at_s] = error_m(fleet)
    assert max(off[0.5], off[1.5], off[3.5]) < 5.0
    assert [off[at_s] for at_s in (4.5, 9.5, 10.5, 30.0)] == pytest.approx([200.0] * 4, abs=10.0)
    assert [m.text for m in parse(out, "STATUSTEXT", 1)] == ["EKF3 lane switch 1", "AHRS: DCM active", "AHRS: EKF3 active"]


def test_while_it_goes_by_its_receiver_alone_it_repeats_each_fix():
    fleet = Fleet(scenario(vehicle=[STRAIGHT], fault=[STEPPED], dead_reckoning=EXACT), 1)
    fleet.advance(LOST_S + 5.0)
    reports = parse(fleet.advance(LOST_S + 9.0), "GLOBAL_POSITION_INT", 1)
    places = [(m.lat, m.lon) for m in reports]
    assert len(places) == pytest.approx(40, abs=1)
    assert len(set(places)) == pytest.approx(20, abs=1)  # reported ten times a second, measured five times


def test_its_glitch_flag_comes_after_a_second_of_refusals_and_goes_ten_seconds_after_the_last():
    fleet = Fleet(scenario(vehicle=[STRAIGHT], fault=[STEPPED], dead_reckoning=EXACT), 1)

    def status(at_s):
        return parse(fleet.advance(LOST_S + at_s), "EKF_STATUS_REPORT", 1)[-1]

    early = status(0.9)
    assert not early.flags & mavlink.EKF_GPS_GLITCHING
    assert early.pos_horiz_variance == pytest.approx(200.0 / (5.0 * 0.7), rel=0.4)  # real: 51
    assert status(2.0).flags & mavlink.EKF_GPS_GLITCHING
    assert status(19.0).flags & mavlink.EKF_GPS_GLITCHING
    assert not status(22.0).flags & mavlink.EKF_GPS_GLITCHING


def test_a_plane_without_any_fix_does_not_fall_back_on_its_receiver():
    fleet = Fleet(scenario(vehicle=[STRAIGHT], fault=[lost(1, LOST_S)]), 1)
    texts = [m.text for m in parse(fleet.advance(60.0), "STATUSTEXT", 1)]
    assert texts == []
    assert fleet.truth()[1].source == "dead_reckoning"
