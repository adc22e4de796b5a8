"""A vehicle between fixed stations on the page: they are named as stations wherever a range, or what it cannot test, is told."""

from __future__ import annotations

import math
import re
import threading
import time

import pytest
from flight import Watched, browser, card, service
from playwright.sync_api import expect
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from vehicles import ALT_M, LAT, LON, M_PER_DEG_LAT, M_PER_DEG_LON, Hover

from bench.free_ports import free_port

pytestmark = pytest.mark.integration

STATIONS = {3: (-250.0, 40.0, 5.0), 5: (60.0, 300.0, 10.0)}
"""By their ids, east, north, up in m."""


def to_station(vehicle: Hover, station_id: int) -> bytes:
    boot_us = int((time.monotonic() - vehicle.started) * 1e6)
    range_m = math.dist(vehicle.enu_m, STATIONS[station_id])
    return vehicle.pack(mavlink.MAVLink_debug_vect_message(f"STN{station_id}".encode(), boot_us, range_m, 0.5, -1.0))


def table(station_id: int) -> str:
    east_m, north_m, up_m = STATIONS[station_id]
    lat_deg, lon_deg = LAT + north_m / M_PER_DEG_LAT, LON + east_m / M_PER_DEG_LON
    return f"[[station]]\nid = {station_id}\nlat_deg = {lat_deg}\nlon_deg = {lon_deg}\nalt_m = {ALT_M + up_m}\n"


def test_two_stations_are_named_on_the_map_and_in_what_the_protection_level_assumes(tmp_path):
    port, landed, failed = free_port(), threading.Event(), set()
    (tmp_path / "config.toml").write_text("".join(map(table, STATIONS)))
    vehicle = Hover(4, (0.0, 0.0, 100.0), ("127.0.0.1", port))

    def hover() -> None:
        step = 0
        while not landed.wait(0.1):
            vehicle.send(*vehicle.telemetry(step, 1 if failed else 3), *(to_station(vehicle, one) for one in STATIONS))
            step += 1

    arguments = ["--config", str(tmp_path / "config.toml"), "--udp", f"127.0.0.1:{port}", "--web", "127.0.0.1:0"]
    thread = threading.Thread(target=hover, daemon=True)
    with service(tmp_path / "log", *arguments) as (_, url), browser() as chromium:
        watched = Watched(chromium.new_page(viewport={"width": 1366, "height": 900}))
        page = watched.page
        thread.start()
        page.goto(url)
        expect(card(page, 4)).to_have_accessible_name(re.compile("^Vehicle 4 good"))
        failed.add(4)
        card(page, 4).click()
        level = page.locator("#facts dt", has_text="protection level").locator("+ dd")
        device = "; assumes that its ranging device is right: no range tests it"
        stations = "; assumes that station 3 and station 5 are where they say: no range tests them"
        expect(level).to_have_text(re.compile(rf"^\d+\.\d m, height \d+\.\d m{device}{stations}$"))
        expect(page.locator("path.range")).to_have_count(2)
        landed.set()
        assert watched.complaints == []
    thread.join()
    vehicle.sock.close()
