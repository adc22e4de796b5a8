"""Stations in the engine, with the real estimator: they locate, their error is not averaged away, and a wrong one is named."""

from __future__ import annotations

from dataclasses import replace
from math import cos, dist, sin

import numpy as np
import pytest
from engine_flights import fly, settings, telemetry, texts, vehicle_4
from recorded_flight import early_loss, write_flight
from station_flights import FRAME, PLACES, configured, error_m, fly_with_ranges, ranges

from gcs_coloc.config.fleets import load_settings
from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.measurements import RangeMeasurement
from gcs_coloc.core.messages.inbound import Attitude, GlobalPosition, GpsReceiver, PeerRange, TimeBase
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.core.stations.node_id import station_node
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.evaluation.calibration import calibrate as calibrate_devices
from gcs_coloc.recorder.flight_history import read_history
from sitl_fakes.geodesy import WorldFrame
from sitl_fakes.scenario import load_scenario


def test_a_vehicle_alone_is_located_by_stations_with_the_numbers_of_vehicles():
    engine = Engine(FleetFilter(), settings(stations=configured(sigma_m=0.1)))
    rng = np.random.default_rng(1)
    fly_with_ranges(engine, 0.0, 8.0, rng)
    fly_with_ranges(engine, 8.0, 40.0, rng, failed=(4,))
    assert engine.sysids() == [4]
    assert engine.gps_state(4) is GpsState.FAILED
    off_m, _ = error_m(engine, 40.0)
    assert off_m < 1.0
    view = vehicle_4(engine, 40.0)
    assert view.ranges_in_use == 4
    assert {r.to_sysid for r in engine.snapshot(40.0).ranges} == {station_node(i) for i in PLACES}


def test_an_error_of_the_stations_lasts_and_is_not_averaged_away():
    """All stations 5 m too far east, as their sigma allows: the position is off by that, and so its sigma must stay."""
    off = dict.fromkeys(PLACES, 5.0)
    engine = Engine(FleetFilter(), settings(stations=configured(sigma_m=5.0, moved=off)))
    rng = np.random.default_rng(2)
    fly_with_ranges(engine, 0.0, 70.0, rng, failed=(4,))
    off_m, sigma_m = error_m(engine, 70.0)
    assert 2.0 < off_m < 8.0
    assert sigma_m > 2.0  # four stations of 5 m; a thousand ranges of 0.3 m, taken as white, would leave centimetres
    assert off_m < 2.45 * sigma_m


def test_a_fleet_that_never_had_gps_gets_its_origin_from_a_station():
    engine = Engine(FleetFilter(), settings(stations=configured()))
    fly_with_ranges(engine, 0.0, 9.0, np.random.default_rng(3), failed=(4,))
    assert engine.frame is None
    fly_with_ranges(engine, 9.0, 40.0, np.random.default_rng(4), failed=(4,))
    assert engine.frame is not None
    assert (engine.frame.lat_deg, engine.frame.lon_deg) == configured()[3].position[:2]  # station 0, the first by its id
    off_m, _ = error_m(engine, 40.0)
    assert off_m < 5.0


def test_a_station_at_a_wrong_position_is_named_and_no_sound_vehicle_is_suspect():
    engine = Engine(FleetFilter(), settings(stations=configured(moved={2: 60.0})))
    rng = np.random.default_rng(5)
    out = fly_with_ranges(engine, 0.0, 25.0, rng, sysids=(1, 2, 3, 4), ranging=(1, 2, 3, 4))
    notices = [o for _, o in out if isinstance(o, Notice) and o.sysid is None]
    assert [o.level for o in notices] == ["error"]
    assert "station 2 (mast 2)" in notices[0].text
    assert {sysid: engine.gps_state(sysid) for sysid in engine.sysids()} == dict.fromkeys((1, 2, 3, 4), GpsState.HEALTHY)
    stations = {s.station_id: s for s in engine.snapshot(25.0).stations}
    assert not stations[2].is_used
    assert all(stations[i].is_used and stations[i].fault is None for i in (0, 1, 3))
    fly_with_ranges(engine, 25.0, 45.0, rng, sysids=(1, 2, 3, 4), ranging=(1, 2, 3, 4), failed=(4,))
    off_m, sigma_m = error_m(engine, 45.0)
    assert off_m < 2.45 * sigma_m < 5.0


def test_a_spoofed_vehicle_is_named_by_stations_alone():
    engine = Engine(FleetFilter(), settings(stations=configured(sigma_m=0.5)))
    rng = np.random.default_rng(6)
    fly_with_ranges(engine, 0.0, 10.0, rng)
    for step in range(100, 200):
        t = step / 10
        for message in telemetry(4, t):
            if hasattr(message, "lat_deg"):
                message = replace(message, lat_deg=message.lat_deg + 0.002)
            engine.receive(message)
        if step % 2 == 0:
            for message in ranges(4, t, rng):
                engine.receive(message)
        while engine.next_deadline() < t + 0.1:
            engine.poll(max(engine.next_deadline(), t))
    assert engine.gps_state(4) is GpsState.FAILED
    assert all(s.is_used for s in engine.snapshot(20.0).stations)


def test_a_range_to_a_station_without_a_position_is_told_with_the_remedy():
    engine = Engine(FleetFilter(), EngineSettings(request_streams=False))
    fly(engine, 0.0, 2.0, sysids=(4,))
    out = fly_with_ranges(engine, 2.0, 4.0, np.random.default_rng(7), station_ids=(2,))
    assert [t for t in texts(out) if "station 2" in t] == [
        "it ranges station 2, which has no position: give it one in [[station]]"
    ]
    assert engine.refused()["station_unknown"] == 10


