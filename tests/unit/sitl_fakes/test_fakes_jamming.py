"""A jammed receiver beside a good injected one, as measured on ArduPilot's SITL: which one is flown on decides everything."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fakes.fleet import Fleet
from tests.unit.sitl_fakes.fakes_support import GroundStation, aid, error_m, parse, scenario

JAMMED = {"kind": "gps_jammed", "vehicle": 1, "at_s": 5.0}


def flown(primary, until_s=65.0):
    fleet = Fleet(scenario(fault=[JAMMED]), 1)
    fleet.advance(4.0)
    set_param(fleet, "GPS_PRIMARY", primary)
    return fleet, aid(fleet, 1, 4.1, until_s)


def set_param(fleet, name, value):
    fleet.deliver(1, GroundStation().pack(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, 2)), fleet.now_s)
    (done,) = parse(fleet.advance(fleet.now_s + 0.04), "PARAM_VALUE", 1)
    assert (done.param_id, done.param_value) == (name, value)


def test_the_autopilot_goes_back_to_the_jammed_receiver_and_is_taken_off_although_good_aid_is_there():
    fleet, out = flown(0)
    assert {m.fix_type for m in parse(out, "GPS_RAW_INT", 1)} == {1, 6}
    assert {m.fix_type for m in parse(out, "GPS2_RAW", 1)[10:]} == {3}
    aided = [error_m(fleet)]
    for _ in range(20):
        aid(fleet, 1, fleet.now_s, fleet.now_s + 0.5)
        aided.append(error_m(fleet))
    assert max(aided) > 200.0


def test_gps_primary_switched_live_brings_it_back_within_half_a_second():
    fleet, _ = flown(0)
    set_param(fleet, "GPS_PRIMARY", 1)
    aid(fleet, 1, fleet.now_s, fleet.now_s + 0.5)
    for _ in range(40):
        aid(fleet, 1, fleet.now_s, fleet.now_s + 0.5)
        # Aid of exact positions: what is left is the autopilot's own noise.
        assert error_m(fleet) < 8.0


@pytest.mark.parametrize("switch", [0, 4])
def test_with_the_injected_receiver_as_primary_jamming_does_no_harm(switch):
    fleet = Fleet(scenario(fault=[JAMMED]), 1)
    fleet.advance(4.0)
    set_param(fleet, "GPS_AUTO_SWITCH", switch)
    set_param(fleet, "GPS_PRIMARY", 1)
    for _ in range(60):
        aid(fleet, 1, fleet.now_s, fleet.now_s + 1.0)
        assert error_m(fleet) < 8.0


def test_gps2_type_set_live_lets_the_stream_in_within_half_a_second():
    vehicles = [{"sysid": 1, "waypoints": [[0, 0], [0, 20000]], "params": {"GPS2_TYPE": 0}, "ranges_to": []}]
    fleet = Fleet(scenario(vehicle=vehicles, fault=[{"kind": "gps_lost", "vehicle": 1, "at_s": 5.0}]), 1)
    fleet.advance(5.0)
    out = aid(fleet, 1, 5.0, 40.0)
    assert parse(out, "GPS2_RAW") == []
    assert fleet.truth()[1].source == "dead_reckoning"
    set_param(fleet, "GPS2_TYPE", 14)
    out = aid(fleet, 1, fleet.now_s, fleet.now_s + 0.5)
    assert fleet.truth()[1].source == "gps2 injected"
    assert parse(out, "GPS2_RAW")[-1].fix_type == 3
    assert error_m(fleet) < 3.0
