"""The service clock: a timer fires once and never early; what the system stamped comes to the time of its arrival."""

from __future__ import annotations

import asyncio

import pytest

from gcs_coloc.runtime.clock import ServiceClock, Timer, arrival_time

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


UNIX_NS = 1_800_000_000_000_000_000


@pytest.mark.parametrize(
    ("unix_now_ns", "expected_s"),
    [
        pytest.param(UNIX_NS + 400_000_000, 99.6, id="what waited 0.4 s arrived 0.4 s ago"),
        pytest.param(UNIX_NS - 3_600_000_000_000, 100.0, id="host clock stepped back: not in the future"),
        pytest.param(UNIX_NS + 3_600_000_000_000, 99.0, id="host clock stepped ahead: not before nothing waited"),
    ],
)
def test_a_stamp_of_the_system_is_brought_to_the_service_clock_within_what_is_known(monkeypatch, unix_now_ns, expected_s):
    monkeypatch.setattr("time.time_ns", lambda: unix_now_ns)
    assert arrival_time(lambda: 100.0, UNIX_NS, 99.0) == expected_s


def test_clocks_that_were_read_too_far_apart_are_read_again(monkeypatch):
    monkeypatch.setattr("time.time_ns", lambda: UNIX_NS)
    readings = iter([100.0, 100.5, 101.0, 101.0])  # interrupted between the first two
    assert arrival_time(lambda: next(readings), UNIX_NS, 0.0) == 101.0
