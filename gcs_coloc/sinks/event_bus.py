"""The hub between the engine and its observers: each observer has its own bounded queue and loses its own oldest news."""

from __future__ import annotations

import asyncio
from collections import deque

from gcs_coloc.core.messages.outbound import ToOperator
from gcs_coloc.core.snapshot import FleetSnapshot

FleetEvent = FleetSnapshot | ToOperator


class Subscription:
    """One observer's queue. `lost` counts the news that were dropped because the observer was slow."""

    def __init__(self, most: int) -> None:
        self.lost = 0
        self._queue: deque[FleetEvent] = deque(maxlen=most)
        self._arrived = asyncio.Event()

    def put(self, news: FleetEvent) -> None:
        """Append one piece of news; never waits."""
        if len(self._queue) == self._queue.maxlen:
            self.lost += 1
        self._queue.append(news)
        self._arrived.set()

    async def get(self) -> FleetEvent:
        """The oldest news in the queue; waits for some."""
        while not self._queue:
            self._arrived.clear()
            await self._arrived.wait()
        return self._queue.popleft()


class EventBus:
    """Hands each piece of news to every observer without waiting for any."""

    def __init__(self) -> None:
        self._subscriptions: list[Subscription] = []

    def subscribe(self, most: int = 64) -> Subscription:
        """A new observer's queue of at most `most` pieces of news."""
        subscription = Subscription(most)
        self._subscriptions.append(subscription)
        return subscription

    def publish(self, news: FleetEvent) -> None:
        """Give one piece of news to every observer."""
        for subscription in self._subscriptions:
            subscription.put(news)
