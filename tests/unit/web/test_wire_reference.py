"""Every field of every message that the page is sent stands in the reference."""

import dataclasses
from pathlib import Path

from gcs_coloc.core.readiness.vehicle_readiness import VehicleReadiness
from gcs_coloc.core.residual_log import Consistency, RangeSnapshot
from gcs_coloc.core.snapshot import VehicleSnapshot
from gcs_coloc.core.station_review import StationSnapshot
from gcs_coloc.sinks.watched_fleets import FleetShown
from gcs_coloc.web import wire
from gcs_coloc.web.fleets_page import FleetsFrame, FleetsHello

TEXT = (Path(__file__).resolve().parents[3] / "docs/reference/web.md").read_text(encoding="utf-8")
MODELS = [
    wire.CountsFrame,
    wire.Event,
    wire.EventsFrame,
    wire.VehicleHistory,
    wire.Hello,
    wire.TilesInfo,
    wire.PlaybackState,
    wire.PlaybackCommand,
    FleetsHello,
    FleetsFrame,
    FleetShown,
]
VALUES = (
    wire.LinkFrame,
    wire.OutFrame,
    wire.Ellipse,
    wire.VehicleFrame,
    wire.FleetFrame,
    VehicleSnapshot,
    StationSnapshot,
    RangeSnapshot,
    Consistency,
    VehicleReadiness,
)
FIELDS = [f"{model.__name__}.{name}" for model in MODELS for name in model.model_fields]
FIELDS += [f"{view.__name__}.{f.name}" for view in VALUES for f in dataclasses.fields(view)]


def test_every_field_is_in_the_reference():
    assert [field for field in FIELDS if f"`{field.split('.')[1]}`" not in TEXT] == []
