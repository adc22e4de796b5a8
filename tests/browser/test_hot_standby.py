"""The hot standby on the pages of two real services: who sends, and the orders to both, each confirmed."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from flight import PATIENCE_S, TOKEN, Watched, browser, card, service
from playwright.sync_api import Page, expect

from bench.two_links import DENIED, TwoLinks, two_links

pytestmark = pytest.mark.integration


@dataclass
class Pages:
    """The pages of the service that is active at first, and of the other one."""

    first: Watched
    second: Watched


@contextlib.contextmanager
def flown(air: TwoLinks) -> Iterator[None]:
    """The vehicles fly in the background."""
    landed = threading.Event()
    thread = threading.Thread(target=air.fly, args=(86_400.0, landed.is_set), daemon=True)
    thread.start()
    try:
        yield
    finally:
        landed.set()
        thread.join()


@pytest.fixture(scope="module")
def pages(tmp_path_factory) -> Iterator[Pages]:
    tmp_path = tmp_path_factory.mktemp("standby")
    (tmp_path / "token").write_text(f"{TOKEN}\n")
    (tmp_path / "token").chmod(0o600)
    with two_links() as (air, ports), flown(air):
        for index, role in enumerate(("active", "standby")):
            signs = air.sign_ports
            (tmp_path / f"{index}.toml").write_text(
                f'[mavlink]\ncomponent_id = {191 + index}\n[web]\ntoken_file = "{tmp_path / "token"}"\n'
                f'[standby]\nrole = "{role}"\npeer = "127.0.0.1:{signs[1 - index]}"\nlisten = "127.0.0.1:{signs[index]}"\n'
            )
        arguments = [
            ["--config", str(tmp_path / f"{index}.toml"), "--udp", f"127.0.0.1:{ports[index]}", "--web", "127.0.0.1:0"]
            for index in (0, 1)
        ]
        with (
            service(tmp_path / "first.log", *arguments[0]) as (_, first),
            service(tmp_path / "second.log", *arguments[1]) as (_, second),
            browser() as chromium,
        ):
            both = Pages(Watched(chromium.new_page()), Watched(chromium.new_page()))
            both.first.page.goto(first)
            both.second.page.goto(second)
            yield both


def panel(page: Page):
    return page.get_by_role("region", name="Hot standby")


def order(page: Page, name: str) -> int:
    """Give an order, again for as long as the page asks for that: a service that stood still must first find out who sends.

    Returns how often it was refused so, of each of which the browser complains.
    """
    deadline_s, refused = time.monotonic() + PATIENCE_S, 0
    while True:
        panel(page).get_by_label("Token of the operator").fill(TOKEN)
        panel(page).get_by_role("button", name=name).click()
        page.locator("#send-command").click()  # waits until it can be pressed
        result = page.locator("#standby-result")
        expect(result).not_to_be_empty()
        if "try again in a second" not in result.inner_text() or time.monotonic() > deadline_s:
            break
        refused += 1
    expect(result).to_have_text("done")
    return refused


def test_each_page_tells_who_sends_and_an_order_that_is_confirmed_changes_it(pages):
    first, second = pages.first.page, pages.second.page
    expect(panel(first)).to_contain_text("active: this service sends")
    expect(panel(second)).to_contain_text("standing by")
    expect(second.locator("#standby-sends")).to_have_text("the other service")
    expect(second.locator("#standby-other")).to_contain_text("254/191: active")
    expect(panel(second).get_by_role("button", name="Stand by")).to_be_hidden()
    # Neither alarms nor cards squeeze it: all of it can be read.
    second.set_viewport_size({"width": 1440, "height": 900})
    expect(panel(second).get_by_role("button", name="Take over")).to_be_in_viewport(ratio=1.0)
    assert panel(second).evaluate("one => one.scrollHeight - one.clientHeight") <= 1
    # Nothing is sent by one press.
    panel(second).get_by_label("Token of the operator").fill(TOKEN)
    panel(second).get_by_role("button", name="Take over").click()
    expect(second.get_by_role("alertdialog")).to_contain_text("Hot standby: Take over?")
    second.get_by_role("button", name="Cancel").click()
    expect(panel(first)).to_contain_text("active: this service sends")
    refused = order(second, "Take over")
    expect(panel(second)).to_contain_text("active: this service sends")
    expect(panel(first)).to_contain_text("standing by")
    expect(first.locator("#standby-sends")).to_have_text("the other service")
    refused += order(second, "Let the other one take over")
    expect(panel(first)).to_contain_text("active: this service sends")
    assert pages.first.complaints == []
    assert [complaint for complaint in pages.second.complaints if "409 (Conflict)" not in complaint] == []
    assert len(pages.second.complaints) == refused


def test_an_override_is_given_to_the_active_one_and_is_in_force_on_both(pages):
    first, second = pages.first.page, pages.second.page
    expect(panel(second)).to_contain_text("standing by")
    for page in (first, second):
        card(page, DENIED).click()
        page.get_by_label("Operator's token").fill(TOKEN)
    second.locator("#commands button[value='gps failed']").click()
    second.locator("#send-command").click()
    expect(second.locator("#command-result")).to_contain_text("refused: the other service is active")
    first.locator("#commands button[value='gps failed']").click()
    first.locator("#send-command").click()
    expect(first.locator("#gps-in-force")).to_have_text("declared failed (by page)")
    expect(second.locator("#gps-in-force")).to_have_text("declared failed (by other service)")
