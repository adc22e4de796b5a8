"""PX4 as a kind of vehicle: what it says of itself, what it takes from outside and what it passes over."""

from __future__ import annotations

import math
import struct

import pytest
from pydantic import ValidationError
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20 import development

from gcs_coloc.core.aiding.methods.px4_positions import px4_local_m
from gcs_coloc.core.messages.inbound import GlobalOrigin
from sitl_fakes.faults import Reboot
from sitl_fakes.fleet import Fleet
from tests.unit.sitl_fakes.fakes_support import GroundStation, aid, error_m, lost, parse, scenario


def px4(*faults, wind=None, **params):
    vehicle = {"sysid": 1, "waypoints": [[0, 0], [0, 20000]], "autopilot": "px4", "params": params}
    return Fleet(scenario(vehicle=[vehicle], fault=list(faults), wind=wind or {}), 1)


def stream_positions(fleet, from_s, to_s, *, eph_m=3.0, shift_east_m=0.0, interval_s=0.2, sensor_id=1):
    """GLOBAL_POSITION_SENSOR of the true position as it is when it arrives."""
    gcs = GroundStation()
    for k in range(1, math.floor((to_s - from_s) / interval_s + 1e-9) + 1):
        fleet.advance(from_s + k * interval_s)
        t = fleet.truth()[1]
        lat, lon, alt = fleet.frame.to_lla(t.east_m + shift_east_m, t.north_m, t.up_m)
        message = mavlink.MAVLink_global_position_sensor_message(
            1, 1, sensor_id, 12345, 0, 0, 0, round(lat * 1e7), round(lon * 1e7), math.nan, alt, eph_m, 5.0
        )
        fleet.deliver(1, gcs.pack(message), fleet.now_s)
    return fleet.advance(to_s + 0.6)  # until the next status has been sent


def ask_origin(fleet):
    request = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 49, 0, 0, 0, 0, 0, 0)
    fleet.deliver(1, GroundStation().pack(request), fleet.now_s)
    return parse(fleet.advance(fleet.now_s + 0.02), "GPS_GLOBAL_ORIGIN")


def stream_vision(fleet, from_s, to_s, *, sigma_m=3.0, shift_east_m=0.0, interval_s=0.2):
    """VISION_POSITION_ESTIMATE of the true position as it is when it arrives, by the origin that the vehicle tells."""
    gcs, [told] = GroundStation(), ask_origin(fleet)
    origin = GlobalOrigin(1, 0.0, told.latitude * 1e-7, told.longitude * 1e-7, told.altitude / 1e3)
    for k in range(1, math.floor((to_s - from_s) / interval_s + 1e-9) + 1):
        fleet.advance(from_s + k * interval_s)
        t = fleet.truth()[1]
        lat, lon, alt = fleet.frame.to_lla(t.east_m + shift_east_m, t.north_m, t.up_m)
        north_m, east_m = px4_local_m(origin, lat, lon)
        covariance = [0.0] * 21
        covariance[0] = covariance[6] = sigma_m**2
        nan = math.nan
        message = mavlink.MAVLink_vision_position_estimate_message(
            12345, north_m, east_m, origin.alt_msl_m - alt, nan, nan, nan, covariance
        )
        fleet.deliver(1, gcs.pack(message), fleet.now_s)
    return fleet.advance(to_s + 0.6)


def test_it_says_that_it_is_px4_and_sends_px4s_messages():
    out = px4().advance(5.0)
    assert {m.autopilot for m in parse(out, "HEARTBEAT")} == {mavlink.MAV_AUTOPILOT_PX4}
    assert {m.flags for m in parse(out, "ESTIMATOR_STATUS")[2:]} == {895}
    assert parse(out, "EKF_STATUS_REPORT") == []
    assert parse(out, "GPS2_RAW") == []
    assert len(parse(out, "GLOBAL_POSITION_INT")) == pytest.approx(50, abs=2)


