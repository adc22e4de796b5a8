"""A flight as KML 2.2 (OGC 07-147r2), which Google Earth plays over time.

The tracks are those of Google's gx extension.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

from gcs_coloc.recorder.flight_history import FlightHistory
from gcs_coloc.recorder.formats.geojson import ELLIPSE_PERIOD_S, map_shapes, station_points

_KML = "http://www.opengis.net/kml/2.2"
_GX = "http://www.google.com/kml/ext/2.2"
_COLOURS = {True: "ff005ed5", False: "ffb27200"}  # KML: alpha, blue, green, red. Without GPS, with GPS.


def write_kml(history: FlightHistory, path: Path) -> None:
    """Write the tracks with their times, the stations and the 2-sigma ellipses as KML.

    A vehicle that is located without its GPS has an ellipse each second.
    """
    ElementTree.register_namespace("", _KML)
    ElementTree.register_namespace("gx", _GX)
    root = ElementTree.Element(f"{{{_KML}}}kml")
    document = _child(root, "Document")
    _child(document, "name", history.file.name)
    for kind, coordinates, properties in map_shapes(history):
        mark = _child(document, "Placemark")
        sysid, state = properties["sysid"], properties["gps_state"]
        _child(mark, "name", f"vehicle {sysid}, GPS {state}")
        style = _child(mark, "Style")
        colour = _COLOURS[properties["without_gps"]]
        line = _child(style, "LineStyle")
        _child(line, "color", colour)
        _child(line, "width", "3" if kind == "LineString" else "1")
        if kind == "LineString":
            _add_track(mark, coordinates, properties["times"])
        else:
            _child(_child(style, "PolyStyle"), "fill", "0")
            begin_s = properties["unix_s"]
            span = ElementTree.Element(f"{{{_KML}}}TimeSpan")  # which the schema wants before the style
            _child(span, "begin", _when(begin_s))
            _child(span, "end", _when(begin_s + ELLIPSE_PERIOD_S))
            mark.insert(1, span)
            ring = _child(_child(_child(mark, "Polygon"), "outerBoundaryIs"), "LinearRing")
            _child(ring, "coordinates", " ".join(",".join(f"{x:.8f}" for x in point) for point in coordinates[0]))
    for place, properties in station_points(history):
        mark = _child(document, "Placemark")
        label = f"station {properties['station']}"
        _child(mark, "name", f"{label} ({properties['name']})" if properties["name"] else label)
        point = _child(mark, "Point")
        _child(point, "altitudeMode", "absolute")
        _child(point, "coordinates", ",".join(f"{x:.8f}" for x in place))
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _add_track(mark: ElementTree.Element, points: Sequence[tuple[float, float, float]], times_ms: Sequence[int]) -> None:
    """A gx:Track: all times, then as many points. Heights are above mean sea level."""
    track = ElementTree.SubElement(mark, f"{{{_GX}}}Track")
    _child(track, "altitudeMode", "absolute")
    for time_ms in times_ms:
        _child(track, "when", _when(time_ms / 1e3))
    for lon, lat, alt in points:
        ElementTree.SubElement(track, f"{{{_GX}}}coord").text = f"{lon:.8f} {lat:.8f} {alt:.3f}"


def _when(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _child(parent: ElementTree.Element, name: str, text: str | None = None) -> ElementTree.Element:
    child = ElementTree.SubElement(parent, f"{{{_KML}}}{name}")
    child.text = text
    return child
