"""The operator's commands on the page in a real browser: none by accident, and the one in force is marked with who gave it."""

from __future__ import annotations

import pytest
from flight import TOKEN, Watched, card, flying, service, wait_for, wait_until_good
from playwright.sync_api import Page, expect
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from vehicles import Hover

from bench.free_ports import free_port

pytestmark = pytest.mark.integration


@pytest.fixture
def posted(watched) -> list[str]:
    """The paths of all commands that the page has sent."""
    paths: list[str] = []
    watched.page.on("request", lambda r: paths.append(r.url.partition("/api/")[2]) if r.method == "POST" else None)
    return paths


def override(page: Page, key: str):
    return page.locator(f"#commands button[value='{key}']")


def confirm(page: Page) -> None:
    page.locator("#send-command").click()  # waits until it can be pressed


def give(page: Page, key: str) -> None:
    override(page, key).click()
    confirm(page)
    expect(page.locator("#command-result")).to_contain_text("done")


def test_enter_in_the_token_field_does_nothing(watched, posted):
    page = watched.page
    card(page, 1).click()
    page.get_by_label("Operator's token").fill(TOKEN)
    for _ in range(3):
        page.keyboard.press("Enter")
    expect(page.get_by_role("alertdialog")).to_be_hidden()
    expect(page.locator(".armed")).to_have_count(0)
    assert posted == []
    assert watched.complaints == []


def test_a_double_click_and_a_key_that_is_held_arm_and_never_send(watched, posted):
    page = watched.page
    card(page, 1).click()
    page.get_by_label("Operator's token").fill(TOKEN)
    button, dialog = override(page, "gps failed"), page.get_by_role("alertdialog")
    plain = button.evaluate("e => getComputedStyle(e).backgroundColor")
    for _ in range(3):
        button.dblclick()
    expect(dialog).to_contain_text("Vehicle 1: Declare GPS failed?")
    expect(dialog).to_contain_text("It is located from its ranges and sent that position; its reported position is not trusted.")
    expect(button).to_contain_text("not sent yet")
    assert button.evaluate("e => getComputedStyle(e).backgroundColor") != plain
    # Where it is confirmed is not where it was armed.
    pressed, sends = button.bounding_box(), page.locator("#send-command").bounding_box()
    assert sends["y"] + sends["height"] < pressed["y"] or sends["y"] > pressed["y"] + pressed["height"]
    page.get_by_role("button", name="Cancel").click()
    expect(dialog).to_be_hidden()
    expect(button).to_have_text("Declare GPS failed")
    button.focus()
    for _ in range(8):
        page.keyboard.press("Enter")
    page.keyboard.press("Escape")
    expect(dialog).to_be_hidden()
    assert posted == []


def test_confirming_is_not_possible_before_a_second_has_passed(watched, posted):
    page = watched.page
    card(page, 1).click()
    page.get_by_label("Operator's token").fill(TOKEN)
    page.clock.install()
    page.clock.pause_at(page.evaluate("Date.now()") + 1000)
    override(page, "aiding off").click()
    sends = page.locator("#send-command")
    page.clock.run_for(950)
    expect(sends).to_be_disabled()
    page.clock.run_for(100)
    expect(sends).to_be_enabled()
    page.clock.run_for(30_000)
    expect(page.get_by_role("alertdialog")).to_be_hidden()  # given up: whoever armed it has gone
    assert posted == []


def test_without_a_token_nothing_is_armed_and_a_wrong_one_is_refused_and_not_kept(watched, posted):
    page = watched.page
    card(page, 1).click()
    override(page, "gps failed").click()
    expect(page.locator("#command-result")).to_contain_text("Enter the operator's token first")
    expect(page.get_by_role("alertdialog")).to_be_hidden()
    page.get_by_label("Operator's token").fill("not the token at all")
    override(page, "gps failed").click()
    confirm(page)
    expect(page.locator("#command-result")).to_contain_text("refused")
    page.reload()
    expect(page.get_by_label("Operator's token")).to_have_value("")
    assert posted == ["vehicles/1/gps"]


