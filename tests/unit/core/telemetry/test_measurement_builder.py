"""Messages to measurements: which clock, which noise, which frame, and what is refused."""

from dataclasses import replace

import pytest

from gcs_coloc.core.clocks.fleet_clocks import FleetClocks
from gcs_coloc.core.clocks.vehicle_clocks import TimeSettings
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import AltitudeMeasurement, Measurement, PositionMeasurement, RangeMeasurement
from gcs_coloc.core.messages.inbound import Airspeed, Attitude, GlobalPosition, GpsReceiver, PeerRange, Pressure, TimeBase
from gcs_coloc.core.reasons import CoreRefusal
from gcs_coloc.core.telemetry.measurement_builder import MeasurementBuilder, MeasurementSettings, SentFix
from gcs_coloc.core.telemetry.reported_state import ReportedState


class Builder(MeasurementBuilder):
    """A builder with clocks of its own, its results unpacked."""

    def __init__(self, time: TimeSettings | None = None, *, has_frame: bool = False) -> None:
        self.clocks = FleetClocks(time)
        super().__init__(MeasurementSettings(), self.clocks)
        if has_frame:
            self.frame = LocalFrame(47.0, 8.0, 500.0)

    def measure(self, message: GlobalPosition, record: ReportedState, trusted: bool = True, **known) -> Measurement | None:
        built = self.position(message, record, is_trusted=trusted, **known)
        return built.measurement if built is not None else None

    def measure_range(self, message: PeerRange, record: ReportedState, peer: ReportedState) -> RangeMeasurement | None:
        return self.range(message, record, peer).measurement


def vehicle(sysid: int = 4) -> ReportedState:
    return ReportedState(sysid, 0.0, 0.0)


def position(at_s: float, alt_m: float = 530.0, boot_s: float | None = None) -> GlobalPosition:
    return GlobalPosition(4, at_s, at_s if boot_s is None else boot_s, 47.1, 8.0, alt_m, 1.0, 2.0, 3.0)


def gps(h_acc_m: float | None, v_acc_m: float | None = None) -> GpsReceiver:
    return GpsReceiver(4, 0.0, 0, 3, 47.0, 8.0, 500.0, 9, 1.0, h_acc_m, v_acc_m, None)


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


def height_sigmas(
    feed: Builder, record: ReportedState, booted_at_s: float, from_s: int, to_s: int, sent_fix: SentFix | None = None
) -> list[float]:
    """The sigma (m) of the height of each position, once a second, of a denied vehicle that climbs at none."""
    messages = [replace(position(float(t), boot_s=t - booted_at_s), vd_mps=0.0) for t in range(from_s, to_s)]
    built = [feed.measure(m, record, trusted=False, sent_fix=sent_fix, located_enu_m=(0.0, 0.0)) for m in messages]
    return [m.sigma_m for m in built if isinstance(m, AltitudeMeasurement)]


def test_a_height_that_began_with_a_fix_of_ours_is_as_uncertain_as_that_was():
    """An autopilot that boots without GPS sets its barometer by the first fix that it gets: its height is ours come back."""
    feed, record = Builder(has_frame=True), vehicle()
    assert height_sigmas(feed, record, 90.0, 106, 108, SentFix(105.0, 10.0)) == pytest.approx([104.0**0.5] * 2)
    assert height_sigmas(feed, record, 90.0, 108, 110, SentFix(108.0, 1.0)) == pytest.approx([104.0**0.5] * 2)
    feed.measure(position(110.0, boot_s=20.0), record)  # its own receiver is back, and sets it right
    assert height_sigmas(feed, record, 90.0, 111, 113, SentFix(108.0, 1.0)) == [2.0, 2.0]


def test_a_height_told_before_the_first_fix_of_ours_is_the_barometers_until_the_autopilot_reboots():
    feed, record = Builder(has_frame=True), vehicle()
    assert height_sigmas(feed, record, 20.0, 100, 103) == [2.0] * 3
    assert height_sigmas(feed, record, 20.0, 106, 109, SentFix(105.0, 10.0)) == [2.0] * 3
    assert height_sigmas(feed, record, 120.0, 136, 140, SentFix(135.0, 10.0))[-1] == pytest.approx(104.0**0.5)


