"""The fakes' frame conversions against pyproj (PROJ), which shares nothing with them."""

from __future__ import annotations

import math

import numpy as np
import pyproj
import pytest

from sitl_fakes.geodesy import WorldFrame

PLACES = [(47.0, 8.0, 500.0, 48.0), (-35.36, 149.165, 584.0, 0.0), (0.0, 0.0, 0.0, 17.0), (69.5, -179.9, 20.0, -30.0)]


@pytest.mark.parametrize("place", PLACES)
def test_enu_to_lla_agrees_with_proj(place):
    lat, lon, alt, geoid = place
    frame = WorldFrame(lat, lon, alt, geoid)
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    oracle = pyproj.Transformer.from_pipeline(f"+proj=topocentric +ellps=WGS84 +lon_0={lon} +lat_0={lat} +h_0={alt + geoid}")
    rng = np.random.default_rng(1)
    for east, north, up in rng.uniform([-20e3, -20e3, -200], [20e3, 20e3, 2000], (50, 3)):
        got_lat, got_lon, got_alt = frame.to_lla(east, north, up)
        back = oracle.transform(*to_ecef.transform(got_lon, got_lat, got_alt + geoid))
        assert np.allclose(back, (east, north, up), rtol=0.0, atol=1e-6)
        assert np.allclose(frame.to_enu(got_lat, got_lon, got_alt), (east, north, up), rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("place", PLACES)
def test_a_local_velocity_is_the_motion_of_latitude_longitude_and_altitude(place):
    frame = WorldFrame(*place)
    geod = pyproj.Geod(ellps="WGS84")
    at, v = np.array([12e3, -7e3, 300.0]), np.array([20.0, 30.0, 2.0])
    lat0, lon0, alt0 = frame.to_lla(*(at - 0.5 * v))
    lat1, lon1, alt1 = frame.to_lla(*(at + 0.5 * v))
    azimuth, _, distance = geod.inv(lon0, lat0, lon1, lat1)
    lat, lon, alt = frame.to_lla(*at)
    north, east, down = frame.vector_to_local_ned(tuple(v), lat, lon)
    scale = 1.0 + alt / 6.37e6
    assert north == pytest.approx(distance * math.cos(math.radians(azimuth)) * scale, abs=5e-3)
    assert east == pytest.approx(distance * math.sin(math.radians(azimuth)) * scale, abs=5e-3)
    assert down == pytest.approx(alt0 - alt1, abs=1e-3)
    assert frame.vector_from_local_ned((north, east, down), lat, lon) == pytest.approx(tuple(v), abs=1e-9)
    heading = math.atan2(v[0], v[1])
    assert frame.heading_to_local(heading, lat, lon) == pytest.approx(math.atan2(east, north), abs=2e-4)


def test_a_point_at_a_given_altitude_has_that_altitude_and_place():
    frame = WorldFrame(47.0, 8.0, 500.0, 48.0)
    lat, lon, alt = frame.to_lla_at(9e3, -4e3, 650.0)
    east, north, up = frame.to_enu(lat, lon, alt)
    assert (east, north) == pytest.approx((9e3, -4e3), abs=1e-3)
    assert alt == 650.0
    assert frame.to_lla(east, north, up)[2] == pytest.approx(650.0, abs=1e-6)
