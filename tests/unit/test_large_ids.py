"""System ids of 32 bits reach whoever looks on: tables, metrics, MQTT and the page."""

import csv
import json
from dataclasses import replace

from fleet_views import HEALTHY, LOCATED, READY, fleet_view
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families
from pyarrow import parquet

from gcs_coloc.core.residual_log import RangeSnapshot
from gcs_coloc.recorder.formats import FlightTables
from gcs_coloc.sinks.metrics import fleet_registry
from gcs_coloc.sinks.mqtt_models import of_vehicle
from gcs_coloc.web.picture import fleet_frame
from gcs_coloc.web.wire import fleet_json

LARGE = (70_000, 3_000_000_000)
VEHICLES = (replace(HEALTHY, sysid=LARGE[0], readiness=READY), replace(LOCATED, sysid=LARGE[1]))
VIEW = fleet_view(10.0, *VEHICLES, ranges=(RangeSnapshot(LARGE[1], LARGE[0], 0.1, 1.5, 2.0, 0.56, None),))


def test_tables_hold_them(tmp_path):
    tables = FlightTables(tmp_path / "flight", ["csv", "parquet"])
    tables.add(VIEW)
    tables.close()
    assert parquet.read_table(tmp_path / "flight.parquet")["sysid"].to_pylist() == list(LARGE)
    rows = csv.DictReader((tmp_path / "flight.csv").read_text().splitlines())
    assert [row["sysid"] for row in rows] == list(map(str, LARGE))


def test_metrics_hold_them():
    families = text_string_to_metric_families(generate_latest(fleet_registry(lambda: VIEW)).decode())
    labels = [sample.labels["sysid"] for family in families for sample in family.samples if "sysid" in sample.labels]
    assert set(labels) == set(map(str, LARGE))
    assert len(labels) > 40


def test_the_page_and_mqtt_hold_them():
    frame = json.loads(fleet_json(fleet_frame(VIEW)))
    assert [vehicle["snapshot"]["sysid"] for vehicle in frame["vehicles"]] == list(LARGE)
    assert set(LARGE) <= set(frame["ranges"][0].values())
    published = [model.model_dump()["sysid"] for vehicle in VEHICLES for model in of_vehicle(vehicle, 1.0).values()]
    assert set(published) == set(LARGE)