@pytest.mark.parametrize("step_s", [-3.0, 3.0, 2**32 / 1e3])
def test_a_clock_that_steps_or_wraps_during_aid_does_not_cost_the_height(step_s):
    feed, record = Builder(has_frame=True), vehicle()
    booted_at_s = 110.0 - 2**32 / 1e3 if step_s > 10.0 else 90.0
    assert height_sigmas(feed, record, booted_at_s, 100, 110) == [2.0] * 10
    assert set(height_sigmas(feed, record, booted_at_s + step_s, 110, 120, SentFix(109.0, 10.0))) == {2.0}


def test_altitude_is_brought_down_by_the_earths_curvature_at_the_last_known_place():
    feed = Builder(has_frame=True)
    measurement = feed.measure(position(1.0), vehicle(), trusted=False, located_enu_m=(0.0, 20_000.0))
    assert isinstance(measurement, AltitudeMeasurement)
    assert measurement.up_m == pytest.approx(30.0 - 20_000.0**2 / (2 * 6.37e6), abs=0.2)


def test_there_is_no_height_before_anything_tells_where_the_vehicle_is():
    assert Builder(has_frame=True).measure(position(1.0), vehicle(), trusted=False) is None


def test_a_vehicle_never_located_is_about_where_the_one_is_that_it_ranges_with():
    feed, peer = Builder(has_frame=True), vehicle(1)
    feed.measure(replace(position(1.0), sysid=1, lat_deg=47.36), peer)  # 40 km north of the origin
    feed.measure_range(PeerRange(4, 1.0, 1, 800.0, 1.0, None, TimeBase.SERVICE, None, None, 0), vehicle(), peer)
    measurement = feed.measure(position(1.1), vehicle(), trusted=False)
    assert isinstance(measurement, AltitudeMeasurement)
    assert measurement.up_m == pytest.approx(30.0 - 40_030.0**2 / (2 * 6.37e6), abs=0.5)
    assert measurement.sigma_m == pytest.approx((2.0**2 + (40_030.0 * 803.0 / 6.371e6) ** 2) ** 0.5, rel=0.01)


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
    feed = Builder()
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
    feed, record = Builder(), vehicle()
    record.winged, record.airspeed, record.position = winged, Airspeed(4, 10.0, 22.0), position(10.0, alt_m=3000.0)
    measurement = feed.attitude(Attitude(4, 10.1, 10.1, 0.1, 0.2, 0.3), record)
    assert measurement is not None
    assert measurement.airspeed_mps == airspeed_mps


def test_a_jumping_clock_is_refused_and_counted():
    feed = Builder()
    record = vehicle()
    feed.measure(position(1.0), record)
    assert feed.measure(position(1.1, boot_s=1e6), record) is None
    assert feed.clocks.refused == {CoreRefusal.POSITION_CLOCK_JUMPED: 1}


def range_message(at_s: float, stamp_s: float | None, base: TimeBase, device: int = 0) -> PeerRange:
    return PeerRange(4, at_s, 1, 100.0, 0.5, stamp_s, base, 1, None, device)


def test_boot_unix_and_unstamped_ranges_each_find_the_service_clock():
    feed = Builder()
    record = vehicle()
    known = vehicle(sysid=1)
    for i in range(5):
        at_s = 100.0 + i
        late_s = 0.2 if i == 4 else 0.0
        boot = feed.measure_range(range_message(at_s + late_s, 7.0 + i, TimeBase.BOOT), record, known)
        unix = feed.measure_range(range_message(at_s + late_s, 1.7e9 + i, TimeBase.UNIX), record, known)
        none = feed.measure_range(range_message(at_s + late_s, None, TimeBase.BOOT), record, known)
        assert boot is not None
        assert unix is not None
        assert none is not None
        assert boot.measured_at_s == pytest.approx(at_s)
        assert unix.measured_at_s == pytest.approx(at_s)
        assert none.measured_at_s == at_s + late_s
        assert (boot.clock_of, unix.clock_of, none.clock_of) == (4, 4, None)


@pytest.mark.parametrize(("delay_s", "at_s", "sigma_s"), [(None, 100.0, 0.05), (-0.01, 100.0, 0.05), (0.3, 99.7, 0.158)])
def test_an_unstamped_range_is_as_old_as_its_vehicles_newest_position_was(delay_s, at_s, sigma_s):
    measured = FleetClocks().range_time(range_message(100.0, None, TimeBase.BOOT), delay_s)
    assert measured is not None
    assert measured == pytest.approx((at_s, sigma_s), abs=1e-3)


def test_the_clocks_of_one_vehicles_ranging_devices_are_bounded():
    feed = Builder()
    record = vehicle()
    for device in range(40):
        feed.measure_range(range_message(1.0, 1.0, TimeBase.BOOT, device), record, vehicle(sysid=1))
    assert feed.clocks.refused == {CoreRefusal.RANGE_CLOCKS_FULL: 24}


