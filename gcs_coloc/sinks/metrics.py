"""Prometheus metrics: of one fleet, made from one snapshot for each scrape, and of all fleets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TypeVar, get_args

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily as _Counter
from prometheus_client.core import GaugeMetricFamily as _Gauge
from prometheus_client.core import InfoMetricFamily, Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector

from gcs_coloc import __version__
from gcs_coloc.core.alarms.alarms import LightColour
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.readiness.vehicle_readiness import ReadinessState
from gcs_coloc.core.snapshot import FleetSnapshot, LinkSnapshot, OutSnapshot, VehicleSnapshot
from gcs_coloc.core.standby.sign_of_life import StandbyState
from gcs_coloc.core.standby.standby_snapshot import StandbySnapshot
from gcs_coloc.core.station_review import StationSnapshot
from gcs_coloc.sinks.watched_fleets import FleetShown, Presence

Family = TypeVar("Family", _Counter, _Gauge)

# name, help, value: a vehicle for which the value is None has no sample.
_GAUGES: tuple[tuple[str, str, Callable[[VehicleSnapshot], float | None]], ...] = (
    ("last_heard_age_seconds", "Time since the vehicle was last heard.", lambda v: v.age_s),
    ("latitude_degrees", "Latitude of the estimate, WGS84.", lambda v: v.lat_deg),
    ("longitude_degrees", "Longitude of the estimate, WGS84.", lambda v: v.lon_deg),
    ("position_sigma_meters", "1-sigma of the position along its worst horizontal direction.", lambda v: v.sigma_h_m),
    ("height_sigma_meters", "1-sigma of the height.", lambda v: v.sigma_v_m),
    ("position_bound_95_meters", "95 % bound of the horizontal position error.", lambda v: v.bound_95_m),
    ("protection_level_meters", "Horizontal protection level (HPL).", lambda v: v.hpl_m),
    ("height_protection_level_meters", "Vertical protection level (VPL).", lambda v: v.vpl_m),
    ("untested_receivers", "Peers whose receiver its ranges cannot test.", lambda v: float(len({*v.untested} - {v.sysid}))),
    ("hdop", "Horizontal dilution of precision of the ranges in use.", lambda v: v.hdop),
    ("ranges_in_use", "Neighbours whose ranges were used lately.", lambda v: float(v.ranges_in_use)),
    (
        "nis_median",
        "Median normalised innovation squared of its ranges of the last 5 s, refused ones included.",
        lambda v: v.consistency.nis_median if v.consistency else None,
    ),
    (
        "ranges_refused_ratio",
        "Share of its ranges of the last 5 s that were refused.",
        lambda v: v.consistency.refused / v.consistency.ranges if v.consistency else None,
    ),
    ("aiding_fix", "1 while the vehicle is being sent a position.", lambda v: float(v.aiding_has_fix)),
    (
        "fix_acknowledged",
        "1 where the vehicle's receiver shows our fix, 0 where it does not.",
        lambda v: float(v.fix_acknowledged) if v.fix_acknowledged is not None else None,
    ),
    (
        "without_gps_bound_95_meters",
        "95 % bound that it would have half a minute after a loss of its GPS now.",
        lambda v: v.readiness.bound_95_m if v.readiness else None,
    ),
    (
        "without_gps_protection_level_meters",
        "Horizontal protection level that it would have half a minute after a loss of its GPS now.",
        lambda v: v.readiness.hpl_m if v.readiness else None,
    ),
    (
        "without_gps_hdop",
        "Horizontal dilution of precision of its ranges half a minute after a loss of its GPS now.",
        lambda v: v.readiness.hdop if v.readiness else None,
    ),
    (
        "without_gps_now_bound_95_meters",
        "95 % bound that it would have at the moment of a loss of its GPS now.",
        lambda v: v.readiness.bound_95_now_m if v.readiness else None,
    ),
    (
        "without_gps_now_protection_level_meters",
        "Horizontal protection level that it would have at the moment of a loss of its GPS now.",
        lambda v: v.readiness.hpl_now_m if v.readiness else None,
    ),
    (
        "without_gps_now_hdop",
        "Horizontal dilution of precision of its ranges at the moment of a loss of its GPS now.",
        lambda v: v.readiness.hdop_now if v.readiness else None,
    ),
    ("link_delay_seconds", "Delay of its newest position beyond the least of the last minute.", lambda v: v.delay_s),
)
_COUNTERS: tuple[tuple[str, str, Callable[[LinkSnapshot], int]], ...] = (
    ("link_frames_received", "Frames received from the vehicle, copies left out.", lambda link: link.received),
    ("link_frames_lost", "Frames missing by their sequence numbers.", lambda link: link.lost),
    ("link_frames_duplicate", "Copies of frames that were received already.", lambda link: link.duplicates),
)
_OUT_COUNTERS: tuple[tuple[str, str, Callable[[OutSnapshot], int]], ...] = (
    ("out_frames_sent", "Vehicles' frames forwarded to the ground tools.", lambda out: out.frames_sent),
    ("out_frames_accepted", "Frames accepted from the ground tools.", lambda out: out.frames_accepted),
    ("out_dropped", "Datagrams and pieces that a ground tool was too slow to receive.", lambda out: out.dropped),
    ("out_refused", "Frames and datagrams of the ground tools that were refused.", lambda out: out.refused),
)


_STATION_GAUGES: tuple[tuple[str, str, Callable[[StationSnapshot], float | None]], ...] = (
    ("latitude_degrees", "Latitude of the station, WGS84.", lambda s: s.lat_deg),
    ("longitude_degrees", "Longitude of the station, WGS84.", lambda s: s.lon_deg),
    ("position_sigma_meters", "1-sigma of its position on each horizontal axis.", lambda s: s.sigma_h_m),
    ("range_age_seconds", "Time since the newest range to the station.", lambda s: s.range_age_s),
    ("used", "1 while its ranges locate vehicles, 0 while they contradict its position.", lambda s: float(s.is_used)),
)


class _Scraped(Collector):
    """Metric families that are made anew at each scrape."""

    def __init__(self, make: Callable[[], Iterable[Metric]]) -> None:
        self._make = make

    def describe(self) -> list[Metric]:
        """Nothing: which vehicles there are is known at the scrape only."""
        return []

    def collect(self) -> Iterable[Metric]:
        """As the protocol says."""
        return self._make()


def _registry(make: Callable[[], Iterable[Metric]]) -> CollectorRegistry:
    """A registry of its own with some families and this process in it."""
    registry = CollectorRegistry()
    registry.register(_Scraped(make))
    ProcessCollector(registry=registry)
    return registry


def _family(kind: type[Family], name: str, text: str, labels: str, samples: Iterable[tuple[object, ...]]) -> Family:
    """A family of some samples, each the values of its labels and then its own.

    `labels` are names with blanks between. A sample whose value is None is left out.
    """
    family = kind(f"gcs_coloc_{name}", text, labels=labels.split())
    for *of, value in samples:
        if value is not None:
            family.add_metric([str(label) for label in of], float(value))  # type: ignore[arg-type]
    return family


def fleet_registry(snapshot: Callable[[], FleetSnapshot]) -> CollectorRegistry:
    """The metrics of one fleet. `snapshot` is called once a scrape."""
    return _registry(lambda: _of_fleet(snapshot()))


def _of_fleet(fleet: FleetSnapshot) -> Iterator[Metric]:
    yield InfoMetricFamily("gcs_coloc_build", "Which program runs.", {"version": __version__, "estimator": fleet.estimator})
    noise, vehicles = fleet.noise, fleet.vehicles
    for name, text, found in (
        ("loop_lag_seconds", "By how much the host ran the service late at worst in the last second.", fleet.loop_lag_s),
        (
            "alert_limit_meters",
            "The alert limit: no position is sent while the protection level is beyond it.",
            fleet.alert_limit_m,
        ),
        ("found_range_bias_sigma_meters", "Lasting error of ranges beyond the stated one.", noise.range_bias_m),
        ("found_device_bias_sigma_meters", "Lasting error of ranging devices beyond the stated one.", noise.device_bias_m),
        ("found_device_scale_sigma_ratio", "Lasting error of ranging devices as a share of the range.", noise.device_scale),
        ("found_height_sigma_meters", "Error of heights beyond the stated one.", noise.height_sigma_m),
        ("found_position_accuracy_ratio", "Error of reported positions over the stated one.", noise.position_factor),
    ):
        yield _family(_Gauge, name, text, "", [(found,)])
    if fleet.standby is not None:
        yield from _standby(fleet.standby)
    yield _family(_Gauge, "vehicles", "Vehicles that were heard.", "", [(len(vehicles),)])
    for name, text, value in _GAUGES:
        yield _family(_Gauge, f"vehicle_{name}", text, "sysid", ((v.sysid, value(v)) for v in vehicles))
    for name, text, number in _STATION_GAUGES:
        yield _family(_Gauge, f"station_{name}", text, "station", ((s.station_id, number(s)) for s in fleet.stations))
    states = ((v.sysid, state.value, v.gps_state == state.value) for v in vehicles for state in GpsState)
    yield _family(_Gauge, "vehicle_gps_state", "1 for the state its GPS is in.", "sysid state", states)
    told = [(v.sysid, v.readiness) for v in vehicles if v.readiness is not None]
    text = "1 for whether it would be located if its GPS failed now; none while its GPS is not healthy."
    ready = ((sysid, each.value, found.state is each) for sysid, found in told for each in ReadinessState)
    yield _family(_Gauge, "vehicle_readiness", text, "sysid state", ready)
    text = "1 for what limits it if its GPS failed now; none where nothing does."
    limits = ((sysid, found.reason, 1) for sysid, found in told if found.reason is not None)
    yield _family(_Gauge, "vehicle_readiness_reason", text, "sysid reason", limits)
    for name, text, count in _COUNTERS:
        yield _family(_Counter, f"vehicle_{name}", text, "sysid", ((link.sysid, count(link)) for link in fleet.links))
    for name, text, count_out in _OUT_COUNTERS:
        yield _family(_Counter, name, text, "out", ((out.name, count_out(out)) for out in fleet.outs))
    yield _family(_Gauge, "out_tools", "Ground tools that can be sent to.", "out", ((out.name, out.tools) for out in fleet.outs))
    yield _family(_Counter, "refused", "What was refused or set aside.", "reason", fleet.refused.items())
    text = "What became of measurements."
    yield _family(_Counter, "estimator_measurements", text, "outcome", fleet.estimator_counts.items())


def _standby(standby: StandbySnapshot) -> Iterator[Metric]:
    states = ((state.value, standby.state == state.value) for state in StandbyState)
    yield _family(_Gauge, "standby_state", "1 for the state this service is in.", "state", states)
    text = "Counts the changes of the active service, the same on both."
    yield _family(_Gauge, "standby_term", text, "", [(standby.term,)])
    if standby.other_age_s is not None:
        text = "Time since the last sign of life of the other service."
        yield _family(_Gauge, "standby_other_age_seconds", text, "", [(standby.other_age_s,)])
    text = "1 while the hot standby is not what it should be."
    yield _family(_Gauge, "standby_problem", text, "", [(standby.problem is not None,)])


def fleets_registry(
    shown: Callable[[], Iterable[FleetShown]], problem: Callable[[], str | None], refused: Callable[[], dict[str, int]]
) -> CollectorRegistry:
    """The metrics of all fleets as they stand at each scrape."""
    return _registry(lambda: _of_fleets(list(shown()), problem(), refused()))


def _of_fleets(fleets: list[FleetShown], problem: str | None, refused: dict[str, int]) -> Iterator[Metric]:
    presences = Counter(fleet.presence for fleet in fleets)
    told = [fleet.overview for fleet in fleets if fleet.presence is Presence.LIVE and fleet.overview is not None]
    lights = Counter(v.light for overview in told for v in overview.vehicles)
    of_presences = ((each.value, presences[each]) for each in Presence)
    yield _family(_Gauge, "watch_fleets", "Fleets by whether they are heard.", "presence", of_presences)
    of_lights = ((light, lights[light]) for light in get_args(LightColour))
    yield _family(_Gauge, "watch_vehicles", "Vehicles of live fleets.", "light", of_lights)
    waiting = sum(alarm.state in ("active", "over") for overview in told for alarm in overview.alarms)
    yield _family(_Gauge, "watch_alarms", "Alarms of live fleets that nobody has acknowledged.", "", [(waiting,)])
    yield _family(_Gauge, "watch_connected", "1 while states can come.", "", [(problem is None,)])
    yield _family(_Counter, "watch_refused", "Messages that were refused.", "reason", refused.items())


def merged_metrics(parts: Iterable[tuple[Mapping[str, str], Iterable[Metric]]]) -> bytes:
    """Metric families of several processes in Prometheus's text format; those of the same name are merged.

    `parts` has the labels and the families of each process.
    """
    families: dict[str, Metric] = {}
    for labels, several in parts:
        for family in several:
            merged = families.setdefault(family.name, Metric(family.name, family.documentation, family.type))
            merged.samples += [sample._replace(labels={**sample.labels, **labels}) for sample in family.samples]
    registry = CollectorRegistry()
    registry.register(_Scraped(families.values))
    return generate_latest(registry)


def read_metrics(text: str) -> list[Metric]:
    """The metric families in Prometheus's text format. Raises ValueError where it is none."""
    return list(text_string_to_metric_families(text))


def worker_metrics(is_heard: Mapping[str, bool], starts: Mapping[str, int]) -> list[Metric]:
    """Return the metrics of the worker processes themselves, by fleet.

    They are whether each runs and is heard, and how often it was started.
    """
    text = "1 while the fleet's process runs and is heard."
    started = "How often the fleet's process was started."
    return [
        _family(_Gauge, "worker_up", text, "fleet", is_heard.items()),
        _family(_Counter, "worker_starts", started, "fleet", starts.items()),
    ]
