"""All fleets of all hosts, each by its last message: which are live, which silent.

It does no IO; time is passed in.

Where the fleets' states come from is not known here: a broker, or worker processes on this computer.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from pydantic import BaseModel, ConfigDict

from gcs_coloc.core.alarms.alarms import LightColour
from gcs_coloc.sinks.fleet_overview import FleetOverview

MAX_FLEETS = 1000
"""Fleets that are kept. Chosen: more than anybody watches; a broker of others cannot fill the memory."""
_MIN_SILENT_S = 5.0
"""Chosen: five messages of a service that publishes once a second, as it does unless told; a radio link may lose two."""
_MISSED_MESSAGES = 3
"""A service that publishes seldom is silent after so many messages that did not come."""
_FAR_OFF_S = 60.0
"""A host whose clock is off by more is told of. Chosen: a wrong clock, and no delay of a link."""
_MAX_HOSTS = 8
"""Hosts that tell of one fleet. Chosen: more than one is a mistake, which is shown."""
WORST_FIRST: tuple[LightColour, ...] = ("bad", "caution", "unknown", "good")


class Presence(StrEnum):
    """Whether a fleet's service is heard. Its value stands in the messages to the page."""

    LIVE = "live"
    """It is heard."""
    STALE = "stale"
    """Nothing was heard of it for longer than it may be silent, or one message since."""
    LOST = "lost"
    """Its connection was lost: the broker, or the supervisor of its process, says so."""
    ENDED = "ended"
    """It has said goodbye."""
    KEPT = "kept"
    """There is one message of it, which the broker may have kept for long: no sign of life."""
    UNTOLD = "untold"
    """It is connected, but does not tell what is shown here: an older version, or it has just started."""


_SAID = {
    Presence.LOST: "the connection to its service was lost",
    Presence.ENDED: "its service has ended",
    Presence.KEPT: "no sign of life yet: this is the last state that was kept of it",
    Presence.UNTOLD: "its service does not tell how its vehicles stand: it is of another version, or has just started",
}
_RANKS = {Presence.STALE: 1, Presence.LOST: 1, Presence.UNTOLD: 4, Presence.KEPT: 6, Presence.ENDED: 7}
_LIVE_RANKS: dict[LightColour, int] = {"bad": 0, "caution": 2, "unknown": 3, "good": 5}
"""The most serious fleet stands first: one in alarm, then one that is not heard any more, and last one that has ended."""


