"""A vehicle that reports another position than its own receiver's: what is told, and the honest flights of which nothing is."""

import numpy as np
import pytest
from engine_flights import LAT, LON, M_PER_DEGREE_EAST, StraightLine, settings, telemetry
from engine_flights import fly as fly_straight

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.gps_health.position_checks import ReceiverCheck
from gcs_coloc.core.messages.inbound import GlobalPosition, GpsReceiver

M_PER_DEGREE_NORTH = 111_180.0


def fix(t: float, east_m: float, h_acc_m: float | None = 1.0, fix_type: int = 3) -> GpsReceiver:
    return GpsReceiver(1, t, 0, fix_type, LAT, LON + east_m / M_PER_DEGREE_EAST, 500.0, 10, 1.0, h_acc_m, 1.5, 0.3)


def position(t: float, east_m: float, north_m: float = 0.0, ve_mps: float = 0.0) -> GlobalPosition:
    lat_deg, lon_deg = LAT + north_m / M_PER_DEGREE_NORTH, LON + east_m / M_PER_DEGREE_EAST
    return GlobalPosition(1, t, t, lat_deg, lon_deg, 500.0, 0.0, ve_mps, 0.0)


def told(off_m: float, seconds: float, *, h_acc_m: float | None = 1.0, ve_mps: float = 0.0, fix_type: int = 3) -> str | None:
    check = ReceiverCheck()
    for i in range(round(seconds * 5) + 1):
        t = i / 5
        check.add(fix(t, ve_mps * t, h_acc_m, fix_type), position(t, ve_mps * t, off_m, ve_mps))
    return check.fault.text if check.fault is not None else None


@pytest.mark.parametrize(
    ("off_m", "h_acc_m", "ve_mps", "is_told"),
    [
        (14.0, 1.0, 0.0, False),
        (16.0, 1.0, 0.0, True),
        (53.0, 1.0, 20.0, False),
        (57.0, 1.0, 20.0, True),
        (57.0, 10.0, 0.0, False),
        (34.0, None, 0.0, False),
        (36.0, None, 0.0, True),
    ],
)
def test_it_is_told_beyond_five_sigmas_ten_metres_and_two_seconds_of_flight(off_m, h_acc_m, ve_mps, is_told):
    words = told(off_m, 3.0, h_acc_m=h_acc_m, ve_mps=ve_mps)
    assert words == (f"the position that it reports is {off_m:.0f} m off its own receiver's" if is_told else None)


def test_it_is_told_after_three_seconds_and_not_before_and_ends_with_the_first_pair_that_agrees():
    assert told(200.0, 2.8) is None
    check = ReceiverCheck()
    for i in range(16):
        check.add(fix(i / 5, 0.0), position(i / 5, 200.0))
    assert check.fault is not None
    check.add(fix(3.2, 0.0), position(3.2, 5.0))
    assert check.fault is None


def test_nothing_is_told_without_a_fix_or_beside_a_position_of_long_ago():
    assert told(200.0, 10.0, fix_type=1) is None
    check = ReceiverCheck()
    for i in range(100):
        check.add(fix(2.1 + i / 5, 0.0), position(0.0, 200.0))
    assert check.fault is None


@pytest.mark.parametrize("lat_lon", [(0.0, 180.0), (89.9999, 10.0)])
def test_the_date_line_and_the_pole_are_no_distance(lat_lon):
    lat_deg, lon_deg = lat_lon
    check = ReceiverCheck()
    for i in range(50):
        own = GpsReceiver(1, i / 5, 0, 3, lat_deg, lon_deg, 500.0, 10, 1.0, 1.0, 1.5, 0.3)
        check.add(own, GlobalPosition(1, i / 5, i / 5, lat_deg, -179.9999 if lat_deg == 0.0 else 30.0, 500.0, 0.0, 0.0, 0.0))
    assert check.fault is None


def test_honest_flight_over_a_poor_link_is_never_told():
    """Half an hour at 30 m/s, a receiver 0.2 s late, both messages once a second and up to 1 s on the way: nothing."""
    rng, check = np.random.default_rng(3), ReceiverCheck()
    reported = position(0.0, 0.0)
    for t in range(1, 1800):
        for late_s, message in sorted([(rng.random(), "fix"), (0.5 + rng.random(), "position")]):
            if message == "position":
                reported = position(t + late_s, 30.0 * t + 1.5 * rng.standard_normal(), 1.5 * rng.standard_normal(), 30.0)
            else:
                check.add(fix(t + late_s, 30.0 * (t - 0.2) + 1.5 * rng.standard_normal(), 1.5), reported)
        assert check.fault is None


def test_a_peer_whose_autopilot_flies_on_something_else_is_suspect_and_no_anchor():
    """Its receiver is sound all the while, it has jumped nowhere and moves as its velocity says: only this shows it."""
    engine = Engine(StraightLine(), settings())
    fly_straight(engine, 0.0, 10.0, sysids=(1, 2, 4), failed=(4,))
    for step in range(100, 200):
        t = step / 10
        for message in telemetry(3, t):
            if isinstance(message, GlobalPosition):
                north = message.lat_deg + 120.0 / M_PER_DEGREE_NORTH
                message = GlobalPosition(3, t, message.boot_s, north, message.lon_deg, 500.0, 0.0, 20.0, 0.0)
            engine.receive(message)
        engine.poll(t)
    assert (engine.gps_state(3).value, engine.gps_health.reason(3)) == (
        "suspect",
        "the position that it reports is 120 m off its own receiver's",
    )
