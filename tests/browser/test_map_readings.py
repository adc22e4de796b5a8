"""What is read off the map and the residual plot, with vehicles in the air whose places are known."""

from __future__ import annotations

import math
import re

import pytest
from flight import card, wait_for
from playwright.sync_api import expect

pytestmark = pytest.mark.integration


def mark(page, sysid: int):
    return page.locator("#map").get_by_role("button", name=re.compile(f"^Vehicle {sysid}, .*estimated position"))


def test_the_position_under_the_cursor_and_the_distance_between_two_vehicles(watched, live):
    page = watched.page
    lat_deg, lon_deg, _ = live.fleet[1].lla
    mark(page, 2).hover()
    text = page.locator("#cursor-text")
    expect(text).to_have_text(re.compile(r"^-?\d+\.\d{6}, -?\d+\.\d{6} {3}-?\d+ m E, -?\d+ m N$"))
    read = [float(x) for x in re.findall(r"-?\d+\.\d+", text.text_content())]
    assert read == pytest.approx([lat_deg, lon_deg], abs=6e-5)  # some 5 px
    page.get_by_role("button", name="Distance").click()
    mark(page, 1).click()
    mark(page, 2).click()
    told = page.locator("#distance-text")
    expect(told).to_have_text(re.compile(r"^\d+ m, bearing \d{3}°$"))
    distance_m, bearing_deg = map(float, re.findall(r"\d+", told.text_content()))
    (e1, n1, _), (e2, n2, _) = live.fleet[0].enu_m, live.fleet[1].enu_m
    assert distance_m == pytest.approx(math.hypot(e2 - e1, n2 - n1), abs=3.0)
    assert bearing_deg == pytest.approx(math.degrees(math.atan2(e2 - e1, n2 - n1)), abs=1.5)
    expect(page.locator("#details")).to_be_hidden()  # a click measures and does not select
    page.keyboard.press("Escape")
    expect(told).to_have_text("")
    mark(page, 1).click()
    expect(page.get_by_role("region", name="Vehicle 1")).to_be_visible()
    assert watched.complaints == []


ENDS = """() => [...document.querySelectorAll("path.range")].map((p) => p.getAttribute("d").match(/-?[0-9.]+/g).map(Number))"""


def pairs_apart_px(lines: list[list[float]]) -> list[float]:
    """How far apart the lines of two directions of one pair are at their ends."""
    return [
        math.dist(one[:2], other[2:])
        for i, one in enumerate(lines)
        for other in lines[i + 1 :]
        if math.dist(one[:2], other[2:]) < 15.0 and math.dist(one[2:], other[:2]) < 15.0
    ]


def test_both_directions_of_a_range_stand_side_by_side_with_their_values_on_request(watched, live):
    page = watched.page
    live.failed.update((3, 4))
    expect(page.locator("path.range")).to_have_count(6)
    wait_for(lambda: len(pairs_apart_px(page.evaluate(ENDS))) == 1, "two lines between 3 and 4")
    assert 4.0 < pairs_apart_px(page.evaluate(ENDS))[0] < 9.0
    values = page.locator(".range-value")
    expect(values).to_have_count(0)
    button = page.get_by_role("button", name="Range values")
    button.click()
    expect(button).to_have_attribute("aria-pressed", "true")
    for pair in ("3→4", "4→3", "4→1"):
        expect(values.filter(has_text=pair)).to_have_text(re.compile(rf"^{pair} [+−]\d+\.\d m( refused)?$"))
    button.click()
    expect(values).to_have_count(0)
    assert watched.complaints == []


def test_the_residuals_of_the_selected_vehicles_ranges_are_a_plot(watched, live):
    page = watched.page
    live.failed.add(4)
    expect(page.locator("path.range")).to_have_count(3)
    card(page, 4).click()
    figure = page.get_by_role("figure", name="Plot of residuals of the ranges of vehicle 4, m over time")

    def is_read() -> bool:
        over = figure.locator(".u-over")
        over.scroll_into_view_if_needed()
        box = over.bounding_box()
        over.hover(position={"x": box["width"] - 2, "y": box["height"] / 2})
        said = figure.locator("figcaption").text_content()
        return bool(re.search(r"4→1: -?\d+\.?\d* {3}4→2: -?\d+\.?\d* {3}4→3: -?\d", said))

    wait_for(is_read, "the residuals of three ranges under the cursor")
    assert watched.complaints == []