class _Shown(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class FleetShown(_Shown):
    """One fleet as a page or table shows it.

    `age_s` is since it was last heard, None where there was no sign of life. `light` is the worst of its vehicles', unknown
    unless the fleet is live. `written_unix_s` is when its state was true, by its own host's clock. `page` is the address of
    its own page, None where that is not known.
    """

    source: str
    host: str
    name: str
    presence: Presence
    text: str
    age_s: float | None
    written_unix_s: float | None
    light: LightColour
    problem: str | None
    sysids: tuple[int, ...]
    overview: FleetOverview | None
    page: str | None = None


@dataclass(slots=True)
class _Heard:
    """What was heard of one fleet of one host. Times are the caller's, s."""

    overview: FleetOverview
    at_s: float
    is_confirmed: bool = False
    """Whether the message before it was heard shortly before: only then is anybody alive who sends them."""
    was_live: bool = False
    """Whether it was live before: then it is known that its service flies, and no message of it is one that was kept."""
    is_last: bool = False
    """Whether its connection was lost, or it said goodbye, after this message."""
    clock_off_s: float | None = None
    """By how much its host's clock was ahead of ours, where both are known."""

    @property
    def silent_after_s(self) -> float:
        return max(_MIN_SILENT_S, _MISSED_MESSAGES * self.overview.every_s)


@dataclass(slots=True)
class _Source:
    """What one source sent of a fleet: its name, the last report on its connection, states by host."""

    name: str
    said: Presence | None = None
    said_at_s: float | None = None
    sysids: tuple[int, ...] = ()
    by_host: dict[str, _Heard] = field(default_factory=dict)


class WatchedFleets:
    """All fleets that were heard of. `now_s` is any clock that is not stepped, `now_unix_s` UNIX time."""

    def __init__(self) -> None:
        self._sources: dict[str, _Source] = {}

    def receive(self, source: str, name: str, overview: FleetOverview, now_s: float, now_unix_s: float) -> bool:
        """Add a message with the state of fleet `name`; return False where there are too many.

        `source` is where the messages of this fleet alone come from.
        A message that was received before is no sign of life: a broker hands on what it has kept.
        """
        place = self._place(source, name)
        if place is None or (overview.host not in place.by_host and len(place.by_host) >= _MAX_HOSTS):
            return False
        before = place.by_host.get(overview.host)
        if before is not None and before.overview.at_s == overview.at_s:
            return True
        heard = _Heard(overview, now_s)
        heard.was_live = before is not None and (before.is_confirmed or before.was_live)
        if before is not None and not before.is_last and now_s - before.at_s <= before.silent_after_s:
            heard.is_confirmed = True
            if place.said in (Presence.LOST, Presence.ENDED):
                place.said = None
        if overview.at_unix_s is not None:
            heard.clock_off_s = overview.at_unix_s - now_unix_s
        place.by_host[overview.host] = heard
        return True

    def receive_connection(
        self, source: str, name: str, said: Presence | None, now_s: float, sysids: tuple[int, ...] = ()
    ) -> bool:
        """Add a report on the connection of a fleet's service: LOST, ENDED, or None where it is up.

        `sysids` are the vehicles that it has heard, as far as that is told. False where there are too many fleets.
        """
        place = self._place(source, name)
        if place is None:
            return False
        place.said, place.said_at_s = said, now_s
        if said in (Presence.LOST, Presence.ENDED):
            for heard in place.by_host.values():
                heard.was_live = heard.was_live or heard.is_confirmed
                heard.is_confirmed, heard.is_last = False, True
        place.sysids = sysids or place.sysids
        return True

    def forget(self, source: str) -> None:
        """Forget a fleet: what the broker had kept of it was deleted."""
        self._sources.pop(source, None)

    def shown(self, now_s: float) -> tuple[FleetShown, ...]:
        """All fleets as they stand, the most serious first."""
        fleets = [fleet for source, place in self._sources.items() for fleet in _of_place(source, place, now_s)]
        return tuple(sorted(fleets, key=_rank))

    def _place(self, source: str, name: str) -> _Source | None:
        if source not in self._sources and len(self._sources) >= MAX_FLEETS:
            return None
        return self._sources.setdefault(source, _Source(name))


def _of_place(source: str, place: _Source, now_s: float) -> list[FleetShown]:
    if not place.by_host:
        presence = place.said or Presence.UNTOLD
        age_s = now_s - place.said_at_s if place.said_at_s is not None else None
        return [
            FleetShown(
                source=source,
                host="",
                name=place.name,
                presence=presence,
                text=_SAID[presence],
                age_s=age_s,
                written_unix_s=None,
                light="unknown",
                problem=None,
                sysids=place.sysids,
                overview=None,
            )
        ]
    live = [host for host, heard in place.by_host.items() if _presence(place, heard, now_s) is Presence.LIVE]
    return [_shown(source, place, heard, [host for host in live if host != own], now_s) for own, heard in place.by_host.items()]


def _shown(source: str, place: _Source, heard: _Heard, others: list[str], now_s: float) -> FleetShown:
    overview, presence = heard.overview, _presence(place, heard, now_s)
    is_live = presence is Presence.LIVE
    problems = []
    if is_live and others:
        problems.append(f"{' and '.join(sorted(others))} tells of a fleet under the same name: give each a name of its own")
    if is_live and heard.clock_off_s is not None and abs(heard.clock_off_s) > _FAR_OFF_S:
        side = "ahead of" if heard.clock_off_s > 0 else "behind"
        problems.append(f"its host's clock is {abs(heard.clock_off_s):.0f} s {side} this computer's")
    lights = {v.light for v in overview.vehicles}
    age_s = now_s - heard.at_s
    return FleetShown(
        source=source,
        host=overview.host,
        name=place.name,
        presence=presence,
        text=_SAID.get(presence, "") if presence is not Presence.STALE else _stale_text(age_s, heard),
        age_s=None if presence is Presence.KEPT else age_s,
        written_unix_s=overview.at_unix_s,
        light=next((light for light in WORST_FIRST if light in lights), "unknown") if is_live else "unknown",
        problem="; ".join(problems) or None,
        sysids=tuple(v.sysid for v in overview.vehicles),
        overview=overview,
    )


def _stale_text(age_s: float, heard: _Heard) -> str:
    if heard.is_last or age_s > heard.silent_after_s:
        return f"not heard for {age_s:.0f} s"
    return "heard again, but not steadily yet"


def _presence(place: _Source, heard: _Heard, now_s: float) -> Presence:
    if place.said is not None:
        return place.said
    if not heard.is_confirmed:
        return Presence.STALE if heard.was_live else Presence.KEPT
    return Presence.LIVE if now_s - heard.at_s <= heard.silent_after_s else Presence.STALE


def _rank(fleet: FleetShown) -> tuple[int, str, str, str]:
    rank = _LIVE_RANKS[fleet.light] if fleet.presence is Presence.LIVE else _RANKS[fleet.presence]
    return rank, fleet.name, fleet.host, fleet.source
