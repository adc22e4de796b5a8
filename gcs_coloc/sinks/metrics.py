"""The fleet as Prometheus metrics, made from one snapshot for each scrape."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.registry import Collector

from gcs_coloc import __version__
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.readiness.vehicle_readiness import ReadinessState
from gcs_coloc.core.snapshot import FleetSnapshot, LinkSnapshot, OutSnapshot, VehicleSnapshot
from gcs_coloc.core.standby.sign_of_life import StandbyState
from gcs_coloc.core.standby.standby_snapshot import StandbySnapshot
from gcs_coloc.core.station_review import StationSnapshot

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
    ("untested_receivers", "Peers whose receiver its ranges cannot test.", lambda v: float(len(v.untested))),
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


class FleetCollector(Collector):
    """Turns the fleet as it stands into metric families. `snapshot` is called once a scrape."""

    def __init__(self, snapshot: Callable[[], FleetSnapshot]) -> None:
        self._snapshot = snapshot

    def describe(self) -> list[Metric]:
        """Nothing: which vehicles there are is known at the scrape only."""
        return []

    def collect(self) -> Iterator[Metric]:
        """As the protocol says."""
        fleet = self._snapshot()
        yield InfoMetricFamily("gcs_coloc_build", "Which program runs.", {"version": __version__, "estimator": fleet.estimator})
        text = "By how much the host ran the service late at worst in the last second."
        yield GaugeMetricFamily("gcs_coloc_loop_lag_seconds", text, fleet.loop_lag_s)
        text = "The alert limit: no position is sent while the protection level is beyond it."
        yield GaugeMetricFamily("gcs_coloc_alert_limit_meters", text, fleet.alert_limit_m)
        noise = fleet.noise
        for name, text, found in (
            ("range_bias_sigma_meters", "Lasting error of ranges beyond the stated one.", noise.range_bias_m),
            ("device_bias_sigma_meters", "Lasting error of ranging devices beyond the stated one.", noise.device_bias_m),
            ("device_scale_sigma_ratio", "Lasting error of ranging devices as a share of the range.", noise.device_scale),
            ("height_sigma_meters", "Error of heights beyond the stated one.", noise.height_sigma_m),
            ("position_accuracy_ratio", "Error of reported positions over the stated one.", noise.position_factor),
        ):
            yield GaugeMetricFamily(f"gcs_coloc_found_{name}", text, found)
        if fleet.standby is not None:
            yield from _standby(fleet.standby)
        yield GaugeMetricFamily("gcs_coloc_vehicles", "Vehicles that were heard.", float(len(fleet.vehicles)))
        for name, text, value in _GAUGES:
            gauge = GaugeMetricFamily(f"gcs_coloc_vehicle_{name}", text, labels=["sysid"])
            for vehicle in fleet.vehicles:
                number = value(vehicle)
                if number is not None:
                    gauge.add_metric([str(vehicle.sysid)], number)
            yield gauge
        for name, text, number_of in _STATION_GAUGES:
            gauge = GaugeMetricFamily(f"gcs_coloc_station_{name}", text, labels=["station"])
            for station in fleet.stations:
                number = number_of(station)
                if number is not None:
                    gauge.add_metric([str(station.station_id)], number)
            yield gauge
        states = GaugeMetricFamily("gcs_coloc_vehicle_gps_state", "1 for the state its GPS is in.", labels=["sysid", "state"])
        for vehicle in fleet.vehicles:
            for state in GpsState:
                states.add_metric([str(vehicle.sysid), state.value], float(vehicle.gps_state == state.value))
        yield states
        text = "1 for whether it would be located if its GPS failed now; none while its GPS is not healthy."
        readiness = GaugeMetricFamily("gcs_coloc_vehicle_readiness", text, labels=["sysid", "state"])
        for sysid, told in ((vehicle.sysid, vehicle.readiness) for vehicle in fleet.vehicles):
            for each in ReadinessState if told is not None else ():
                readiness.add_metric([str(sysid), each.value], float(told is not None and told.state is each))
        yield readiness
        text = "1 for what limits it if its GPS failed now; none where nothing does."
        limits = GaugeMetricFamily("gcs_coloc_vehicle_readiness_reason", text, labels=["sysid", "reason"])
        for sysid, told in ((vehicle.sysid, vehicle.readiness) for vehicle in fleet.vehicles):
            if told is not None and told.reason is not None:
                limits.add_metric([str(sysid), told.reason], 1.0)
        yield limits
        for name, text, count in _COUNTERS:
            counter = CounterMetricFamily(f"gcs_coloc_vehicle_{name}", text, labels=["sysid"])
            for link in fleet.links:
                counter.add_metric([str(link.sysid)], float(count(link)))
            yield counter
        for name, text, count_out in _OUT_COUNTERS:
            counter = CounterMetricFamily(f"gcs_coloc_{name}", text, labels=["out"])
            for out in fleet.outs:
                counter.add_metric([out.name], float(count_out(out)))
            yield counter
        tools = GaugeMetricFamily("gcs_coloc_out_tools", "Ground tools that can be sent to.", labels=["out"])
        for out in fleet.outs:
            tools.add_metric([out.name], float(out.tools))
        yield tools
        refused = CounterMetricFamily("gcs_coloc_refused", "What was refused or set aside.", labels=["reason"])
        for reason, times in fleet.refused.items():
            refused.add_metric([reason], float(times))
        yield refused
        counts = CounterMetricFamily("gcs_coloc_estimator_measurements", "What became of measurements.", labels=["outcome"])
        for outcome, times in fleet.estimator_counts.items():
            counts.add_metric([outcome], float(times))
        yield counts


def _standby(standby: StandbySnapshot) -> Iterator[Metric]:
    states = GaugeMetricFamily("gcs_coloc_standby_state", "1 for the state this service is in.", labels=["state"])
    for state in StandbyState:
        states.add_metric([state.value], float(standby.state == state.value))
    yield states
    text = "Counts the changes of the active service, the same on both."
    yield GaugeMetricFamily("gcs_coloc_standby_term", text, float(standby.term))
    if standby.other_age_s is not None:
        text = "Time since the last sign of life of the other service."
        yield GaugeMetricFamily("gcs_coloc_standby_other_age_seconds", text, standby.other_age_s)
    text = "1 while the hot standby is not what it should be."
    yield GaugeMetricFamily("gcs_coloc_standby_problem", text, float(standby.problem is not None))


def fleet_registry(snapshot: Callable[[], FleetSnapshot]) -> CollectorRegistry:
    """A registry of its own with the fleet and this process in it."""
    registry = CollectorRegistry()
    registry.register(FleetCollector(snapshot))
    ProcessCollector(registry=registry)
    return registry
