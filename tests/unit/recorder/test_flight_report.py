"""A recorded flight and its truth held against each other."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import gcs_coloc
from recorded_flight import EPOCH_S, write_flight, write_truth

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    NoEstimate,
    NoEstimateReason,
    PositionMeasurement,
    RangeMeasurement,
    Unlocated,
)
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.evaluation.data_checks.findings import DataFinding
from gcs_coloc.recorder import flight_report
from gcs_coloc.recorder.flight_report import MeasurementTap
from gcs_coloc.recorder.replay import Replay, replay
from gcs_coloc.recorder.side_tables import TruthPoint
from gcs_coloc.recorder.tlog import TlogReader


@pytest.fixture(scope="module")
def flown(tmp_path_factory) -> tuple[Path, MeasurementTap, Engine, list[TruthPoint]]:
    """25 s of the fakes' four-ship, vehicle 4 without GPS after 10 s, replayed."""
    path = tmp_path_factory.mktemp("flight") / "flight.tlog"
    truth = write_flight(path, 25.0)
    heard = MeasurementTap(load_estimator("fleet", {}))
    engine = Engine(heard)
    replay(Replay(engine, TlogReader(path), [], lambda _at_s, _outputs: None))
    return path, heard, engine, truth


def findings(flown, change: Callable[[TruthPoint], TruthPoint]) -> list[DataFinding]:
    _, heard, engine, truth = flown
    return heard.findings([change(point) for point in truth], engine.frame)


def test_a_replay_has_the_readiness_of_the_flight(flown):
    _, _, engine, _ = flown
    readiness = [vehicle.readiness for vehicle in engine.snapshot(EPOCH_S + 25.0).vehicles if vehicle.sysid != 4]
    assert {found.reason for found in readiness} <= {"no_peer", "one_peer"}
    assert len(readiness) == 3
    assert MeasurementTap(Silent()).predict_loss is None


def test_of_a_sound_flight_nothing_is_said(flown):
    assert findings(flown, lambda p: p) == []


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        (lambda p: replace(p, lat_deg=p.lon_deg, lon_deg=p.lat_deg), "truth_elsewhere", "are latitude and longitude swapped?"),
        (lambda p: replace(p, lat_deg=-p.lat_deg), "truth_elsewhere", "km off the reported positions"),
        (lambda p: replace(p, alt_msl_m=p.alt_msl_m / 0.3048), "truth_height_factor", "are those of the truth in ft?"),
        (lambda p: replace(p, alt_msl_m=p.alt_msl_m + 48.0), "truth_offset", "(east, north, up) off the reported positions"),
        (
            lambda p: replace(p, unix_s=p.unix_s + 5.0),
            "time_offset",
            "the clock of the truth of 1, 2, 3 is",
        ),
        (lambda p: replace(p, unix_s=1000.0 * p.unix_s), "no_overlap", "one clock"),
    ],
)
def test_a_truth_in_other_units_axes_or_time_is_told(flown, change, kind, words):
    (finding,) = findings(flown, change)
    assert finding.kind == kind
    assert words in finding.text


def test_replay_and_report_say_it(flown, tmp_path):
    path, _, _, truth = flown
    table = tmp_path / "truth.csv"
    write_truth(table, (replace(point, alt_msl_m=point.alt_msl_m / 0.3048) for point in truth))
    done = gcs_coloc("replay", path, "--truth", table, "--json")
    assert done.returncode == 0, done.stderr
    (warning,) = json.loads(done.stdout)["warnings"]
    assert warning["kind"] == "truth_height_factor"
    assert done.stderr == f"gcs-coloc: warning: {path}: {warning['text']}\n"
    page = tmp_path / "flight.html"
    done = gcs_coloc("report", path, "--truth", table, "--out", page)
    assert done.returncode == 0, done.stderr
    assert warning["text"] in done.stderr
    assert f"The data do not agree: {warning['text']}" in page.read_text(encoding="utf-8")


class Silent:
    """Notes what it is given."""

    name = "silent"

    def __init__(self) -> None:
        self.given: list[object] = []

    def set_denied(self, denied, at_s):
        self.given.append((denied, at_s))

    def add(self, measurement):
        self.given.append(measurement)

    def estimate(self, vehicle, at_s):
        return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.OTHER, detail="silent"))

    def drain_residuals(self):
        return []

    def counts(self):
        return {"given": len(self.given)}


def test_the_estimator_is_given_everything_while_what_is_kept_stays_small(monkeypatch):
    monkeypatch.setattr(flight_report, "MAX_ROWS", 30)
    inner = Silent()
    heard = MeasurementTap(inner)
    given = [
        m
        for i in range(1000)
        for m in (
            PositionMeasurement(1, 0.1 * i, 0.1 * i, (0.0, 0.0, 0.0), 1.0, 1.0),
            RangeMeasurement(1, 2, 0.1 * i, 0.1 * i, 5.0, 1.0),
            AltitudeMeasurement(2, 0.1 * i, 0.1 * i, 5.0, 1.0),
        )
    ]
    heard.set_denied({2}, 0.0)
    for m in given:
        heard.add(m)
    assert inner.given == [({2}, 0.0), *given]
    assert heard.counts() == {"given": 3001}
    assert (heard.name, heard.drain_residuals()) == ("silent", [])
    assert sum(len(rows) // 8 for rows in heard._positions.values()) + len(heard._ranges) // 5 == 30
    assert heard.findings([], None) == []
