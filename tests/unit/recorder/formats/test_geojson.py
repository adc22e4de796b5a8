"""The shapes of a map: which entries of a track have an ellipse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fleet_views import HEALTHY, LOCATED

from gcs_coloc.recorder.flight_history import FlightHistory
from gcs_coloc.recorder.formats.geojson import map_shapes
from gcs_coloc.recorder.journal import VehicleEntry

FAILED = replace(LOCATED, covariance_h_m2=(9.0, 0.0, 4.0))
WELL = replace(HEALTHY, sysid=4)


def test_a_vehicle_that_has_its_gps_again_has_no_ellipse():
    states = [WELL, WELL, FAILED, FAILED, FAILED, replace(FAILED, gps_state="recovering"), WELL, WELL]
    track = [VehicleEntry(float(at_s), vehicle) for at_s, vehicle in enumerate(states)]
    history = FlightHistory(Path("flight.tlog"), "fleet", None, None, {}, tracks={4: track})
    shapes = list(map_shapes(history))
    ellipses = [properties for kind, _, properties in shapes if kind == "Polygon"]
    assert [properties["unix_s"] for properties in ellipses] == [2.0, 3.0, 4.0, 5.0]
    assert all(properties["without_gps"] and properties["sigmas"] == 2 for properties in ellipses)
    lines = [properties for kind, _, properties in shapes if kind == "LineString"]
    assert [(properties["gps_state"], properties["until_unix_s"]) for properties in lines] == [
        ("healthy", 2.0),
        ("failed", 5.0),
        ("recovering", 6.0),
        ("healthy", 7.0),
    ]
