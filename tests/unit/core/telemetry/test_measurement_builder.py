"""Positions and attitudes to measurements: which clock, which noise, which frame, and what is refused."""

from dataclasses import replace

import pytest
from built_measurements import Builder, gps, position, range_message, vehicle

from gcs_coloc.core.clocks.vehicle_clocks import TimeSettings
from gcs_coloc.core.measurements import AltitudeMeasurement, PositionMeasurement
from gcs_coloc.core.messages.inbound import Airspeed, Attitude, TimeBase
from gcs_coloc.core.reasons import CoreRefusal


def test_the_first_healthy_position_is_the_origin():
    feed = Builder()
    assert feed.measure(position(1.0), vehicle(), trusted=False) is None
    first = feed.measure(position(2.0), vehicle())
    assert isinstance(first, PositionMeasurement)
    assert first.position_enu_m == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert first.velocity_enu_mps == pytest.approx((2.0, 1.0, -3.0))


def test_only_a_trusted_vehicles_position_is_believed():
    measurement = Builder(has_frame=True).measure(position(1.0), vehicle(), trusted=False, located_enu_m=(0.0, 0.0))
    assert isinstance(measurement, AltitudeMeasurement)
    assert measurement.up_m == pytest.approx(30.0, abs=0.01)


@pytest.mark.parametrize(
    ("receiver", "expected"),
    [(gps(1.5, 2.5), (1.5, 2.5)), (gps(0.01, 0.01), (0.3, 0.3)), (gps(None), (5.0, 8.0)), (None, (5.0, 8.0))],
)
def test_the_receivers_own_accuracy_is_the_noise_where_it_states_one(receiver, expected):
    feed = Builder(TimeSettings(min_delay_sigma_s=1e-6))
    healthy = vehicle()
    healthy.receiver = receiver
    measurement = feed.measure(position(1.0), healthy)
    assert isinstance(measurement, PositionMeasurement)
    assert (measurement.sigma_h_m, measurement.sigma_v_m) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("hdop", "h_acc_m", "expected"),
    [(None, None, (5.0, 8.0)), (0.7, None, (5.0, 8.0)), (4.0, None, (20.0, 32.0)), (4.0, 1.5, (1.5, 2.5))],
)
def test_where_it_states_none_its_dilution_tells_how_bad_the_receiver_is(hdop, h_acc_m, expected):
    feed = Builder(TimeSettings(min_delay_sigma_s=1e-6))
    healthy = vehicle()
    healthy.receiver = replace(gps(h_acc_m, 2.5 if h_acc_m is not None else None), hdop=hdop)
    measurement = feed.measure(position(1.0), healthy)
    assert isinstance(measurement, PositionMeasurement)
    assert (measurement.sigma_h_m, measurement.sigma_v_m) == pytest.approx(expected)


@pytest.mark.parametrize(("apart_m", "sigma_m"), [(14.0, 14.0), (-530.0, 0.5)])
def test_a_height_is_no_better_known_than_autopilot_and_receiver_agree_on_it(apart_m, sigma_m):
    """A barometer on a day 20 K off the standard, 200 m above the ground: 14 m off, where the receiver states 0.5 m.

    A receiver that has no height, 0 m, says nothing of it.
    """
    feed = Builder(TimeSettings(min_delay_sigma_s=1e-6))
    healthy = vehicle()
    for tenth in range(300):
        here = position(1.0 + tenth / 10)
        healthy.receiver = replace(gps(1.0, 0.5), received_at_s=here.received_at_s, alt_msl_m=here.alt_msl_m + apart_m)
        measurement = feed.measure(here, healthy)
    assert isinstance(measurement, PositionMeasurement)
    assert measurement.sigma_v_m == pytest.approx(sigma_m, abs=1.0)
    assert measurement.sigma_h_m == pytest.approx(1.0)


