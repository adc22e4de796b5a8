"""Which vehicle is reached where: a table of addresses learnt from received frames, sans-IO.

GPS_INPUT has no target field, so every vehicle at an address uses what is sent there. Hence the two rules of this table:
a system id is bound to the address that it was heard from first, and an address with two autopilots gets nothing.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

from gcs_coloc.core.messages.control import RouteBlock
from gcs_coloc.links.base import Address, Link, Route
from gcs_coloc.links.rate_limiter import find_evicted
from gcs_coloc.mavlink.refusals import Counts, Refusal

SHARED_MEMORY_S = 60.0
"""An autopilot, heard once, counts as being at an address for so long: a vehicle that we do not hear may still hear us."""
PROVEN_AFTER_S = 10.0
"""A vehicle that is known for so long is proven. Chosen: ten heartbeats, and longer than a flood of forged ids is overlooked."""
WARN_EVERY_S = 10.0
"""Per vehicle. Chosen: a pretender may send a hundred frames a second, and a person can use one line in this time."""


@dataclass(frozen=True, slots=True)
class Blocked:
    """Why a vehicle may not be sent everything, or nothing at all.

    `shared_with`: the system ids of the other vehicles at its address.
    `route`: where messages with a target field still reach it; None where it is not reached at all.
    """

    reason: RouteBlock
    shared_with: tuple[int, ...] = ()
    route: Route | None = None


@dataclass(slots=True)
class _Binding:
    """Where a sender is heard, since when it is known, and when it was heard last.

    `since_s` is the first time at any address. Times are service times in s.
    `is_other`: its own heartbeat says that it is no autopilot, as a ground station's does.
    """

    route: Route
    since_s: float
    heard_at_s: float
    is_other: bool = False

    @property
    def is_proven(self) -> bool:
        return self.heard_at_s - self.since_s >= PROVEN_AFTER_S


class RouteTable:
    """Learns from every received frame where each vehicle is reached.

    `rebind_after_s`: how long a system must be silent at its address before it may be bound to another one.
    `companions_elsewhere`: components other than the autopilot may have addresses of their own; without, all frames of a vehicle
    come from one address; of two addresses, the one with the autopilot's heartbeat counts.
    `max_components`, `max_addresses`: bounds of the tables; what makes room in a full one is the rule of `find_evicted`.
    """

    def __init__(
        self,
        *,
        rebind_after_s: float = 5.0,
        companions_elsewhere: bool = False,
        max_components: int = 1024,
        max_addresses: int = 256,
    ) -> None:
        self.counts = Counts()
        self.conflicts = AddressConflicts()
        self._companions_elsewhere = companions_elsewhere
        self._rebind_after_s = rebind_after_s
        self._max_components = max_components
        self._max_addresses = max_addresses
        # Both are in the order of last hearing, so the first entry is the one silent for longest.
        self._components: OrderedDict[tuple[int, int], _Binding] = OrderedDict()
        self._autopilots_at: OrderedDict[Route, dict[int, float]] = OrderedDict()
        self._autopilots: dict[int, _Binding] = {}

    def learn(
        self,
        sysid: int,
        compid: int,
        link: Link,
        address: Address,
        *,
        is_autopilot_heartbeat: bool,
        is_other_heartbeat: bool = False,
        now_s: float,
    ) -> bool:
        """Learn from one frame where its sender is; return whether the frame may be used.

        False: the sender's ids are bound to another address, or the table is full. `counts` has which.
        A sender without an autopilot in its system, whose heartbeat says that it is none (`is_other_heartbeat`), is no vehicle.
        It is bound to no address, because vehicles forward ground stations.
        """
        heard = Route(link, address)
        # Before any refusal: an autopilot that we refuse at this address would still use what is sent there.
        if is_autopilot_heartbeat and not self._add_autopilot_at(heard, sysid, now_s):
            self.counts.add(Refusal.ROUTE_TABLE_FULL)
            return False
        autopilot = self._autopilots.get(sysid) if is_autopilot_heartbeat else None
        sender = self._sender(sysid, compid, is_autopilot_heartbeat=is_autopilot_heartbeat)
        binding = self._components.get(sender)
        if is_other_heartbeat and binding is not None:
            binding.is_other = True
        # An earlier sender of other messages does not keep the autopilot itself out.
        rivals = (autopilot,) if is_autopilot_heartbeat and not self._companions_elsewhere else (autopilot, binding)
        for other in rivals:
            if other is not None and self._excludes(other, sysid, heard, now_s):
                self.counts.add(Refusal.ADDRESS_CONFLICT)
                if sysid in self._autopilots:
                    self.conflicts.add_refusal(sysid, other.route, heard)
                return False
        if binding is None and not self._has_room(sysid, heard, now_s, is_autopilot_heartbeat=is_autopilot_heartbeat):
            self.counts.add(Refusal.ROUTE_TABLE_FULL)
            return False
        self._components[sender] = _renewed(binding, heard, now_s)
        if binding is None:
            self._components[sender].is_other = is_other_heartbeat
        self._components.move_to_end(sender)
        if is_autopilot_heartbeat:
            if autopilot is not None and autopilot.route != heard:
                self.conflicts.add_move(sysid, autopilot.route, heard)
            self._autopilots[sysid] = _renewed(autopilot, heard, now_s)
        elif not self._companions_elsewhere and sysid in self._autopilots and self._autopilots[sysid].route == heard:
            self._autopilots[sysid].heard_at_s = now_s
        return True

    def autopilots_at(self, link: Link, address: Address, now_s: float) -> tuple[int, ...]:
        """The vehicles that are reached at an address, or were a short while ago, by system id."""
        heard = self._autopilots_at.get(Route(link, address), {})
        return tuple(sorted(sysid for sysid, at_s in heard.items() if now_s - at_s <= SHARED_MEMORY_S))

    def route(self, sysid: int, now_s: float) -> Route | Blocked:
        """Where the autopilot of a vehicle is reached, or why not everything may be sent to it."""
        binding = self._autopilots.get(sysid)
        if binding is None:
            return Blocked(RouteBlock.NO_HEARTBEAT)
        others = sorted(
            other
            for other, heard_at_s in self._autopilots_at.get(binding.route, {}).items()
            if other != sysid and now_s - heard_at_s <= SHARED_MEMORY_S
        )
        if others:
            return Blocked(RouteBlock.SHARED_ADDRESS, tuple(others), binding.route)
        return binding.route

    def comes_from_its_binding(self, sysid: int, compid: int, link: Link, address: Address, now_s: float) -> bool:
        """Whether a frame, from which nothing is learnt, comes from its sender's address.

        An unknown sender may be anywhere.
        """
        binding = self._components.get(self._sender(sysid, compid, is_autopilot_heartbeat=False))
        return binding is None or not self._excludes(binding, sysid, Route(link, address), now_s)

    def is_vehicle(self, sysid: int) -> bool:
        """Whether an autopilot of that system id was heard."""
        return sysid in self._autopilots

    def reach(self, sysid: int, compid: int) -> tuple[Route, ...]:
        """Return the routes to a component of a system; component 0 means all of them.

        Empty where the system was not heard.
        A component that was not heard itself is reached wherever its system is: an autopilot forwards what is not for it.
        """
        if sysid in self._autopilots and not self._companions_elsewhere:
            return (self._autopilots[sysid].route,)
        bindings = {sender[1]: binding.route for sender, binding in self._components.items() if sender[0] == sysid}
        return (bindings[compid],) if compid in bindings else tuple(dict.fromkeys(bindings.values()))

    def vehicles(self) -> dict[Route, set[int]]:
        """Every address at which a vehicle was heard last, with the system ids of the vehicles there."""
        there: dict[Route, set[int]] = {}
        for sysid in self._autopilots:
            for route in self.reach(sysid, 0):
                there.setdefault(route, set()).add(sysid)
        return there

    def _sender(self, sysid: int, compid: int, *, is_autopilot_heartbeat: bool) -> tuple[int, int]:
        """The ids by which a sender's binding is kept."""
        # A system without an autopilot is no vehicle: several ground stations share one system id by custom.
        as_one = not self._companions_elsewhere and (is_autopilot_heartbeat or sysid in self._autopilots)
        return sysid, 0 if as_one else compid

    def _excludes(self, binding: _Binding, sysid: int, heard: Route, now_s: float) -> bool:
        if binding.is_other and sysid not in self._autopilots:
            return False
        return binding.route != heard and now_s - binding.heard_at_s < self._rebind_after_s

    def _add_autopilot_at(self, heard: Route, sysid: int, now_s: float) -> bool:
        autopilots = self._autopilots_at.get(heard)
        if autopilots is None:
            if len(self._autopilots_at) >= self._max_addresses:
                evicted = find_evicted(
                    self._autopilots_at,
                    is_silent=lambda route: now_s - max(self._autopilots_at[route].values()) > SHARED_MEMORY_S,
                    is_proven=lambda route: any(map(self.is_proven, self._autopilots_at[route])),
                    for_proven=self.is_proven(sysid),
                )
                if evicted is None:
                    return False
                del self._autopilots_at[evicted]
            autopilots = self._autopilots_at[heard] = {}
        autopilots[sysid] = now_s
        self._autopilots_at.move_to_end(heard)
        return True

    def is_proven(self, sysid: int) -> bool:
        """Whether an autopilot of that system id has been known for `PROVEN_AFTER_S`.

        A flood of new senders takes no room from it.
        """
        return sysid in self._autopilots and self._autopilots[sysid].is_proven

    def _has_room(self, sysid: int, heard: Route, now_s: float, *, is_autopilot_heartbeat: bool) -> bool:
        """Whether there is room for a sender that has no binding, or has lost it while it was silent."""
        if len(self._components) < self._max_components:
            return True
        evicted = find_evicted(
            self._components,
            is_silent=lambda sender: now_s - self._components[sender].heard_at_s >= self._rebind_after_s,
            is_proven=lambda sender: self._is_proven_at(sender[0], self._components[sender].route),
            for_proven=self.is_proven(sysid) if is_autopilot_heartbeat else self._is_proven_at(sysid, heard),
        )
        if evicted is None:
            return False
        del self._components[evicted]
        return True

    def _is_proven_at(self, sysid: int, route: Route) -> bool:
        """Whether a vehicle is proven and its autopilot is reached by this route.

        By another route, anybody may use its system id.
        """
        return self.is_proven(sysid) and self._autopilots[sysid].route == route


