"""The page on a desk's screen, a tablet and a phone, with a vehicle selected: nothing is pushed away, cut off or covered."""

from __future__ import annotations

import itertools
import re

import pytest
from flight import card, wait_for
from playwright.sync_api import expect

pytestmark = pytest.mark.integration


def overlap(a, b):
    return all(a[at] < b[at] + b[size] and b[at] < a[at] + a[size] for at, size in (("x", "width"), ("y", "height")))


def test_the_details_leave_alarms_and_fleet_in_a_window_of_900_px(watched, live):
    page = watched.page
    page.set_viewport_size({"width": 1440, "height": 900})
    live.failed.add(4)
    expect(page.locator("#alarms li")).not_to_have_count(0)
    card(page, 4).click()
    for part in ("#alarms-title", "#fleet-title", "#details-title"):
        expect(page.locator(part)).to_be_in_viewport(ratio=1.0)
    first = page.locator("#facts dt", has_text="protection level").locator("+ dd")
    expect(first).to_be_in_viewport(ratio=1.0)
    expect(first).to_have_text(re.compile(r"^\d+\.\d m, height \d+\.\d m$"))
    numbers = re.compile(r"protection level \d+\.\d m, 1-sigma \d+\.\d m, HDOP \d\.\d, 3 ranges in use")
    expect(card(page, 4)).to_contain_text(numbers)
    expect(page.locator("#alarms li[data-kind='gps_lost']")).to_contain_text(re.compile(r"\(95 %\), protection level \d+ m;"))
    assert page.evaluate("window.scrollY") == 0
    assert watched.complaints == []


def test_without_a_vehicle_selected_the_fleet_has_the_room_of_the_details(watched):
    page = watched.page
    page.set_viewport_size({"width": 1440, "height": 900})
    expect(page.locator("#details")).to_be_hidden()
    for vehicle in (1, 2, 3, 4):
        expect(card(page, vehicle)).to_be_in_viewport(ratio=1.0)


@pytest.mark.parametrize("size", [(820, 1180), (390, 844)])
def test_in_one_column_the_details_are_whole_and_cover_nothing(watched, size):
    page = watched.page
    page.set_viewport_size({"width": size[0], "height": size[1]})
    card(page, 4).click()
    expect(page.locator("#facts dd")).not_to_have_count(0)
    parts = ["#alarm-panel", "#fleet-panel", "#details", "#plots", "#links", "#log-panel"]
    boxes = [page.locator(part).bounding_box() for part in parts]
    for above, below in itertools.pairwise(boxes):
        assert above["y"] + above["height"] <= below["y"]
    assert page.locator("#details").evaluate("e => e.scrollHeight <= e.clientHeight + 1")
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


@pytest.mark.parametrize("size", [(390, 844), (320, 568)])
def test_no_vehicle_is_hidden_beneath_the_buttons_of_the_map(watched, size):
    page = watched.page
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.get_by_role("button", name="Show all").click()
    marks = page.locator("#map").get_by_role("button", name=re.compile(r"^Vehicle \d"))
    expect(marks).to_have_count(4)

    def are_free():
        # The map takes its new size, and fits it, a picture or two after the window has it.
        covers = [page.locator(part).bounding_box() for part in ("#map-tools", ".leaflet-control-zoom")]
        return not any(overlap(mark.bounding_box(), cover) for mark in marks.all() for cover in covers)

    wait_for(are_free, "a map whose buttons cover no vehicle")


COVERED = """() => {
  const zoom = document.querySelector(".leaflet-control-zoom").getBoundingClientRect();
  window.covered = false;
  const look = () => {
    for (const mark of document.querySelectorAll("#map [role=button][aria-label^='Vehicle']")) {
      const { left, right, top, bottom } = mark.getBoundingClientRect();
      if (left < zoom.right && zoom.left < right && top < zoom.bottom && zoom.top < bottom) window.covered = true;
    }
    requestAnimationFrame(look);
  };
  look();
}"""
"""Looks at every picture whether a mark is beneath the zoom buttons."""


def test_a_vehicle_that_flies_beneath_the_zoom_buttons_has_the_map_fitted_anew_at_once(watched, live):
    page, hover = watched.page, live.fleet[1]
    page.set_viewport_size({"width": 390, "height": 844})
    page.get_by_role("button", name="Show all").click()

    def centre(locator):
        box = locator.bounding_box()
        return box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0

    first, second = (page.locator("#map").get_by_role("button", name=f"Vehicle {sysid}, ") for sysid in (1, 2))
    wait_for(lambda: 100.0 < centre(second)[0] - centre(first)[0] < 300.0, "a map that has its new size")
    (x1, y1), (x2, _), (x, y) = centre(first), centre(second), centre(page.locator(".leaflet-control-zoom"))
    before_m, px_per_m = hover.enu_m, (x2 - x1) / hover.enu_m[0]
    page.evaluate(COVERED)
    hover.enu_m = ((x - x1) / px_per_m, (y1 - y) / px_per_m, before_m[2])
    try:
        wait_for(lambda: centre(first) != (x1, y1), "another view of the map")
        assert not page.evaluate("window.covered")
    finally:
        hover.enu_m = before_m
