"""The one timer of a fleet's path: it calls when the service's clock has passed the earliest time that was asked for."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from gcs_coloc.runtime.clock import ServiceClock

_NEVER = float("inf")


class Timer:
    """Calls `passed` on the running event loop, once for each time that it fires; then it waits to be asked again.

    `at_s` is when it will fire next (service time), infinity where nobody has asked.
    """

    def __init__(self, clock: ServiceClock, passed: Callable[[], None]) -> None:
        self._clock = clock
        self._passed = passed
        self._timer: asyncio.TimerHandle | None = None
        self.at_s = _NEVER

    def by(self, at_s: float) -> None:
        """Fire at service time `at_s`, unless it will have fired before; infinity asks for nothing."""
        if at_s >= self.at_s:
            return
        self.cancel()
        self.at_s = at_s
        self._timer = asyncio.get_running_loop().call_at(self._clock.on_loop(at_s), self._fire)

    def cancel(self) -> None:
        """Do not fire."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer, self.at_s = None, _NEVER

    def _fire(self) -> None:
        self._timer, self.at_s = None, _NEVER
        self._passed()
