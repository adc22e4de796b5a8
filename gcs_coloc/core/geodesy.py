"""Geodesy: WGS 84 coordinates to and from a local east-north-up frame.

The conversion is exact, as it goes through earth-centred coordinates.

Heights are taken as ellipsoidal. The service feeds heights above mean sea level: the geoid's undulation is then a
constant of the whole fleet and cancels, but for a scale error of undulation / earth radius (below 2e-5).

Source: closed formulas of the WGS 84 ellipsoid; the inverse by Bowring's method with two refinements (below 1e-6 m up to
100 km height).
"""

from __future__ import annotations

from math import atan2, cos, degrees, dist, hypot, radians, sin, sqrt

from gcs_coloc.core.measurements import Vector3

_SEMI_MAJOR_M = 6378137.0  # Source: WGS 84 (NIMA TR8350.2), defining parameter a
_FLATTENING = 1.0 / 298.257223563  # Source: WGS 84, defining parameter 1/f
_SEMI_MINOR_M = _SEMI_MAJOR_M * (1.0 - _FLATTENING)  # b, derived from a and f
_E2 = _FLATTENING * (2.0 - _FLATTENING)  # first eccentricity squared, derived from f
_EP2 = _E2 / (1.0 - _E2)  # second eccentricity squared, derived from the first


def geodetic_to_ecef(lat_deg: float, lon_deg: float, height_m: float) -> Vector3:
    """Return earth-centred, earth-fixed x, y, z (m) of latitude, longitude (degrees) and height (m)."""
    lat, lon = radians(lat_deg), radians(lon_deg)
    sin_lat = sin(lat)
    normal_m = _SEMI_MAJOR_M / sqrt(1.0 - _E2 * sin_lat * sin_lat)
    horizontal_m = (normal_m + height_m) * cos(lat)
    return horizontal_m * cos(lon), horizontal_m * sin(lon), (normal_m * (1.0 - _E2) + height_m) * sin_lat


def ecef_to_geodetic(x_m: float, y_m: float, z_m: float) -> Vector3:
    """Return the geodetic latitude, longitude (degrees) and height (m) of earth-centred coordinates (m)."""
    p_m = hypot(x_m, y_m)
    beta = atan2(z_m * _SEMI_MAJOR_M, p_m * _SEMI_MINOR_M)
    lat = 0.0
    for _ in range(3):
        lat = atan2(z_m + _EP2 * _SEMI_MINOR_M * sin(beta) ** 3, p_m - _E2 * _SEMI_MAJOR_M * cos(beta) ** 3)
        beta = atan2((1.0 - _FLATTENING) * sin(lat), cos(lat))
    sin_lat, cos_lat = sin(lat), cos(lat)
    normal_m = _SEMI_MAJOR_M / sqrt(1.0 - _E2 * sin_lat * sin_lat)
    height_m = p_m * cos_lat + z_m * sin_lat - _SEMI_MAJOR_M * _SEMI_MAJOR_M / normal_m
    return degrees(lat), degrees(atan2(y_m, x_m)), height_m


def horizontal_distance_m(a_lat_deg: float, a_lon_deg: float, b_lat_deg: float, b_lon_deg: float) -> float:
    """Return the straight distance (m) of two places on the ellipsoid; below 3 km the arc is as long."""
    return dist(geodetic_to_ecef(a_lat_deg, a_lon_deg, 0.0), geodetic_to_ecef(b_lat_deg, b_lon_deg, 0.0))


class LocalFrame:
    """The fleet's east-north-up frame about an origin, with its rotation prepared."""

    def __init__(self, lat_deg: float, lon_deg: float, height_m: float) -> None:
        self.lat_deg, self.lon_deg, self.height_m = lat_deg, lon_deg, height_m
        self._origin = geodetic_to_ecef(lat_deg, lon_deg, height_m)
        self._axes = _enu_axes(lat_deg, lon_deg)

    def enu_from_geodetic(self, lat_deg: float, lon_deg: float, height_m: float) -> Vector3:
        """Return the east, north, up coordinates (m) of a place in degrees and m."""
        x, y, z = geodetic_to_ecef(lat_deg, lon_deg, height_m)
        ox, oy, oz = self._origin
        return _rotate(self._axes, (x - ox, y - oy, z - oz))

    def geodetic_from_enu(self, east_m: float, north_m: float, up_m: float) -> Vector3:
        """Return the geodetic latitude, longitude (degrees) and height (m) of east, north, up coordinates."""
        dx, dy, dz = _rotate_back(self._axes, (east_m, north_m, up_m))
        ox, oy, oz = self._origin
        return ecef_to_geodetic(ox + dx, oy + dy, oz + dz)

    def enu_from_ned_velocity(self, lat_deg: float, lon_deg: float, ned: Vector3) -> Vector3:
        """Return a velocity in the frame's axes, from north, east, down (m/s) at a place (degrees)."""
        vn, ve, vd = ned
        return _rotate(self._axes, _rotate_back(_enu_axes(lat_deg, lon_deg), (ve, vn, -vd)))

    def ned_from_enu_velocity(self, lat_deg: float, lon_deg: float, enu: Vector3) -> Vector3:
        """Return a velocity in north, east, down (m/s) at a place (degrees), from the frame's axes."""
        ve, vn, vu = _rotate(_enu_axes(lat_deg, lon_deg), _rotate_back(self._axes, enu))
        return vn, ve, -vu

    def up_from_height(self, east_m: float, north_m: float, height_m: float) -> float:
        """Return the up coordinate of a height (m) over a place: the earth falls away from the frame's plane."""
        up_m = height_m - self.height_m
        for _ in range(2):
            up_m += height_m - self.geodetic_from_enu(east_m, north_m, up_m)[2]
        return up_m


_Axes = tuple[Vector3, Vector3, Vector3]


def _enu_axes(lat_deg: float, lon_deg: float) -> _Axes:
    sin_lat, cos_lat = sin(radians(lat_deg)), cos(radians(lat_deg))
    sin_lon, cos_lon = sin(radians(lon_deg)), cos(radians(lon_deg))
    return (
        (-sin_lon, cos_lon, 0.0),
        (-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat),
        (cos_lat * cos_lon, cos_lat * sin_lon, sin_lat),
    )


def _rotate(axes: _Axes, v: Vector3) -> Vector3:
    (a, b, c), (d, e, f), (g, h, i) = axes
    x, y, z = v
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def _rotate_back(axes: _Axes, v: Vector3) -> Vector3:
    (a, b, c), (d, e, f), (g, h, i) = axes
    x, y, z = v
    return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z
