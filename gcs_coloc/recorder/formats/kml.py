"""A flight as KML 2.2 (OGC 07-147r2), for Google Earth."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from gcs_coloc.recorder.flight_history import FlightHistory
from gcs_coloc.recorder.formats.geojson import map_shapes

_KML = "http://www.opengis.net/kml/2.2"
_COLOURS = {True: "ff005ed5", False: "ffb27200"}  # KML: alpha, blue, green, red. Without GPS, with GPS.


def write_kml(history: FlightHistory, path: Path) -> None:
    """Write the tracks as lines and, while a vehicle is located without its GPS, a 2-sigma ellipse each second."""
    ElementTree.register_namespace("", _KML)
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
            shape = _child(mark, "LineString")
            _child(shape, "altitudeMode", "absolute")
        else:
            _child(_child(style, "PolyStyle"), "fill", "0")
            polygon = _child(mark, "Polygon")
            shape = _child(_child(polygon, "outerBoundaryIs"), "LinearRing")
            coordinates = coordinates[0]
        _child(shape, "coordinates", " ".join(",".join(f"{x:.8f}" for x in point) for point in coordinates))
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _child(parent: ElementTree.Element, name: str, text: str | None = None) -> ElementTree.Element:
    child = ElementTree.SubElement(parent, f"{{{_KML}}}{name}")
    child.text = text
    return child
