"""What is at the other end of a range: a vehicle, a configured station, or one that a RANGING_BEACON states."""

from __future__ import annotations

import math

import pytest

from gcs_coloc.core.messages.inbound import Beacon, BeaconPosition, GpsReceiver, PeerRange, TimeBase
from gcs_coloc.core.stations.node_id import is_station, node_name, station_id_of, station_node
from gcs_coloc.core.stations.stations import Station, StationPosition, Stations, StationSource

MAST = Station(3, "mast", StationPosition(47.0, 8.0, 500.0, 0.5, 0.5))


def beacon(beacon_id=3, position=None, sysid=4, at_s=1.0) -> PeerRange:
    node = station_node(beacon_id)
    return PeerRange(sysid, at_s, node, 100.0, 0.5, None, TimeBase.SERVICE, None, None, 0, Beacon(beacon_id, position))


def place(lat_deg=47.0, alt_m: float | None = 500.0, *, is_msl=True) -> BeaconPosition:
    return BeaconPosition(lat_deg, 8.0, alt_m, is_msl, 0.5, None)


def named(node, at_s=1.0) -> PeerRange:
    return PeerRange(4, at_s, node, 100.0, 0.5, None, TimeBase.SERVICE, None, None, 0)


def receiver(geoid_height_m, fix_type=3) -> GpsReceiver:
    return GpsReceiver(1, 0.0, 0, fix_type, 47.0, 8.0, 500.0, 10, 1.0, 1.0, 1.0, 0.3, None, geoid_height_m)


@pytest.mark.parametrize("station_id", [0, 1, 3, 255, 65_535])
def test_no_station_has_the_node_id_of_a_vehicle(station_id):
    node = station_node(station_id)
    assert is_station(node)
    assert station_id_of(node) == station_id
    assert not any(node == sysid for sysid in range(1, 256))
    assert node_name(node) == f"station {station_id}"


@pytest.mark.parametrize("position", [None, place()])
def test_a_beacon_is_a_station_and_never_the_vehicle_of_that_number(position):
    resolved = Stations([MAST]).resolve(beacon(position=position))
    assert resolved.message is not None
    assert resolved.message.peer == station_node(3)
    assert resolved.notice is None


def test_a_beacon_without_a_position_of_no_known_station_is_refused_once_a_minute_with_the_remedy():
    stations = Stations()
    told = [stations.resolve(beacon(at_s=t)) for t in (1.0, 2.0, 60.0, 62.0)]
    assert [one.message for one in told] == [None] * 4
    assert [one.notice is not None for one in told] == [True, False, False, True]
    assert told[0].notice is not None
    assert "ranging_beacon_ids" in told[0].notice.text
    assert "[[station]]" in told[0].notice.text
    assert stations.refused == {"ranging_beacon_without_position": 4}


def test_by_the_setting_a_beacon_without_a_position_is_a_vehicle_even_where_a_station_has_its_number():
    stations = Stations([MAST], "vehicles")
    resolved = stations.resolve(beacon())
    assert resolved.message is not None
    assert (resolved.message.peer, resolved.message.beacon) == (3, None)
    with_position = stations.resolve(beacon(position=place())).message
    assert with_position is not None
    assert with_position.peer == station_node(3)


def test_by_the_setting_an_id_beyond_one_byte_is_a_vehicles_too():
    resolved = Stations((), "vehicles").resolve(beacon(256)).message
    assert resolved is not None
    assert resolved.peer == 256


@pytest.mark.parametrize("beacon_id", [0, 4])
def test_by_the_setting_an_id_that_is_no_other_vehicles_is_refused(beacon_id):
    stations = Stations((), "vehicles")
    assert stations.resolve(beacon(beacon_id)).message is None
    assert stations.refused == {"ranging_beacon_no_vehicle": 1}


def test_a_beacon_that_states_its_position_becomes_a_station_there():
    stations = Stations()
    assert stations.resolve(beacon(position=place())).message is not None
    (station,) = stations
    assert station.source is StationSource.STATED
    assert station.position == StationPosition(47.0, 8.0, 500.0, 0.5, 8.0)  # no vertical accuracy: the default's
    assert stations.resolve(beacon(position=None)).message is not None