def test_an_uncertain_time_is_an_uncertain_place():
    feed = Builder(TimeSettings(min_delay_s=0.1, min_delay_sigma_s=0.5))
    moving, peer = vehicle(), vehicle(sysid=1)
    moving.receiver = gps(1.5, 2.5)
    moving.position = position(1.0)  # 1 m/s north, 2 east, 3 down
    measurement = feed.measure(moving.position, moving)
    assert isinstance(measurement, PositionMeasurement)
    assert measurement.measured_at_s == pytest.approx(0.9)
    assert measurement.sigma_h_m == pytest.approx((1.5**2 + 5.0 * 0.5**2) ** 0.5)
    assert measurement.time_sigma_s == 0.5
    assert measurement.sigma_v_m == pytest.approx((2.5**2 + 9.0 * 0.5**2) ** 0.5)
    alone = feed.measure_range(range_message(1.0, 1.0, TimeBase.BOOT), moving, peer)
    peer.position = moving.position
    together = feed.measure_range(range_message(1.1, 1.1, TimeBase.BOOT), moving, peer)
    assert alone is not None
    assert together is not None
    assert alone.sigma_m == pytest.approx((0.5**2 + 14.0 * 0.5**2) ** 0.5)
    assert (alone.time_sigma_s, alone.time_sigma_m) == pytest.approx((0.5, 14.0**0.5 * 0.5))
    assert (together.sigma_m, together.time_sigma_m) == (0.5, 0.0)  # side by side a range does not change, whenever measured


def test_airspeed_goes_with_the_attitude_only_while_it_is_fresh():
    """On a radio of 1 Hz one of thirteen attitudes of a real plane came without it, and its bank was not used either."""
    feed = Builder()
    record = vehicle()
    record.winged = True
    record.airspeed = Airspeed(4, 10.0, 22.0)
    fresh = feed.measure_attitude(Attitude(4, 12.1, 12.1, 0.1, 0.2, 0.3), record)
    stale = feed.measure_attitude(Attitude(4, 12.3, 12.3, 0.1, 0.2, 0.3), record)
    assert fresh is not None
    assert stale is not None
    assert (fresh.airspeed_mps, stale.airspeed_mps) == (22.0, None)
    assert feed.attitude_at_s(4) == fresh.measured_at_s
    record.airspeed = Airspeed(4, 12.5, 22.0)
    feed.measure_attitude(Attitude(4, 12.8, 12.4, 0.1, 0.2, 0.3), record)
    assert feed.attitude_at_s(4) == pytest.approx(12.4, abs=0.05)  # it was under way for 0.4 s
    assert (fresh.roll_rad, fresh.pitch_rad, fresh.yaw_rad) == (0.1, 0.2, 0.3)


@pytest.mark.parametrize(
    ("winged", "airspeed_mps", "heard_at_s", "has"),
    [(True, 22.0, 10.0, True), (False, 22.0, 10.0, False), (True, 4.0, 10.0, False), (True, 22.0, 7.9, False)],
)
def test_air_data_tell_how_a_vehicle_moves_on_wings_fast_enough_and_lately(winged, airspeed_mps, heard_at_s, has):
    record = vehicle()
    assert not record.has_air_data(10.0)
    record.winged, record.airspeed = winged, Airspeed(4, heard_at_s, airspeed_mps)
    record.attitude = Attitude(4, 10.0, 10.0, 0.1, 0.2, 0.3)
    assert record.has_air_data(10.0) is has


@pytest.mark.parametrize(("winged", "airspeed_mps"), [(True, pytest.approx(22.0 * 1.1607, rel=1e-3)), (False, None)])
def test_airspeed_is_the_true_one_at_the_vehicles_altitude_and_only_where_it_flies_on_wings(winged, airspeed_mps):
    """At 3000 m a plane that tells 22 m/s moves at 25.5; a multirotor may do so to any side."""
    feed, record = Builder(), vehicle()
    record.winged, record.airspeed, record.position = winged, Airspeed(4, 10.0, 22.0), position(10.0, alt_m=3000.0)
    measurement = feed.measure_attitude(Attitude(4, 10.1, 10.1, 0.1, 0.2, 0.3), record)
    assert measurement is not None
    assert measurement.airspeed_mps == airspeed_mps


def test_a_vtol_on_its_rotors_has_no_airspeed_that_tells_its_course():
    feed, record = Builder(), vehicle()
    record.winged, record.on_rotors, record.airspeed = True, True, Airspeed(4, 10.0, 12.0)
    hovering = feed.measure_attitude(Attitude(4, 10.1, 10.1, 0.1, 0.2, 0.3), record)
    record.on_rotors = False
    flying = feed.measure_attitude(Attitude(4, 10.2, 10.2, 0.1, 0.2, 0.3), record)
    assert (hovering.airspeed_mps, flying.airspeed_mps) == (None, 12.0)


def test_a_jumping_clock_is_refused_and_counted():
    feed = Builder()
    record = vehicle()
    feed.measure(position(1.0), record)
    assert feed.measure(position(1.1, boot_s=1e6), record) is None
    assert feed.clocks.refused == {CoreRefusal.POSITION_CLOCK_JUMPED: 1}
