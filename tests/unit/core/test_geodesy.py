"""The fleet's frame against pyproj, an independent implementation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Transformer

from gcs_coloc.core.geodesy import LocalFrame, ecef_to_geodetic, geodetic_to_ecef

ORIGINS = [
    (47.3977, 8.5456, 488.0),
    (-35.3632, 149.1652, 584.0),
    (0.0, 179.9999, 0.0),
    (78.2, 15.6, 10.0),
    (-60.0, -179.99, 3000.0),
]
LAT = st.floats(-89.5, 89.5)
LON = st.floats(-180.0, 180.0)
HEIGHT = st.floats(-400.0, 20_000.0)


def topocentric(origin: tuple[float, float, float]) -> Transformer:
    lat, lon, height = origin
    return Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lat_0={lat} +lon_0={lon} +h_0={height}"
    )


@pytest.mark.parametrize("origin", ORIGINS)
def test_enu_agrees_with_pyproj_within_a_tenth_of_a_millimetre(origin):
    oracle = topocentric(origin)
    frame = LocalFrame(*origin)
    rng = np.random.default_rng(1)
    for dlat, dlon, dh in rng.uniform((-0.5, -0.5, -100), (0.5, 0.5, 3000), (50, 3)):
        lat, lon, height = origin[0] + dlat, origin[1] + dlon, origin[2] + dh
        assert frame.enu_from_geodetic(lat, lon, height) == pytest.approx(oracle.transform(lon, lat, height), abs=1e-4)


@given(lat=LAT, lon=LON, height=HEIGHT)
def test_ecef_round_trip(lat, lon, height):
    back_lat, back_lon, back_height = ecef_to_geodetic(*geodetic_to_ecef(lat, lon, height))
    assert back_lat == pytest.approx(lat, abs=1e-10)
    assert np.cos(np.radians(back_lon - lon)) == pytest.approx(1.0, abs=1e-15)
    assert back_height == pytest.approx(height, abs=1e-5)


@pytest.mark.parametrize("origin", ORIGINS)
def test_enu_round_trip(origin):
    frame = LocalFrame(*origin)
    for enu in [(0.0, 0.0, 0.0), (1e4, -2e4, 300.0), (-5e4, 5e4, -100.0)]:
        assert frame.enu_from_geodetic(*frame.geodetic_from_enu(*enu)) == pytest.approx(enu, abs=1e-5)


def test_velocity_is_the_derivative_of_position():
    frame = LocalFrame(60.0, 10.0, 100.0)
    lat, lon, height = 60.2, 10.5, 400.0
    there = LocalFrame(lat, lon, height)
    vn, ve, vd, dt = 12.0, -30.0, 4.0, 1e-2
    before = frame.enu_from_geodetic(*there.geodetic_from_enu(-ve * dt / 2, -vn * dt / 2, vd * dt / 2))
    after = frame.enu_from_geodetic(*there.geodetic_from_enu(ve * dt / 2, vn * dt / 2, -vd * dt / 2))
    numeric = [(b - a) / dt for a, b in zip(before, after, strict=True)]
    assert frame.enu_from_ned_velocity(lat, lon, (vn, ve, vd)) == pytest.approx(numeric, abs=1e-4)
    assert frame.ned_from_enu_velocity(lat, lon, frame.enu_from_ned_velocity(lat, lon, (vn, ve, vd))) == pytest.approx(
        (vn, ve, vd)
    )


def test_up_of_a_height_allows_for_the_earths_curvature():
    frame = LocalFrame(45.0, 7.0, 300.0)
    east, north, up = frame.enu_from_geodetic(45.1, 7.1, 500.0)
    assert up < 200.0 - 10.0  # 13.6 km away the surface has fallen by about 14 m
    assert frame.up_from_height(east, north, 500.0) == pytest.approx(up, abs=1e-3)
