"""The metrics of several processes on one page."""

import pytest
from prometheus_client import CollectorRegistry, Counter, Gauge, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from gcs_coloc.sinks.metrics import merged_metrics, read_metrics


def process(vehicles: float, refused: float, with_gauge: bool = True) -> str:
    """The metrics of one process."""
    registry = CollectorRegistry()
    if with_gauge:
        Gauge("vehicles", "Vehicles.", registry=registry).set(vehicles)
    Counter("refused", "Refused.", ["reason"], registry=registry).labels('a "b"\n').inc(refused)
    return generate_latest(registry).decode()


def test_families_of_one_name_are_one_and_each_sample_keeps_its_labels_beside_those_of_its_process():
    parts = [({"fleet": "north"}, read_metrics(process(4, 1))), ({"fleet": "south"}, read_metrics(process(5, 2)))]
    text = merged_metrics([({}, read_metrics(process(0, 3, with_gauge=False))), *parts]).decode()
    assert text.count("# TYPE vehicles gauge\n") == text.count("# TYPE refused_total counter\n") == 1
    families = {family.name: family for family in text_string_to_metric_families(text)}
    found = {(s.name, s.labels.get("fleet"), s.labels.get("reason")): s.value for f in families.values() for s in f.samples}
    assert found["vehicles", "north", None] == 4.0
    assert found["vehicles", "south", None] == 5.0
    reasons = {fleet: found["refused_total", fleet, 'a "b"\n'] for fleet in (None, "north", "south")}
    assert reasons == {None: 3.0, "north": 1.0, "south": 2.0}


def test_what_is_no_page_of_metrics_is_refused():
    with pytest.raises(ValueError, match="invalid"):
        read_metrics("<html>")
