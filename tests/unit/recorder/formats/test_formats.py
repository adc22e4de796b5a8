"""What export writes, read by independent readers and held against the true flight."""

from __future__ import annotations

import csv
import json
import math
import sys
from bisect import bisect_left
from datetime import datetime
from itertools import pairwise
from statistics import median
from xml.etree import ElementTree

import pytest
from command_line import gcs_coloc
from pyarrow import parquet
from recorded_flight import EPOCH_S, LOST_S, write_flight

from gcs_coloc.cli.recordings import export
from gcs_coloc.core.errors import UsageError
from gcs_coloc.recorder.formats import FlightTables

GX = "{http://www.google.com/kml/ext/2.2}"
KML = "{http://www.opengis.net/kml/2.2}"


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    directory = tmp_path_factory.mktemp("export")
    truth = {p.unix_s: (p.lat_deg, p.lon_deg) for p in write_flight(directory / "flight.tlog", 20.0) if p.sysid == 4}
    done = gcs_coloc("export", directory / "flight.tlog", "--out", directory / "out", "--parquet")
    assert (done.returncode, done.stderr) == (0, "")
    return directory / "out", truth


def metres(a: tuple[float, float], b: tuple[float, float]) -> float:
    north = (a[0] - b[0]) * 111_200.0
    east = (a[1] - b[1]) * 111_200.0 * math.cos(math.radians(a[0]))
    return math.hypot(east, north)