@pytest.mark.parametrize("kind", ["gps_spoofed", "gps_jammed"])
def test_a_receiver_that_notices_says_so_in_gnss_integrity(kind):
    noticed, unnoticed = ({"vehicle": 1, "kind": kind, "at_s": 2.0, "reported": reported} for reported in (True, False))
    for fault, state in ((noticed, 3), (unnoticed, 0)):
        out = px4(fault).advance(8.0)
        frames = [m for d in out for m in development.MAVLink(None).parse_buffer(d.payload) or []]
        said = [(m.spoofing_state, m.jamming_state) for m in frames if m.get_type() == "GNSS_INTEGRITY"]
        assert len(said) == pytest.approx(8, abs=1)
        assert said[0] == (0, 0)
        assert said[-1] == ((state, 0) if kind == "gps_spoofed" else (0, state))


def test_without_gps_it_dead_reckons_says_so_and_passes_over_gps_input():
    fleet = px4(lost(1))
    fleet.advance(5.0)
    out = aid(fleet, 1, 5.0, 30.0)
    assert fleet.truth()[1].source == "dead_reckoning"
    assert not parse(out, "ESTIMATOR_STATUS")[-1].flags & mavlink.ESTIMATOR_POS_HORIZ_ABS
    assert not parse(out, "SYS_STATUS")[-1].onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_SENSOR_GPS


def use_own_gps(fleet, enable):
    command = mavlink.MAVLink_command_long_message(1, 1, 43006, 0, 0, 0, enable, math.nan, 0, 0, 0)
    fleet.deliver(1, GroundStation().pack(command), fleet.now_s)
    return [ack.result for ack in parse(fleet.advance(fleet.now_s + 0.2), "COMMAND_ACK")]


@pytest.mark.parametrize("armed", [True, False])
def test_its_own_gps_is_switched_off_and_on_by_command_and_over_a_reboot_where_it_was_disarmed(armed):
    vehicle = {"sysid": 1, "waypoints": [[0, 0], [0, 20000]], "autopilot": "px4", "armed": armed}
    fleet = Fleet(scenario(vehicle=[vehicle]), 1)
    fleet.advance(5.0)
    assert fleet.truth()[1].source == "gps1"
    assert use_own_gps(fleet, 0.0) == [mavlink.MAV_RESULT_ACCEPTED]
    fleet.advance(10.0)
    assert fleet.truth()[1].source == "dead_reckoning"
    fleet.inject(Reboot(vehicle=1, at_s=10.5))
    fleet.advance(20.0)
    assert (fleet.truth()[1].source == "gps1") == armed
    use_own_gps(fleet, 1.0)
    fleet.advance(25.0)
    assert fleet.truth()[1].source == "gps1"


def test_an_ardupilot_does_not_know_the_command():
    fleet = Fleet(scenario(vehicle=[{"sysid": 1, "waypoints": [[0, 0], [0, 20000]]}]), 1)
    fleet.advance(5.0)
    assert use_own_gps(fleet, 0.0) == [mavlink.MAV_RESULT_UNSUPPORTED]
    fleet.advance(10.0)
    assert fleet.truth()[1].source == "gps1"


def test_auxiliary_positions_keep_it_where_it_is_after_a_loss():
    alone, aided = px4(lost(1)), px4(lost(1))
    alone.advance(120.0)
    aided.advance(5.0)
    out = stream_positions(aided, 5.0, 120.0)
    assert aided.truth()[1].source == "aux global position"
    assert aided.truth()[1].aid_refusal is None
    # Exact positions of 3 m stated accuracy five times a second: well below one of them.
    assert error_m(aided) < 3.0 < error_m(alone)
    assert parse(out, "ESTIMATOR_STATUS")[-1].flags & mavlink.ESTIMATOR_POS_HORIZ_ABS


@pytest.mark.parametrize(
    ("eph_m", "ctrl", "why"), [(0.0, 1, "no auxiliary"), (math.nan, 1, "no auxiliary"), (3.0, 0, "EKF2_AGP0_CTRL is off")]
)
def test_a_position_without_accuracy_or_with_the_fusion_off_is_not_used(eph_m, ctrl, why):
    fleet = px4(lost(1), EKF2_AGP0_CTRL=ctrl)
    fleet.advance(5.0)
    stream_positions(fleet, 5.0, 15.0, eph_m=eph_m)
    assert fleet.truth()[1].source == "dead_reckoning"
    assert why in fleet.truth()[1].aid_refusal


def test_that_no_range_comes_is_said_where_ranges_are_what_it_would_navigate_on():
    fleet = px4(lost(1), EKF2_AGP0_CTRL=0, EKF2_RNGBC_CTRL=1)
    fleet.advance(15.0)
    assert fleet.truth()[1].aid_refusal == "no range to a beacon is fused"


