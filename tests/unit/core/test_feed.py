"""Messages to measurements: which clock, which noise, which frame, and what is refused."""

from dataclasses import replace

import pytest

from gcs_coloc.core.clocks.vehicle_clocks import TimeSettings
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.gps_health import GpsHealthSettings, GpsState
from gcs_coloc.core.measurements import AltitudeMeasurement, PositionMeasurement
from gcs_coloc.core.messages.inbound import Airspeed, Attitude, GlobalPosition, GpsReceiver, PeerRange, TimeBase
from gcs_coloc.core.telemetry.measurement_builder import MeasurementBuilder, MeasurementSettings
from gcs_coloc.core.telemetry.vehicles import FixSent, Vehicle, VehicleRegistry


def vehicle(state: GpsState = GpsState.HEALTHY, sysid: int = 4) -> Vehicle:
    record = VehicleRegistry(GpsHealthSettings(), 10).add(sysid, 0.0)
    assert record is not None
    record.health.state = state
    return record


def position(at_s: float, alt_m: float = 530.0, boot_s: float | None = None) -> GlobalPosition:
    return GlobalPosition(4, at_s, at_s if boot_s is None else boot_s, 47.1, 8.0, alt_m, 1.0, 2.0, 3.0)


def gps(h_acc_m: float | None, v_acc_m: float | None = None) -> GpsReceiver:
    return GpsReceiver(4, 0.0, 0, 3, 47.0, 8.0, 500.0, 9, 1.0, h_acc_m, v_acc_m, None)


def test_the_first_healthy_position_is_the_origin():
    feed = MeasurementBuilder(MeasurementSettings())
    assert feed.position(position(1.0), vehicle(GpsState.FAILED)) is None
    first = feed.position(position(2.0), vehicle())
    assert isinstance(first, PositionMeasurement)
    assert first.position_enu_m == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert first.velocity_enu_mps == pytest.approx((2.0, 1.0, -3.0))


@pytest.mark.parametrize("state", [s for s in GpsState if s is not GpsState.HEALTHY])
def test_only_a_healthy_vehicles_position_is_believed(state):
    feed = MeasurementBuilder(MeasurementSettings())
    feed.frame = LocalFrame(47.0, 8.0, 500.0)
    measurement = feed.position(position(1.0), vehicle(state))
    assert isinstance(measurement, AltitudeMeasurement)
    assert measurement.up_m == pytest.approx(30.0, abs=0.01)


def height_sigmas(feed: MeasurementBuilder, record: Vehicle, booted_at_s: float, from_s: int, to_s: int) -> list[float]:
    """The sigma (m) of the height of each position, once a second, of a vehicle that climbs at none."""
    told = [feed.position(replace(position(float(t), boot_s=t - booted_at_s), vd_mps=0.0), record) for t in range(from_s, to_s)]
    return [m.sigma_m for m in told if isinstance(m, AltitudeMeasurement)]


def test_a_height_that_began_with_a_fix_of_ours_is_as_uncertain_as_that_was():
    """An autopilot that boots without GPS sets its barometer by the first fix that it gets: its height is ours come back."""
    feed, record = MeasurementBuilder(MeasurementSettings()), vehicle(GpsState.FAILED)
    feed.frame = LocalFrame(47.0, 8.0, 500.0)
    record.fix_sent = FixSent(105.0, 10.0)
    assert height_sigmas(feed, record, 90.0, 106, 108) == pytest.approx([104.0**0.5] * 2)
    record.fix_sent = FixSent(108.0, 1.0)
    assert height_sigmas(feed, record, 90.0, 108, 110) == pytest.approx([104.0**0.5] * 2)
    record.health.state = GpsState.HEALTHY  # its own receiver is back, and sets it right
    feed.position(position(110.0, boot_s=20.0), record)
    record.health.state = GpsState.FAILED
    assert height_sigmas(feed, record, 90.0, 111, 113) == [2.0, 2.0]


def test_a_height_told_before_the_first_fix_of_ours_is_the_barometers_until_the_autopilot_reboots():
    feed, record = MeasurementBuilder(MeasurementSettings()), vehicle(GpsState.FAILED)
    feed.frame = LocalFrame(47.0, 8.0, 500.0)
    assert height_sigmas(feed, record, 20.0, 100, 103) == [2.0] * 3
    record.fix_sent = FixSent(105.0, 10.0)
    assert height_sigmas(feed, record, 20.0, 106, 109) == [2.0] * 3
    record.fix_sent = FixSent(135.0, 10.0)
    assert height_sigmas(feed, record, 120.0, 136, 140)[-1] == pytest.approx(104.0**0.5)


