"""The demo: what it can show of a scenario, and what it cannot show is told before the flight."""

from __future__ import annotations

import sys
from dataclasses import replace
from math import isnan

import pytest

from gcs_coloc.core.errors import UsageError
from gcs_coloc.study import demo
from gcs_coloc.study.demo import figures, run_demo
from sitl_fakes.faults import GpsLost
from sitl_fakes.scenario import SCENARIOS, load_scenario, shipped_scenarios


class _FliesError(Exception):
    pass


@pytest.fixture(autouse=True)
def _nothing_flies(monkeypatch):
    def fly(*_arguments):
        raise _FliesError

    monkeypatch.setattr(demo, "_fly_live", fly)


def test_that_there_is_no_matplotlib_is_told_before_the_flight(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(UsageError, match=r"needs matplotlib: pip install \"gcs-coloc\[plots\]\""):
        run_demo(tmp_path, "paper", "fleet", 1)


@pytest.mark.parametrize("name", shipped_scenarios())
def test_every_scenario_that_comes_with_the_aircraft_can_be_shown(name, tmp_path, capsys):
    with pytest.raises(_FliesError):
        run_demo(tmp_path, name, "fleet", 1)
    told = capsys.readouterr().out
    assert "UAV4 loses its GPS at 20 s" in told.replace("\n", " ")
    assert ("EK3_GPS_CHECK=19" in told) is (name == "paper")


@pytest.mark.parametrize("change", ["vehicle = 1", "at_s = 70.0", 'kind = "gps_frozen"'])
def test_the_vehicle_is_the_one_that_loses_its_gps_early_enough(change, tmp_path, capsys):
    file = tmp_path / "mine.toml"
    before, fault = (SCENARIOS / "uwb.toml").read_text().split("[[fault]]")
    key = change.split(" = ")[0]
    file.write_text(before + "[[fault]]\n" + "\n".join(change if line.startswith(key) else line for line in fault.split("\n")))
    if key == "vehicle":
        with pytest.raises(_FliesError):
            run_demo(tmp_path, str(file), "fleet", 1)
        assert "UAV1 loses its GPS" in capsys.readouterr().out.replace("\n", " ")
    else:
        with pytest.raises(UsageError, match=r"mine\.toml: no vehicle loses its GPS in the first 60 s"):
            run_demo(tmp_path, str(file), "fleet", 1)


def test_an_autopilot_without_a_position_does_not_believe_itself_at_the_origin():
    loss = GpsLost(vehicle=4, at_s=3.0)
    flight = demo._fly_one(load_scenario("uwb").model_copy(update={"fault": [loss], "duration_s": 4.0}), "fleet", 7, True)
    lost = [s for s in flight.samples[4] if s.at_s >= 3.0]
    nowhere = replace(lost[0], truth=replace(lost[0].truth, east_m=9000.0, estimate_east_m=None, estimate_north_m=None))
    flight.samples[4] = [nowhere, *lost]
    assert figures(flight, loss, aided=True).navigation_most_m < 20.0
    flight.samples[4] = [nowhere]
    assert isnan(figures(flight, loss, aided=True).navigation_rms_m)


def test_the_service_knows_where_the_stations_stand():
    loss = GpsLost(vehicle=4, at_s=10.0)
    scenario = load_scenario("stations").model_copy(update={"fault": [loss], "duration_s": 25.0})
    shown = figures(demo._fly_one(scenario, "fleet", 7, True), loss, aided=True)
    assert shown.located > 0.9
    assert shown.rmse_m < 4.0
