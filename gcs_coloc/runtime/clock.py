"""The service's clock: steady, and in the numbers that a recording holds."""

from __future__ import annotations

from time import monotonic_ns, time_ns

_RESOLUTION_S = 2e-6


class ServiceClock:
    """UNIX seconds as the host had them at the start, counted on by the monotonic clock in whole microseconds.

    It is never stepped. Its readings divide microseconds by a million, as a tlog's reader does: what the engine was told in
    flight and what it is told in replay are the same numbers to the last bit.
    """

    def __init__(self) -> None:
        self._started_unix_us = time_ns() // 1000
        self._started_ns = monotonic_ns()
        self._unix_minus_monotonic_ns = self._started_unix_us * 1000 - self._started_ns

    def __call__(self) -> float:
        """The time now, seconds."""
        return (monotonic_ns() + self._unix_minus_monotonic_ns) // 1000 / 1e6

    def on_loop(self, at_s: float) -> float:
        """When, on the event loop's clock, this clock has passed `at_s`: a reading taken then is later."""
        return self._started_ns / 1e9 + (at_s - self._started_unix_us / 1e6) + _RESOLUTION_S