def _renewed(binding: _Binding | None, heard: Route, now_s: float) -> _Binding:
    """The binding of a sender that is heard now: a new one, or the one it has, moved where need be."""
    if binding is None:
        return _Binding(heard, now_s, now_s)
    binding.route, binding.heard_at_s = heard, now_s
    return binding


class AddressConflicts:
    """Collects refused senders and moves until they are warned of, one of each kind for each system id."""

    def __init__(self) -> None:
        self._refused: dict[int, tuple[Route, Route, int]] = {}
        self._moved: dict[int, tuple[Route, Route]] = {}
        self._warned_at_s: dict[int, float] = {}

    def add_refusal(self, sysid: int, bound: Route, other: Route) -> None:
        """A frame of `sysid`, which is bound to `bound`, was refused from `other`."""
        times = self._refused[sysid][2] if sysid in self._refused else 0
        self._refused[sysid] = (bound, other, times + 1)

    def add_move(self, sysid: int, before: Route, after: Route) -> None:
        """A vehicle, silent at one address, is heard from another one."""
        self._moved[sysid] = (before, after)

    def pending_warnings(self, now_s: float) -> list[tuple[int, str]]:
        """System id and text of the warnings that are due."""
        out = []
        for sysid in sorted(self._refused.keys() | self._moved.keys()):
            if now_s - self._warned_at_s.get(sysid, float("-inf")) < WARN_EVERY_S:
                continue
            self._warned_at_s[sysid] = now_s
            if sysid in self._moved:
                before, after = self._moved.pop(sysid)
                out.append((sysid, f"is heard from another address now: {after}, before from {before}"))
            if sysid in self._refused:
                out.append((sysid, _refusal_warning(*self._refused.pop(sysid))))
        return out


def _refusal_warning(bound: Route, other: Route, times: int) -> str:
    return (
        f"another sender uses its system id and is refused ({times} times): {other}; it is heard at {bound}. Give every vehicle "
        "its own system id (SYSID_THISMAV or MAV_SYSID); one with two radios is used over the first of them until that is "
        "silent; a companion of its own needs "
        "senders.companions_elsewhere; otherwise, somebody is pretending"
    )
