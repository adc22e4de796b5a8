"""Which vehicle is reached where: a table of addresses learnt from what was heard, sans-IO.

GPS_INPUT has no target field, so everyone at an address takes what is sent there. Hence the two rules of this table:
an address is pinned to the vehicle that was heard from it first, and an address with two autopilots gets nothing.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

from gcs_coloc.links.base import Address, Link
from gcs_coloc.mavlink.counts import Counts

ADDRESS_CONFLICT = "address_conflict"
TABLE_FULL = "route_table_full"


@dataclass(frozen=True, slots=True)
class Route:
    """Where to send what is meant for one vehicle."""

    link: Link
    address: Address


@dataclass(frozen=True, slots=True)
class Blocked:
    """Nothing may be sent to this vehicle; the reason tells the operator what to do."""

    reason: str


@dataclass(slots=True)
class _Pin:
    route: Route
    heard_at_s: float


class RouteTable:
    """Learns from every frame heard, and answers where a vehicle is.

    `roam_after_s`: how long a component must be silent at its address before it may turn up at another one.
    `shared_memory_s`: how long an autopilot, heard once, counts as living behind an address. It is long because a vehicle
    that we do not hear may still hear us. `max_components`, `max_addresses`: bounds of the tables; when one is full, only
    what is silent makes room.
    """

    def __init__(
        self,
        *,
        roam_after_s: float = 5.0,
        shared_memory_s: float = 60.0,
        max_components: int = 1024,
        max_addresses: int = 256,
    ) -> None:
        self.counts = Counts()
        self._roam_after_s = roam_after_s
        self._shared_memory_s = shared_memory_s
        self._max_components = max_components
        self._max_addresses = max_addresses
        # Both are in the order of last hearing, so the first entry is the one silent for longest.
        self._components: OrderedDict[tuple[int, int], _Pin] = OrderedDict()
        self._autopilots_at: OrderedDict[Route, dict[int, float]] = OrderedDict()
        self._autopilots: dict[int, _Pin] = {}

    def learn(self, sysid: int, compid: int, link: Link, address: Address, *, is_autopilot_heartbeat: bool, now_s: float) -> bool:
        """Take note of one frame; False if it must not be used, because its sender's ids belong to another address.

        The reason of a refusal is counted: address_conflict, route_table_full.
        """
        heard = Route(link, address)
        # Before any refusal: an autopilot that we refuse at this address would still take what is sent there.
        if is_autopilot_heartbeat and not self._note_autopilot_at(heard, sysid, now_s):
            self.counts.add(TABLE_FULL)
            return False
        if is_autopilot_heartbeat and self._is_pinned_elsewhere(self._autopilots.get(sysid), heard, now_s):
            self.counts.add(ADDRESS_CONFLICT)
            return False
        sender = (sysid, compid)
        pin = self._components.get(sender)
        if self._is_pinned_elsewhere(pin, heard, now_s):
            self.counts.add(ADDRESS_CONFLICT)
            return False
        if pin is None and not self._has_room(now_s):
            self.counts.add(TABLE_FULL)
            return False
        self._components[sender] = _Pin(heard, now_s)
        self._components.move_to_end(sender)
        if is_autopilot_heartbeat:
            self._autopilots[sysid] = _Pin(heard, now_s)
        return True

    def route(self, sysid: int, now_s: float) -> Route | Blocked:
        """Where the autopilot of a vehicle is reached, or why nothing may be sent to it."""
        pin = self._autopilots.get(sysid)
        if pin is None:
            return Blocked(f"no autopilot heartbeat of vehicle {sysid} has been heard yet")
        others = sorted(
            other
            for other, heard_at_s in self._autopilots_at.get(pin.route, {}).items()
            if other != sysid and now_s - heard_at_s <= self._shared_memory_s
        )
        if others:
            listed = ", ".join(str(other) for other in others)
            return Blocked(
                f"vehicles {listed} and {sysid} are heard from one address (a router?), and GPS_INPUT has no target field: all "
                "of them would take it. Give each vehicle its own UDP stream to us, from its own port, or its own --link"
            )
        return pin.route

    def _is_pinned_elsewhere(self, pin: _Pin | None, heard: Route, now_s: float) -> bool:
        return pin is not None and pin.route != heard and now_s - pin.heard_at_s < self._roam_after_s

    def _note_autopilot_at(self, heard: Route, sysid: int, now_s: float) -> bool:
        autopilots = self._autopilots_at.get(heard)
        if autopilots is None:
            if len(self._autopilots_at) >= self._max_addresses:
                stalest = next(iter(self._autopilots_at))
                if now_s - max(self._autopilots_at[stalest].values()) <= self._shared_memory_s:
                    return False
                del self._autopilots_at[stalest]
            autopilots = self._autopilots_at[heard] = {}
        autopilots[sysid] = now_s
        self._autopilots_at.move_to_end(heard)
        return True

    def _has_room(self, now_s: float) -> bool:
        if len(self._components) < self._max_components:
            return True
        stalest = next(iter(self._components))
        if now_s - self._components[stalest].heard_at_s < self._roam_after_s:
            return False
        del self._components[stalest]
        return True