def test_the_configured_position_wins_and_a_contradiction_is_counted_and_told_once_a_minute():
    stations = Stations([MAST])
    told = [stations.resolve(beacon(position=place(lat_deg=47.001), at_s=t)) for t in (1.0, 2.0)]
    assert all(one.message is not None for one in told)
    assert [one.notice is not None for one in told] == [True, False]
    assert told[0].notice is not None
    assert "station 3 (mast) 111 m" in told[0].notice.text
    assert stations.refused == {"station_contradicted": 2}
    assert stations.get(station_node(3)) == MAST


def test_a_stated_position_within_its_accuracy_is_no_contradiction():
    stations = Stations([MAST])
    assert stations.resolve(beacon(position=place(lat_deg=47.00001))).notice is None  # 1.1 m, of 0.5 m each
    assert not stations.refused


def test_a_station_that_states_another_place_than_at_first_is_not_used():
    stations = Stations()
    stations.resolve(beacon(position=place()))
    moved = stations.resolve(beacon(position=place(lat_deg=47.01), at_s=2.0))
    assert moved.message is None
    assert moved.notice is not None
    assert stations.refused == {"station_contradicted": 1}


def test_a_height_above_the_ellipsoid_needs_a_receiver_that_knows_the_geoid():
    stations = Stations()
    refused = stations.resolve(beacon(position=place(alt_m=548.0, is_msl=False)))
    assert refused.message is None
    assert refused.notice is not None
    stations.add_receiver(receiver(40.0, fix_type=1))
    assert stations.resolve(beacon(position=place(alt_m=548.0, is_msl=False), at_s=2.0)).message is None
    stations.add_receiver(receiver(48.0))
    assert stations.resolve(beacon(position=place(alt_m=548.0, is_msl=False), at_s=3.0)).message is not None
    (station,) = stations
    assert station.position is not None
    assert station.position.alt_msl_m == pytest.approx(500.0)
    assert stations.refused == {"station_height_unknown": 2}


def test_a_beacon_without_a_height_is_refused_unless_its_station_is_configured():
    assert Stations().resolve(beacon(position=place(alt_m=None))).message is None
    assert Stations([MAST]).resolve(beacon(position=place(alt_m=None))).message is not None


def test_a_named_range_to_an_unknown_station_is_refused_with_the_remedy():
    stations = Stations([MAST])
    assert stations.resolve(named(station_node(3))).message is not None
    assert stations.resolve(named(3)).message is not None  # a vehicle
    unknown = stations.resolve(named(station_node(7)))
    assert unknown.message is None
    assert unknown.notice is not None
    assert "station 7" in unknown.notice.text
    assert stations.refused == {"station_unknown": 1}


def test_forged_stations_fill_no_memory_without_bound():
    stations = Stations()
    for beacon_id in range(600):
        stations.resolve(beacon(beacon_id, place(lat_deg=47.0 + beacon_id * 1e-4), at_s=1.0 + beacon_id))
    assert len(list(stations)) == 256
    assert stations.refused["stations_full"] == 344


def test_forged_beacons_keep_a_warning_back_for_a_minute_at_most():
    stations = Stations()
    told = [stations.resolve(beacon(beacon_id, at_s=1.0)).notice for beacon_id in range(300)]
    assert sum(notice is not None for notice in told) == 256
    assert stations.resolve(named(station_node(700), at_s=60.0)).notice is None
    assert stations.resolve(named(station_node(700), at_s=61.0)).notice is not None


def test_a_range_is_remembered_with_its_time():
    stations = Stations([MAST])
    assert stations.ranged_s(station_node(3)) is None
    stations.resolve(named(station_node(3), at_s=7.5))
    assert stations.ranged_s(station_node(3)) == 7.5
    assert math.isclose(stations.first_ranged_s or 0.0, 7.5)
