"""The alarms in a real browser: one list for all pages, with a life, that never contradicts the header, and rings on request."""

from __future__ import annotations

import json
import re

import pytest
from flight import Watched, card, wait_for, wait_until_good
from playwright.sync_api import WebSocketRoute, expect

pytestmark = pytest.mark.integration


def alarm(page, sysid: int):
    return page.locator(f"#alarms li[data-kind='gps_lost'][data-sysid='{sysid}']")


def test_an_alarm_is_active_on_every_page_until_it_is_over_and_somebody_has_acknowledged_it(watched, live):
    page = watched.page
    other = Watched(live.chromium.new_page()).page
    other.goto(live.url)
    wait_until_good(other, 4)
    live.failed.add(4)
    # Its receiver never shows what it is sent: after 5 s the caution is an alarm, and stays one.
    for one in (page, other):
        expect(alarm(one, 4)).to_have_class("error active")
        expect(alarm(one, 4)).to_contain_text("GPS failed: ")
        expect(alarm(one, 4)).to_contain_text("Its autopilot does not use what it is sent: fly it by hand")
        expect(one.locator("#summary")).to_contain_text("1 in alarm (4)")
        expect(one.get_by_role("link", name="to acknowledge")).to_be_visible()
    page.reload()
    alarm(page, 4).get_by_role("button", name="Acknowledge vehicle 4").click()
    for one in (page, other):
        # It lasts: acknowledged it stays in the list, as the header still counts it.
        expect(alarm(one, 4)).to_have_class("error acknowledged")
        expect(one.locator("#summary")).to_contain_text("1 in alarm (4)")
    live.failed.clear()
    for one in (page, other):
        expect(alarm(one, 4)).to_have_count(0)
        expect(one.locator("#summary")).to_contain_text("0 in alarm")
    wait_until_good(page, 4)
    live.failed.add(4)
    expect(alarm(page, 4)).to_have_class(re.compile(" active$"))
    live.failed.clear()
    # Over, and said so, until somebody has read it.
    expect(alarm(page, 4)).to_have_class(re.compile(" over$"))
    expect(alarm(page, 4)).to_contain_text("over: vehicle 4")
    expect(alarm(page, 4).locator(".when")).to_have_text(re.compile(r"^\d\d:\d\d:\d\d to \d\d:\d\d:\d\d, over$"))
    expect(page.locator("#summary")).to_contain_text("0 in alarm, 0 with caution")
    alarm(other, 4).get_by_role("button", name="Acknowledge vehicle 4").click()
    for one in (page, other):
        expect(alarm(one, 4)).to_have_count(0)
    assert watched.complaints == []
    other.close()


def test_a_notice_is_never_called_over_for_nobody_knows_whether_its_cause_lasts(watched, live):
    page = watched.page
    notice = page.locator("#alarms li[data-kind='notice'][data-sysid='2']", has_text="GPS_INPUT is not taken")
    live.failed.add(2)
    expect(notice).to_have_class("error notice")
    expect(notice.locator(".text")).to_have_text(re.compile("^vehicle 2: GPS_INPUT is not taken"))
    expect(notice.locator(".when")).to_have_text(re.compile(r"^\d\d:\d\d:\d\d$"))
    notice.get_by_role("button", name="Acknowledge").click()
    expect(notice).to_have_count(0)
    live.failed.clear()
    wait_until_good(page, 2)


RINGS = """
    window.rung = 0;
    window.notified = [];
    const start = OscillatorNode.prototype.start;
    OscillatorNode.prototype.start = function (...when) {
        window.rung += 1;
        return start.apply(this, when);
    };
    window.Notification = class extends Notification {
        constructor(title, options) {
            super(title, options);
            window.notified.push(options.body);
        }
    };
"""


def test_sound_and_notification_ring_on_request_and_not_for_what_a_page_finds_when_it_opens(watched, live):
    watched.page.close()
    context = live.chromium.new_context(permissions=["notifications"])
    context.add_init_script(RINGS)
    page = Watched(context.new_page()).page
    page.goto(live.url)
    wait_until_good(page, 3)
    for name in ("Sound", "Notify"):
        page.get_by_role("button", name=name).click()
        expect(page.get_by_role("button", name=name)).to_have_attribute("aria-pressed", "true")
    before = page.evaluate("rung")
    live.failed.add(3)
    raised = "vehicle 3: alarm active: GPS failed"
    wait_for(lambda: any(text.startswith(raised) for text in page.evaluate("notified")), "the notification")
    assert page.evaluate("rung") > before
    expect(page.locator("#announcer")).to_contain_text("vehicle 3")

    def only_what_it_finds(browser_side: WebSocketRoute) -> None:
        found: list[str] = []

        def pass_on(text: str) -> None:
            if json.loads(text)["kind"] == "events":
                found.append(text)
                if len(found) > 1:
                    return
            browser_side.send(text)

        browser_side.connect_to_server().on_message(pass_on)

    page.route_web_socket(re.compile("/live$"), only_what_it_finds)
    page.reload()
    expect(page.get_by_role("button", name="Sound")).to_have_attribute("aria-pressed", "true")
    expect(page.locator("#log li").filter(has_text=raised)).not_to_have_count(0)
    expect(alarm(page, 3)).to_have_count(1)
    assert page.evaluate("[rung, notified.length]") == [0, 0]
    context.close()


def test_times_are_told_as_soon_as_the_service_knows_what_time_it_is(live):
    """What a page shows that found a service in its first second again: events first, and the time of day later."""
    knows_the_time = False
    page = Watched(live.chromium.new_page()).page

    def between(browser_side: WebSocketRoute) -> None:
        def pass_on(text: str) -> None:
            message = json.loads(text)
            if not knows_the_time and "utc_minus_service_s" in message:
                text = json.dumps(message | {"utc_minus_service_s": None})
            browser_side.send(text)

        browser_side.connect_to_server().on_message(pass_on)

    page.route_web_socket(re.compile("/live$"), between)
    live.failed.clear()
    page.goto(live.url)
    wait_until_good(page, 4)
    live.failed.add(4)
    line = page.locator("#log li").filter(has_text="vehicle 4: GPS suspect\u00a0→\u00a0failed").first
    expect(alarm(page, 4)).to_have_class(re.compile(" active$"))
    expect(alarm(page, 4).locator(".when")).to_have_text(re.compile(r"^since \d+\.\d s"))
    expect(line).to_have_text(re.compile(r"^\d+\.\d s vehicle 4"))
    knows_the_time = True
    expect(alarm(page, 4).locator(".when")).to_have_text(re.compile(r"^since \d\d:\d\d:\d\d"))
    expect(line).to_have_text(re.compile(r"^\d\d:\d\d:\d\d vehicle 4"))
    live.failed.clear()
    expect(card(page, 4)).to_contain_text("GPS healthy")
    page.close()
