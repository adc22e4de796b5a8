"""The picture of a live fleet as the page draws it, with the history for a page that opens late.

It adds traffic lights with their reasons, ellipses and true positions to a snapshot.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from math import nan

from gcs_coloc.core.alarms.alarms import Alarm, AlarmKind, AlarmState, traffic_light
from gcs_coloc.core.error_ellipse import error_ellipse
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Vector3
from gcs_coloc.core.messages.outbound import Notice, ToOperator
from gcs_coloc.core.snapshot import FleetSnapshot, LinkSnapshot, OutSnapshot, VehicleSnapshot
from gcs_coloc.mavlink.decoder import HeardTruth
from gcs_coloc.sinks.event_bus import FleetEvent, Subscription, level_and_text
from gcs_coloc.web.pages import PageSource
from gcs_coloc.web.wire import (
    CountsFrame,
    Ellipse,
    Event,
    EventsFrame,
    FleetFrame,
    LinkFrame,
    OutFrame,
    VehicleFrame,
    VehicleHistory,
    fleet_json,
)

SAMPLES_PER_VEHICLE = 600
"""Ten minutes at one sample a second, which is what the plots hold."""
EVENTS_KEPT = 500
"""Chosen: more than the page lists (200), at some 300 bytes each."""
_MIN_SAMPLE_PERIOD_S = 0.7
"""Snapshots come once a second, some a little early; where they come more often, one a second is kept."""
_MAX_SAMPLES_SENT = 20_000
"""Of all vehicles together, chosen: some 1.5 MB, which a page parses within 0.1 s."""
_RATE_WINDOW_S = 5.0  # chosen: smooth enough to read
_TRUTH_FRESH_S = 2.0  # chosen: simulators tell where their vehicles are at 1 Hz or faster

Sample = tuple[float, ...]
"""One vehicle at one time: `at_s`, and a number for each of `SAMPLE_COLUMNS`; NaN where it is unknown."""
SAMPLE_COLUMNS = ("east_m", "north_m", "sigma_h_m", "hdop", "ranges_in_use", "nis_median", "band_low", "band_high")


class LinkRates:
    """Rates and loss of the links and ground tools over the last 5 s, from the totals in snapshots."""

    def __init__(self) -> None:
        self._totals: deque[tuple[float, dict[int, LinkSnapshot], dict[str, OutSnapshot]]] = deque()

    def update(self, fleet: FleetSnapshot) -> None:
        """Add the totals of one snapshot."""
        self._totals.append((fleet.at_s, {link.sysid: link for link in fleet.links}, {out.name: out for out in fleet.outs}))
        while fleet.at_s - self._totals[0][0] > _RATE_WINDOW_S:
            self._totals.popleft()

    def counts(self, fleet: FleetSnapshot) -> CountsFrame:
        """The counters of a snapshot, with the rates since the oldest snapshot of the window."""
        from_s, links, outs = self._totals[0] if self._totals else (fleet.at_s, {}, {})
        return CountsFrame(
            links=tuple(_link_frame(link, links.get(link.sysid), fleet.at_s - from_s) for link in fleet.links),
            outs=tuple(_out_frame(out, outs.get(out.name), fleet.at_s - from_s) for out in fleet.outs),
            refused=fleet.refused,
            estimator_counts=fleet.estimator_counts,
        )


class LiveSource(PageSource):
    """What pages are sent of a live fleet: its picture, its last ten minutes and its last 500 events.

    `snapshot` returns the fleet with its counters, `recent_snapshot` the fleet as of a moment ago, for many times a second;
    `alarms` brings the service's alarms up to date with a snapshot and returns them, `truths` the true positions that a
    simulation sends.
    """

    def __init__(
        self,
        snapshot: Callable[[], FleetSnapshot],
        recent_snapshot: Callable[[], FleetSnapshot],
        alarms: Callable[[FleetSnapshot], Iterable[Alarm]],
        truths: Callable[[], Iterable[HeardTruth]] = tuple,
    ) -> None:
        super().__init__()
        self._snapshot = snapshot
        self._recent_snapshot = recent_snapshot
        self._alarms = alarms
        self._truths = truths
        self._rates = LinkRates()
        self._samples: dict[int, deque[Sample]] = {}
        self._events: deque[Event] = deque(maxlen=EVENTS_KEPT)
        self._sampled_at_s = float("-inf")
        self._newest_event = 0

    async def follow(self, events: Subscription) -> None:
        """Add every event of a subscription, for ever."""
        while True:
            self.add(await events.get())

    def add(self, event: FleetEvent) -> None:
        """Add a snapshot of the fleet, a message to the operator, or the change of an alarm."""
        if isinstance(event, FleetSnapshot):
            self._add_snapshot(event)
            return
        if is_told_already(event):
            return
        self._newest_event += 1
        self._events.append(page_event(self._newest_event, event))

    @property
    def newest_event(self) -> int:
        """As `PageSource` says."""
        return self._newest_event

    @property
    def utc_minus_service_s(self) -> float | None:
        """As `PageSource` says."""
        return self._recent_snapshot().utc_minus_service_s

    def events_after(self, number: int) -> EventsFrame:
        """The kept events with a higher number, and how many are no longer kept."""
        events = tuple(e for e in self._events if e.id > number)
        return EventsFrame(events=events, missed=self._newest_event - number - len(events))

    def tracks(self) -> tuple[VehicleHistory, ...]:
        """The last minutes of each vehicle; fewer of them for a large fleet, so that a page opens quickly."""
        count = samples_per_vehicle(len(self._samples))
        return tuple(columns(sysid, list(samples)[-count:]) for sysid, samples in sorted(self._samples.items()))

    def messages(self, *, with_counts: bool) -> list[str]:
        """As `PageSource` says."""
        fleet = self._recent_snapshot()
        messages = [fleet_json(fleet_frame(fleet, self._alarms(fleet), self._truths())).decode()]
        if with_counts:
            messages.append(self._rates.counts(self._snapshot()).model_dump_json())
        return messages

    def _add_snapshot(self, fleet: FleetSnapshot) -> None:
        self._rates.update(fleet)
        if fleet.at_s - self._sampled_at_s < _MIN_SAMPLE_PERIOD_S:
            return
        self._sampled_at_s = fleet.at_s
        for v in fleet.vehicles:
            self._samples.setdefault(v.sysid, deque(maxlen=SAMPLES_PER_VEHICLE)).append(sample(v, fleet.at_s))


def page_event(number: int, message: ToOperator | Alarm) -> Event:
    """A message to the operator, or the change of an alarm, as the page is sent it."""
    if isinstance(message, Alarm):
        is_active = message.state is AlarmState.ACTIVE
        level, text = (message.level if is_active else "info"), f"alarm {message.state}: {message.text}"
    else:
        level, text = level_and_text(message)
        is_active = isinstance(message, Notice) and level != "info"
    content = {"id": number, "at_s": message.at_s, "sysid": message.sysid, "level": level, "text": text, "alarm": is_active}
    return Event.model_validate(content)


def is_told_already(event: ToOperator | Alarm) -> bool:
    """Whether an event repeats the notice before it: it is the alarm that this notice raised."""
    return isinstance(event, Alarm) and event.kind is AlarmKind.NOTICE and event.state is AlarmState.OVER


def samples_per_vehicle(vehicles: int) -> int:
    """How many samples of each vehicle a page is sent in a fleet of so many."""
    return min(max(_MAX_SAMPLES_SENT // max(vehicles, 1), 1), SAMPLES_PER_VEHICLE)


def sample(v: VehicleSnapshot, at_s: float) -> Sample:
    """What the plots and the trail keep of one vehicle."""
    east_m, north_m, _ = v.enu_m if v.enu_m is not None else (nan, nan, nan)
    c = v.consistency
    nis = (c.nis_median, c.band_low, c.band_high) if c is not None else (nan, nan, nan)
    sigma_m, hdop = (x if x is not None else nan for x in (v.sigma_h_m, v.hdop))
    return (at_s, east_m, north_m, sigma_m, hdop, float(v.ranges_in_use), *nis)


def columns(sysid: int, samples: Iterable[Sequence[float]]) -> VehicleHistory:
    """Samples of one vehicle column by column, as the page is sent them. At least one is needed."""
    at_s, *rest = zip(*samples, strict=True)
    named = {name: tuple(_rounded(x) for x in column) for name, column in zip(SAMPLE_COLUMNS, rest, strict=True)}
    return VehicleHistory(sysid=sysid, at_s=at_s, **named)


def _rounded(x: float) -> float | None:
    return round(x, 3) if x == x else None  # NaN differs from itself


def _link_frame(now: LinkSnapshot, then: LinkSnapshot | None, elapsed_s: float) -> LinkFrame:
    rate_hz = loss_percent = None
    if then is not None and elapsed_s > 0.0:
        received, lost = now.received - then.received, max(now.lost - then.lost, 0)
        rate_hz = received / elapsed_s
        if received + lost > 0:
            loss_percent = 100.0 * lost / (received + lost)
    return LinkFrame(**asdict(now), rate_hz=rate_hz, loss_percent=loss_percent)


def _out_frame(now: OutSnapshot, then: OutSnapshot | None, elapsed_s: float) -> OutFrame:
    rate_hz = (now.frames_sent - then.frames_sent) / elapsed_s if then is not None and elapsed_s > 0.0 else None
    return OutFrame(**asdict(now), rate_hz=rate_hz)


def fleet_frame(fleet: FleetSnapshot, alarms: Iterable[Alarm] = (), truths: Iterable[HeardTruth] = ()) -> FleetFrame:
    """The page's picture of one instant."""
    true_enu_m = _true_positions(fleet, truths)
    return FleetFrame(
        at_s=fleet.at_s,
        utc_minus_service_s=fleet.utc_minus_service_s,
        estimator=fleet.estimator,
        origin=fleet.origin,
        vehicles=tuple(_vehicle_frame(v, fleet.loop_lag_s, true_enu_m.get(v.sysid)) for v in fleet.vehicles),
        ranges=fleet.ranges,
        stations=fleet.stations,
        alarms=tuple(alarms),
        standby=fleet.standby,
    )


