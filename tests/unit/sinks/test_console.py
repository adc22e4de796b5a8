"""The console: what an operator reads of a vehicle, on a terminal and in a log."""

import asyncio
import io
import logging
import re
from dataclasses import replace

import pytest
from fleet_views import NOT_READY, READY
from rich.console import Console

from gcs_coloc.core.messages.outbound import HealthChanged, Notice
from gcs_coloc.core.snapshot import FleetSnapshot, OutSnapshot, VehicleSnapshot
from gcs_coloc.sinks.console import show
from gcs_coloc.sinks.event_bus import EventBus
from gcs_coloc.sinks.fleet_lines import vehicle_line
from gcs_coloc.sinks.terminal import FleetTables

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


def rendered(view: FleetSnapshot, width: int = 80, height: int = 24) -> str:
    console = Console(file=io.StringIO(), width=width, height=height)
    console.print(FleetTables({"": view}))
    return console.file.getvalue()  # type: ignore[attr-defined]


def fleet_of(*vehicles: VehicleSnapshot) -> FleetSnapshot:
    return FleetSnapshot(10.0, "fleet", vehicles, {"bad_crc": 3}, {})


def test_the_table_shows_all_that_matters_of_each_vehicle():
    located = replace(LOCATED, lat_deg=-47.1, lon_deg=-122.2, hpl_m=41.3, name="Kite", aiding_has_fix=True)
    text = rendered(fleet_of(located, LOST))
    assert re.search(r"^4 Kite +failed +0.4 s +-47.10000 +-122.20000 +30.1 m +41.3 m +3 +fix", text, re.MULTILINE)
    assert re.search(r"^5 +failed +0.1 s +- +- +- +- +0 +no fix", text, re.MULTILINE)
    assert "4 Kite: no 3D fix: fix type 1, HDOP 1.4, sending 3D fix" in text
    assert "5: silence, position unknown: no ranges for 6 s, sending no fix" in text
    assert "refused: bad_crc 3" in text


WIDEST = replace(
    LOCATED, sysid=255, name="Kite West", gps_state="recovering", age_s=5900.0, lat_deg=-47.39774, lon_deg=-122.54559,
    bound_95_m=9999.0, hpl_m=99.9,
)  # fmt: skip


def test_the_widest_line_fits_eighty_columns_uncut():
    lines = [line for line in rendered(fleet_of(WIDEST)).splitlines() if line.startswith("255 Kite West ")]
    assert lines[0].split() == [
        "255",
        "Kite",
        "West",
        "recovering",
        "98",
        "min",
        "-47.39774",
        "-122.54559",
        "9999",
        "m",
        "99.9",
        "m",
        "3",
        "no",
        "fix",
    ]
    assert len(lines[0]) <= 80


HEALTHY = replace(LOCATED, gps_state="healthy", gps_reason="fix type 3", aiding="off")


@pytest.mark.parametrize("failed", [0, 2, 30])
def test_thirty_vehicles_fit_a_terminal_of_24_lines_the_most_serious_first(failed: int):
    fleet = [replace(LOCATED if i > 30 - failed else HEALTHY, sysid=i) for i in range(1, 31)]
    lines = rendered(fleet_of(*fleet)).splitlines()
    assert len(lines) <= 23
    rows = [int(line.split()[0]) for line in lines if re.match(r"\d+ +(failed|healthy)", line)]
    reasons = [int(line.split(":")[0]) for line in lines if re.match(r"\d+:", line)]
    worst_first = [*range(31 - failed, 31), *range(1, 31 - failed)]
    assert rows == worst_first[: len(rows)]
    assert reasons == worst_first[: len(reasons)]
    assert (len(reasons) > 0) == (failed > 0)
    (left_out,) = [line for line in lines if line.startswith("and ")]
    assert left_out == f"and {30 - len(rows)} more vehicles, " + (
        f"{30 - len(rows)} of them not healthy" if failed == 30 else "all healthy"
    )


def test_two_fleets_share_the_terminal():
    console = Console(file=io.StringIO(), width=80, height=24)
    fleet = fleet_of(*(replace(HEALTHY, sysid=i) for i in range(1, 31)))
    console.print(FleetTables({"south": fleet, "north": fleet}))
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert len(lines) <= 23
    assert [line.split(",")[1].strip() for line in lines if line.startswith("gcs-coloc")] == ["fleet north", "fleet south"]


def test_what_becomes_of_a_ground_tools_frames_is_told_on_the_table_and_in_plain_lines(caplog: pytest.LogCaptureFixture):
    view = FleetSnapshot(0.0, "fleet", (LOCATED,), {}, {}, outs=(OutSnapshot("udpout:127.0.0.1:14551", 1, 400, 12, 3, 2),))
    words = "ground tools on udpout:127.0.0.1:14551: 1, frames sent 400, accepted 12, dropped 3, refused 2"
    assert words in rendered(view, width=120)

    async def scenario():
        events = EventBus()
        task = asyncio.create_task(show({"north": events.subscribe()}, None))
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
        task = asyncio.create_task(show({"": events.subscribe()}, None))
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
    assert "95 % bound 30.1 m, HPL -, HDOP 1.4, 3 ranges in use, aiding sending 3D fix" in lines[2]


@pytest.mark.parametrize(("readiness", "words"), [(READY, "0 ready"), (NOT_READY, "0 not ready"), (None, "0 -")])
def test_a_healthy_vehicle_shows_its_readiness(readiness, words):
    text = rendered(fleet_of(replace(HEALTHY, readiness=readiness, ranges_in_use=0)))
    (line,) = [line for line in text.splitlines() if "healthy" in line]
    assert " ".join(line.split()).endswith(words)


def test_where_the_widest_line_has_no_room_the_end_of_the_name_gives_way():
    lines = rendered(fleet_of(WIDEST, replace(HEALTHY, readiness=NOT_READY))).splitlines()
    (widest,) = [line for line in lines if line.startswith("255") and "recovering" in line]
    assert widest.split("recovering")[0].strip() == "255 Kite …"
    assert " ".join(widest.split()).endswith("-47.39774 -122.54559 9999 m 99.9 m 3 no fix")
    assert any(line.rstrip().endswith("not ready") for line in lines)


def test_lost_readiness_is_a_reason_to_be_told():
    lost = replace(HEALTHY, readiness=replace(NOT_READY, is_lost=True))
    assert "would be lost without GPS: peers 2 and 3 in one line with it: HDOP 9" in rendered(fleet_of(lost))
    assert "would be lost" not in rendered(fleet_of(replace(HEALTHY, readiness=NOT_READY)))


def test_the_plain_line_tells_readiness_in_words():
    line = vehicle_line(replace(HEALTHY, readiness=NOT_READY))
    assert line.endswith(", without GPS not ready (peers 2 and 3 in one line with it: HDOP 9)")
    assert vehicle_line(replace(HEALTHY, readiness=READY)).endswith(", without GPS ready")
    assert "without GPS" not in vehicle_line(HEALTHY)
