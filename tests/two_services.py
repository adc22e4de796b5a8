"""Two services, the link between them and the vehicles that they feed, in simulated time: for tests of the hot standby.

Each service runs on its own clock, has a queue of what arrives, and may be killed, stopped, slowed down and started anew. What a
stopped one has waiting it gets when it goes on, before or after its timers, as the event loop may have it.
"""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Callable
from dataclasses import dataclass, field

from gcs_coloc.core.standby.sign_of_life import Identity, SignOfLife, StandbyState
from gcs_coloc.core.standby.standby_peer import TICK_S, StandbyPeer

PERIOD_S = 0.1
REPORT_S = 0.2
DEVICES = (Identity(254, 191), Identity(254, 192))


@dataclass
class Vehicle:
    """One vehicle: whether it needs aid, passes GPS_INPUT on, reports GPS2_RAW, and who has fed it when (s, index)."""

    sysid: int
    needs_aid: bool = True
    passes_on: bool = True
    reports: bool = True
    fed: list[tuple[float, int]] = field(default_factory=list)
    fixed_boot_s: float = 0.0


@dataclass
class Service:
    """One of the two: `peer` is None while it does not run; `resumes_at_s` is when it goes on; `pauses` of a slow host, s."""

    index: int
    peer: StandbyPeer | None = None
    clock_offset_s: float = 0.0
    is_stopped: bool = False
    busy_until_s: float = 0.0
    pause_s: float = 0.0
    hears_vehicles: bool = True
    waiting: list[Callable[[], None]] = field(default_factory=list)


