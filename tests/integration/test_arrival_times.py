"""A service that is held up: what waited in its sockets meanwhile counts from when it arrived, over all links in one order."""

from __future__ import annotations

import asyncio
import socket
import sys
import time
from collections.abc import Callable

import pytest
from link_peers import heartbeat, stamps_of_arrival, until
from vehicles import Hover

from bench.free_ports import free_port, free_ports
from gcs_coloc.config.fleets import load_settings
from gcs_coloc.core.alarms.alarms import AlarmKind, AlarmState, traffic_light
from gcs_coloc.links.base import SCHEMES
from gcs_coloc.links.udp import UdpIn
from gcs_coloc.mavlink.refusals import Counts
from gcs_coloc.recorder.tlog import TlogReader, message_id
from gcs_coloc.runtime.clock import ServiceClock, read_host_clock
from gcs_coloc.service.fleet_service import FleetService

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(sys.platform != "linux", reason="only Linux stamps what arrives in nanoseconds"),
]

HELD_UP_S = 0.02
"""The event loop is busy with sending for so long."""
SLACK_S = 100e-6
"""Whole microseconds, and two clocks of the host that are read one after the other."""


def test_datagrams_of_two_links_that_waited_are_received_in_the_order_and_at_the_time_of_their_arrival(tmp_path):
    ports = free_ports(2)
    sent: list[tuple[int, float, float]] = []
    clock = ServiceClock()

    async def flight() -> None:
        links = [f"udpin:127.0.0.1:{port}" for port in ports]
        path = FleetService(
            load_settings(None, {"links": links, "record": {"directory": str(tmp_path)}}), clock, read_host_clock(clock())
        )
        await path.open()
        path.start()
        senders = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in ports]
        # The event loop does not run while these are sent: as if something had held the service up.
        began_s = clock()
        for number in range(300):  # within what a sender may send at once
            which, sequence = (number // 3) % 2, (number // 6 * 3 + number % 3) % 256
            before_s = clock()
            senders[which].sendto(heartbeat(which + 1, sequence), ("127.0.0.1", ports[which]))
            sent.append((which + 1, before_s, clock()))
        while clock() < began_s + HELD_UP_S:
            pass
        await until(lambda: len(path.known_sysids()) == 2)
        await path.close()
        for sender in senders:
            sender.close()

    with stamps_of_arrival():
        asyncio.run(flight())
    (recording,) = tmp_path.rglob("*.tlog")
    received = [(record.frame[5], record.unix_s) for record in TlogReader(recording) if record.frame[5] in (1, 2)]
    assert [at_s for _, at_s in received] == sorted(at_s for _, at_s in received)
    for sysid in (1, 2):
        spans = [(before_s, after_s) for sender, before_s, after_s in sent if sender == sysid]
        stamps = [at_s for sender, at_s in received if sender == sysid]
        for (before_s, after_s), at_s in zip(spans, stamps, strict=True):
            assert before_s - SLACK_S <= at_s <= after_s + SLACK_S


START_S = 1_800_000_000.0
GPS_INPUT = 232


class HandClock(ServiceClock):
    """The service's clock, set by hand."""

    now_s = START_S

    def __call__(self) -> float:
        return self.now_s


class HandLink:
    """A link whose `waiting` datagrams are handed over when they are fetched."""

    made: HandLink
    is_late = False

    def __init__(self, handler):
        self.name, self.peers, self.counts = "hand", (), Counts()
        self.handler, self.waiting, self.sent = handler, [], []
        HandLink.made = self

    async def open(self):
        pass

    async def close(self):
        pass

    def send(self, address, payload, *, forwarded=False):
        self.sent.append(message_id(payload))

    def receive_waiting(self, most):
        waiting, self.waiting = self.waiting, []
        for payload, at_s in waiting:
            self.handler(self, ("hand", 1), payload, at_s)


class HandAddress(UdpIn):
    SCHEME = "hand"

    def make_link(self, handler, clock, *, most_unsent_bytes=0):
        return HandLink(handler)


def test_a_host_that_falls_behind_is_known_to_the_engine_and_told_until_it_is_over(monkeypatch):
    monkeypatch.setitem(SCHEMES, "hand", (__name__, "HandAddress"))

    async def flight() -> None:
        clock = HandClock()
        path = FleetService(load_settings(None, {"links": ["hand:127.0.0.1:1"]}), clock, read_host_clock(clock()))
        await path.open()
        path.start()
        link, hover = HandLink.made, Hover(1, (0.0, 0.0, 50.0), ("127.0.0.1", 1))

        def stands() -> tuple[float, list[AlarmKind]]:
            path.each_second(read_host_clock(clock()))
            clock.now_s += 0.15  # past the snapshot that observers share
            fleet = path.snapshots.snapshot()
            kinds = [a.kind for a in path.alarms.update(fleet) if a.sysid is None and a.state is AlarmState.ACTIVE]
            return fleet.loop_lag_s, kinds

        link.handler(link, ("hand", 1), b"".join(hover.telemetry(0, 3)), clock.now_s)
        assert stands() == (0.0, [])
        link.waiting = [(frame, clock.now_s + 0.1 * step) for step in range(10) for frame in hover.telemetry(step, 3)]
        clock.now_s += 0.9
        link.handler(link, ("hand", 1), hover.telemetry(10, 3)[0], clock.now_s)
        lag_s, alarms = stands()
        assert (round(lag_s, 3), alarms) == (0.9, [AlarmKind.HOST_LATE])
        assert stands() == (0.0, [])
        await path.close()
        hover.sock.close()

    asyncio.run(flight())


def test_of_the_positions_that_were_due_while_the_service_was_held_up_only_the_newest_is_sent(monkeypatch):
    monkeypatch.setitem(SCHEMES, "hand", (__name__, "HandAddress"))

    async def flight() -> None:
        clock = HandClock()
        path = FleetService(
            load_settings(None, {"links": ["hand:127.0.0.1:1"], "fleet": {"failed": [1]}}), clock, read_host_clock(clock())
        )
        await path.open()
        path.start()
        link, hover = HandLink.made, Hover(1, (0.0, 0.0, 50.0), ("127.0.0.1", 1))
        for step in range(20):
            clock.now_s = round(START_S + 0.1 * step, 6)
            for frame in hover.telemetry(step, 3):
                link.handler(link, ("hand", 1), frame, clock.now_s)
        at_its_pace = link.sent.count(GPS_INPUT)
        link.waiting = [(frame, round(START_S + 0.1 * step, 6)) for step in range(20, 29) for frame in hover.telemetry(step, 3)]
        clock.now_s = START_S + 2.9
        path.each_second(read_host_clock(clock()))
        assert at_its_pace >= 5
        assert link.sent.count(GPS_INPUT) == at_its_pace + 1
        await path.close()
        hover.sock.close()

    asyncio.run(flight())


class SlowHost(HandClock):
    """A host on which every look at the clock takes a millisecond; the event loop's timers fire by it."""

    def __call__(self) -> float:
        self.now_s = round(self.now_s + 1e-3, 6)
        return self.now_s

    def on_loop(self, at_s: float) -> float:
        return at_s - START_S

    def drive(self, loop: asyncio.AbstractEventLoop) -> None:
        """Have an event loop go by this clock. Its owner must keep it busy, for it would wait in real time."""
        loop.time = lambda: self.now_s - START_S


def test_a_host_with_little_time_works_its_backlog_off_in_portions_and_sends_no_position_of_the_past(monkeypatch):
    """Page, log and the other service go on between the portions; what was missed is answered once, in the present."""
    monkeypatch.setitem(SCHEMES, "hand", (__name__, "HandAddress"))

    async def flight() -> None:
        clock = SlowHost()
        clock.drive(asyncio.get_running_loop())
        path = FleetService(
            load_settings(None, {"links": ["hand:127.0.0.1:1"], "fleet": {"failed": [1]}}), clock, read_host_clock(clock())
        )
        await path.open()
        path.start()
        link, hover = HandLink.made, Hover(1, (0.0, 0.0, 50.0), ("127.0.0.1", 1))
        for step in range(20):
            clock.now_s = round(START_S + 0.1 * step, 6)
            for frame in hover.telemetry(step, 3):
                link.handler(link, ("hand", 1), frame, clock.now_s)
        at_its_pace = link.sent.count(GPS_INPUT)
        assert at_its_pace >= 5
        link.waiting = [(frame, round(START_S + 0.1 * step, 6)) for step in range(20, 80) for frame in hover.telemetry(step, 3)]
        clock.now_s = START_S + 8.0
        link.handler(link, ("hand", 1), hover.telemetry(80, 3)[0], clock.now_s)
        behind, sent = [path.fault()], [link.sent.count(GPS_INPUT)]
        while path.fault() is not None or len(behind) < 3:
            await asyncio.sleep(0)
            behind.append(path.fault())
            sent.append(link.sent.count(GPS_INPUT))
        assert behind[0] is not None
        assert "the engine was last run" in behind[0]
        assert sum(fault is not None for fault in behind) >= 2  # others had their turns meanwhile
        assert sent[-1] - at_its_pace <= 3
        await path.close()
        hover.sock.close()

    asyncio.run(flight())


def test_no_vehicle_is_called_silent_or_late_while_what_it_sent_waits(monkeypatch):
    """Six seconds of datagrams wait. Page, console and log may be first to run then; they look at each turn here."""
    monkeypatch.setitem(SCHEMES, "hand", (__name__, "HandAddress"))

    async def flight() -> None:
        clock = SlowHost()
        clock.drive(asyncio.get_running_loop())
        path = FleetService(load_settings(None, {"links": ["hand:127.0.0.1:1"]}), clock, read_host_clock(clock()))
        await path.open()
        path.start()
        link, hover = HandLink.made, Hover(1, (0.0, 0.0, 50.0), ("127.0.0.1", 1))

        def sent(step: int) -> list[bytes]:
            hover.started = time.monotonic() - 100.0 - 0.1 * step  # its clock goes as the service's
            return hover.telemetry(step, 3)

        for step in range(20):
            clock.now_s = round(START_S + 0.1 * step, 6)
            for frame in sent(step):
                link.handler(link, ("hand", 1), frame, clock.now_s)
        lights: list[str] = []
        told: set[AlarmKind] = set()

        def look() -> None:
            fleet = path.snapshots.recent_snapshot()
            told.update(alarm.kind for alarm in path.alarms.update(fleet))
            lights.extend(traffic_light(v, fleet.loop_lag_s)[0] for v in fleet.vehicles)

        look()
        link.waiting = [(frame, round(START_S + 0.1 * step, 6)) for step in range(20, 80) for frame in sent(step)]
        clock.now_s = START_S + 8.0
        look()
        link.handler(link, ("hand", 1), sent(80)[0], clock.now_s)
        assert path.fault() is not None
        while path.fault() is not None:
            await asyncio.sleep(0)
            clock.now_s += 0.11  # past the snapshot that observers share
            look()
        path.each_second(read_host_clock(clock()))
        look()
        assert AlarmKind.HOST_LATE in told
        assert told <= {AlarmKind.HOST_LATE, AlarmKind.NOT_READY, AlarmKind.NOTICE}
        assert "bad" not in lights
        await path.close()
        hover.sock.close()

    asyncio.run(flight())


def test_a_service_that_is_behind_gives_the_other_one_no_sign_of_life_until_it_has_caught_up(monkeypatch):
    """The other service of a hot standby takes over from one that lives, but sends nothing."""
    monkeypatch.setitem(SCHEMES, "hand", (__name__, "HandAddress"))

    async def flight() -> None:
        clock = SlowHost()
        clock.drive(asyncio.get_running_loop())
        other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        other.bind(("127.0.0.1", 0))
        other.setblocking(False)
        own_port = free_port()
        standby = {"peer": f"127.0.0.1:{other.getsockname()[1]}", "listen": f"127.0.0.1:{own_port}"}
        path = FleetService(
            load_settings(None, {"links": ["hand:127.0.0.1:1"], "standby": standby}), clock, read_host_clock(clock())
        )
        await path.open()
        path.start()

        def signs() -> int:
            found = 0
            while True:
                try:
                    other.recv(65535)
                except BlockingIOError:
                    return found
                found += 1

        async def turns(until: Callable[[], bool]) -> int:
            found = 0
            for _ in range(20_000):
                await asyncio.sleep(0)
                clock()
                found += signs()
                if until():
                    return found
            raise AssertionError("never")

        began_s = clock()
        assert await turns(lambda: clock.now_s > began_s + 2.0) > 5
        link, hover = HandLink.made, Hover(1, (0.0, 0.0, 50.0), ("127.0.0.1", 1))
        link.waiting = [(frame, round(clock.now_s + 0.02 * step, 6)) for step in range(300) for frame in hover.telemetry(step, 3)]
        clock.now_s += 8.0
        link.handler(link, ("hand", 1), hover.telemetry(300, 3)[0], clock.now_s)
        signs()
        assert path.fault() is not None
        assert await turns(lambda: path.fault() is None) == 0
        caught_up_s = clock()
        assert await turns(lambda: clock.now_s > caught_up_s + 4.0) > 5
        await path.close()
        for used in (other, hover.sock):
            used.close()

    asyncio.run(flight())