def test_the_range_error_holds_the_peers_own_and_follows_slowly():
    feed = Builder()
    record, peer = vehicle(), vehicle(sysid=1)
    peer.receiver = gps(1.2)
    feed.measure_range(range_message(1.0, None, TimeBase.BOOT), record, peer)
    assert feed.range_sigma_m(4) == pytest.approx(1.3)  # 0.5 and 1.2
    peer.receiver = gps(12.0)
    feed.measure_range(range_message(1.1, None, TimeBase.BOOT), record, peer)
    assert feed.range_sigma_m(4) == pytest.approx(1.3 + 0.1 * (12.0104 - 1.3), abs=1e-3)


def test_the_range_error_is_known_of_the_vehicle_that_others_measure_too():
    feed = Builder()
    record, peer = vehicle(), vehicle(sysid=1)
    record.receiver, peer.receiver = gps(12.0), gps(1.2)
    feed.measure_range(range_message(1.0, None, TimeBase.BOOT), record, peer)
    assert feed.range_sigma_m(4) == pytest.approx(1.3)
    assert feed.range_sigma_m(1) == pytest.approx(12.0104, abs=1e-3)


def test_a_range_is_free_of_the_lasting_errors_of_both_devices():
    feed = Builder(has_frame=True)
    raw = feed.measure_range(range_message(1.0, None, TimeBase.SERVICE), vehicle(), vehicle(1))
    feed.settings = MeasurementSettings(range_bias_m={4: 0.5, 1: -0.2, 9: 7.0}, range_scale={1: 0.01})
    calibrated = feed.measure_range(range_message(1.1, None, TimeBase.SERVICE), vehicle(), vehicle(1))
    assert raw is not None
    assert calibrated is not None
    assert calibrated.range_m == pytest.approx((raw.range_m - 0.3) / 1.01)


@pytest.mark.parametrize("wrong", [{"range_bias_m": {300: 0.1}}, {"range_scale": {4: 1.01}}, {"range_bias_m": {4: float("nan")}}])
def test_a_calibration_that_cannot_be_is_refused(wrong):
    with pytest.raises(ValueError, match="range_"):
        MeasurementSettings(**wrong)


def with_barometer(own_gps_until_s: float) -> Builder:
    """Vehicles 1 and 4 with barometers, 30 s long; 4 reports its position while it has GPS."""
    feed = Builder(has_frame=True)
    for tenth in range(300):
        t = tenth / 10
        for sysid in (1, 4):
            feed.pressure(Pressure(sysid, t, t, 950.0), is_trusted=sysid == 1 or t < own_gps_until_s)
            if sysid == 1 or t < own_gps_until_s:
                feed.measure(replace(position(t, 540.0), sysid=sysid), vehicle(sysid))
    return feed


def test_the_height_of_an_aided_vehicle_is_its_barometers_and_not_what_its_autopilot_makes_of_our_fix():
    """The autopilot says 12 m too high, as it does when it fuses what we sent."""
    feed = with_barometer(own_gps_until_s=25.0)
    assert feed.measure(position(30.0, 552.0), vehicle(), trusted=False) is None
    height = feed.pressure(Pressure(4, 30.1, 30.1, 950.0), is_trusted=False, located_enu_m=(0.0, 0.0))
    assert height is not None
    assert height.up_m == pytest.approx(40.0, abs=0.2)
    assert height.sigma_m == pytest.approx(2.0, abs=0.1)


def test_a_vehicle_that_never_had_gps_and_reports_no_position_has_a_height():
    """PX4 sends no GLOBAL_POSITION_INT before its first fix."""
    pressure = Pressure(4, 30.0, 30.0, 950.0)
    height = with_barometer(own_gps_until_s=0.0).pressure(pressure, is_trusted=False, located_enu_m=(0.0, 0.0))
    assert height is not None
    assert height.up_m == pytest.approx(40.0, abs=0.2)
    assert height.sigma_m > 8.0


def test_where_the_barometer_falls_silent_the_height_is_the_autopilots_again():
    feed = with_barometer(own_gps_until_s=25.0)
    measurement = feed.measure(position(35.0, 541.0), vehicle(), trusted=False, located_enu_m=(0.0, 0.0))
    assert isinstance(measurement, AltitudeMeasurement)
    assert measurement.up_m == pytest.approx(41.0, abs=0.2)
