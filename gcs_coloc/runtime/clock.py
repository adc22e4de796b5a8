"""The service's clock, the host's clock, and a timer."""

from __future__ import annotations

import asyncio
import ctypes
import time
from collections.abc import Callable

from gcs_coloc.core.messages.control import ClockReference

_RESOLUTION_S = 2e-6
"""Two steps of the service's clock, whose readings are whole microseconds."""
_READING_S = 50e-6
"""Readings of two clocks that are further apart are made again: the process was interrupted between them."""
_MOST_READINGS = 3
"""Chosen: three interruptions in a row are rarer than the error of some milliseconds matters."""
_NEVER = float("inf")
_TIMEX_BYTES = 512
"""struct timex has 208 bytes on 64-bit Linux (sys/timex.h). Its first field, `modes`, is 0: only read."""
_TIME_ERROR = 5
"""What adjtimex(2) returns while the clock is not synchronised."""
_EARLIEST_PLAUSIBLE_UNIX_S = 1_704_067_200.0
"""2024-01-01. Chosen: a host that reads less has no clock battery, and no time yet."""


class ServiceClock:
    """The service's clock: UNIX seconds at the start, counted on by the monotonic clock.

    It counts whole microseconds and is never stepped. A reading is microseconds divided by a million, as a tlog's reader does:
    the engine gets the same numbers, to the last bit, in flight and in replay.
    """

    def __init__(self) -> None:
        self._started_unix_us = time.time_ns() // 1000
        self._started_ns = time.monotonic_ns()
        self._unix_minus_monotonic_ns = self._started_unix_us * 1000 - self._started_ns

    def __call__(self) -> float:
        """The time now, seconds."""
        return (time.monotonic_ns() + self._unix_minus_monotonic_ns) // 1000 / 1e6

    def on_loop(self, at_s: float) -> float:
        """When, on the event loop's clock, this clock has passed `at_s`: a reading at that time is later."""
        return self._started_ns / 1e9 + (at_s - self._started_unix_us / 1e6) + _RESOLUTION_S


def arrival_time(clock: Callable[[], float], received_unix_ns: int, not_before_s: float) -> float:
    """Return when the system received what is read from it now, service time, s.

    `received_unix_ns` is the system's own stamp, UNIX time in ns; `clock` is the service's.
    A host clock that is stepped meanwhile cannot move it before `not_before_s`, when nothing waited, or into the future.
    """
    for _ in range(_MOST_READINGS):
        now_s, unix_ns = clock(), time.time_ns()
        if clock() - now_s <= _READING_S:
            break
    waited_s = (unix_ns - received_unix_ns) / 1e9
    # Whole microseconds, as the service's clock has them.
    return min(now_s, max(not_before_s, round((now_s - waited_s) * 1e6) / 1e6))


def read_host_clock(now_s: float) -> ClockReference:
    """Return how far the host's UNIX time is ahead of service time `now_s`.

    The result also has whether the host's clock is synchronised.
    """
    unix_s = time.time()
    return ClockReference(now_s, unix_s - now_s if unix_s >= _EARLIEST_PLAUSIBLE_UNIX_S else None, is_synchronised())


def is_synchronised() -> bool | None:
    """Whether the host's clock is synchronised, as by NTP, PTP or a GPS receiver.

    None where that is unknown. Source: adjtimex(2), which returns TIME_ERROR while the clock is not synchronised.
    """
    try:
        adjtimex = ctypes.CDLL(None).adjtimex
    except (OSError, AttributeError):
        return None
    state = int(adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES)))
    return state != _TIME_ERROR if state >= 0 else None


class Timer:
    """Calls `passed` once the service's clock has passed the earliest requested time.

    It runs on the event loop, fires once and forgets the later times.
    `at_s` is when it will fire next (service time), infinity where it will not.
    """

    def __init__(self, clock: ServiceClock, passed: Callable[[], None]) -> None:
        self._clock = clock
        self._passed = passed
        self._timer: asyncio.TimerHandle | None = None
        self.at_s = _NEVER

    def by(self, at_s: float) -> None:
        """Fire at service time `at_s`, unless it fires before; infinity requests nothing."""
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
