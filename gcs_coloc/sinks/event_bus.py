"""The event bus between the engine and its observers: each has a bounded queue and loses its own oldest events."""

from __future__ import annotations

import asyncio
from collections import deque

from gcs_coloc.core.messages.outbound import HealthChanged, ToOperator
from gcs_coloc.core.snapshot import FleetSnapshot

FleetEvent = FleetSnapshot | ToOperator


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
    """The level of an event (`info`, `warning`, `error`) and its text. What is not `info` is an alarm."""
    if isinstance(event, HealthChanged):
        bad = event.after in ("suspect", "failed")
        return ("warning" if bad else "info"), f"GPS {event.before} -> {event.after}: {event.reason}"
    return event.level, event.text
