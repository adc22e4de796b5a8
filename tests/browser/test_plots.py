"""The plots: values under the cursor, lines that are switched off and on, a scale that a spike does not set."""

from __future__ import annotations

import re

import pytest
from flight import wait_for
from playwright.sync_api import expect

pytestmark = pytest.mark.integration

_SPIKE_AT_THE_START = """async () => {
  const { Plots } = await import("/static/plots.js");
  const plots = new Plots();
  const at_s = [...Array(100).keys()], none = at_s.map(() => null);
  const one = { hdop: none, nis_median: none, ranges_in_use: none, band_low: none, band_high: none };
  plots.restore([{ ...one, sysid: 1, at_s, sigma_h_m: at_s.map((t) => (t < 2 ? 800 : 2)) }]);
  await new Promise(requestAnimationFrame);
  return plots.plots[0].scales.y.max;
}"""
_RESIDUALS_OF_FIVE_SECONDS = """async (size) => {
  const { Plots } = await import("/static/plots.js");
  const plots = new Plots();
  plots.setOffset(1795251578);
  const ranges = (innovation_m) => [{ from_sysid: 4, to_sysid: 1, innovation_m }];
  for (let at_s = 0; at_s < 5; at_s += 1) plots.residuals.add({ at_s, ranges: ranges(at_s % 2 ? size : -size) });
  await new Promise(requestAnimationFrame);
  return plots.residuals.plot.axes.map((axis) => axis._values);
}"""


def test_the_values_under_the_cursor_are_told_for_every_plot(watched):
    page = watched.page
    figure = page.get_by_role("figure", name="Plot of 1-sigma, m over time")
    wait_for(lambda: _read(figure), "values under the cursor")
    readings = page.locator("#plots figcaption")
    expect(readings).to_have_count(5)
    expect(readings.nth(3)).to_have_text(re.compile(r"^\d\d:\d\d:\d\d {3}1: \d"))  # one cursor for all of them
    page.mouse.move(5, 5)
    expect(readings.first).to_have_text("")
    assert watched.complaints == []


def _read(figure) -> bool:
    """Whether there are values where the newest samples are."""
    over = figure.locator(".u-over")
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    over.hover(position={"x": box["width"] - 2, "y": box["height"] / 2})
    return bool(re.search(r"\d\d:\d\d:\d\d {3}1: \d\.?\d* {3}2: ", figure.locator("figcaption").text_content()))


def test_a_line_is_switched_off_and_on_in_the_legend(watched):
    page = watched.page
    button = page.locator("#series").get_by_role("button", name="vehicle 2")
    figure = page.get_by_role("figure", name="Plot of 1-sigma, m over time")
    expect(button).to_have_attribute("aria-pressed", "true")
    button.click()
    expect(button).to_have_attribute("aria-pressed", "false")
    wait_for(lambda: _read_without(figure, "2"), "values without those of vehicle 2")
    page.locator("#fleet").get_by_role("button", name="Vehicle 1").click()  # the plots are built anew
    expect(button).to_have_attribute("aria-pressed", "false")
    button.click()
    wait_for(lambda: _read(figure), "values of vehicle 2 again")
    assert watched.complaints == []


def _read_without(figure, sysid: str) -> bool:
    over = figure.locator(".u-over")
    box = over.bounding_box()
    over.hover(position={"x": box["width"] - 3, "y": box["height"] / 2})
    text = figure.locator("figcaption").text_content()
    return "1: " in text and f"   {sysid}: " not in text


def test_a_spike_at_the_start_does_not_set_the_scale(watched):
    assert 2.0 < watched.page.evaluate(_SPIKE_AT_THE_START) < 10.0


@pytest.mark.parametrize("size_m", [0.7, 1.2, 1.7, 2.3, 4.4, 9.5])
def test_a_plot_of_a_few_seconds_tells_its_scale_and_no_time_twice(watched, size_m):
    times, values = watched.page.evaluate(_RESIDUALS_OF_FIVE_SECONDS, size_m)
    assert len(values) >= 3, values
    assert len(set(times)) == len(times) >= 2, times
