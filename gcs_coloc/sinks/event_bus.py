"""The event bus between the engine and its observers, and the observers' idle-time slots.

Each observer has a bounded queue and loses its own oldest events. Observers work in slots of idle time, which come right
after the outputs of a deadline were sent, as far from the next deadline as possible.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from math import floor

from gcs_coloc.core.alarms.alarms import Alarm
from gcs_coloc.core.messages.outbound import HealthChanged, ToOperator
from gcs_coloc.core.snapshot import FleetSnapshot

FleetEvent = FleetSnapshot | ToOperator | Alarm
_MAX_WAIT_S = 0.5
"""A slot starts this much late at most. Chosen: where nobody is heard there are no deadlines, and the page is still to move."""


class Subscription:
    """One observer's queue. `lost` counts the events that were dropped because the observer was slow."""

    def __init__(self, most: int) -> None:
        self.lost = 0
        self._queue: deque[FleetEvent] = deque(maxlen=most)
        self._arrived = asyncio.Event()

    def put(self, event: FleetEvent) -> None:
        """Append an event; never waits."""
        if len(self._queue) == self._queue.maxlen:
            self.lost += 1
        self._queue.append(event)
        self._arrived.set()

    async def get(self) -> FleetEvent:
        """The oldest event in the queue; waits for one."""
        while not self._queue:
            self._arrived.clear()
            await self._arrived.wait()
        return self._queue.popleft()


class EventBus:
    """Passes each event to every observer without waiting for any of them."""

    def __init__(self) -> None:
        self._subscriptions: list[Subscription] = []

    def subscribe(self, most: int = 64) -> Subscription:
        """A new observer's queue of at most `most` events."""
        subscription = Subscription(most)
        self._subscriptions.append(subscription)
        return subscription

    def publish(self, event: FleetEvent) -> None:
        """Pass an event to every observer."""
        for subscription in self._subscriptions:
            subscription.put(event)


def level_and_text(event: ToOperator) -> tuple[str, str]:
    """The level of an event (`info`, `warning`, `error`) and its text."""
    if isinstance(event, HealthChanged):
        bad = event.after in ("suspect", "failed")
        return ("warning" if bad else "info"), f"GPS {event.before} -> {event.after}: {event.reason}"
    return event.level, event.text


class IdleScheduler:
    """Starts periodic work of observers in the idle time of one fleet's path.

    The path calls `start_slots` whenever the outputs of a deadline have been sent.
    """

    def __init__(self) -> None:
        self._due_s: dict[asyncio.Future[None], float] = {}
        self._start_s: float | None = None

    @property
    def waiting(self) -> int:
        """How many slots are waited for."""
        return len(self._due_s)

    def start_slots(self) -> None:
        """Start every slot that is due."""
        now_s = asyncio.get_running_loop().time()
        for slot, due_s in self._due_s.items():
            if due_s <= now_s:
                _start(slot)

    async def every(self, period_s: float, phase: float = 0.0) -> AsyncIterator[None]:
        """Slots that are `period_s` apart, at `phase` (0 to 1) of the period; each waits for idle time.

        All periods are counted from the first call. Slots that are due together start in the same idle time, and can share a
        snapshot of the fleet. The first slot of a later caller starts at once. A slot waits for half a period, or
        `_MAX_WAIT_S`, at most. Missed slots are left out.
        """
        loop = asyncio.get_running_loop()
        if self._start_s is None:
            self._start_s = loop.time()
        first_s, number = self._start_s + phase * period_s, 0
        while True:
            number = max(number, floor((loop.time() - first_s) / period_s))
            due_s = first_s + number * period_s
            slot = loop.create_future()
            self._due_s[slot] = due_s
            timer = loop.call_at(due_s + min(0.5 * period_s, _MAX_WAIT_S), _start, slot)
            try:
                await slot
            finally:
                timer.cancel()
                del self._due_s[slot]
            # What has arrived while the outputs were made goes first.
            await asyncio.sleep(0)
            yield
            number += 1


def _start(slot: asyncio.Future[None]) -> None:
    if not slot.done():
        slot.set_result(None)
