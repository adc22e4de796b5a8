"""What a vehicle says of its own motion, checked against itself: what must trip, and the honest flights that must not."""

import numpy as np
import pytest

from gcs_coloc.core.gps_health.position_checks import MotionCheck
from gcs_coloc.core.measurements import PositionMeasurement
from gcs_coloc.core.messages.inbound import GpsReceiver


def reported(t: float, east_m: float, north_m: float, ve: float, vn: float, h_acc_m: float = 1.0) -> PositionMeasurement:
    return PositionMeasurement(1, t, t + 0.1, (east_m, north_m, 50.0), h_acc_m, 2.0, (ve, vn, 0.0), 0.3)


def climbing(t: float, up_m: float, vu: float) -> PositionMeasurement:
    return PositionMeasurement(1, t, t + 0.1, (20.0 * t, 0.0, up_m), 1.0, 2.0, (20.0, 0.0, vu), 0.3)


def fix(t: float, lat_deg: float, fix_type: int = 3, velocity_ne_mps: tuple[float, float] | None = None) -> GpsReceiver:
    return GpsReceiver(1, t, 0, fix_type, lat_deg, 8.0, 500.0, 10, 1.0, 1.0, 2.0, 0.3, velocity_ne_mps=velocity_ne_mps)


def circle(t: float, speed_mps: float, radius_m: float) -> tuple[float, float, float, float]:
    a = speed_mps / radius_m * t
    return radius_m * np.sin(a), radius_m * np.cos(a), speed_mps * np.cos(a), -speed_mps * np.sin(a)


@pytest.mark.parametrize(("speed_mps", "radius_m"), [(0.0, 50.0), (1.0, 20.0), (25.0, 60.0), (25.0, 1e5)])
@pytest.mark.parametrize(("h_acc_m", "correlation"), [(0.5, 0.0), (1.5, 0.998), (15.0, 0.0)])
def test_no_alarm_in_half_an_hour_of_honest_flight(speed_mps, radius_m, h_acc_m, correlation):
    """Hovering, slow, turning and straight; errors white and slow, of 0.5 to 15 m: over twelve flights of half an hour none."""
    rng = np.random.default_rng(5)
    check, error = MotionCheck(), h_acc_m * rng.standard_normal(2)
    for i in range(18_000):
        t = i / 10
        error = correlation * error + h_acc_m * np.sqrt(1 - correlation**2) * rng.standard_normal(2)
        e, n, ve, vn = circle(t, speed_mps, radius_m)
        noise = 0.3 * rng.standard_normal(2)
        check.add_position(reported(t, e + error[0], n + error[1], ve + noise[0], vn + noise[1], h_acc_m), own=True)
        assert check.implausible(t + 0.1) is None


def test_a_jump_is_told_within_two_seconds_and_held_for_ten():
    check = MotionCheck()
    for i in range(400):
        t = i / 10
        check.add_position(reported(t, 20.0 * t + (30.0 if t >= 10.0 else 0.0), 0.0, 20.0, 0.0), own=True)
        if t < 10.0:
            assert check.implausible(t) is None
        elif 12.0 <= t <= 20.0:
            assert "moved 30 m other than its velocity" in check.implausible(t).text
    assert check.implausible(39.9) is None


def test_positions_that_are_off_for_less_than_a_second_are_passed_over():
    check = MotionCheck()
    for i in range(200):
        t = i / 10
        check.add_position(reported(t, 20.0 * t + (30.0 if 10.0 <= t < 10.8 else 0.0), 0.0, 20.0, 0.0), own=True)
        assert check.implausible(t + 0.1) is None


@pytest.mark.parametrize(("jump_m", "is_told"), [(95.0, False), (120.0, True)])
def test_a_jump_counts_beyond_five_sigmas_of_two_positions(jump_m, is_told):
    """Two positions of 15 m (1-sigma) are 21.2 m apart (1-sigma): 106 m, and 2 m that always pass."""
    check = MotionCheck()
    for i in range(120):
        t = i / 10
        check.add_position(reported(t, 20.0 * t + (jump_m if t >= 10.0 else 0.0), 0.0, 20.0, 0.0, h_acc_m=15.0), own=True)
    assert (check.implausible(12.0) is not None) is is_told


def test_an_altitude_that_jumps_is_told_within_two_seconds_and_held_for_ten():
    check = MotionCheck()
    for i in range(400):
        t = i / 10
        check.add_position(climbing(t, 0.1 * t + (60.0 if t >= 10.0 else 0.0), 0.1), own=True)
        if t < 10.0:
            assert check.implausible(t) is None
        elif 12.0 <= t <= 20.0:
            assert "moved 60 m other than its velocity" in check.implausible(t).text
    assert check.implausible(39.9) is None


