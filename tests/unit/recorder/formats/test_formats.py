"""What export writes, read by independent readers and held against the true flight."""

from __future__ import annotations

import csv
import json
import math
import subprocess
import sys
from xml.etree import ElementTree

import pytest
from recorded_flight import EPOCH_S, write_flight

KML = "{http://www.opengis.net/kml/2.2}"


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    directory = tmp_path_factory.mktemp("export")
    truth = write_flight(directory / "flight.tlog", 30.0)
    command = [sys.executable, "-m", "gcs_coloc", "export", str(directory / "flight.tlog"), "--out", str(directory / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return directory / "out", truth


def metres(a: tuple[float, float], b: tuple[float, float]) -> float:
    north = (a[0] - b[0]) * 111_200.0
    east = (a[1] - b[1]) * 111_200.0 * math.cos(math.radians(a[0]))
    return math.hypot(east, north)


def test_the_table_holds_every_vehicle_five_times_a_second_and_where_it_truly_was(exported):
    directory, truth = exported
    with (directory / "flight.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    times = [float(row["unix_s"]) for row in rows]
    assert times == sorted(times)
    mine = [row for row in rows if row["sysid"] == "4"]
    assert len(mine) == pytest.approx(2.5 * 30, abs=5)
    lost = [row for row in mine if row["gps_state"] == "failed" and row["lat_deg"]]
    assert len(lost) > 2.5 * 6
    assert all(row["aiding_has_fix"] == "1" for row in lost[5:])
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
        assert one["properties"]["unix_s"] >= EPOCH_S + 20.0
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
    first = marks[0].find(f"{KML}LineString/{KML}coordinates")
    lon, lat, _ = map(float, first.text.split()[0].split(","))
    assert (lon, lat) == pytest.approx(tuple(features[0]["geometry"]["coordinates"][0][:2]), abs=1e-7)


def test_a_directory_that_cannot_be_made_is_one_line(exported, tmp_path):
    directory, _ = exported
    (tmp_path / "file").write_text("")
    command = [
        sys.executable,
        "-m",
        "gcs_coloc",
        "export",
        str(directory.parent / "flight.tlog"),
        "--out",
        str(tmp_path / "file"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "cannot be written" in done.stderr