def test_a_position_beyond_the_gate_is_refused_while_its_own_receiver_is_good_and_taken_over_when_that_is_gone():
    fleet = px4(lost(1, 20.0))
    fleet.advance(5.0)
    stream_positions(fleet, 5.0, 19.0, shift_east_m=200.0)
    assert error_m(fleet) < 3.0
    stream_positions(fleet, 19.6, 40.0, shift_east_m=200.0)
    assert error_m(fleet) == pytest.approx(200.0, abs=10.0)


VISION = {"EKF2_AGP0_CTRL": 0, "EKF2_EV_CTRL": 1}


def test_vision_positions_about_its_own_origin_keep_it_where_it_is_after_a_loss_while_they_come():
    aided = px4(lost(1), **VISION)
    aided.advance(5.0)
    out = stream_vision(aided, 5.0, 120.0)
    assert aided.truth()[1].source == "vision position"
    assert aided.truth()[1].aid_refusal is None
    # 2.5 km north of its origin the projection and the ellipsoid are metres apart: what is off is no projection.
    assert error_m(aided) < 3.0
    # Bit 512 is of a global position, which this is not; bit 256 tells of it.
    assert {m.flags for m in parse(out, "ESTIMATOR_STATUS")[-5:]} == {383}
    aided.advance(130.0)
    assert aided.truth()[1].source == "dead_reckoning"
    assert aided.truth()[1].aid_refusal == "no vision position is fused"


def test_without_the_horizontal_bit_of_ekf2_ev_ctrl_a_vision_position_is_not_used():
    fleet = px4(lost(1), EKF2_AGP0_CTRL=0, EKF2_EV_CTRL=14)
    fleet.advance(5.0)
    stream_vision(fleet, 5.0, 15.0)
    assert fleet.truth()[1].source == "dead_reckoning"


@pytest.mark.parametrize(("noise_md", "stated_m", "follows"), [(0, 30.0, False), (1, 30.0, True), (0, 0.01, True)])
def test_a_vision_position_counts_by_its_own_variance_unless_ekf2_ev_noise_md_is_set(noise_md, stated_m, follows):
    fleet = px4(lost(1), EKF2_EV_NOISE_MD=noise_md, EKF2_EVP_GATE=1000, **VISION)
    fleet.advance(5.0)
    stream_vision(fleet, 5.0, 10.0, sigma_m=stated_m)
    stream_vision(fleet, 10.6, 12.0, sigma_m=stated_m, shift_east_m=20.0)
    assert (error_m(fleet) > 15.0) == follows


def test_beside_its_own_receiver_a_vision_position_moves_nothing_and_its_offset_is_kept_at_the_loss():
    fleet = px4(lost(1, 20.0), **VISION)
    fleet.advance(5.0)
    stream_vision(fleet, 5.0, 15.0, shift_east_m=100.0)
    assert fleet.truth()[1].source == "gps1"
    assert error_m(fleet) < 3.0
    stream_vision(fleet, 15.6, 40.0, shift_east_m=100.0)
    assert fleet.truth()[1].source == "vision position"
    assert error_m(fleet) < 5.0


def test_without_gps_since_the_start_it_has_no_origin():
    fleet = px4(lost(1, 0.0), **VISION)
    fleet.advance(5.0)
    assert ask_origin(fleet) == []


def test_its_integer_parameters_travel_as_bytes_and_reals_as_numbers():
    fleet, gcs = px4(), GroundStation()
    fleet.advance(1.0)
    field = struct.unpack("<f", struct.pack("<i", 0))[0]
    fleet.deliver(1, gcs.pack(mavlink.MAVLink_param_set_message(1, 1, b"EKF2_AGP0_CTRL", field, 6)), 1.0)
    fleet.deliver(1, gcs.pack(mavlink.MAVLink_param_request_read_message(1, 1, b"EKF2_REQ_NSATS", -1)), 1.0)
    fleet.deliver(1, gcs.pack(mavlink.MAVLink_param_request_read_message(1, 1, b"EKF2_AGP0_NOISE", -1)), 1.0)
    values = {m.param_id: (m.param_value, m.param_type) for m in parse(fleet.advance(1.1), "PARAM_VALUE")}
    assert values["EKF2_AGP0_CTRL"] == (0.0, 6)
    assert struct.pack("<f", values["EKF2_REQ_NSATS"][0]) == struct.pack("<i", 6)
    assert values["EKF2_AGP0_NOISE"] == (pytest.approx(1.0), 9)
    assert fleet.truth()[1].aid_refusal == "EKF2_AGP0_CTRL is off"


