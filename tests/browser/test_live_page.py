"""The operator's page in a real browser, on a real service with vehicles in the air, and no network but loopback."""

from __future__ import annotations

import json
import re
import socket

import pytest
from flight import Watched, card, flying, service, wait_for, wait_until_good
from playwright.sync_api import expect
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from bench.free_ports import free_port

pytestmark = pytest.mark.integration


def test_four_vehicles_are_shown_and_nothing_is_complained_of(watched):
    page = watched.page
    for sysid in (1, 2, 3, 4):
        expect(card(page, sysid)).to_contain_text("last heard 0.")
        expect(page.locator("#map").get_by_role("button", name=f"Vehicle {sysid}, good: estimated position")).to_be_visible()
    expect(page.get_by_role("status").filter(has_text="live")).to_be_visible()
    expect(page.locator("#link-rows tr")).to_have_count(4)
    expect(page.locator("#plots canvas")).to_have_count(5)
    assert watched.complaints == []


def test_a_ground_tool_is_shown_with_what_goes_to_it_and_what_is_refused_of_it(watched, live):
    cells = watched.page.locator("#out-rows tr").locator("th, td")
    expect(cells.first).to_have_text(f"udpin:127.0.0.1:{live.out_port}")
    expect(cells.nth(1)).to_have_text("0")
    sender = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as tool:
        tool.sendto(beat.pack(sender), ("127.0.0.1", live.out_port))
        sender.srcSystem = 3  # a vehicle's
        tool.sendto(beat.pack(sender), ("127.0.0.1", live.out_port))
        expect(cells.nth(1)).to_have_text("1")
        expect(cells.nth(2)).to_have_text(re.compile(r"^[1-9][0-9]*\.[0-9]$"))
        expect(cells.nth(3)).to_have_text("1")
        expect(cells.nth(5)).to_have_text("1")
    expect(watched.page.get_by_role("table", name="Ground tools")).to_be_visible()
    assert watched.complaints == []


def test_a_failed_vehicle_gets_an_ellipse_and_its_reported_position_apart(watched, live):
    page = watched.page
    expect(page.locator("path.ellipse:not([d='M0 0'])")).to_have_count(0)
    live.failed.add(4)
    expect(card(page, 4)).to_contain_text("sending 3D fix")
    expect(card(page, 4)).to_contain_text("caution")
    expect(page.locator("path.ellipse:not([d='M0 0'])")).to_have_count(1)
    expect(page.get_by_role("button", name="Vehicle 4: reported position, not trusted")).to_be_visible()
    expect(page.locator("path.range")).to_have_count(3)
    card(page, 4).click()
    page.get_by_role("button", name="Follow it").click()
    wait_for(lambda: page.locator("path.ellipse:not([d='M0 0'])").bounding_box()["width"] > 60, "an ellipse that can be seen")
    assert watched.complaints == []


def test_a_page_that_is_behind_others_is_sent_no_pictures_and_is_up_to_date_when_it_is_looked_at_again(live):
    hidden, seen = (Watched(live.chromium.new_page()).page for _ in range(2))
    kinds = {hidden: [], seen: []}
    for page, got in kinds.items():
        note = lambda frame, got=got: got.append(json.loads(frame)["kind"])  # noqa: E731
        page.on("websocket", lambda socket, note=note: socket.on("framereceived", note))
        page.goto(live.url)
        expect(page.get_by_role("status").filter(has_text="live")).to_be_visible()

    def pictures(page):
        page.evaluate("0")  # lets what has arrived be told
        return kinds[page].count("fleet")

    def look(page, state):
        hide = f"Object.defineProperty(document, 'hidden', {{value: {state}, configurable: true}})"
        page.evaluate(f"{hide}; document.dispatchEvent(new Event('visibilitychange'))")

    look(hidden, "true")
    before, until = pictures(hidden), pictures(seen) + 15
    wait_for(lambda: pictures(seen) >= until, "pictures of the other page")
    assert pictures(hidden) <= before + 3
    hellos = kinds[hidden].count("hello")
    look(hidden, "false")
    wait_for(lambda: pictures(hidden) > before + 5, "pictures again")
    assert kinds[hidden].count("hello") == hellos + 1
    expect(hidden.get_by_role("status").filter(has_text="live")).to_be_visible()
    for page in kinds:
        page.close()


def focused(page) -> str:
    return page.evaluate("document.activeElement.ariaLabel || document.activeElement.textContent")


def test_the_keyboard_skips_to_the_fleet_and_a_vehicles_details_and_comes_back_from_there(watched):
    page = watched.page
    page.keyboard.press("Tab")
    assert focused(page) == "Skip to the fleet"
    page.keyboard.press("Enter")
    page.keyboard.press("Tab")
    assert focused(page) == "Filter the fleet"
    for sysid in (1, 2):
        page.keyboard.press("Tab")
        assert focused(page).startswith(f"Vehicle {sysid} good")
    page.keyboard.press("Enter")
    details = page.get_by_role("region", name="Vehicle 2")
    expect(details).to_contain_text("ArduPilot")
    expect(details).to_contain_text("10 satellites")
    expect(card(page, 2)).to_have_attribute("aria-pressed", "true")
    assert focused(page) == "Vehicle 2"
    page.keyboard.press("Tab")
    assert focused(page) == "Follow it"
    page.keyboard.press("Escape")
    assert focused(page).startswith("Vehicle 2 good")
    assert watched.complaints == []


