"""The geojson format (RFC 7946), and the shapes that it shares with KML.

Tracks are lines, 2-sigma ellipses polygons, fixed stations points.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gcs_coloc.core.error_ellipse import error_ellipse
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.snapshot import VehicleSnapshot
from gcs_coloc.recorder.flight_history import WITHOUT_GPS, FlightHistory
from gcs_coloc.recorder.journal import VehicleEntry

ELLIPSE_PERIOD_S = 1.0  # chosen: as dense as a map shows
_ELLIPSE_CORNERS = 24  # chosen: round on a screen
_ELLIPSE_SIGMAS = 2
"""Holds 86 % of the true positions where the covariance is right."""


def write_geojson(history: FlightHistory, path: Path) -> None:
    """Write the tracks, the stations and the 2-sigma ellipses of a flight as GeoJSON.

    A vehicle that is located without its GPS has an ellipse each second.
    """
    features = [_feature(kind, coordinates, properties) for kind, coordinates, properties in map_shapes(history)]
    features += [_feature("Point", place, properties) for place, properties in station_points(history)]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False), encoding="utf-8")


def _feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": properties}


def map_shapes(history: FlightHistory) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Lines and polygons: the geometry's type, its coordinates as GeoJSON has them, and its properties."""
    for sysid, track in sorted(history.tracks.items()):
        for stretch in _stretches(track):
            first, last = stretch[0], stretch[-1]
            properties = _properties(first.vehicle) | {"unix_s": first.at_s, "until_unix_s": last.at_s, "sysid": sysid}
            if len(stretch) > 1:
                # One time for each point, in ms since 1970, as Leaflet.TimeDimension and kepler.gl read it.
                times = {"times": [round(entry.at_s * 1e3) for entry in stretch]}
                yield "LineString", [_point(entry.vehicle) for entry in stretch], properties | times
        yield from _ellipses(track)


def station_points(history: FlightHistory) -> Iterator[tuple[tuple[float, float, float], dict[str, Any]]]:
    """Yield position and properties of each fixed station whose position is known.

    The position is longitude and latitude (degrees) and height above mean sea level (m).
    """
    for _, station in sorted(history.stations.items(), reverse=True):
        if station.lat_deg is not None and station.lon_deg is not None and station.alt_msl_m is not None:
            properties = {
                "station": station.station_id,
                "name": station.name,
                "sigma_h_m": station.sigma_h_m,
                "used": station.is_used,
            }
            yield (station.lon_deg, station.lat_deg, station.alt_msl_m), properties


def _ellipses(track: Sequence[VehicleEntry]) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """The ellipses of the entries without GPS.

    A stretch of the track is no guide: it ends with the first entry of the next.
    """
    due_s = float("-inf")
    for entry in track:
        is_due = entry.vehicle.gps_state in WITHOUT_GPS and entry.at_s >= due_s
        ring = ellipse_ring(entry.vehicle) if is_due else None
        if ring is not None:
            due_s = entry.at_s + ELLIPSE_PERIOD_S
            about = {"unix_s": entry.at_s, "sigma_h_m": entry.vehicle.sigma_h_m, "sigmas": _ELLIPSE_SIGMAS}
            yield "Polygon", [[(lon, lat) for lat, lon in ring]], _properties(entry.vehicle) | about


def _stretches(track: Sequence[VehicleEntry]) -> Iterator[list[VehicleEntry]]:
    """The track cut where the state of the GPS changes and where the position is unknown."""
    stretch: list[VehicleEntry] = []
    for entry in track:
        if entry.vehicle.lat_deg is None:
            if stretch:
                yield stretch
            stretch = []
        elif stretch and entry.vehicle.gps_state != stretch[-1].vehicle.gps_state:
            yield [*stretch, entry]
            stretch = [entry]
        else:
            stretch.append(entry)
    if stretch:
        yield stretch


def _properties(vehicle: VehicleSnapshot) -> dict[str, Any]:
    return {"sysid": vehicle.sysid, "gps_state": vehicle.gps_state, "without_gps": vehicle.gps_state in WITHOUT_GPS}


def _point(vehicle: VehicleSnapshot) -> tuple[float, float, float]:
    assert vehicle.lat_deg is not None
    assert vehicle.lon_deg is not None
    assert vehicle.alt_msl_m is not None
    return vehicle.lon_deg, vehicle.lat_deg, vehicle.alt_msl_m


def ellipse_ring(vehicle: VehicleSnapshot) -> list[tuple[float, float]] | None:
    """Return the 2-sigma ellipse of a vehicle's position; None where there is no estimate.

    It has 25 corners (latitude, longitude) in degrees, and ends with the first of them.
    """
    if vehicle.covariance_h_m2 is None or vehicle.lat_deg is None or vehicle.lon_deg is None or vehicle.alt_msl_m is None:
        return None
    major_m, minor_m, angle_rad = error_ellipse(*vehicle.covariance_h_m2)
    axes = np.array([[np.cos(angle_rad), -np.sin(angle_rad)], [np.sin(angle_rad), np.cos(angle_rad)]])
    angles = np.linspace(0.0, 2.0 * np.pi, _ELLIPSE_CORNERS, endpoint=False)
    circle = np.vstack([np.cos(angles), np.sin(angles)])
    corners = (_ELLIPSE_SIGMAS * axes @ (np.array([[major_m], [minor_m]]) * circle)).T
    frame = LocalFrame(vehicle.lat_deg, vehicle.lon_deg, vehicle.alt_msl_m)
    ring = [frame.geodetic_from_enu(float(e), float(n), 0.0)[:2] for e, n in corners]
    return [*ring, ring[0]]
