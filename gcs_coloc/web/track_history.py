"""Track history for a page that opens late: the last minutes of each vehicle.

It also has the latest events and the rates of the links.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from math import nan

from gcs_coloc.core.alarms.alarms import Alarm, AlarmKind, AlarmState
from gcs_coloc.core.messages.outbound import Notice, ToOperator
from gcs_coloc.core.snapshot import FleetSnapshot, LinkSnapshot, OutSnapshot, VehicleSnapshot
from gcs_coloc.sinks.event_bus import FleetEvent, Subscription, level_and_text
from gcs_coloc.web.wire import CountsFrame, Event, EventsFrame, LinkFrame, OutFrame, VehicleHistory

SAMPLES_PER_VEHICLE = 600
"""Ten minutes at one sample a second, which is what the plots hold."""
EVENTS_KEPT = 500
"""Chosen: more than the page lists (200), at some 300 bytes each."""
_MIN_SAMPLE_PERIOD_S = 0.7
"""Snapshots come once a second, some a little early; where they come more often, one a second is kept."""
_MAX_SAMPLES_SENT = 20_000
"""Of all vehicles together, chosen: some 1.5 MB, which a page parses within 0.1 s."""
_RATE_WINDOW_S = 5.0  # chosen: smooth enough to read

Sample = tuple[float, ...]
"""One vehicle at one time: `at_s`, and a number for each of `SAMPLE_COLUMNS`; NaN where it is unknown."""
SAMPLE_COLUMNS = ("east_m", "north_m", "sigma_h_m", "hdop", "ranges_in_use", "nis_median", "band_low", "band_high")


class LinkRates:
    """Rates and loss of the links and ground tools over the last 5 s, from the totals in snapshots."""

    def __init__(self) -> None:
        self._links: deque[tuple[float, dict[int, LinkSnapshot]]] = deque()
        self._outs: deque[tuple[float, dict[str, OutSnapshot]]] = deque()

    def update(self, fleet: FleetSnapshot) -> None:
        """Add the totals of one snapshot."""
        self._links.append((fleet.at_s, {link.sysid: link for link in fleet.links}))
        self._outs.append((fleet.at_s, {out.name: out for out in fleet.outs}))
        while fleet.at_s - self._links[0][0] > _RATE_WINDOW_S:
            self._links.popleft()
            self._outs.popleft()

    def counts(self, fleet: FleetSnapshot) -> CountsFrame:
        """The counters of a snapshot, with the rates since the oldest snapshot of the window."""
        links_s, links = self._links[0] if self._links else (fleet.at_s, {})
        outs_s, outs = self._outs[0] if self._outs else (fleet.at_s, {})
        return CountsFrame(
            links=tuple(_link_frame(link, links.get(link.sysid), fleet.at_s - links_s) for link in fleet.links),
            outs=tuple(_out_frame(out, outs.get(out.name), fleet.at_s - outs_s) for out in fleet.outs),
            refused=fleet.refused,
            estimator_counts=fleet.estimator_counts,
        )


class TrackHistory:
    """The last ten minutes and the last 500 events of a live fleet; the oldest go first."""

    def __init__(self) -> None:
        self._rates = LinkRates()
        self._samples: dict[int, deque[Sample]] = {}
        self._events: deque[Event] = deque(maxlen=EVENTS_KEPT)
        self._sampled_at_s = float("-inf")
        self.newest_event = 0
        """The number of the newest event; 0 before the first."""

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
        self.newest_event += 1
        self._events.append(page_event(self.newest_event, event))

    def events_after(self, number: int) -> EventsFrame:
        """The kept events with a higher number, and how many are no longer kept."""
        events = tuple(e for e in self._events if e.id > number)
        return EventsFrame(events=events, missed=self.newest_event - number - len(events))

    def tracks(self) -> tuple[VehicleHistory, ...]:
        """The last minutes of each vehicle; fewer of them for a large fleet, so that a page opens quickly."""
        count = samples_per_vehicle(len(self._samples))
        return tuple(columns(sysid, list(samples)[-count:]) for sysid, samples in sorted(self._samples.items()))

    def counts(self, fleet: FleetSnapshot) -> CountsFrame:
        """The counters of a snapshot, with rates over the last seconds."""
        return self._rates.counts(fleet)

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
    return LinkFrame(
        sysid=now.sysid,
        received=now.received,
        lost=now.lost,
        duplicates=now.duplicates,
        rate_hz=rate_hz,
        loss_percent=loss_percent,
    )


def _out_frame(now: OutSnapshot, then: OutSnapshot | None, elapsed_s: float) -> OutFrame:
    rate_hz = (now.frames_sent - then.frames_sent) / elapsed_s if then is not None and elapsed_s > 0.0 else None
    return OutFrame(**asdict(now), rate_hz=rate_hz)
