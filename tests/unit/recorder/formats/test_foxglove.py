"""What Foxglove and Lichtblick draw of a recording: the format's reader, the published schemas, a flight of the engine."""

from __future__ import annotations

import io
import json
import math
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import fastjsonschema
import pytest
from fleet_views import HEALTHY, LOCATED, LOST
from mcap.reader import make_reader

from gcs_coloc.core.alarms.alarms import Alarm, AlarmKind, AlarmState
from gcs_coloc.core.messages.outbound import HealthChanged, Notice
from gcs_coloc.core.residual_log import RangeSnapshot
from gcs_coloc.core.station_review import StationSnapshot
from gcs_coloc.recorder.formats.mcap_file import McapEncoder
from gcs_coloc.recorder.journal import RangeEntry, StationEntry, VehicleEntry

ROOT = Path(__file__).resolve().parents[4]
REPORTED = {"reported_alt_msl_m": 505.0, "reported_enu_m": (118.0, 41.0, 5.0)}
AT_S = 1_780_000_000.25
MAST = StationSnapshot(3, -4, "mast", "configuration", 47.0, 8.0, 512.0, 0.1, 0.1, (50.0, -20.0, 12.0), 0.1, None, True)
ENTRIES = [
    VehicleEntry(AT_S, HEALTHY),
    VehicleEntry(AT_S, replace(LOCATED, covariance_h_m2=(9.0, 0.0, 4.0), **REPORTED)),
    RangeEntry(AT_S + 0.1, RangeSnapshot(1, 4, 0.05, 0.4, 0.3, 1.8, None)),
    RangeEntry(AT_S + 0.2, RangeSnapshot(4, 1, 0.05, 14.0, 0.3, 99.0, "an outlier")),
    RangeEntry(AT_S + 0.2, RangeSnapshot(4, 9, 0.05, 1.0, 0.3, 1.0, None)),
    StationEntry(AT_S + 0.2, MAST),
    StationEntry(AT_S + 0.2, replace(MAST, station_id=6, node=-7, lat_deg=None, lon_deg=None, alt_msl_m=None, enu_m=None)),
    RangeEntry(AT_S + 0.3, RangeSnapshot(4, MAST.node, 0.05, 0.4, 0.3, 1.8, None)),
    RangeEntry(AT_S + 0.3, RangeSnapshot(4, -7, 0.05, 0.4, 0.3, 1.8, None)),
    HealthChanged(AT_S + 0.3, 4, "healthy", "failed", "no 3D fix"),
    Notice(AT_S + 0.4, None, "error", "nothing is being recorded"),
    Alarm(1, AlarmKind.GPS_LOST, 4, AlarmState.ACTIVE, "warning", "GPS failed", "Land it.", AT_S, AT_S + 0.5),
    Alarm(2, AlarmKind.NOTICE, 4, AlarmState.OVER, "error", "its notice is there", "Read it.", AT_S, AT_S + 0.6),
]


@pytest.fixture(scope="module")
def read():
    """The messages by topic, each with its schema's name, the time in ns and its content; every one meets its schema."""
    encoder = McapEncoder()
    for entry in ENTRIES:
        encoder.add(entry)
    found, checks = defaultdict(list), {}
    for schema, channel, message in make_reader(io.BytesIO(encoder.pop() + encoder.finish())).iter_messages():
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        content = json.loads(message.data)
        check = checks.setdefault(schema.name, fastjsonschema.compile(json.loads(schema.data)))
        check(content)
        found[channel.topic].append((schema.name, message.log_time, content))
    return found


def test_the_schemas_in_the_file_are_those_that_foxglove_publishes(read):
    names = {name for messages in read.values() for name, _, _ in messages if name.startswith("foxglove.")}
    assert names == {"foxglove.LocationFix", "foxglove.SceneUpdate", "foxglove.Log"}
    published = ROOT / "gcs_coloc/recorder/formats/foxglove_schemas"
    assert {json.loads(path.read_text())["title"] for path in published.glob("*.json")} == names


def test_a_schema_refuses_what_is_not_of_it(read):
    [(_, _, content)] = read["/estimate/1"]
    check = fastjsonschema.compile(
        json.loads((ROOT / "gcs_coloc/recorder/formats/foxglove_schemas/LocationFix.json").read_text())
    )
    for key in content.keys() - {"color"}:
        with pytest.raises(fastjsonschema.JsonSchemaValueException):
            check({name: value for name, value in content.items() if name != key})


def test_an_estimate_has_its_covariance_and_a_reported_position_says_that_it_has_none(read):
    [(_, at_ns, estimate)] = read["/estimate/4"]
    assert at_ns == round(AT_S * 1e6) * 1000 == estimate["timestamp"]["sec"] * 10**9 + estimate["timestamp"]["nsec"]
    assert (estimate["latitude"], estimate["longitude"], estimate["altitude"]) == (47.0, 8.0, 500.0)
    assert estimate["position_covariance"] == [9.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 16.0]
    assert estimate["position_covariance_type"] == 1
    [(_, _, reported)] = read["/reported/4"]
    assert (reported["altitude"], reported["position_covariance_type"]) == (505.0, 0)
    assert "/reported/1" not in read  # of it no reported altitude is known
    assert estimate["color"] != read["/estimate/1"][0][2]["color"]  # failed and healthy


