"""Thirty vehicles on the page in a real browser: the most serious first, filtered, in rows, with labels that can be read."""

from __future__ import annotations

import re

import pytest
from flight import Watched, browser, card, service, wait_for
from playwright.sync_api import expect
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from vehicles import COUNT, swarm

from bench.free_ports import free_port

pytestmark = pytest.mark.integration

OVERLAPS = """() => {
    const boxes = [...document.querySelectorAll("#map .vehicle .name")].map((e) => e.getBoundingClientRect());
    const overlap = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
    return [boxes.length, boxes.filter((a, i) => boxes.slice(i + 1).some((b) => overlap(a, b))).length];
}"""

BLANK_BELOW = """() => {
    const { bottom } = document.querySelector("main").getBoundingClientRect();
    return document.documentElement.scrollHeight - scrollY - bottom;
}"""

ALL_IN_VIEW = """() => {
    const { left, right } = document.querySelector("#map").getBoundingClientRect();
    const boxes = [...document.querySelectorAll("#map .mark svg")].map((e) => e.getBoundingClientRect());
    return boxes.every((box) => box.left > left && box.right < right);
}"""


def test_thirty_vehicles_are_sorted_filtered_and_told_apart(tmp_path):
    port, failed = free_port(), set()
    (tmp_path / "names.toml").write_text('[fleet.names]\n6 = "Kite"\n')
    arguments = ["--udp", f"127.0.0.1:{port}", "--web", "127.0.0.1:0", "--config", str(tmp_path / "names.toml")]
    with service(tmp_path / "log", *arguments) as (_, url), swarm(port, failed) as fleet, browser() as chromium:
        watched = Watched(chromium.new_page(viewport={"width": 1366, "height": 900}))
        page = watched.page
        page.goto(url)
        cards = page.locator("#fleet li")
        expect(page.locator("#fleet .card.good")).to_have_count(COUNT)
        expect(page.locator("#fleet")).to_have_class("compact")
        # One that would not be located without GPS says so in its row.
        expect(page.locator("#readiness-1")).to_have_text(re.compile("^without GPS not ready: "), timeout=60_000)
        rows = cards.evaluate_all("all => all.map((e) => e.getBoundingClientRect().height)")
        assert max(rows) < 40.0
        fields = dict.fromkeys(("load", "voltage_battery", "current_battery", "drop_rate_comm", "errors_comm"), 0)
        fields |= {f"errors_count{n}": 0 for n in range(1, 5)}
        gps = mavlink.MAV_SYS_STATUS_SENSOR_GPS
        fleet[4].send(fleet[4].pack(mavlink.MAVLink_sys_status_message(gps, gps, gps, battery_remaining=87, **fields)))
        expect(card(page, 5).locator(".flight")).to_have_text("AUTO, armed, 87 %, 564 m")
        expect(card(page, 6).locator(".flight")).to_have_text("AUTO, armed, 565 m")
        expect(card(page, 6)).to_contain_text("Vehicle 6 Kite")
        expect(page.locator("#map .vehicle .name", has_text="6 Kite")).to_have_count(1)
        # The labels that are shown can be read.
        wait_for(lambda: (found := page.evaluate(OVERLAPS))[0] >= 10 and found[1] == 0, "labels that do not cover each other")
        failed.update((23, 17))
        expect(cards.nth(0)).to_contain_text("Vehicle 17")
        expect(cards.nth(1)).to_contain_text("Vehicle 23")
        expect(cards.nth(2)).to_contain_text("Vehicle 1")
        expect(card(page, 17).locator(".reason")).to_be_visible()
        expect(page.locator("#summary")).to_contain_text("(17, 23)")
        page.locator("#summary").get_by_role("button", name="Vehicle 23: to its card").click()
        expect(page.get_by_role("region", name="Vehicle 23")).to_be_attached()
        expect(card(page, 23)).to_be_focused()
        expect(card(page, 23)).to_be_in_viewport()
        search = page.get_by_role("searchbox", name="Filter the fleet")
        for wanted, count in (("12", 1), ("gps failed", 2), ("AUTO", COUNT), ("87 %", 1), ("nothing at all", 0)):
            search.fill(wanted)
            expect(page.locator("#fleet li:visible")).to_have_count(count)
        search.fill("")
        expect(page.locator("#fleet li:visible")).to_have_count(COUNT)
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
        # Neighbours without GPS, on a phone: the names of reported positions too.
        failed.update(range(13, 19))
        expect(page.locator("#map .vehicle.reported")).to_have_count(7)
        for width, height in ((390, 844), (1366, 900)):
            page.set_viewport_size({"width": width, "height": height})
            wait_for(lambda: page.evaluate(ALL_IN_VIEW), "a map that shows all")
            wait_for(lambda: (found := page.evaluate(OVERLAPS))[0] >= 3 and found[1] == 0, "labels that do not cover each other")
            assert page.evaluate(BLANK_BELOW) < 1
        assert [text for text in watched.complaints if not re.search("favicon", text)] == []
