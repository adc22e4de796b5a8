"""The metrics tell the fleet as it is, by Prometheus' conventions, and stand in the reference."""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from fleet_views import HEALTHY, LOCATED, LOST, NOT_READY, READY, STANDBY, fleet_view
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families

from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel
from gcs_coloc.sinks.metrics import fleet_registry, worker_metrics

ROOT = Path(__file__).resolve().parents[3]
PROMTOOL = shutil.which("promtool", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")


def families(view):
    text = generate_latest(fleet_registry(lambda: view)).decode()
    return {family.name: family for family in text_string_to_metric_families(text)}


def value(view, name, **labels):
    found = [s.value for f in families(view).values() for s in f.samples if s.name == name and s.labels == labels]
    return found[0] if found else None


def test_the_numbers_are_the_views():
    view = replace(fleet_view(10.0), noise=NoiseModel(range_bias_m=4.0, device_scale=0.01))
    assert value(view, "gcs_coloc_vehicles") == 2
    assert value(view, "gcs_coloc_found_range_bias_sigma_meters") == 4.0
    assert value(view, "gcs_coloc_found_device_bias_sigma_meters") == 0.0
    assert value(view, "gcs_coloc_found_device_scale_sigma_ratio") == 0.01
    assert value(view, "gcs_coloc_found_position_accuracy_ratio") == 1.0
    assert value(view, "gcs_coloc_vehicle_position_sigma_meters", sysid="4") == 3.0
    assert value(view, "gcs_coloc_vehicle_height_sigma_meters", sysid="4") == 4.0
    assert value(view, "gcs_coloc_vehicle_aiding_fix", sysid="4") == 1
    assert value(view, "gcs_coloc_vehicle_aiding_fix", sysid="1") == 0
    assert value(view, "gcs_coloc_vehicle_nis_median", sysid="4") == 0.5
    assert value(view, "gcs_coloc_vehicle_ranges_refused_ratio", sysid="4") == 3 / 150
    assert value(view, "gcs_coloc_vehicle_gps_state", sysid="4", state="failed") == 1
    assert value(view, "gcs_coloc_vehicle_gps_state", sysid="4", state="healthy") == 0
    assert value(view, "gcs_coloc_vehicle_link_frames_received_total", sysid="1") == 200
    assert value(view, "gcs_coloc_refused_total", reason="bad_crc") == 3
    counts = ("tools", "frames_sent_total", "frames_accepted_total", "dropped_total", "refused_total")
    assert [value(view, f"gcs_coloc_out_{c}", out="udpout:127.0.0.1:14551") for c in counts] == [1, 400, 12, 3, 2]
    assert value(view, "gcs_coloc_estimator_measurements_total", outcome="used") == 7


def test_what_is_unknown_has_no_sample_instead_of_a_zero():
    view = fleet_view(10.0, HEALTHY, LOST)
    assert value(view, "gcs_coloc_vehicle_position_sigma_meters", sysid="4") is None
    assert value(view, "gcs_coloc_vehicle_position_bound_95_meters", sysid="4") is None
    assert value(view, "gcs_coloc_vehicle_aiding_fix", sysid="4") == 0


def test_a_hot_standby_tells_its_state_and_how_the_other_one_is():
    view = fleet_view(10.0, standby=replace(STANDBY, problem="the other service gives no sign of life"))
    assert value(view, "gcs_coloc_standby_state", state="standby") == 1
    assert value(view, "gcs_coloc_standby_state", state="active") == 0
    assert value(view, "gcs_coloc_standby_term") == 3
    assert value(view, "gcs_coloc_standby_other_age_seconds") == 0.1
    assert value(view, "gcs_coloc_standby_problem") == 1
    assert value(fleet_view(10.0), "gcs_coloc_standby_problem") is None


def test_every_metric_is_in_the_reference():
    text = (ROOT / "docs/reference/metrics.md").read_text(encoding="utf-8")
    for family in families(fleet_view(10.0, replace(HEALTHY, readiness=NOT_READY), LOCATED, standby=STANDBY)).values():
        for sample in family.samples:
            assert f"`{sample.name}`" in text, f"{sample.name} is not in metrics.md"


def test_readiness_is_one_of_its_states_and_only_of_a_vehicle_that_has_one():
    told = replace(HEALTHY, readiness=NOT_READY)
    found = families(fleet_view(10.0, told, LOCATED))
    samples = found["gcs_coloc_vehicle_readiness"].samples
    assert {s.labels["sysid"] for s in samples} == {"1"}
    assert [s.labels["state"] for s in samples if s.value == 1.0] == ["not_ready"]
    assert len(samples) == 4
    for name, value in {"bound_95_meters": 40.0, "protection_level_meters": 120.0, "hdop": 9.0}.items():
        (sample,) = found[f"gcs_coloc_vehicle_without_gps_{name}"].samples
        assert sample.value == value
    for name, value in {"bound_95_meters": 2.9, "protection_level_meters": 15.0, "hdop": 8.0}.items():
        (sample,) = found[f"gcs_coloc_vehicle_without_gps_now_{name}"].samples
        assert sample.value == value
    (sample,) = found["gcs_coloc_vehicle_readiness_reason"].samples
    assert (sample.labels, sample.value) == ({"sysid": "1", "reason": "in_line"}, 1.0)
    ready = families(fleet_view(10.0, replace(HEALTHY, readiness=READY)))
    assert ready["gcs_coloc_vehicle_readiness_reason"].samples == []


def alert_rules() -> list[str]:
    text = (ROOT / "configs/prometheus-alerts.yml").read_text(encoding="utf-8")
    return [line.split("expr: ")[1] for line in text.splitlines() if "expr: " in line]


def test_the_alert_rules_ask_for_metrics_that_there_are():
    there = set(families(fleet_view(10.0, standby=STANDBY))) | {family.name for family in worker_metrics({}, {})}
    assert len(alert_rules()) >= 6
    for expression in alert_rules():
        names = re.findall(r"gcs_coloc_\w+", expression)
        assert names
        assert set(names) <= there, expression


@pytest.mark.skipif(PROMTOOL is None, reason="promtool, of Prometheus, is not installed here")
def test_promtool_finds_the_alert_rules_right():
    done = subprocess.run(
        [PROMTOOL, "check", "rules", str(ROOT / "configs/prometheus-alerts.yml")],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_dashboard_asks_for_metrics_that_there_are():
    dashboard = json.loads((ROOT / "configs/grafana-dashboard.json").read_text(encoding="utf-8"))
    there = {
        s.name
        for f in families(fleet_view(10.0, replace(HEALTHY, readiness=READY), replace(LOCATED, hpl_m=14.0, vpl_m=20.0))).values()
        for s in f.samples
    }
    asked = [t["expr"] for panel in dashboard["panels"] for t in panel.get("targets", [])]
    assert len(asked) >= 8
    for expression in asked:
        names = re.findall(r"(?:gcs_coloc|process)_\w+", expression)
        assert names
        assert set(names) <= there, expression
    metrics = set(re.findall(r"\w+", " ".join(asked)))
    assert {"gcs_coloc_vehicle_protection_level_meters", "gcs_coloc_loop_lag_seconds"} <= metrics
    places = [tuple(panel["gridPos"][key] for key in "xywh") for panel in dashboard["panels"]]
    cells = [(column, row) for x, y, w, h in places for column in range(x, x + w) for row in range(y, y + h)]
    assert len(cells) == len(set(cells))  # no panel lies over another
    assert max(column for column, _ in cells) < 24


def test_rules_that_compare_two_metrics_tell_vehicles_of_two_fleets_apart():
    """One address may have the metrics of many fleets, whose vehicles have the same system ids."""
    dashboard = json.loads((ROOT / "configs/grafana-dashboard.json").read_text(encoding="utf-8"))
    asked = [t["expr"] for panel in dashboard["panels"] for t in panel.get("targets", [])]
    matched = [words for expression in (*alert_rules(), *asked) for words in re.findall(r"(?:on|by) \(([^)]*)\)", expression)]
    assert matched
    assert all("fleet" in words.split(", ") for words in matched)
    joined = [
        (step["options"]["byField"], target["expr"])
        for panel in dashboard["panels"]
        for step in panel.get("transformations", [])
        if step["id"] == "joinByField"
        for target in panel["targets"]
    ]
    assert len(joined) == 2
    for field, expression in joined:
        assert f'"{field}", " ", "instance", "fleet", "sysid")' in expression