def test_the_table_holds_every_vehicle_at_the_rate_of_the_service_and_where_it_truly_was(exported):
    directory, truth = exported
    with (directory / "flight.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    times = [float(row["unix_s"]) for row in rows]
    assert times == sorted(times)
    mine = [row for row in rows if row["sysid"] == "4"]
    steps_s = [float(b["unix_s"]) - float(a["unix_s"]) for a, b in pairwise(mine)]
    assert max(steps_s) < 0.25
    aided_s = [step for step, row in zip(steps_s, mine, strict=False) if row["aiding_has_fix"] == "1"]
    assert median(aided_s) == pytest.approx(0.1, abs=0.01)
    lost = [row for row in mine if row["gps_state"] == "failed" and row["lat_deg"]]
    assert len(lost) > 60
    assert all(row["aiding_has_fix"] == "1" for row in lost[20:])
    for row in lost:
        at = min(truth, key=lambda t: abs(t - float(row["unix_s"])))
        # Within three times its own bound, and what it flies (below 30 m/s) in the 0.1 s to the next true position.
        error_m = metres((float(row["lat_deg"]), float(row["lon_deg"])), truth[at])
        assert error_m < 3.0 * float(row["bound_95_m"]) + 3.0
        assert int(row["ranges_in_use"]) == 3
        assert float(row["sigma_h_m"]) < float(row["bound_95_m"])


def test_the_tracks_are_cut_where_the_gps_failed_and_the_ellipses_hold_the_position(exported):
    directory, _ = exported
    features = json.loads((directory / "flight.geojson").read_text())["features"]
    lines = [f for f in features if f["geometry"]["type"] == "LineString"]
    assert {f["properties"]["sysid"] for f in lines} == {1, 2, 3, 4}
    assert [f["properties"]["gps_state"] for f in lines if f["properties"]["sysid"] == 4][-2:] == ["suspect", "failed"]
    ellipses = [f for f in features if f["geometry"]["type"] == "Polygon"]
    assert ellipses
    for one in ellipses:
        assert one["properties"]["sysid"] == 4
        assert one["properties"]["unix_s"] >= EPOCH_S + LOST_S
        [ring] = one["geometry"]["coordinates"]
        assert ring[0] == ring[-1]
        across = max(metres((a[1], a[0]), (b[1], b[0])) for a in ring for b in ring)
        assert across == pytest.approx(4.0 * one["properties"]["sigma_h_m"], rel=0.05)  # 2 sigma to each side


def test_the_kml_holds_the_same_shapes(exported):
    directory, _ = exported
    root = ElementTree.parse(directory / "flight.kml").getroot()
    features = json.loads((directory / "flight.geojson").read_text())["features"]
    marks = root.findall(f"{KML}Document/{KML}Placemark")
    assert len(marks) == len(features)
    track = marks[0].find(f"{GX}Track")
    lon, lat, _ = map(float, track.find(f"{GX}coord").text.split())
    assert (lon, lat) == pytest.approx(tuple(features[0]["geometry"]["coordinates"][0][:2]), abs=1e-7)


def test_every_point_of_a_track_has_its_time_in_kml_and_geojson(exported):
    directory, _ = exported
    root = ElementTree.parse(directory / "flight.kml").getroot()
    features = json.loads((directory / "flight.geojson").read_text())["features"]
    lines = [f for f in features if f["geometry"]["type"] == "LineString"]
    tracks = root.findall(f".//{GX}Track")
    assert len(tracks) == len(lines) > 4
    for track, line in zip(tracks, lines, strict=True):
        told = [datetime.fromisoformat(one.text).timestamp() for one in track.findall(f"{KML}when")]
        assert len(told) == len(track.findall(f"{GX}coord")) == len(line["geometry"]["coordinates"])
        assert told == pytest.approx([t / 1e3 for t in line["properties"]["times"]], abs=1e-3)
        assert told == sorted(told)
        assert told[0] == pytest.approx(line["properties"]["unix_s"], abs=1e-3)
    ellipse = next(mark for mark in root.iter(f"{KML}Placemark") if mark.find(f"{KML}Polygon") is not None)
    assert [part.tag.rpartition("}")[2] for part in ellipse] == ["name", "TimeSpan", "Style", "Polygon"]


def test_the_table_has_velocity_covariance_and_the_reported_position(exported):
    directory, truth = exported
    with (directory / "flight.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["sysid"] == "4" and row["gps_state"] == "failed" and row["lat_deg"]]
    times = sorted(truth)
    for row in rows[12:]:
        i = min(max(bisect_left(times, float(row["unix_s"])), 1), len(times) - 1)
        step_m = metres(truth[times[i]], truth[times[i - 1]])
        speed_mps = step_m / (times[i] - times[i - 1])
        assert math.hypot(float(row["ve_mps"]), float(row["vn_mps"])) == pytest.approx(speed_mps, abs=6.0)
        largest_m2 = float(row["sigma_h_m"]) ** 2
        assert max(float(row["var_ee_m2"]), float(row["var_nn_m2"])) <= largest_m2 * 1.01
        off_m = metres(*((float(row[f"{kind}lat_deg"]), float(row[f"{kind}lon_deg"])) for kind in ("", "reported_")))
        assert float(row["reported_off_m"]) == pytest.approx(off_m, rel=0.02, abs=0.1)
        assert int(row["fix_type"]) < 3


def test_the_parquet_holds_what_the_csv_holds_in_types_of_its_own(exported):
    directory, _ = exported
    with (directory / "flight.csv").open(newline="") as file:
        texts = list(csv.DictReader(file))
    rows = parquet.read_table(directory / "flight.parquet").to_pylist()
    assert len(rows) == len(texts)
    for row, text in zip(rows, texts, strict=True):
        assert list(row) == list(text)
        for name, value in row.items():
            if value is None or isinstance(value, str):
                assert text[name] == (value or "")
            else:
                assert float(text[name]) == pytest.approx(float(value), abs=5e-4)


def test_without_its_package_parquet_is_refused_before_the_replay_with_the_remedy(exported, tmp_path, monkeypatch):
    directory, _ = exported
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.delitem(sys.modules, "gcs_coloc.recorder.formats.parquet_table", raising=False)
    with pytest.raises(UsageError, match=r"--parquet: needs pyarrow: pip install 'gcs-coloc\[parquet\]'"):
        export(directory.parent / "flight.tlog", out=tmp_path, parquet=True)
    assert list(tmp_path.iterdir()) == []


def test_a_flight_without_a_row_gives_tables_with_their_heading(tmp_path):
    tables = FlightTables(tmp_path / "silent", ["csv", "parquet"])
    tables.close()
    assert [file.exists() for file in tables.files] == [True, True]
    heading = (tmp_path / "silent.csv").read_text().strip().split(",")
    assert parquet.read_table(tmp_path / "silent.parquet").column_names == heading
    assert heading[:2] == ["unix_s", "sysid"]


def test_a_directory_that_cannot_be_made_is_one_line(exported, tmp_path):
    directory, _ = exported
    (tmp_path / "file").write_text("")
    done = gcs_coloc("export", directory.parent / "flight.tlog", "--out", tmp_path / "file")
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "cannot be written" in done.stderr
