"""A fleet's timer: the earliest time that was asked for, once, and never before the service's clock has passed it."""

from __future__ import annotations

import asyncio

from gcs_coloc.runtime.clock import ServiceClock, Timer

SOON_S = 0.01
GENEROUS_S = 30.0


class _Fired:
    """Notes when a deadline fired."""

    def __init__(self, clock: ServiceClock) -> None:
        self.at_s: list[float] = []
        self.event = asyncio.Event()
        self._clock = clock

    def __call__(self) -> None:
        self.at_s.append(self._clock())
        self.event.set()

    async def wait(self) -> None:
        await asyncio.wait_for(self.event.wait(), GENEROUS_S)
        self.event.clear()


def test_it_fires_at_the_earliest_time_once_its_clock_has_passed_that():
    async def run() -> None:
        clock = ServiceClock()
        fired = _Fired(clock)
        deadline = Timer(clock, fired)
        due_s = clock() + SOON_S
        deadline.by(due_s + 2.0 * GENEROUS_S)
        deadline.by(due_s)
        deadline.by(due_s + GENEROUS_S)
        await fired.wait()
        assert fired.at_s[0] > due_s
        # It has forgotten the others: asked anew, it fires anew.
        deadline.by(clock() + SOON_S)
        await fired.wait()
        assert len(fired.at_s) == 2

    asyncio.run(run())


def test_once_cancelled_it_does_not_fire_and_can_be_asked_again():
    async def run() -> None:
        clock = ServiceClock()
        cancelled, later = _Fired(clock), _Fired(clock)
        deadline, other = Timer(clock, cancelled), Timer(clock, later)
        deadline.by(clock())
        deadline.cancel()
        other.by(clock() + SOON_S)
        await later.wait()
        assert cancelled.at_s == []
        deadline.by(clock())
        await cancelled.wait()

    asyncio.run(run())
