"""Slots for observers: right after the outputs of a deadline were sent, as far from the next deadline as possible."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from math import floor

_MAX_WAIT_S = 0.5
"""A slot starts this much late at most. Chosen: where nobody is heard there are no deadlines, and the page is still to move."""


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
