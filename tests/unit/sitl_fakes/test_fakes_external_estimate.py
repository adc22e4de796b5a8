"""MAV_CMD_EXTERNAL_POSITION_ESTIMATE as ArduPilot takes it: when, in which frame, and for which time."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fakes.fleet import Fleet
from sitl_fakes.flight_controller import OffboardClock
from tests.unit.sitl_fakes.fakes_support import GroundStation, lost, parse, scenario


def estimate(fleet, *, z=math.nan, frame=0, shift_m=0.0, sent_s=0.0, worked_s=0.0):
    truth = fleet.truth()[1]
    lat, lon, _ = fleet.frame.to_lla(truth.east_m + shift_m, truth.north_m, truth.up_m)
    place = (round(lat * 1e7), round(lon * 1e7), z)
    return mavlink.MAVLink_command_int_message(1, 1, frame, 43003, 0, 0, sent_s, worked_s, 20.0, 0, *place)


def result(fleet, message):
    fleet.deliver(1, GroundStation().pack(message), fleet.now_s)
    return parse(fleet.advance(fleet.now_s + 0.02), "COMMAND_ACK", 1)[0].result


def dead_reckoning(at_s=40.0):
    fleet = Fleet(scenario(fault=[lost(1, 5.0)]), 1)
    fleet.advance(at_s)
    return fleet


def test_it_fails_while_gps_is_good_and_before_there_ever_was_a_position():
    fleet = dead_reckoning(4.0)
    assert result(fleet, estimate(fleet)) == mavlink.MAV_RESULT_FAILED
    never = Fleet(scenario(fault=[lost(1, 0.0)]), 1)
    never.advance(20.0)
    assert never.truth()[1].source == "none"
    assert result(never, estimate(never)) == mavlink.MAV_RESULT_FAILED


@pytest.mark.parametrize(("z", "frame"), [(100.0, 0), (0.0, 0), (math.nan, mavlink.MAV_FRAME_LOCAL_NED)])
def test_it_is_denied_with_an_altitude_or_in_a_frame_that_is_not_global(z, frame):
    fleet = dead_reckoning()
    assert result(fleet, estimate(fleet, z=z, frame=frame)) == mavlink.MAV_RESULT_DENIED


def test_an_estimate_that_took_a_second_to_work_out_is_brought_forward_by_it():
    fleet = dead_reckoning()
    assert result(fleet, estimate(fleet, worked_s=1.0)) == mavlink.MAV_RESULT_ACCEPTED
    truth = fleet.truth()[1]
    # North at 22 m/s: what is stated for a second ago is true of now, so it comes out a second's flight ahead.
    assert truth.estimate_north_m - truth.north_m == pytest.approx(22.0, abs=2.0)


def test_it_may_be_repeated_and_brings_a_drift_back_each_time():
    fleet = dead_reckoning()
    for at_s in (40.0, 41.0, 42.0):
        fleet.advance(at_s)
        assert result(fleet, estimate(fleet, sent_s=at_s)) == mavlink.MAV_RESULT_ACCEPTED
        truth = fleet.truth()[1]
        assert math.hypot(truth.estimate_east_m - truth.east_m, truth.estimate_north_m - truth.north_m) < 1.0


def test_a_message_that_was_held_up_is_known_to_be_late_by_the_quickest_before_it():
    clock = OffboardClock()
    assert clock.to_local_s(1000.0, 5.02) == pytest.approx(5.02)
    assert clock.to_local_s(1001.0, 6.3) == pytest.approx(6.02)
    assert clock.to_local_s(1002.0, 7.01) == pytest.approx(7.01)
    assert clock.to_local_s(1003.0, 9.0) == pytest.approx(8.5)