@pytest.mark.parametrize("step_s", [-3.0, 3.0, 2**32 / 1e3])
def test_a_clock_that_steps_or_wraps_during_aid_does_not_cost_the_height(step_s):
    feed, record = MeasurementBuilder(MeasurementSettings()), vehicle(GpsState.FAILED)
    feed.frame = LocalFrame(47.0, 8.0, 500.0)
    booted_at_s = 110.0 - 2**32 / 1e3 if step_s > 10.0 else 90.0
    assert height_sigmas(feed, record, booted_at_s, 100, 110) == [2.0] * 10
    record.fix_sent = FixSent(109.0, 10.0)
    assert set(height_sigmas(feed, record, booted_at_s + step_s, 110, 120)) == {2.0}


def test_altitude_is_brought_down_by_the_earths_curvature_at_the_last_known_place():
    feed = MeasurementBuilder(MeasurementSettings())
    feed.frame = LocalFrame(47.0, 8.0, 500.0)
    failed = vehicle(GpsState.FAILED)
    failed.last_known_enu_m = (0.0, 20_000.0)
    measurement = feed.position(position(1.0), failed)
    assert isinstance(measurement, AltitudeMeasurement)
    assert measurement.up_m == pytest.approx(30.0 - 20_000.0**2 / (2 * 6.37e6), abs=0.2)


@pytest.mark.parametrize(
    ("receiver", "expected"),
    [(gps(1.5, 2.5), (1.5, 2.5)), (gps(0.01, 0.01), (0.3, 0.3)), (gps(None), (5.0, 8.0)), (None, (5.0, 8.0))],
)
def test_the_receivers_own_accuracy_is_the_noise_where_it_states_one(receiver, expected):
    feed = MeasurementBuilder(MeasurementSettings(), TimeSettings(min_delay_sigma_s=1e-6))
    healthy = vehicle()
    healthy.receiver = receiver
    measurement = feed.position(position(1.0), healthy)
    assert isinstance(measurement, PositionMeasurement)
    assert (measurement.sigma_h_m, measurement.sigma_v_m) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("hdop", "h_acc_m", "expected"),
    [(None, None, (5.0, 8.0)), (0.7, None, (5.0, 8.0)), (4.0, None, (20.0, 32.0)), (4.0, 1.5, (1.5, 2.5))],
)
def test_where_it_states_none_its_dilution_tells_how_bad_the_receiver_is(hdop, h_acc_m, expected):
    feed = MeasurementBuilder(MeasurementSettings(), TimeSettings(min_delay_sigma_s=1e-6))
    healthy = vehicle()
    healthy.receiver = replace(gps(h_acc_m, 2.5 if h_acc_m is not None else None), hdop=hdop)
    measurement = feed.position(position(1.0), healthy)
    assert isinstance(measurement, PositionMeasurement)
    assert (measurement.sigma_h_m, measurement.sigma_v_m) == pytest.approx(expected)


def test_an_uncertain_time_is_an_uncertain_place():
    feed = MeasurementBuilder(MeasurementSettings(), TimeSettings(min_delay_s=0.1, min_delay_sigma_s=0.5))
    moving, peer = vehicle(), vehicle(sysid=1)
    moving.receiver = gps(1.5, 2.5)
    moving.position = position(1.0)  # 1 m/s north, 2 east, 3 down
    measurement = feed.position(moving.position, moving)
    assert isinstance(measurement, PositionMeasurement)
    assert measurement.measured_at_s == pytest.approx(0.9)
    assert measurement.sigma_h_m == pytest.approx((1.5**2 + 5.0 * 0.5**2) ** 0.5)
    assert measurement.time_sigma_s == 0.5
    assert measurement.sigma_v_m == pytest.approx((2.5**2 + 9.0 * 0.5**2) ** 0.5)
    alone = feed.range(range_message(1.0, 1.0, TimeBase.BOOT), moving, peer)
    peer.position = moving.position
    together = feed.range(range_message(1.1, 1.1, TimeBase.BOOT), moving, peer)
    assert alone is not None
    assert together is not None
    assert alone.sigma_m == pytest.approx((0.5**2 + 14.0 * 0.5**2) ** 0.5)
    assert (alone.time_sigma_s, alone.time_sigma_m) == pytest.approx((0.5, 14.0**0.5 * 0.5))
    assert (together.sigma_m, together.time_sigma_m) == (0.5, 0.0)  # side by side a range does not change, whenever measured


