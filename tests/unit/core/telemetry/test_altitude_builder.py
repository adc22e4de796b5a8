"""Altitudes: by the barometer or the autopilot, from which datum, and how well they are known."""

from dataclasses import replace

import pytest
from built_measurements import Builder, position, vehicle

from gcs_coloc.core.measurements import AltitudeMeasurement
from gcs_coloc.core.messages.inbound import PeerRange, Pressure, TimeBase
from gcs_coloc.core.telemetry.altitude_builder import SentFix
from gcs_coloc.core.telemetry.reported_state import ReportedState


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


@pytest.mark.parametrize(("wrong_for_s", "off_m"), [(5, 0.0), (80, 60.0)])
def test_a_height_that_jumps_after_a_pause_is_learnt_only_once_it_has_stayed(wrong_for_s, off_m):
    """An autopilot whose height is GPS's followed a spoofer: five seconds of trust put the barometer 50 m off."""
    feed = with_barometer(own_gps_until_s=17.0)
    for half_s in range(2 * wrong_for_s):
        t = 30.0 + half_s / 2
        feed.pressure(Pressure(4, t, t, 950.0), is_trusted=True)
        feed.measure(position(t, 600.0), vehicle())
    t = 30.0 + wrong_for_s
    height = feed.pressure(Pressure(4, t, t, 950.0), is_trusted=False, located_enu_m=(0.0, 0.0))
    assert height is not None
    assert height.up_m == pytest.approx(40.0 + off_m, abs=0.2)


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
