"""The terminal's table of all fleets: the most serious first, what is past as past, and all of it within the height."""

import io
from dataclasses import replace

import pytest
from fleet_views import HEALTHY, LOST, fleet_view
from rich.console import Console

from gcs_coloc.sinks.fleet_overview import fleet_overview
from gcs_coloc.sinks.terminal import FleetsTable, fleet_line
from gcs_coloc.sinks.watched_fleets import WatchedFleets


def fleets_at(now_s, number=1):
    fleets = WatchedFleets()
    for n in range(number):
        for second in (1.0, 2.0):
            view = fleet_view(second, HEALTHY, replace(LOST, sysid=5, name="Heron"))
            fleets.receive(f"f{n}", f"f{n}", fleet_overview(view, (), host="alpha", every_s=1.0), second, 0.0)
    return fleets.shown(now_s)


def drawn(table, height=24, width=100):
    out = io.StringIO()
    Console(file=out, width=width, height=height).print(table)
    return out.getvalue()


@pytest.mark.parametrize("width", [80, 120])
def test_a_live_fleet_has_a_line_and_each_vehicle_in_need_another_with_their_ages_in_80_columns_too(width):
    text = drawn(FleetsTable(fleets_at(2.5), None), width=width)
    assert max(map(len, text.splitlines())) <= width
    assert text.splitlines()[1].rstrip().endswith("0.5 s")
    assert text.splitlines()[2].rstrip().endswith("0.1 s")
    assert "1 alarm, 1 good" in text
    assert "5 Heron" in text
    assert "GPS failed: no 3D fix" in text
    assert "fix type 3" not in text


def test_a_silent_fleet_is_told_of_in_the_past():
    text = drawn(FleetsTable(fleets_at(62.0), None))
    assert "not heard for 60 s; was: 1 alarm, 1 good" in text
    assert "1 min" in text
    assert "Heron" not in text


@pytest.mark.parametrize("height", [10, 24, 50])
def test_it_fits_the_terminal_and_counts_what_has_no_room(height):
    lines = drawn(FleetsTable(fleets_at(2.5, 40), "no connection to the MQTT broker x:1883"), height).splitlines()
    assert len(lines) < height
    assert lines[0] == "no connection to the MQTT broker x:1883"
    assert lines[-1].endswith("more lines; the page shows all")


def test_without_a_fleet_it_says_so():
    assert "no fleet heard yet" in drawn(FleetsTable((), None))


def test_a_line_for_the_log():
    (fleet,) = fleets_at(2.5)
    assert fleet_line(fleet) == "fleet f0 on alpha: 1 alarm, 1 good"
