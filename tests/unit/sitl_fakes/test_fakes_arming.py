"""Arming with an injected second receiver: refused in ArduPilot's words until the stream is there, even and near the first."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fakes.fleet import Fleet
from tests.unit.sitl_fakes.fakes_support import GroundStation, aid, lost, parse, scenario

ARM = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
DISARM = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, 0, 0, 0, 0, 0, 0)


def standing(*faults, **of_vehicle):
    vehicle = {"sysid": 1, "waypoints": [[0, 0], [0, 20000]], "armed": False, **of_vehicle}
    fleet = Fleet(scenario(vehicle=[vehicle], fault=list(faults)), 1)
    fleet.advance(2.0)
    return fleet


def answer(fleet, command):
    """The result and the words of what the vehicle says to a command; a long text comes in several pieces."""
    fleet.deliver(1, GroundStation().pack(command), fleet.now_s)
    out = fleet.advance(fleet.now_s + 0.04)
    return [m.result for m in parse(out, "COMMAND_ACK")], "".join(m.text for m in parse(out, "STATUSTEXT"))


def test_an_unarmed_vehicle_stands_still_until_it_is_armed_and_then_flies():
    fleet = standing(params={"GPS2_TYPE": 0})
    before = fleet.truth()[1]
    assert (before.east_m, before.north_m, before.vn_mps) == (0.0, 0.0, 0.0)
    assert not parse(fleet.advance(4.0), "HEARTBEAT")[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert answer(fleet, ARM) == ([mavlink.MAV_RESULT_ACCEPTED], "")
    assert parse(fleet.advance(24.0), "HEARTBEAT")[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert fleet.truth()[1].north_m == pytest.approx(20.0 * 22.0, rel=0.1)
    assert answer(fleet, DISARM) == ([mavlink.MAV_RESULT_FAILED], "")


def test_a_second_receiver_that_nobody_feeds_forbids_arming():
    fleet = standing()
    assert answer(fleet, ARM) == ([mavlink.MAV_RESULT_FAILED], "Arm: GPS 2: Bad fix")
    assert answer(fleet, DISARM) == ([mavlink.MAV_RESULT_ACCEPTED], "")


def test_a_stream_that_is_steady_and_near_the_first_receiver_allows_arming():
    fleet = standing()
    aid(fleet, 1, 2.0, 12.5)
    assert answer(fleet, ARM) == ([mavlink.MAV_RESULT_ACCEPTED], "")


def test_a_stream_that_has_just_begun_or_begun_again_does_not_allow_arming_for_ten_seconds():
    fleet, refused = standing(), ([mavlink.MAV_RESULT_FAILED], "Arm: GPS 2: not healthy")
    aid(fleet, 1, 2.0, 11.8)
    assert answer(fleet, ARM) == refused
    fleet.advance(20.0)
    aid(fleet, 1, 20.0, 29.8)
    assert answer(fleet, ARM) == refused
    aid(fleet, 1, fleet.now_s, 30.5)
    assert answer(fleet, ARM) == ([mavlink.MAV_RESULT_ACCEPTED], "")


@pytest.mark.parametrize(
    ("interval_s", "shift_east_m", "words"),
    [(0.3, 0.0, "Arm: GPS 2: not healthy"), (0.1, 95.0, "Arm: GPS positions differ by 9"), (0.1, 45.0, "")],
)
def test_a_stream_too_seldom_or_too_far_off_forbids_arming(interval_s, shift_east_m, words):
    fleet = standing()
    aid(fleet, 1, 2.0, 14.0, interval_s, shift_east_m=shift_east_m)
    results, text = answer(fleet, ARM)
    assert results == [mavlink.MAV_RESULT_FAILED if words else mavlink.MAV_RESULT_ACCEPTED]
    assert text.startswith(words)
    assert bool(text) == bool(words)


def test_px4_arms_once_it_has_a_position():
    assert answer(standing(autopilot="px4"), ARM) == ([mavlink.MAV_RESULT_ACCEPTED], "")
    refused = answer(standing(lost(1, 0.0), autopilot="px4"), ARM)
    assert refused == ([mavlink.MAV_RESULT_TEMPORARILY_REJECTED], "Arming denied: Resolve system health failures first")
