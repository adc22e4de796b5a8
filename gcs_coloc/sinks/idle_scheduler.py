"""When observers may take their time: right after what was due has been sent, as far from the next deadline as can be."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from math import floor

_WAIT_S = 0.5


class IdleScheduler:
    """The lulls of one fleet's path: `begin` one whenever the outputs of a deadline have been sent."""

    def __init__(self) -> None:
        self._due_s: dict[asyncio.Future[None], float] = {}
        self._start_s: float | None = None

    @property
    def waiting(self) -> int:
        """How many turns are waited for."""
        return len(self._due_s)

    def begin(self) -> None:
        """Give their turn to those whose time has come."""
        now_s = asyncio.get_running_loop().time()
        for turn, due_s in self._due_s.items():
            if due_s <= now_s:
                _give(turn)

    async def every(self, period_s: float, phase: float = 0.0) -> AsyncIterator[None]:
        """Turns that are `period_s` apart, at `phase` (0 to 1) of it; each waits for a lull.

        Periods are counted from when the first of all began: what falls due together has its turns in one lull, and can share a
        look at the fleet. Who begins later has a first turn at once. A turn waits for half a period or `_WAIT_S` at most: where
        nothing is heard there are no deadlines. What was missed is not caught up with.
        """
        loop = asyncio.get_running_loop()
        if self._start_s is None:
            self._start_s = loop.time()
        first_s, number = self._start_s + phase * period_s, 0
        while True:
            number = max(number, floor((loop.time() - first_s) / period_s))
            due_s = first_s + number * period_s
            turn = loop.create_future()
            self._due_s[turn] = due_s
            timer = loop.call_at(due_s + min(0.5 * period_s, _WAIT_S), _give, turn)
            try:
                await turn
            finally:
                timer.cancel()
                del self._due_s[turn]
            # What has arrived while the outputs were made goes first.
            await asyncio.sleep(0)
            yield
            number += 1


def _give(turn: asyncio.Future[None]) -> None:
    if not turn.done():
        turn.set_result(None)