@pytest.mark.parametrize("share", [0.93, 1.0, 1.07])
def test_an_altitude_may_follow_the_climb_as_a_barometer_on_a_hot_day_does(share):
    check = MotionCheck()
    for i in range(600):
        t = i / 10
        up_m, vu = 100.0 * np.sin(0.1 * t), 10.0 * np.cos(0.1 * t)
        check.add_position(climbing(t, share * up_m, vu), own=True)
        assert check.implausible(t + 0.1) is None


def test_the_height_that_an_ekf_sets_with_its_origin_is_no_jump():
    """An ArduPlane that had booted: at its place from 2 s on, at a height of 0 until its EKF set its origin 8 s later."""
    check = MotionCheck()
    for i in range(400):
        t = i / 10
        check.add_position(climbing(t, 450.0 if t >= 10.0 else 0.0, 0.1), own=True, is_placed=t >= 20.0)
        assert check.implausible(t + 0.1) is None


def test_an_altitude_of_a_sender_that_states_no_vertical_velocity_is_not_held_against_it():
    check = MotionCheck()
    for i in range(300):
        t = i / 10
        check.add_position(climbing(t, 15.0 * t, 0.0), own=True)
        assert check.implausible(t + 0.1) is None


def test_a_position_that_stands_while_the_velocity_does_not_is_told():
    check = MotionCheck()
    for i in range(60):
        t = i / 10
        check.add_position(reported(t, 20.0 * min(t, 2.0), 0.0, 20.0, 0.0), own=True)
    assert check.implausible(6.0) is not None


def test_an_echo_of_our_aid_is_no_evidence():
    check = MotionCheck()
    for i in range(60):
        t = i / 10
        check.add_position(reported(t, 100.0 * (i % 2), 0.0, 20.0, 0.0), own=False)
    assert check.implausible(6.0) is None


def test_a_receiver_that_repeats_itself_on_the_move_is_frozen_until_it_moves():
    check = MotionCheck()
    for i in range(50):
        t = i / 5
        check.add_position(reported(t, 20.0 * t, 0.0, 20.0, 0.0), own=True)
        check.add_receiver(fix(t, 47.0 + 1e-6 * min(i, 25)))
        assert (check.frozen() is not None) == (t >= 8.0)
    check.add_receiver(fix(10.2, 47.1))
    assert check.frozen() is None


def test_a_hovering_receiver_with_static_hold_and_one_without_a_fix_are_not_frozen():
    hover, lost = MotionCheck(), MotionCheck()
    for i in range(300):
        t = i / 5
        hover.add_position(reported(t, 0.0, 0.0, 0.05, 0.0), own=True)
        hover.add_receiver(fix(t, 47.0))
        lost.add_position(reported(t, 20.0 * t, 0.0, 20.0, 0.0), own=True)
        lost.add_receiver(fix(t, 47.0, fix_type=1))
    assert hover.frozen() is None
    assert lost.frozen() is None


def test_a_receiver_that_stands_is_not_frozen_while_the_filter_states_a_velocity():
    """A real ArduCopter before its take-off: its EKF3 stated 0.9 m/s for minutes, its position stayed within a few decimetres."""
    check = MotionCheck()
    for i in range(600):
        t = i / 5
        check.add_position(reported(t, 0.3 * np.sin(0.05 * t), 0.0, -0.9, -0.3), own=True)
        check.add_receiver(fix(t, 47.0, velocity_ne_mps=(0.0, 0.0)))
        assert check.frozen() is None


def test_a_receiver_that_states_a_velocity_and_holds_the_filter_at_its_place_is_frozen():
    check = MotionCheck()
    for i in range(25):
        t = i / 5
        check.add_position(reported(t, 4.0, 0.0, 15.0, 0.0), own=True)
        check.add_receiver(fix(t, 47.0, velocity_ne_mps=(0.0, 20.0)))
    assert check.frozen() is not None


def test_a_receiver_frozen_while_the_vehicle_flies_a_small_round_is_told():
    check = MotionCheck()
    for i in range(100):
        t = i / 5
        check.add_position(reported(t, *circle(t, 3.0, 8.0)), own=True)
        check.add_receiver(fix(t, 47.0))
    assert check.frozen() is not None


def test_a_slow_receiver_repeated_in_telemetry_is_not_frozen():
    check = MotionCheck()
    for i in range(300):
        t = i / 5
        check.add_position(reported(t, 25.0 * t, 0.0, 25.0, 0.0), own=True)
        check.add_receiver(fix(t, 47.0 + 1e-4 * int(t)))
        assert check.frozen() is None
