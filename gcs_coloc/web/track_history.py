"""What a page that opens late must know: the last minutes of each vehicle, the events, the rates of the links."""

from __future__ import annotations

import secrets
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict
from math import nan
from typing import Any

from gcs_coloc.core.snapshot import FleetSnapshot, LinkSnapshot, OutSnapshot, VehicleSnapshot
from gcs_coloc.sinks.event_bus import FleetEvent, Subscription, level_and_text
from gcs_coloc.web.wire import CountsFrame, Event, EventsFrame, LinkFrame, OutFrame, VehicleHistory

_SAMPLE_EVERY_S = 0.7
"""Views come once a second, some a little early; where they come more often every second one is kept."""
_SAMPLES_PER_VEHICLE = 600
_SAMPLES_SENT = 20_000
_EVENTS = 500
_RATE_OVER_S = 5.0

_Row = tuple[float, ...]


class TrackHistory:
    """Follows the news; everything it keeps is bounded, the oldest goes first."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything: another flight begins, or the same one again. `instance` tells the two apart.

        `edition` is raised by whoever wants the pages to be told the history again.
        """
        self.instance = secrets.token_hex(8)
        self.edition = 0
        self._rows: dict[int, deque[_Row]] = {}
        self._events: deque[Event] = deque(maxlen=_EVENTS)
        self._next_event = 1
        self._sampled_at_s = float("-inf")
        self._links: deque[tuple[float, dict[int, LinkSnapshot]]] = deque()
        self._outs: deque[tuple[float, dict[str, OutSnapshot]]] = deque()

    def state(self) -> dict[str, Any]:
        """Everything that it was told, see `restore`."""
        return {name: value for name, value in vars(self).items() if name not in ("instance", "edition")}

    def restore(self, state: Mapping[str, Any], *, anew: bool) -> None:
        """Know what a story of the same flight knew at another place; `anew`: at an earlier one, pages are to forget this one.

        What the state holds is this one's from now on: it wants a copy to be kept.
        """
        vars(self).update(state)
        if anew:
            self.instance = secrets.token_hex(8)
            self.edition = 0

    async def follow(self, news: Subscription) -> None:
        """Take the news for ever."""
        while True:
            self.take(await news.get())

    def take(self, news: FleetEvent) -> None:
        """Take one piece of news."""
        if isinstance(news, FleetSnapshot):
            self._take_view(news)
            return
        level, text = level_and_text(news)
        event = Event.model_validate(
            {
                "id": self._next_event,
                "at_s": news.at_s,
                "sysid": news.sysid,
                "level": level,
                "text": text,
                "alarm": level != "info",
            }
        )
        self._next_event += 1
        self._events.append(event)

    @property
    def newest_event(self) -> int:
        """The number of the newest event; 0 where there was none."""
        return self._next_event - 1

    def events_after(self, number: int) -> EventsFrame:
        """The events with a higher number that are still kept, and how many are not."""
        events = tuple(e for e in self._events if e.id > number)
        return EventsFrame(events=events, missed=self.newest_event - number - len(events))

    def history(self) -> tuple[VehicleHistory, ...]:
        """The last minutes of each vehicle; fewer of them for large fleets, so that a page opens quickly."""
        most = max(_SAMPLES_SENT // max(len(self._rows), 1), 1)
        return tuple(_columns(sysid, list(rows)[-most:]) for sysid, rows in sorted(self._rows.items()))

    def counts(self, view: FleetSnapshot) -> CountsFrame:
        """What is counted in a view, with rates and loss over the last seconds."""
        links_s, links = self._links[0] if self._links else (view.at_s, {})
        outs_s, outs = self._outs[0] if self._outs else (view.at_s, {})
        return CountsFrame(
            links=tuple(_link(link, links.get(link.sysid), view.at_s - links_s) for link in view.links),
            outs=tuple(_out(out, outs.get(out.name), view.at_s - outs_s) for out in view.outs),
            refused=view.refused,
            estimator_counts=view.estimator_counts,
        )

    def _take_view(self, view: FleetSnapshot) -> None:
        self._links.append((view.at_s, {link.sysid: link for link in view.links}))
        self._outs.append((view.at_s, {out.name: out for out in view.outs}))
        while view.at_s - self._links[0][0] > _RATE_OVER_S:
            self._links.popleft()
            self._outs.popleft()
        if view.at_s - self._sampled_at_s < _SAMPLE_EVERY_S:
            return
        self._sampled_at_s = view.at_s
        for v in view.vehicles:
            self._rows.setdefault(v.sysid, deque(maxlen=_SAMPLES_PER_VEHICLE)).append(_row(v, view.at_s))


def _row(v: VehicleSnapshot, at_s: float) -> _Row:
    east_m, north_m, _ = v.enu_m if v.enu_m is not None else (nan, nan, nan)
    c = v.consistency
    nis = (c.nis_median, c.band_low, c.band_high) if c is not None else (nan, nan, nan)
    sigma_m, hdop = (x if x is not None else nan for x in (v.sigma_h_m, v.hdop))
    return (at_s, east_m, north_m, sigma_m, hdop, float(v.ranges_in_use), *nis)


def _columns(sysid: int, rows: list[_Row]) -> VehicleHistory:
    at_s, *rest = zip(*rows, strict=True)
    names = ("east_m", "north_m", "sigma_h_m", "hdop", "ranges_in_use", "nis_median", "band_low", "band_high")
    columns = {name: tuple(_short(x) for x in column) for name, column in zip(names, rest, strict=True)}
    return VehicleHistory(sysid=sysid, at_s=at_s, **columns)


def _short(x: float) -> float | None:
    return round(x, 3) if x == x else None  # NaN differs from itself


def _link(now: LinkSnapshot, then: LinkSnapshot | None, elapsed_s: float) -> LinkFrame:
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


def _out(now: OutSnapshot, then: OutSnapshot | None, elapsed_s: float) -> OutFrame:
    rate_hz = (now.frames_sent - then.frames_sent) / elapsed_s if then is not None and elapsed_s > 0.0 else None
    return OutFrame(**asdict(now), rate_hz=rate_hz)