class TwoServices:
    """Two services. `now_s` is true time; `loss` and `delay_s` are those of the link between the two, `split` cuts it."""

    def __init__(self, seed: int, vehicles: list[Vehicle] | None = None, *, roles: tuple[bool, bool] = (True, False)) -> None:
        self.random = random.Random(seed)
        self.vehicles = vehicles if vehicles is not None else [Vehicle(4)]
        self.services = [Service(0, clock_offset_s=1000.0), Service(1, clock_offset_s=5000.0)]
        self.roles = roles
        self.now_s = 0.0
        self.loss = 0.0
        self.delay_s = 0.002
        self.split = [False, False]  # from the first, from the second
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        for vehicle in self.vehicles:
            self._every(PERIOD_S, lambda v=vehicle: self._telemetry(v))
            self._every(REPORT_S, lambda v=vehicle: self._report(v))

    def at(self, at_s: float, act: Callable[[], None]) -> None:
        heapq.heappush(self._events, (at_s, next(self._order), act))

    def run(self, until_s: float) -> None:
        while self._events and self._events[0][0] <= until_s:
            self.now_s, _, act = heapq.heappop(self._events)
            act()
        self.now_s = until_s

    def start(self, index: int, *, is_active: bool | None = None) -> None:
        service = self.services[index]
        active = self.roles[index] if is_active is None else is_active
        service.peer = StandbyPeer(
            DEVICES[index], self.random.getrandbits(64), is_active=active, now_s=self._clock(service), period_s=PERIOD_S
        )
        service.is_stopped, service.busy_until_s = False, 0.0
        service.waiting.clear()
        peer = service.peer
        self._every(
            TICK_S,
            lambda: self._run(service, lambda: self._tick(service)),
            lambda: service.peer is peer,
            lambda: peer.next_tick_s(self._clock(service)) - self._clock(service),
        )
        self._every(PERIOD_S, lambda: self._run(service, lambda: self._aid(service)), lambda: service.peer is peer)

    def kill(self, index: int) -> None:
        self.services[index].peer = None
        self.services[index].waiting.clear()

    def stop(self, index: int) -> None:
        self.services[index].is_stopped = True

    def go_on(self, index: int) -> None:
        service = self.services[index]
        service.is_stopped = False
        self._catch_up(service)

    def states(self) -> list[StandbyState | None]:
        return [service.peer.state if service.peer is not None else None for service in self.services]

    def active(self) -> list[int]:
        return [index for index, state in enumerate(self.states()) if state is StandbyState.ACTIVE]

    def clock_of(self, index: int) -> float:
        return self._clock(self.services[index])

    def _clock(self, service: Service) -> float:
        return self.now_s + service.clock_offset_s

    def _every(
        self,
        period_s: float,
        act: Callable[[], None],
        goes_on: Callable[[], bool] = lambda: True,
        next_in_s: Callable[[], float] | None = None,
    ) -> None:
        def again() -> None:
            if goes_on():
                act()
                self.at(self.now_s + (next_in_s() if next_in_s is not None else period_s), again)

        self.at(self.now_s + self.random.uniform(0.0, period_s), again)

    def _run(self, service: Service, act: Callable[[], None]) -> None:
        """Run what is due on a service; one that stands still does it when it goes on."""
        if service.peer is None:
            return
        if service.is_stopped or self.now_s < service.busy_until_s:
            service.waiting.append(act)
            return
        if service.pause_s and self.random.random() < 0.02:
            pause_s = self.random.uniform(0.0, service.pause_s)
            service.busy_until_s = self.now_s + pause_s
            self.at(service.busy_until_s, lambda: self._catch_up(service))
        act()

    def _catch_up(self, service: Service) -> None:
        if service.is_stopped or self.now_s < service.busy_until_s:
            return
        waiting, service.waiting = service.waiting, []
        if self.random.random() < 0.5:
            self.random.shuffle(waiting)
        for act in waiting[-200:]:
            if service.peer is not None:
                act()

    def _tick(self, service: Service) -> None:
        peer, now_s = service.peer, self._clock(service)
        assert peer is not None
        peer.tick(now_s, self._wanted())
        if peer.sign_is_due(now_s):
            self._send_sign(service)

    def _send_sign(self, service: Service) -> None:
        assert service.peer is not None
        now_s = self._clock(service)
        sign = service.peer.sign_of_life(now_s)
        if not self.split[service.index] and self.random.random() >= self.loss:
            other = self.services[1 - service.index]
            self.at(
                self.now_s + self.random.uniform(0.5, 2.0) * self.delay_s,
                lambda: self._run(other, lambda: self._receive(other, sign)),
            )

    def _receive(self, service: Service, sign: SignOfLife) -> None:
        assert service.peer is not None
        now_s = self._clock(service)
        service.peer.receive(sign, now_s)
        if service.peer.sign_is_due(now_s):
            self._send_sign(service)

    def _wanted(self) -> list[int]:
        return [v.sysid for v in self.vehicles if v.needs_aid]

    def _aid(self, service: Service) -> None:
        assert service.peer is not None
        now_s = self._clock(service)
        for vehicle in self.vehicles:
            if vehicle.needs_aid and service.peer.may_send(vehicle.sysid, now_s):
                vehicle.fed.append((self.now_s, service.index))
                vehicle.fixed_boot_s = self.now_s
                other = self.services[1 - service.index]
                if vehicle.passes_on and other.hears_vehicles:
                    delay_s = self.random.uniform(0.01, 0.06)
                    self.at(self.now_s + delay_s, lambda v=vehicle, o=other: self._run(o, lambda: self._passed_on(o, v)))
        if service.peer.sign_is_due(now_s + TICK_S):
            self._send_sign(service)

    def _passed_on(self, service: Service, vehicle: Vehicle) -> None:
        assert service.peer is not None
        service.peer.watch.add_passed_on(vehicle.sysid, self._clock(service))

    def _telemetry(self, vehicle: Vehicle) -> None:
        for service in self.services:
            if service.hears_vehicles:
                self._run(service, lambda s=service: s.peer.watch.add_heard(vehicle.sysid, self._clock(s)) if s.peer else None)

    def _report(self, vehicle: Vehicle) -> None:
        if not vehicle.reports:
            return
        fixed_s = vehicle.fixed_boot_s
        for service in self.services:
            if service.hears_vehicles:

                def add(s: Service = service) -> None:
                    if s.peer is not None:
                        s.peer.watch.add_fed_receiver(vehicle.sysid, self._clock(s), fixed_s)

                self.at(self.now_s + self.random.uniform(0.01, 0.05), lambda s=service, a=add: self._run(s, a))


def overlaps(vehicle: Vehicle, within_s: float = 1.0) -> list[tuple[float, float]]:
    """When a second service began to feed a vehicle while the first still did, and for how long both did (s)."""
    found = []
    for (before_s, was), (at_s, now) in itertools.pairwise(vehicle.fed):
        del before_s
        if was != now:
            later = [t for t, index in vehicle.fed if index == was and at_s < t <= at_s + within_s]
            if later:
                found.append((at_s, max(later) - at_s))
    return found


def gaps(vehicle: Vehicle, from_s: float, to_s: float) -> float:
    """The longest time without a fix between two times (s)."""
    times = [from_s, *(t for t, _ in vehicle.fed if from_s <= t <= to_s), to_s]
    return max(b - a for a, b in itertools.pairwise(times))
