"""axe-core finds no violation on the live page, a replayed flight and the report of a flight, in light and dark."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import product

import pytest
from axe_playwright_python.sync_playwright import Axe
from command_line import gcs_coloc
from flight import card, flying, service, wait_until_good
from playwright.sync_api import Page, expect
from recorded_flight import write_flight
from test_replay_page import replaying

from bench.free_ports import free_port

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """20 s, vehicle 4 without GPS after 10 s."""
    path = tmp_path_factory.mktemp("flight") / "flight.tlog"
    write_flight(path, 20.0)
    return path


@pytest.fixture(scope="module")
def replayed(recording) -> Iterator[str]:
    """The address of the page on which that flight is replayed."""
    with replaying(recording) as (_, url):
        yield url


@pytest.fixture(scope="module")
def report(recording):
    """The report of that flight, as a page."""
    out = recording.with_suffix(".html")
    assert gcs_coloc("report", recording, "--out", out).returncode == 0
    return out


def violations(page: Page) -> list[tuple[str, list[str]]]:
    """What axe-core complains of: each rule with the elements."""
    found = Axe().run(page).response
    assert len(found["passes"]) > 10  # it has looked
    return [(rule["id"], [node["html"][:90] for node in rule["nodes"]]) for rule in found["violations"]]


def looks(page: Page) -> Iterator[None]:
    """Show the page light and dark, on a desk's screen and on a phone."""
    for scheme, (width, height) in product(("light", "dark"), ((1440, 900), (390, 844))):
        page.emulate_media(color_scheme=scheme)
        page.set_viewport_size({"width": width, "height": height})
        yield


def test_the_live_page_with_an_alarm_its_details_and_an_armed_command(watched, live):
    page = watched.page
    for _ in looks(page):
        assert violations(page) == []
    live.failed.add(4)
    expect(page.locator("#alarms li[data-kind='gps_lost']")).not_to_have_count(0)
    expect(page.locator("path.range")).to_have_count(3)
    card(page, 4).click()
    for _ in looks(page):
        assert violations(page) == []
    page.get_by_label("Operator's token").fill("a token")
    for _ in looks(page):
        page.get_by_role("button", name="Declare GPS failed").click()
        expect(page.get_by_role("button", name="Send: Declare GPS failed")).to_be_enabled()
        assert violations(page) == []
        page.get_by_role("button", name="Cancel").click()
    live.failed.clear()
    wait_until_good(page, 4)
    for _ in looks(page):
        assert violations(page) == []  # the alarm is over


def test_a_page_that_has_lost_its_service(live, tmp_path):
    port = free_port()
    page = live.chromium.new_page(viewport={"width": 1440, "height": 900})
    with flying(port, set()), service(tmp_path / "log", "--udp", f"127.0.0.1:{port}", "--web", "127.0.0.1:0") as (process, url):
        page.goto(url)
        expect(card(page, 4)).to_be_visible()
        card(page, 4).click()
        process.kill()
        expect(page.locator("#connection")).to_contain_text("NO CONNECTION")
        assert violations(page) == []
    page.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_replayed_flight(live, replayed, scheme):
    page = live.chromium.new_page(viewport={"width": 1440, "height": 900}, color_scheme=scheme)
    page.goto(replayed)
    place = page.get_by_role("slider", name="Position in the recording")
    place.focus()
    page.keyboard.press("End")
    expect(place).to_have_attribute("aria-valuetext", re.compile("^0:(19|20) of"))
    expect(card(page, 4)).to_contain_text("GPS failed")
    card(page, 4).click()
    assert violations(page) == []
    page.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_report_of_a_flight(live, report, scheme):
    page = live.chromium.new_page(color_scheme=scheme)
    page.goto(report.as_uri())
    expect(page.get_by_role("heading", name="Vehicle 4 without its GPS")).to_be_visible()
    for width_px in (1440, 390):
        page.set_viewport_size({"width": width_px, "height": 900})
        assert violations(page) == []
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    page.close()
