"""A vehicle's radio link in one direction: delay, jitter, loss, dropout; what is under way, in order of arrival."""

from __future__ import annotations

import heapq
from itertools import count

import numpy as np

from sitl_fakes.scenario import Telemetry


class Link:
    """One direction of a link. Datagrams arrive when their own delay is over: a late one is overtaken."""

    def __init__(self, settings: Telemetry, rng: np.random.Generator) -> None:
        self._settings = settings
        self._rng = rng
        self._under_way: list[tuple[float, int, bytes]] = []
        self._numbers = count()

    def send(self, payload: bytes, at_s: float) -> None:
        """Send a datagram at a time (s); it is lost with the link's probability."""
        s = self._settings
        chance, jitter = self._rng.random(2).tolist()
        if chance >= s.loss:
            heapq.heappush(self._under_way, (at_s + s.latency_s + jitter * s.jitter_s, next(self._numbers), payload))

    def arrived(self, by_s: float) -> list[tuple[float, bytes]]:
        """Take out what arrives by a time (s): arrival time and datagram, in order."""
        out = []
        while self._under_way and self._under_way[0][0] <= by_s:
            due, _, payload = heapq.heappop(self._under_way)
            out.append((due, payload))
        return out