def test_the_override_in_force_is_marked_with_who_gave_it_and_selection_and_token_survive_a_reload(watched):
    page = watched.page
    card(page, 1).click()
    expect(page.locator("#gps-in-force")).to_have_text("decided by evidence")
    page.get_by_label("Operator's token").fill(TOKEN)
    give(page, "gps failed")
    expect(card(page, 1)).to_contain_text("declared failed by the operator")
    expect(page.locator("#gps-in-force")).to_have_text("declared failed (by page)")
    expect(override(page, "gps failed")).to_have_attribute("aria-pressed", "true")
    expect(override(page, "gps auto")).to_have_attribute("aria-pressed", "false")
    page.reload()
    expect(page.get_by_role("region", name="Vehicle 1")).to_be_visible()
    expect(card(page, 1)).to_have_attribute("aria-pressed", "true")
    give(page, "gps auto")
    expect(page.locator("#gps-in-force")).to_have_text("decided by evidence")
    wait_until_good(page, 1)
    assert watched.complaints == []


def test_an_override_of_a_flag_or_the_configuration_is_named_so(live, tmp_path):
    (tmp_path / "coloc.toml").write_text("[fleet]\nhealthy = [2]\n")
    port = free_port()
    arguments = ["--config", str(tmp_path / "coloc.toml"), "--failed", "4", "--udp", f"127.0.0.1:{port}", "--web", "127.0.0.1:0"]
    with service(tmp_path / "log", *arguments) as (_, url), flying(port, set()):
        page = Watched(live.chromium.new_page()).page
        page.goto(url)
        for sysid, told in ((4, "GPS failed by flag"), (2, "GPS healthy by configuration")):
            card(page, sysid).click()
            expect(page.get_by_role("region", name=f"Vehicle {sysid}")).to_contain_text(told)
        page.close()


def test_a_vehicles_aiding_is_overridden_on_the_page(watched):
    page = watched.page
    card(page, 2).click()
    page.get_by_label("Operator's token").fill(TOKEN)
    details = page.get_by_role("region", name="Vehicle 2")
    for key, told in (("aiding off", "aiding off by page"), ("aiding auto", "aiding auto")):
        give(page, key)
        expect(details).to_contain_text(told)


def answer_for_gps_primary(hover: Hover, value: float) -> None:
    """As an autopilot does whose second receiver takes our fix; `value` is what its GPS_PRIMARY is at first."""
    real32, taken = mavlink.MAV_PARAM_TYPE_REAL32, 0
    while True:
        new = hover.received[taken:]
        taken += len(new)
        for _, message in new:
            if message.get_type() in ("PARAM_REQUEST_READ", "PARAM_SET"):
                value = getattr(message, "param_value", value)
                hover.send(hover.pack(mavlink.MAVLink_param_value_message(b"GPS_PRIMARY", value, real32, 1, 0)))
        if fixes := hover.of("GPS_INPUT"):
            place = (fixes[-1].lat, fixes[-1].lon, round(fixes[-1].alt * 1e3))
            hover.send(hover.pack(mavlink.MAVLink_gps2_raw_message(0, 3, *place, 80, 100, 0, 0, 7, 0, 0)))
        yield value


def test_gps_primary_is_set_and_restored_from_the_page_with_what_that_does_in_words(watched, live):
    page, hover = watched.page, live.fleet[3]
    autopilot = answer_for_gps_primary(hover, 0.0)
    live.failed.add(4)
    expect(card(page, 4)).to_contain_text("sending 3D fix")
    card(page, 4).click()
    page.get_by_label("Operator's token").fill(TOKEN)
    details = page.get_by_role("region", name="Vehicle 4")
    for key, effect, value in (
        ("gps_primary ours", "whatever its own receiver says", 1.0),
        ("gps_primary own", "even if that is faulty", 0.0),
    ):
        override(page, key).click()
        expect(page.get_by_role("alertdialog")).to_contain_text(effect)
        confirm(page)
        expect(page.locator("#command-result")).to_contain_text("done")
        told = "GPS_PRIMARY set to 1, our receiver; it was 0" if value else "GPS_PRIMARY restored to 0"
        expected = (value, True)
        wait_for(lambda told=told, e=expected: (next(autopilot), told in page.locator("#log").inner_text()) == e, told)
    expect(details).to_contain_text("GPS_PRIMARY own")
    assert watched.complaints == []
