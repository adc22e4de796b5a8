"""The metrics of several processes as one page of metrics: each process's samples get labels of their own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector


class MergedMetrics(Collector):
    """Metric families of several processes, those of the same name as one. `parts` are each one's labels and families."""

    def __init__(self, parts: Iterable[tuple[Mapping[str, str], Iterable[Metric]]]) -> None:
        self._families: dict[str, Metric] = {}
        for labels, families in parts:
            for family in families:
                merged = self._families.setdefault(family.name, Metric(family.name, family.documentation, family.type))
                merged.samples += [sample._replace(labels={**sample.labels, **labels}) for sample in family.samples]

    def describe(self) -> list[Metric]:
        """Nothing: the families are known already, and there are no others to collide with."""
        return []

    def collect(self) -> Iterator[Metric]:
        """As the protocol says."""
        yield from self._families.values()


def read_metrics(text: str) -> list[Metric]:
    """The metric families in Prometheus's text format. Raises ValueError where it is none."""
    return list(text_string_to_metric_families(text))


def worker_metrics(is_heard: Mapping[str, bool], starts: Mapping[str, int]) -> list[Metric]:
    """Of the worker processes themselves, by fleet: whether each runs and is heard, and how often it was started."""
    up = GaugeMetricFamily("gcs_coloc_worker_up", "1 while the fleet's process runs and is heard.", labels=["fleet"])
    for fleet, heard in is_heard.items():
        up.add_metric([fleet], float(heard))
    started = CounterMetricFamily("gcs_coloc_worker_starts", "How often the fleet's process was started.", labels=["fleet"])
    for fleet, times in starts.items():
        started.add_metric([fleet], float(times))
    return [up, started]
