"""A flight for other programs: a table (CSV), and its tracks with their uncertainty as GeoJSON and KML."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from gcs_coloc.core.snapshot import VehicleSnapshot
from gcs_coloc.recorder.ellipse import ellipse
from gcs_coloc.recorder.flight_history import WITHOUT_GPS, FlightHistory
from gcs_coloc.recorder.journal import VehicleEntry

COLUMNS = (
    "unix_s", "sysid", "lat_deg", "lon_deg", "alt_msl_m", "sigma_h_m", "bound_95_m", "hdop", "nis", "ranges_in_use",
    "gps_state", "aiding_has_fix", "no_estimate_reason",
)  # fmt: skip
_ELLIPSE_EVERY_S = 1.0
_KML = "http://www.opengis.net/kml/2.2"
_COLOURS = {True: "ff005ed5", False: "ffb27200"}  # KML: alpha, blue, green, red. Without GPS, with GPS.


def write_csv(story: FlightHistory, path: Path) -> int:
    """One row for each vehicle each 0.4 s, in order of time; an empty cell where nothing is known. Returns the rows."""
    entries = sorted((e for track in story.tracks.values() for e in track), key=lambda e: (e.at_s, e.vehicle.sysid))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(_row(entry) for entry in entries)
    return len(entries)


def write_geojson(story: FlightHistory, path: Path) -> None:
    """The tracks as lines and, while a vehicle is located without its GPS, a 2-sigma ellipse each second. WGS 84, heights MSL."""
    features = [_feature(kind, coordinates, properties) for kind, coordinates, properties in _shapes(story)]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False), encoding="utf-8")


def write_kml(story: FlightHistory, path: Path) -> None:
    """The same as KML, for Google Earth."""
    ElementTree.register_namespace("", _KML)
    root = ElementTree.Element(f"{{{_KML}}}kml")
    document = _child(root, "Document")
    _child(document, "name", story.file.name)
    for kind, coordinates, properties in _shapes(story):
        mark = _child(document, "Placemark")
        sysid, state = properties["sysid"], properties["gps_state"]
        _child(mark, "name", f"vehicle {sysid}, GPS {state}")
        style = _child(mark, "Style")
        colour = _COLOURS[properties["without_gps"]]
        line = _child(style, "LineStyle")
        _child(line, "color", colour)
        _child(line, "width", "3" if kind == "LineString" else "1")
        if kind == "LineString":
            shape = _child(mark, "LineString")
            _child(shape, "altitudeMode", "absolute")
        else:
            _child(_child(style, "PolyStyle"), "fill", "0")
            polygon = _child(mark, "Polygon")
            shape = _child(_child(polygon, "outerBoundaryIs"), "LinearRing")
            coordinates = coordinates[0]
        _child(shape, "coordinates", " ".join(",".join(f"{x:.8f}" for x in point) for point in coordinates))
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _row(entry: VehicleEntry) -> list[Any]:
    v = entry.vehicle
    nis = v.consistency.nis_median if v.consistency is not None else None
    return [
        f"{entry.at_s:.6f}", v.sysid, _number(v.lat_deg, 8), _number(v.lon_deg, 8), _number(v.alt_msl_m, 3),
        _number(v.sigma_h_m, 3), _number(v.bound_95_m, 3), _number(v.hdop, 3), _number(nis, 4), v.ranges_in_use,
        v.gps_state, int(v.aiding_has_fix), v.no_estimate_reason or "",
    ]  # fmt: skip


def _number(value: float | None, digits: int) -> str:
    return f"{value:.{digits}f}" if value is not None else ""


def _shapes(story: FlightHistory) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Lines and polygons with their coordinates as GeoJSON has them, and what is to be said of each."""
    for sysid, track in sorted(story.tracks.items()):
        for stretch in _stretches(track):
            first, last = stretch[0], stretch[-1]
            properties = _properties(first.vehicle) | {"unix_s": first.at_s, "until_unix_s": last.at_s, "sysid": sysid}
            if len(stretch) > 1:
                yield "LineString", [_point(entry.vehicle) for entry in stretch], properties
            if properties["without_gps"]:
                yield from _ellipses(stretch)


def _ellipses(stretch: Sequence[VehicleEntry]) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    due_s = float("-inf")
    for entry in stretch:
        ring = ellipse(entry.vehicle) if entry.at_s >= due_s else None
        if ring is not None:
            due_s = entry.at_s + _ELLIPSE_EVERY_S
            properties = _properties(entry.vehicle) | {"unix_s": entry.at_s, "sigma_h_m": entry.vehicle.sigma_h_m, "sigmas": 2}
            yield "Polygon", [[(lon, lat) for lat, lon in ring]], properties


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


def _feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": properties}


def _child(parent: ElementTree.Element, name: str, text: str | None = None) -> ElementTree.Element:
    child = ElementTree.SubElement(parent, f"{{{_KML}}}{name}")
    child.text = text
    return child
