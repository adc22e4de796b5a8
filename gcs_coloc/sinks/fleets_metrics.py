"""All fleets as Prometheus metrics, for the page that shows all of them.

The metrics of several processes are merged here too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import get_args

from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector

from gcs_coloc.core.alarms.alarms import LightColour
from gcs_coloc.sinks.watched_fleets import FleetShown, Presence


class FleetsCollector(Collector):
    """Makes the metrics of all fleets as they stand at each scrape."""

    def __init__(
        self,
        shown: Callable[[], Iterable[FleetShown]],
        problem: Callable[[], str | None],
        refused: Callable[[], dict[str, int]],
    ) -> None:
        self._shown = shown
        self._problem = problem
        self._refused = refused

    def collect(self) -> Iterator[Metric]:
        """Yield every metric, as prometheus_client asks."""
        fleets = list(self._shown())
        presences = Counter(fleet.presence for fleet in fleets)
        told = [fleet.overview for fleet in fleets if fleet.presence is Presence.LIVE and fleet.overview is not None]
        lights = Counter(v.light for overview in told for v in overview.vehicles)
        yield _labelled("fleets", "Fleets by whether they are heard.", "presence", {p.value: presences[p] for p in Presence})
        yield _labelled(
            "vehicles", "Vehicles of live fleets.", "light", {light: lights[light] for light in get_args(LightColour)}
        )
        waiting = sum(alarm.state in ("active", "over") for overview in told for alarm in overview.alarms)
        yield GaugeMetricFamily("gcs_coloc_watch_alarms", "Alarms of live fleets that nobody has acknowledged.", waiting)
        yield GaugeMetricFamily("gcs_coloc_watch_connected", "1 while states can come.", float(self._problem() is None))
        refused = CounterMetricFamily("gcs_coloc_watch_refused", "Messages that were refused.", labels=["reason"])
        for reason, times in self._refused().items():
            refused.add_metric([reason], times)
        yield refused


def fleets_registry(
    shown: Callable[[], Iterable[FleetShown]], problem: Callable[[], str | None], refused: Callable[[], dict[str, int]]
) -> CollectorRegistry:
    """A registry of its own with all fleets and this process in it."""
    registry = CollectorRegistry()
    registry.register(FleetsCollector(shown, problem, refused))
    ProcessCollector(registry=registry)
    return registry


class MergedMetrics(Collector):
    """Metric families of several processes; those of the same name are merged.

    `parts` has the labels and the families of each process.
    """

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
    """Return the metrics of the worker processes themselves, by fleet.

    They are whether each runs and is heard, and how often it was started.
    """
    up = GaugeMetricFamily("gcs_coloc_worker_up", "1 while the fleet's process runs and is heard.", labels=["fleet"])
    for fleet, heard in is_heard.items():
        up.add_metric([fleet], float(heard))
    started = CounterMetricFamily("gcs_coloc_worker_starts", "How often the fleet's process was started.", labels=["fleet"])
    for fleet, times in starts.items():
        started.add_metric([fleet], float(times))
    return [up, started]


def _labelled(name: str, text: str, label: str, values: dict[str, int]) -> GaugeMetricFamily:
    family = GaugeMetricFamily(f"gcs_coloc_watch_{name}", text, labels=[label])
    for value, number in values.items():
        family.add_metric([value], number)
    return family