def test_the_ellipse_holds_95_percent_along_its_axes(read):
    entities = {one["id"]: one for _, _, update in read["/scene"] for one in update["entities"]}
    [ellipse] = entities["vehicle 4"]["cylinders"]
    assert ellipse["size"]["x"] == pytest.approx(2 * 3.0 * math.sqrt(5.991), rel=1e-3)
    assert ellipse["size"]["y"] == pytest.approx(2 * 2.0 * math.sqrt(5.991), rel=1e-3)
    assert ellipse["pose"]["position"] == {"x": 120.0, "y": 40.0, "z": 5.0}
    assert [text["text"] for text in entities["vehicle 4"]["texts"]] == ["4"]


def test_a_turned_ellipse_is_turned_from_east_to_north():
    turned = replace(LOCATED, covariance_h_m2=(5.0, 4.0, 5.0))
    encoder = McapEncoder()
    encoder.add(VehicleEntry(AT_S, turned))
    reader = make_reader(io.BytesIO(encoder.pop() + encoder.finish()))
    [update] = [json.loads(message.data) for _, channel, message in reader.iter_messages() if channel.topic == "/scene"]
    orientation = update["entities"][0]["cylinders"][0]["pose"]["orientation"]
    assert 2 * math.atan2(orientation["z"], orientation["w"]) == pytest.approx(math.pi / 4)


def test_a_range_is_a_line_between_the_two_that_are_known(read):
    entities = {one["id"]: one for _, _, update in read["/scene"] for one in update["entities"]}
    ranges = {name for name in entities if name.startswith("range")}
    assert ranges == {"range 1 4", "range 4 1", "range 4 station 3"}  # nobody knows where 9 and station 6 are
    used, refused = entities["range 1 4"], entities["range 4 1"]
    ends = [(point["x"], point["y"], point["z"]) for point in used["lines"][0]["points"]]
    assert ends == [(0.0, 0.0, 0.0), (120.0, 40.0, 5.0)]
    assert used["lines"][0]["color"] != refused["lines"][0]["color"]
    assert {"key": "refused", "value": "an outlier"} in refused["metadata"]


def test_a_station_never_leaves_the_picture_and_its_ranges_lead_to_it(read):
    entities = {one["id"]: one for _, _, update in read["/scene"] for one in update["entities"]}
    assert {name for name in entities if name.startswith("station")} == {"station 3"}
    [label] = entities["station 3"]["texts"]
    assert (label["text"], label["pose"]["position"]) == ("mast", {"x": 50.0, "y": -20.0, "z": 12.0})
    assert entities["station 3"]["lifetime"] == {"sec": 0, "nsec": 0}
    assert entities["range 4 station 3"]["lines"][0]["points"][1] == {"x": 50.0, "y": -20.0, "z": 12.0}


def test_the_log_holds_notices_changes_of_state_and_alarms_once_each(read):
    log = [(content["level"], content["name"], content["message"]) for _, _, content in read["/log"]]
    assert log == [
        (2, "vehicle 4", "GPS healthy -> failed: no 3D fix"),
        (4, "fleet", "nothing is being recorded"),
        (3, "vehicle 4", "alarm active: GPS failed"),
    ]


def test_a_vehicle_that_is_nowhere_leaves_the_map_and_stays_where_it_reports_in_three_dimensions():
    encoder = McapEncoder()
    lost = replace(LOST, enu_m=None, covariance_h_m2=None, **REPORTED)
    encoder.add(VehicleEntry(AT_S, lost))
    reader = make_reader(io.BytesIO(encoder.pop() + encoder.finish()))
    found = {channel.topic: json.loads(message.data) for _, channel, message in reader.iter_messages()}
    assert found.keys() == {"/vehicle/4", "/reported/4", "/scene"}
    assert found["/scene"]["entities"][0]["cylinders"] == []


def test_the_layout_shows_topics_and_fields_that_a_recording_has(read):
    layout = json.loads((ROOT / "configs/foxglove-layout.json").read_text())
    panels = layout["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    assert len(paths) > 6
    for path in paths:
        topic, _, fields = path.partition(".")
        topic = "/vehicle/4" if topic.startswith("/vehicle/") else topic
        value = read[topic][0][2]
        for field in fields.split("."):
            value = value[field]
    assert panels["RosOut!log"]["topicToRender"] in read
    assert all(topic in read for topic in panels["3D!gcs-coloc"]["topics"])
    assert panels["3D!gcs-coloc"]["followTf"] == read["/scene"][0][2]["entities"][0]["frame_id"]

    def shown(node):
        return [node] if isinstance(node, str) else shown(node["first"]) + shown(node["second"])

    assert sorted(shown(layout["layout"])) == sorted(panels)