def test_airspeed_goes_with_the_attitude_only_while_it_is_fresh():
    feed = MeasurementBuilder(MeasurementSettings())
    record = vehicle()
    record.winged = True
    record.airspeed = Airspeed(4, 10.0, 22.0)
    fresh = feed.attitude(Attitude(4, 10.9, 10.9, 0.1, 0.2, 0.3), record)
    stale = feed.attitude(Attitude(4, 11.1, 11.1, 0.1, 0.2, 0.3), record)
    assert fresh is not None
    assert stale is not None
    assert (fresh.airspeed_mps, stale.airspeed_mps) == (22.0, None)
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
    feed, record = MeasurementBuilder(MeasurementSettings()), vehicle()
    record.winged, record.airspeed, record.position = winged, Airspeed(4, 10.0, 22.0), position(10.0, alt_m=3000.0)
    measurement = feed.attitude(Attitude(4, 10.1, 10.1, 0.1, 0.2, 0.3), record)
    assert measurement is not None
    assert measurement.airspeed_mps == airspeed_mps


def test_a_jumping_clock_is_refused_and_counted():
    feed = MeasurementBuilder(MeasurementSettings())
    record = vehicle()
    feed.position(position(1.0), record)
    assert feed.position(position(1.1, boot_s=1e6), record) is None
    assert feed.refused == {"GLOBAL_POSITION_INT: its clock jumped": 1}


def range_message(at_s: float, stamp_s: float | None, base: TimeBase, device: int = 0) -> PeerRange:
    return PeerRange(4, at_s, 1, 100.0, 0.5, stamp_s, base, 1, None, device)


def test_boot_unix_and_unstamped_ranges_each_find_the_service_clock():
    feed = MeasurementBuilder(MeasurementSettings())
    record = vehicle()
    known = vehicle(sysid=1)
    for i in range(5):
        at_s = 100.0 + i
        late_s = 0.2 if i == 4 else 0.0
        boot = feed.range(range_message(at_s + late_s, 7.0 + i, TimeBase.BOOT), record, known)
        unix = feed.range(range_message(at_s + late_s, 1.7e9 + i, TimeBase.UNIX), record, known)
        none = feed.range(range_message(at_s + late_s, None, TimeBase.BOOT), record, known)
        assert boot is not None
        assert unix is not None
        assert none is not None
        assert boot.measured_at_s == pytest.approx(at_s)
        assert unix.measured_at_s == pytest.approx(at_s)
        assert none.measured_at_s == at_s + late_s
        assert (boot.clock_of, unix.clock_of, none.clock_of) == (4, 4, None)


@pytest.mark.parametrize(("delay_s", "at_s", "sigma_s"), [(None, 100.0, 0.05), (-0.01, 100.0, 0.05), (0.3, 99.7, 0.158)])
def test_an_unstamped_range_is_as_old_as_its_vehicles_newest_position_was(delay_s, at_s, sigma_s):
    record = vehicle()
    record.delay_s = delay_s
    measured = MeasurementBuilder(MeasurementSettings()).range(
        range_message(100.0, None, TimeBase.BOOT), record, vehicle(sysid=1)
    )
    assert measured is not None
    assert (measured.measured_at_s, measured.time_sigma_s) == pytest.approx((at_s, sigma_s), abs=1e-3)


def test_the_clocks_of_one_vehicles_ranging_devices_are_bounded():
    feed = MeasurementBuilder(MeasurementSettings())
    record = vehicle()
    for device in range(40):
        feed.range(range_message(1.0, 1.0, TimeBase.BOOT, device), record, vehicle(sysid=1))
    assert len(record.range_clocks) == 16
    assert feed.refused["range: more clocks than a vehicle may have"] == 24


def test_the_range_error_holds_the_peers_own_and_follows_slowly():
    feed = MeasurementBuilder(MeasurementSettings())
    record, peer = vehicle(), vehicle(sysid=1)
    peer.receiver = gps(1.2)
    feed.range(range_message(1.0, None, TimeBase.BOOT), record, peer)
    assert record.range_error_m == pytest.approx(1.3)  # 0.5 and 1.2
    peer.receiver = gps(12.0)
    feed.range(range_message(1.1, None, TimeBase.BOOT), record, peer)
    assert record.range_error_m == pytest.approx(1.3 + 0.1 * (12.0104 - 1.3), abs=1e-3)