def test_a_parameter_of_the_other_autopilot_is_refused_in_the_scenario():
    with pytest.raises(ValidationError, match="no such parameter: GPS2_TYPE"):
        px4(GPS2_TYPE=14)


def test_an_external_estimate_is_a_hard_reset_that_forgets_the_wind_also_while_it_has_gps():
    fleet, gcs = px4(wind={"speed_mps": 8.0, "from_deg": 270.0}), GroundStation()
    fleet.advance(40.0)
    t = fleet.truth()[1]
    before_mps = ground_speed_mps(fleet)
    lat, lon, _ = fleet.frame.to_lla(t.east_m + 100.0, t.north_m, t.up_m)
    command = mavlink.MAVLink_command_int_message(
        1, 1, 0, 43003, 0, 0, 40.0, 0.0, 5.0, 0, round(lat * 1e7), round(lon * 1e7), math.nan
    )
    fleet.deliver(1, gcs.pack(command), fleet.now_s)
    assert parse(fleet.advance(fleet.now_s + 0.02), "COMMAND_ACK")[0].result == mavlink.MAV_RESULT_ACCEPTED
    assert error_m(fleet) == pytest.approx(100.0, abs=3.0)
    assert abs(ground_speed_mps(fleet) - before_mps) > 0.5


def ground_speed_mps(fleet):
    gcs = GroundStation()
    request = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 33, 0, 0, 0, 0, 0, 0)
    fleet.deliver(1, gcs.pack(request), fleet.now_s)
    message = parse(fleet.advance(fleet.now_s + 0.02), "GLOBAL_POSITION_INT")[-1]
    return math.hypot(message.vx, message.vy) / 100.0


def test_the_slot_of_the_auxiliary_position_is_read_at_the_start_alone():
    off = px4(lost(1), EKF2_AGP0_ID=0)
    off.advance(5.0)
    field = struct.unpack("<f", struct.pack("<i", 1))[0]
    off.deliver(1, GroundStation().pack(mavlink.MAVLink_param_set_message(1, 1, b"EKF2_AGP0_ID", field, 6)), 5.0)
    stream_positions(off, 5.0, 10.0)
    assert off.truth()[1].aid_refusal == "EKF2_AGP0_ID was 0 at the start"
    other = px4(lost(1))
    other.advance(5.0)
    stream_positions(other, 5.0, 10.0, sensor_id=2)
    assert other.truth()[1].source == "dead_reckoning"


def test_its_status_says_by_bit_512_whether_a_global_position_is_used():
    used, alone = px4(lost(1)), px4(lost(1))
    used.advance(5.0)
    assert {m.flags for m in parse(stream_positions(used, 5.0, 20.0), "ESTIMATOR_STATUS")[-5:]} == {895}
    flags = [m.flags for m in parse(alone.advance(20.0), "ESTIMATOR_STATUS")]
    assert flags[-1] == 101
    assert 383 in flags
    assert not any(f & 512 for f in flags[-20:])


def test_on_the_ground_it_says_constant_position_beside_an_absolute_one_and_no_airspeed():
    vehicle = {"sysid": 1, "waypoints": [[0, 0], [0, 20000]], "autopilot": "px4", "armed": False}
    out = Fleet(scenario(vehicle=[vehicle]), 1).advance(10.0)
    assert parse(out, "ESTIMATOR_STATUS")[-1].flags == 895 | mavlink.ESTIMATOR_CONST_POS_MODE
    assert math.isnan(parse(out, "VFR_HUD")[-1].airspeed)


def test_without_gps_since_the_start_its_height_comes_in_altitude_alone():
    out = px4(lost(1, 0.0)).advance(10.0)
    assert parse(out, "GLOBAL_POSITION_INT") == []
    assert parse(out, "ALTITUDE")[-1].altitude_amsl == pytest.approx(600.0, abs=5.0)