@pytest.mark.parametrize("sigma_m", [0.1, 3.0])
def test_the_snapshot_has_every_station_with_its_place(sigma_m):
    engine = Engine(FleetFilter(), settings(stations=configured(sigma_m)))
    fly_with_ranges(engine, 0.0, 5.0, np.random.default_rng(8))
    stations = engine.snapshot(5.0).stations
    assert [s.station_id for s in stations] == [0, 1, 2, 3]
    for s in stations:
        assert s.enu_m == pytest.approx(engine.frame.enu_from_geodetic(s.lat_deg, s.lon_deg, s.alt_msl_m))
        assert s.sigma_h_m == sigma_m
        assert 0.0 <= s.range_age_s < 0.5


def test_the_lasting_error_of_a_stations_device_is_taken_off():
    stations = tuple(replace(s, range_bias_m=2.0 if s.station_id == 1 else 0.0, range_scale=0.01) for s in configured())
    engine, taken = Engine(FleetFilter(), settings(stations=stations)), []
    add = engine.estimator.add
    engine.estimator.add = lambda m: taken.append(m) or add(m)
    fly_with_ranges(engine, 0.0, 3.0, np.random.default_rng(9), station_ids=(1, 2))
    found = {m.to_vehicle: m for m in taken if isinstance(m, RangeMeasurement) and m.measured_at_s == 2.0}
    sent = {m.peer: m.range_m for m in ranges(4, 2.0, _same_noise(2.0), (1, 2))}
    assert {node: m.range_m for node, m in found.items()} == pytest.approx(
        {node: (range_m - (2.0 if node == station_node(1) else 0.0)) / 1.01 for node, range_m in sent.items()}
    )


def _same_noise(until_s: float):
    """The noise of a flight from its beginning, two ranges each 0.2 s, up to a time."""
    rng = np.random.default_rng(9)
    rng.normal(0.0, 1.0, 2 * round(until_s / 0.2))
    return rng


def test_a_recorded_flight_with_stations_is_replayed_the_same_and_can_be_reported_and_calibrated(tmp_path):
    file = tmp_path / "flight.tlog"
    write_flight(file, 26.0, early_loss("stations", 20.0))
    chosen = load_settings(None, {"station": [stated(s) for s in load_scenario("stations").station]})
    histories = [read_history(file, chosen, None, None) for _ in range(2)]
    tracks = [[(e.at_s, e.vehicle.enu_m, e.vehicle.covariance_h_m2) for e in h.tracks[4]] for h in histories]
    assert tracks[0] == tracks[1]
    assert {s.station_id for s in histories[0].stations.values()} == {1, 2, 3, 4}
    recorded = histories[0].recorded
    assert {recorded.names[station_node(i)] for i in (1, 2, 3, 4)} == {f"station {i}" for i in (1, 2, 3, 4)}
    assert not [f for f in histories[0].findings if "station" in str(f)]
    devices = calibrate_devices(recorded).devices
    assert {d.vehicle for d in devices} == {4, *(station_node(i) for i in (1, 2, 3, 4))}
    assert max(abs(d.bias_m) for d in devices) < 1.0


def stated(station):
    o = load_scenario("stations").origin
    frame = WorldFrame(o.lat_deg, o.lon_deg, o.alt_msl_m, o.geoid_height_m)
    lat_deg, lon_deg, alt_m = frame.to_lla(station.east_m, station.north_m, station.height_m)
    return {"id": station.id, "lat_deg": lat_deg, "lon_deg": lon_deg, "alt_m": alt_m, "sigma_m": 0.1}


def test_a_station_without_position_is_surveyed_by_vehicles_with_gps_and_locates_nobody():
    engine = Engine(FleetFilter(), settings())
    rng = np.random.default_rng(5)
    where, told = PLACES[2], []
    for step in range(2000):
        t = step / 10
        at = (900.0 + 300.0 * cos(t / 15.0), 100.0 + 300.0 * sin(t / 15.0), 120.0 + 60.0 * sin(t / 23.0))
        lat, lon, alt = FRAME.geodetic_from_enu(*at)
        speed = {"vn_mps": 20.0 * cos(t / 15.0), "ve_mps": -20.0 * sin(t / 15.0), "vd_mps": -60.0 / 23.0 * cos(t / 23.0)}
        for message in telemetry(1, t, 3):
            if isinstance(message, GlobalPosition):
                message = replace(message, lat_deg=lat, lon_deg=lon, alt_msl_m=alt, **speed)
            if isinstance(message, GpsReceiver):
                message = replace(message, lat_deg=lat, lon_deg=lon, alt_msl_m=alt)
            if not isinstance(message, Attitude):
                engine.receive(message)
        engine.receive(
            PeerRange(1, t, station_node(2), dist(at, where) + rng.normal(0.0, 0.3), 0.3, t, TimeBase.SERVICE, None, None, 0)
        )
        while engine.next_deadline() < t + 0.1:
            told += [o for o in engine.poll(max(engine.next_deadline(), t)) if isinstance(o, Notice) and "surveyed" in o.text]
    assert told
    assert "[[station]] id = 2, lat_deg = " in told[-1].text
    (station,) = engine.snapshot(200.0).stations
    off_m = dist(FRAME.enu_from_geodetic(station.lat_deg, station.lon_deg, station.alt_msl_m), where)
    assert off_m < 3.0 * max(station.sigma_h_m, station.sigma_v_m) < 15.0
    assert (station.source, station.is_used) == ("surveyed", False)
    assert engine.snapshot(200.0).ranges == ()
