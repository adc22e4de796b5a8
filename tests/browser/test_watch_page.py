"""The page of all fleets: two hosts with bridged brokers, of which one dies while the page is open."""

from __future__ import annotations

import re

import pytest
from flight import Watched, browser, service, wait_for
from playwright.sync_api import expect
from test_accessibility import looks, violations
from two_sites import two_sites

pytestmark = pytest.mark.integration


@pytest.fixture
def opened(tmp_path):
    """Both sites, and a page that shows them, with four vehicles each that are good."""
    with (
        two_sites(tmp_path, ("north", "south")) as sites,
        service(tmp_path / "log", "watch", "--config", str(sites[0].config), "--web", "127.0.0.1:0") as (process, url),
        browser() as chromium,
    ):
        watched = Watched(chromium.new_page(viewport={"width": 1366, "height": 900}))
        watched.page.goto(url)
        for name in ("north", "south"):
            expect(fleet(watched.page, name)).to_contain_text("4 good")
        yield sites, watched, process


def fleet(page, name):
    return page.get_by_role("region", name=re.compile(f"^Fleet {name} on "))


def row(page, name, vehicle):
    return fleet(page, name).get_by_role("row").filter(has=page.get_by_role("rowheader", name=vehicle, exact=True))


def names(page):
    return page.locator("#fleets h3").all_text_contents()


def test_the_most_serious_stands_first_the_past_is_past_and_nothing_is_made_up(opened):
    (north, south), watched, process = opened
    page = watched.page
    # While the states come in one by one, that of a fleet may be more serious for a moment.
    wait_for(lambda: names(page) == ["north", "south"], "two fleets that are well, by their names")
    expect(page.locator("#connection")).to_have_text("live")
    for name in ("north", "south"):
        expect(fleet(page, name).locator("details")).not_to_have_attribute("open", "")  # all is well

    south.failed.add(4)
    expect(row(page, "south", "4")).to_contain_text("GPS failed")
    expect(row(page, "south", "4")).to_contain_text(re.compile(r"\d+\.\d{5}, \d+\.\d{5}"))
    expect(row(page, "south", "1")).to_contain_text("good")
    wait_for(lambda: names(page) == ["south", "north"], "the one with a lost GPS first")
    expect(fleet(page, "south").locator("tbody tr").first.get_by_role("rowheader")).to_have_text("4")
    for _ in looks(page):
        assert violations(page) == []
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")

    page.get_by_label("Filter the fleets").fill("north")
    expect(fleet(page, "south")).to_be_hidden()
    page.get_by_label("Filter the fleets").fill("nobody")
    expect(page.get_by_text("No fleet matches the filter.")).to_be_visible()
    page.get_by_label("Filter the fleets").fill("")

    fleet(page, "north").locator("summary").click()
    expect(row(page, "north", "2")).to_be_visible()

    south.broker.kill()  # its bridge is gone with it
    expect(fleet(page, "south")).to_contain_text("not heard for")
    expect(row(page, "south", "4")).to_contain_text("? was")
    expect(page.locator("#summary")).to_contain_text("1 live fleet with 4 vehicles")
    expect(fleet(page, "north")).to_contain_text("4 good")
    for _ in looks(page):
        assert violations(page) == []

    north.broker.kill()
    expect(page.get_by_role("alert")).to_contain_text("no connection to the MQTT broker")
    expect(fleet(page, "north")).to_contain_text("not heard for")
    for _ in looks(page):
        assert violations(page) == []
    north.broker.start()
    expect(fleet(page, "north").locator(".word").last).to_have_text("4 good")
    expect(page.get_by_role("alert")).to_have_count(0)
    assert watched.complaints == []

    process.kill()
    expect(page.locator("#connection")).to_contain_text("NO CONNECTION")
    for _ in looks(page):
        assert violations(page) == []
