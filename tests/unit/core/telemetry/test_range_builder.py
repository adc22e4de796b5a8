"""Ranges: on which clock, with which noise, free of which errors, and what is refused."""

import pytest
from built_measurements import Builder, gps, range_message, vehicle

from gcs_coloc.core.clocks.fleet_clocks import FleetClocks
from gcs_coloc.core.messages.inbound import PeerRange, TimeBase
from gcs_coloc.core.reasons import CoreRefusal
from gcs_coloc.core.telemetry.measurement_settings import MeasurementSettings


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


def test_forged_device_ids_keep_a_new_device_out_for_half_a_minute_and_a_known_one_never():
    clocks = FleetClocks()

    def is_known(at_s, device):
        return clocks.range_time(range_message(at_s, at_s, TimeBase.BOOT, device), None) is not None

    assert all(is_known(float(at_s), 1) for at_s in range(62))
    assert all(is_known(62.0, forged) for forged in range(100, 115))
    assert not is_known(90.0, 2)
    # Now all are silent, the known one for longest; the forged ones make room.
    assert all(is_known(92.0, new) for new in range(2, 17))
    assert is_known(92.1, 1)
    assert not is_known(92.2, 17)


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
    settings = MeasurementSettings(range_bias_m={4: 0.5, 1: -0.2, 9: 7.0}, range_scale={1: 0.01})
    message = range_message(1.0, None, TimeBase.SERVICE)
    raw = Builder(has_frame=True).measure_range(message, vehicle(), vehicle(1))
    calibrated = Builder(settings=settings, has_frame=True).measure_range(message, vehicle(), vehicle(1))
    assert raw is not None
    assert calibrated is not None
    assert calibrated.range_m == pytest.approx((raw.range_m - 0.3) / 1.01)


@pytest.mark.parametrize("wrong", [{"range_bias_m": {300: 0.1}}, {"range_scale": {4: 1.01}}, {"range_bias_m": {4: float("nan")}}])
def test_a_calibration_that_cannot_be_is_refused(wrong):
    with pytest.raises(ValueError, match="range_"):
        MeasurementSettings(**wrong)


def test_a_range_on_a_way_around_is_refused_and_counted_while_those_to_another_peer_are_used():
    feed, record, peers = Builder(), vehicle(), {1: vehicle(1), 2: vehicle(2)}
    used = []
    for k in range(30):
        for peer, reported in peers.items():
            at_s, around_m = 0.2 * k + 0.05 * peer, 25.0 if peer == 1 and 10 <= k < 20 else 0.0
            message = PeerRange(4, at_s, peer, 100.0 + around_m + 0.01 * k, 0.5, None, TimeBase.SERVICE, k, None, 0)
            if feed.measure_range(message, record, reported) is not None:
                used.append((peer, k))
    assert [k for peer, k in used if peer == 2] == list(range(30))
    assert [k for peer, k in used if peer == 1] == [*range(10), *range(21, 30)]
    assert feed.refused == {CoreRefusal.RANGE_JUMPED: 11}
