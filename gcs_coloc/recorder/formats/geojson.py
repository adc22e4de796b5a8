"""A flight as GeoJSON (RFC 7946), for QGIS and web maps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from gcs_coloc.recorder.flight_history import FlightHistory
from gcs_coloc.recorder.formats.map_shapes import map_shapes


def write_geojson(history: FlightHistory, path: Path) -> None:
    """Write the tracks as lines and, while a vehicle is located without its GPS, a 2-sigma ellipse each second."""
    features = [_feature(kind, coordinates, properties) for kind, coordinates, properties in map_shapes(history)]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False), encoding="utf-8")


def _feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": properties}