def ellipse(covariance_h_m2: tuple[float, float, float]) -> Ellipse:
    """The 2-sigma ellipse of a covariance (east-east, east-north, north-north) in square metres."""
    major_m, minor_m, angle_rad = error_ellipse(*covariance_h_m2)
    return Ellipse(semi_major_m=2.0 * major_m, semi_minor_m=2.0 * minor_m, angle_rad=angle_rad)


def _true_positions(fleet: FleetSnapshot, truths: Iterable[HeardTruth]) -> dict[int, Vector3]:
    """Return the true positions that are fresh as east, north, up in m, by system id.

    They come without a height and get the estimate's.
    """
    fresh = [t for t in truths if abs(fleet.at_s - t.at_s) <= _TRUTH_FRESH_S]
    if fleet.origin is None or not fresh:
        return {}
    frame = LocalFrame(*fleet.origin)
    heights = {v.sysid: v.alt_msl_m for v in fleet.vehicles if v.alt_msl_m is not None}
    return {t.sysid: frame.enu_from_geodetic(t.lat_deg, t.lon_deg, heights.get(t.sysid, fleet.origin[2])) for t in fresh}


def _vehicle_frame(v: VehicleSnapshot, loop_lag_s: float, truth_enu_m: Vector3 | None) -> VehicleFrame:
    light, reason = traffic_light(v, loop_lag_s)
    shape = ellipse(v.covariance_h_m2) if v.covariance_h_m2 is not None else None
    return VehicleFrame(snapshot=v, light=light, reason=reason, ellipse=shape, truth_enu_m=truth_enu_m)