def test_the_vehicles_on_the_map_are_one_stop_of_the_tab_key_with_arrow_keys_among_them(watched, live):
    page = watched.page
    live.failed.add(4)
    expect(page.get_by_role("button", name="Vehicle 4: reported position, not trusted")).to_be_visible()
    page.locator("#map").focus()
    page.keyboard.press("Tab")
    expect(page.get_by_role("toolbar", name="Vehicles on the map").locator(":focus")).to_have_count(1)
    page.keyboard.press("Home")
    for sysid in (1, 2, 3, 4):
        assert re.match(f"Vehicle {sysid}, .*: estimated position", focused(page))
        page.keyboard.press("ArrowRight")
    assert focused(page) == "Vehicle 4: reported position, not trusted"
    page.keyboard.press("Tab")
    assert focused(page) == "Zoom in"
    page.keyboard.press("Shift+Tab")
    assert focused(page) == "Vehicle 4: reported position, not trusted"
    live.failed.clear()
    expect(page.get_by_role("button", name="Vehicle 4: reported position, not trusted")).to_have_count(0)
    neighbour = re.match(r"(Vehicle \d), .*: estimated position", focused(page))  # of what is no longer there
    assert neighbour is not None
    page.keyboard.press("Enter")
    expect(page.get_by_role("region", name=neighbour[1])).to_be_visible()
    assert focused(page) == neighbour[1]
    assert watched.complaints == []


@pytest.mark.parametrize("size", [(1366, 900), (800, 1180)])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_control_has_a_name_and_nothing_is_wider_than_the_screen(watched, size, scheme):
    page = watched.page
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.emulate_media(color_scheme=scheme)
    card(page, 4).click()
    controls = page.locator("button:visible, input:visible, a:visible, [role=button]:visible, [role=img]:visible")
    assert controls.count() > 12
    for name in controls.evaluate_all(
        "all => all.map(e => e.ariaLabel || e.textContent.trim() || e.labels?.[0]?.textContent || '')"
    ):
        assert name
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    text, ground = page.evaluate(
        "['color', 'backgroundColor'].map(k => getComputedStyle(document.body)[k].match(/[0-9]+/g).slice(0, 3).map(Number))"
    )
    assert (sum(text) < sum(ground)) is (scheme == "light")
    assert abs(sum(text) - sum(ground)) > 450


MARKS_APART_PX = """() => {
    const [a, b] = [1, 2].map((id) => document.querySelector(`#map [aria-label^="Vehicle ${id}, "]`).getBoundingClientRect());
    return Math.hypot(a.x - b.x, a.y - b.y);
}"""


def double_click(page):
    for _ in range(2):
        page.locator("#map").dblclick(position={"x": 60, "y": 120})


def spread_two_fingers(page):
    box = page.locator("#map").bounding_box()
    gesture = {"x": box["x"] + 60, "y": box["y"] + 120, "scaleFactor": 4.0, "gestureSourceType": "touch"}
    page.context.new_cdp_session(page).send("Input.synthesizePinchGesture", gesture)


@pytest.mark.parametrize("zoom", [double_click, spread_two_fingers])
def test_who_zooms_the_map_ends_show_all(live, zoom):
    live.failed.clear()
    context, pictures = live.chromium.new_context(has_touch=True, viewport={"width": 1366, "height": 900}), []
    page = Watched(context.new_page()).page
    page.on("websocket", lambda socket: socket.on("framereceived", lambda text: pictures.append(text)))
    page.goto(live.url)
    wait_until_good(page, 1, 2, 3, 4)
    before = page.evaluate(MARKS_APART_PX)
    zoom(page)
    wait_for(lambda: page.evaluate(MARKS_APART_PX) > 3.0 * before, "the zoom")
    seen = len(pictures)
    wait_for(lambda: page.evaluate("0") is not None and len(pictures) > seen + 5, "pictures, each of which would show all again")
    assert page.evaluate(MARKS_APART_PX) > 3.0 * before
    page.get_by_role("button", name="Show all").click()
    wait_for(lambda: page.evaluate(MARKS_APART_PX) < 1.5 * before, "the whole fleet")
    context.close()


def test_without_tiles_nothing_that_draws_them_is_loaded(watched):
    page = watched.page
    loaded = page.evaluate("performance.getEntriesByType('resource').map(e => e.name.split('/').pop())")
    assert "map.js" in loaded
    assert "tiles.js" not in loaded


