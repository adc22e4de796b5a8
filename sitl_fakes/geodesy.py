"""World geodesy of the fakes: from east-north-up metres to WGS 84 and back, by way of ECEF.

Written for the simulation alone; the service has its own. Formulas: geodetic to ECEF is exact; ECEF to geodetic is Bowring's
(1976) start followed by fixed-point steps, which agree with the exact answer to below a micrometre for heights under 100 km.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_A = 6378137.0  # m; source: WGS 84
_F = 1.0 / 298.257223563  # source: WGS 84
_E2 = _F * (2.0 - _F)
_PX4_RADIUS_M = 6_371_000.0  # source: PX4's CONSTANTS_RADIUS_OF_EARTH

Vector = tuple[float, float, float]


def geodetic_to_ecef(lat_deg: float, lon_deg: float, height_m: float) -> Vector:
    """ECEF coordinates (m) of a geodetic point; `height_m` is above the WGS 84 ellipsoid."""
    lat, lon = math.radians(lat_deg), math.radians(lon_deg)
    n = _A / math.sqrt(1.0 - _E2 * math.sin(lat) ** 2)
    horizontal = (n + height_m) * math.cos(lat)
    return horizontal * math.cos(lon), horizontal * math.sin(lon), (n * (1.0 - _E2) + height_m) * math.sin(lat)


def ecef_to_geodetic(x: float, y: float, z: float) -> Vector:
    """Return latitude (deg), longitude (deg) and ellipsoidal height (m) of an ECEF point (m).

    The point has to be away from the Earth's axis.
    """
    p = math.hypot(x, y)
    b = _A * (1.0 - _F)
    theta = math.atan2(z * _A, p * b)
    lat = math.atan2(z + _E2 / (1.0 - _E2) * b * math.sin(theta) ** 3, p - _E2 * _A * math.cos(theta) ** 3)
    for _ in range(2):
        sin_lat = math.sin(lat)
        n = _A / math.sqrt(1.0 - _E2 * sin_lat**2)
        lat = math.atan2(z + _E2 * n * sin_lat, p)
    sin_lat = math.sin(lat)
    height = p * math.cos(lat) + z * sin_lat - _A * math.sqrt(1.0 - _E2 * sin_lat**2)
    return math.degrees(lat), math.degrees(math.atan2(y, x)), height


def _enu_axes(lat_deg: float, lon_deg: float) -> NDArray[np.float64]:
    """Rotation (3, 3) whose rows are the east, north and up unit vectors of a place, in ECEF."""
    sin_lat, cos_lat = math.sin(math.radians(lat_deg)), math.cos(math.radians(lat_deg))
    sin_lon, cos_lon = math.sin(math.radians(lon_deg)), math.cos(math.radians(lon_deg))
    return np.array(
        [
            [-sin_lon, cos_lon, 0.0],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ]
    )


def from_px4_local(origin_lat_deg: float, origin_lon_deg: float, north_m: float, east_m: float) -> tuple[float, float]:
    """Return latitude and longitude (deg) of a place of PX4's local frame.

    PX4's projection is azimuthal equidistant on a sphere.

    Source: PX4's lib/geo, MapProjection::reproject.
    """
    lat_0, north, east = math.radians(origin_lat_deg), north_m / _PX4_RADIUS_M, east_m / _PX4_RADIUS_M
    arc = math.hypot(north, east)
    if arc == 0.0:
        return origin_lat_deg, origin_lon_deg
    sin_arc, cos_arc = math.sin(arc), math.cos(arc)
    lat = math.asin(cos_arc * math.sin(lat_0) + north * sin_arc * math.cos(lat_0) / arc)
    lon = math.atan2(east * sin_arc, arc * math.cos(lat_0) * cos_arc - north * math.sin(lat_0) * sin_arc)
    return math.degrees(lat), origin_lon_deg + math.degrees(lon)


class WorldFrame:
    """The simulation's east-north-up frame (m), tangent to the ellipsoid at its origin.

    `alt_msl_m` is the origin's altitude above mean sea level and `geoid_height_m` that of mean sea level above the
    ellipsoid, taken as constant over the scene.
    """

    def __init__(self, lat_deg: float, lon_deg: float, alt_msl_m: float, geoid_height_m: float = 0.0) -> None:
        self.geoid_height_m = geoid_height_m
        self._origin = geodetic_to_ecef(lat_deg, lon_deg, alt_msl_m + geoid_height_m)
        self._axes = _enu_axes(lat_deg, lon_deg)
        self._rows: list[list[float]] = self._axes.tolist()

    def to_lla(self, east_m: float, north_m: float, up_m: float) -> Vector:
        """Latitude (deg), longitude (deg) and altitude above mean sea level (m) of a point of the frame."""
        (e1, e2, e3), (n1, n2, n3), (u1, u2, u3) = self._rows
        ox, oy, oz = self._origin
        lat, lon, height = ecef_to_geodetic(
            ox + e1 * east_m + n1 * north_m + u1 * up_m,
            oy + e2 * east_m + n2 * north_m + u2 * up_m,
            oz + e3 * east_m + n3 * north_m + u3 * up_m,
        )
        return lat, lon, height - self.geoid_height_m

    def to_lla_at(self, east_m: float, north_m: float, alt_msl_m: float) -> Vector:
        """Return latitude (deg), longitude (deg) and altitude (m) of a point of known altitude.

        The point lies over (east, north).
        """
        up = alt_msl_m - self.to_lla(east_m, north_m, 0.0)[2]
        lat, lon, _ = self.to_lla(east_m, north_m, up)
        return lat, lon, alt_msl_m

    def to_enu(self, lat_deg: float, lon_deg: float, alt_msl_m: float) -> Vector:
        """East, north and up (m) of a geodetic point; the altitude is above mean sea level."""
        x, y, z = geodetic_to_ecef(lat_deg, lon_deg, alt_msl_m + self.geoid_height_m)
        ox, oy, oz = self._origin
        east, north, up = ((x - ox) * a + (y - oy) * b + (z - oz) * c for a, b, c in self._rows)
        return east, north, up

    def vector_to_local_ned(self, vector_enu: Vector, lat_deg: float, lon_deg: float) -> Vector:
        """Turn a vector of the frame into north, east, down of a place in it.

        The axes of both differ by the Earth's curvature.
        """
        east, north, up = (_enu_axes(lat_deg, lon_deg) @ (np.array(vector_enu) @ self._axes)).tolist()
        return north, east, -up

    def vector_from_local_ned(self, vector_ned: Vector, lat_deg: float, lon_deg: float) -> Vector:
        """Turn north, east, down of a place into a vector of the frame: the inverse of `vector_to_local_ned`."""
        north, east, down = vector_ned
        e, n, u = (self._axes @ (np.array([east, north, -down]) @ _enu_axes(lat_deg, lon_deg))).tolist()
        return e, n, u

    def heading_to_local(self, heading_rad: float, lat_deg: float, lon_deg: float) -> float:
        """Heading from the place's own true north (rad) of a heading measured from the frame's north axis."""
        north, east, _ = self.vector_to_local_ned((math.sin(heading_rad), math.cos(heading_rad), 0.0), lat_deg, lon_deg)
        return math.atan2(east, north)
