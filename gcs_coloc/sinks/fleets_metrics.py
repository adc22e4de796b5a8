"""All fleets as Prometheus metrics, for the page that shows all of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import get_args

from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from gcs_coloc.core.alarms.traffic_light import LightColour
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


def _labelled(name: str, text: str, label: str, values: dict[str, int]) -> GaugeMetricFamily:
    family = GaugeMetricFamily(f"gcs_coloc_watch_{name}", text, labels=[label])
    for value, number in values.items():
        family.add_metric([value], number)
    return family