def test_the_true_position_of_a_simulation_has_a_mark_of_its_own(watched, live):
    page, hover = watched.page, live.fleet[0]
    expect(page.locator("#truth-key")).to_be_hidden()
    lat_deg, lon_deg, _ = hover.lla
    mark = page.get_by_role("button", name="Vehicle 1: true position")
    # Both at one moment: the mark disappears 2 s after the last message.
    offset_px = """() => {
        const [truth, estimate] = ["Vehicle 1: true position", "Vehicle 1, good: estimated position"]
            .map((name) => document.querySelector(`#map [aria-label="${name}"]`)?.getBoundingClientRect());
        return truth && estimate ? [truth.x - estimate.x, truth.y - estimate.y] : null;
    }"""
    offsets = []

    def is_shown():
        hover.send(hover.pack(mavlink.MAVLink_simstate_message(*(0.0,) * 9, round(lat_deg * 1e7), round(lon_deg * 1e7))))
        offsets.append(page.evaluate(offset_px))
        return offsets[-1] is not None

    wait_for(is_shown, "the mark")
    assert offsets[-1] == pytest.approx([0.0, 0.0], abs=10.0)
    expect(mark).to_have_count(0)  # what is no longer told is no longer shown


def test_after_a_kill_and_a_restart_with_nobody_heard_no_vehicle_of_before_is_shown(live, tmp_path):
    udp_port, web_port = free_port(), free_port(socket.SOCK_STREAM)
    arguments = ["--udp", f"127.0.0.1:{udp_port}", "--web", f"127.0.0.1:{web_port}"]
    watched = Watched(live.chromium.new_page())
    page = watched.page
    with flying(udp_port, set()), service(tmp_path / "first", *arguments) as (process, url):
        page.goto(url)
        wait_until_good(page, 1, 2, 3, 4)
        card(page, 2).click()
        process.kill()
        expect(page.locator("#connection")).to_contain_text("NO CONNECTION")
    watched.complaints.clear()  # of the connection that was lost
    with service(tmp_path / "second", *arguments):
        expect(page.locator("#connection")).to_have_text("live")
        expect(page.locator("#summary")).to_contain_text("0 vehicles")
        expect(page.locator("#fleet li")).to_have_count(0)
        expect(page.locator("#map").get_by_role("button", name=re.compile("^Vehicle"))).to_have_count(0)
        expect(page.locator("#details")).to_be_hidden()
        gone = page.get_by_text("Gone: heard before the service restarted, and not since")
        expect(gone).to_have_text(re.compile(": 1, 2, 3, 4$"))
        with flying(udp_port, set()):
            wait_until_good(page, 1, 2, 3, 4)
            expect(gone).to_be_hidden()
            expect(page.get_by_role("region", name="Vehicle 2")).to_be_visible()  # it is still selected
    page.close()


def test_a_restarted_service_is_found_again_and_its_absence_is_said(live, tmp_path):
    udp_port, web_port = free_port(), free_port(socket.SOCK_STREAM)
    arguments = ["--udp", f"127.0.0.1:{udp_port}", "--web", f"127.0.0.1:{web_port}"]
    page = Watched(live.chromium.new_page()).page
    with flying(udp_port, {4}):
        with service(tmp_path / "first", *arguments) as (_, url):
            page.goto(url)
            expect(page.locator("#alarms li").filter(has_text="vehicle 4")).not_to_have_count(0)
            expect(page.locator("#commands")).to_be_hidden()
            expect(page.locator("#connection")).to_have_text("live")
            wait_until_good(page, 1)
        expect(page.locator("#connection")).to_contain_text("NO CONNECTION")
        expect(card(page, 1)).to_have_text(re.compile("Vehicle 1was good"))
        assert "grayscale(1)" in page.locator("#fleet").evaluate("e => getComputedStyle(e).filter")
        with service(tmp_path / "second", *arguments):
            expect(page.locator("#connection")).to_have_text("live")
            expect(card(page, 4)).to_contain_text("last heard 0.")
            expect(card(page, 4)).not_to_contain_text("was ")
            wait_for(lambda: page.locator("#fleet li").count() == 4, "four vehicles")
    page.close()


def test_a_healthy_vehicle_says_whether_it_would_be_located_without_gps(watched, live):
    page = watched.page
    expect(card(page, 1)).to_contain_text("without GPS not ready: no peer ranged")
    expect(page.locator("#map svg.vehicle .name").filter(has_text="✓○")).to_have_count(4)
    expect(page.locator("#legend")).to_contain_text("○ not ready")
    card(page, 1).click()
    facts = page.locator("#facts")
    expect(facts.locator("dt").filter(has_text="without GPS")).to_have_count(1)
    expect(facts).to_contain_text("not ready: no peer ranged; peers ranged: 0; half a minute after a loss: no position")
    live.failed.add(4)
    expect(card(page, 4)).to_contain_text("sending 3D fix")
    expect(card(page, 4)).not_to_contain_text("without GPS")
    assert watched.complaints == []
