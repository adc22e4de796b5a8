"""The console: what an operator reads of a vehicle, on a terminal and in a log."""

import asyncio
import io
import logging

import pytest
from rich.console import Console

from gcs_coloc.core.messages.outbound import HealthChanged, Notice
from gcs_coloc.core.snapshot import FleetSnapshot, OutSnapshot, VehicleSnapshot
from gcs_coloc.sinks.console import SharedConsole, show, table
from gcs_coloc.sinks.event_bus import EventBus

LOCATED = VehicleSnapshot(
    4,
    0.4,
    "ArduPilot",
    "failed",
    "no 3D fix: fix type 1",
    47.1,
    8.2,
    512.0,
    12.3,
    30.1,
    1.4,
    3,
    None,
    47.0,
    8.0,
    "sending 3D fix",
)
LOST = VehicleSnapshot(
    5,
    0.1,
    "ArduPilot",
    "failed",
    "silence",
    None,
    None,
    None,
    None,
    None,
    None,
    0,
    "no ranges for 6 s",
    None,
    None,
    "sending no fix",
)


def rendered(view: FleetSnapshot) -> str:
    console = Console(file=io.StringIO(), width=200)
    console.print(table(view))
    return console.file.getvalue()  # type: ignore[attr-defined]


def test_the_table_shows_all_that_matters_of_each_vehicle():
    text = rendered(FleetSnapshot(10.0, "fleet", (LOCATED, LOST), {"bad_crc": 3}, {}))
    for words in ("fleet", "0.4 s", "failed", "fix type 1", "47.100000 8.200000 512 m", "12.3 m", "1.4", "sending 3D fix"):
        assert words in text
    assert "unknown: no ranges for 6 s" in text
    assert "refused: 3" in text


def test_what_becomes_of_a_ground_tools_frames_is_told_on_the_table_and_in_plain_lines(caplog: pytest.LogCaptureFixture):
    view = FleetSnapshot(0.0, "fleet", (LOCATED,), {}, {}, outs=(OutSnapshot("udpout:127.0.0.1:14551", 1, 400, 12, 3, 2),))
    words = "ground tools on udpout:127.0.0.1:14551: 1, frames sent 400, accepted 12, dropped 3, refused 2"
    assert words in rendered(view)

    async def scenario():
        events = EventBus()
        task = asyncio.create_task(show({"north": events.subscribe()}, SharedConsole(file=io.StringIO())))
        await asyncio.sleep(0)
        events.publish(view)
        for _ in range(10):
            await asyncio.sleep(0)
        task.cancel()

    with caplog.at_level(logging.INFO, logger="gcs_coloc"):
        asyncio.run(scenario())
    assert caplog.records[-1].getMessage() == f"north: {words}"


def test_an_empty_fleet_says_so():
    assert "no vehicle heard yet" in rendered(FleetSnapshot(0.0, "fleet", (), {}, {}))


def test_without_a_terminal_there_are_plain_lines_at_a_calm_rate(caplog: pytest.LogCaptureFixture):
    async def scenario():
        events = EventBus()
        task = asyncio.create_task(show({"": events.subscribe()}, SharedConsole(file=io.StringIO())))
        await asyncio.sleep(0)
        events.publish(HealthChanged(0.0, 4, "healthy", "failed", "no 3D fix"))
        events.publish(Notice(0.0, None, "error", "something"))
        for i in range(24):
            events.publish(FleetSnapshot(i * 0.5, "fleet", (LOCATED,), {}, {}))
        for _ in range(60):
            await asyncio.sleep(0)
        task.cancel()

    with caplog.at_level(logging.INFO, logger="gcs_coloc"):
        asyncio.run(scenario())
    lines = [r.getMessage() for r in caplog.records]
    assert lines[:2] == ["vehicle 4: GPS healthy -> failed: no 3D fix", "something"]
    assert [r.levelno for r in caplog.records[:2]] == [logging.WARNING, logging.ERROR]
    assert len(lines) == 2 + 3  # at 0, 5 and 10 s
    assert "1-sigma 12.3 m, HDOP 1.4, 3 ranges in use, aiding sending 3D fix" in lines[2]
