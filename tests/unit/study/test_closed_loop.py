"""The closed loop in process: every way to report a range, several failures, and the demo's figures and picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gcs_coloc.core.engine import Engine
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.study.closed_loop import Flight, fly
from gcs_coloc.study.demo import figures
from gcs_coloc.study.demo_picture import draw
from sitl_fakes.scenario import Scenario, load_scenario

CONFIGS = Path(__file__).resolve().parents[3] / "configs"
LOST_S = 20.0


def uwb(**ranging: object) -> Scenario:
    scenario = load_scenario(CONFIGS / "scenario-uwb.toml")
    return scenario.model_copy(update={"ranging": scenario.ranging.model_copy(update=ranging)})


def flown(scenario: Scenario, estimator: str = "fleet", duration_s: float = 40.0, aided: bool = True) -> Flight:
    return fly(scenario, 7, Engine(load_estimator(estimator, {})), duration_s=duration_s, aided=aided)


def errors_m(flight: Flight, sysid: int) -> np.ndarray:
    samples = [s for s in flight.samples[sysid] if s.at_s >= LOST_S + 2.0]
    assert all(s.error_enu_m is not None for s in samples)
    return np.array([np.hypot(*s.error_enu_m[:2]) for s in samples])


@pytest.mark.parametrize("message", ["peer_range", "ranging_beacon", "named_value"])
@pytest.mark.parametrize("time_base", ["boot", "unix"])
def test_every_way_to_report_a_range_locates_the_vehicle(message, time_base):
    flight = flown(uwb(message=message, time_base=time_base))
    # Peers' GPS of 1.5 m with correlated errors, ranges of 0.5 m with 0.3 m bias: 3 sigma of a position as good as GPS.
    assert np.sqrt(np.mean(errors_m(flight, 4) ** 2)) < 4.5
    sources = [s.truth.source for s in flight.samples[4] if s.at_s >= LOST_S + 3.0]
    assert sources.count("gps2 injected") > 0.95 * len(sources)


def test_the_papers_stack_locates_it_too_only_coarser():
    assert np.sqrt(np.mean(errors_m(flown(uwb(), estimator="qu_zhang"), 4) ** 2)) < 10.0


def test_two_failed_vehicles_are_located_together():
    flight = flown(load_scenario(CONFIGS / "scenario-two-failed.toml"), duration_s=60.0)
    lost = [s for s, samples in flight.samples.items() if samples[-1].gps_state == "failed"]
    assert len(lost) == 2
    for sysid in lost:
        late = [s for s in flight.samples[sysid] if s.at_s >= 50.0]
        assert np.sqrt(np.mean([np.sum(s.error_enu_m[:2] ** 2) for s in late])) < 4.5
        assert {s.truth.source for s in late} == {"gps2 injected"}


def test_healthy_vehicles_are_sent_nothing():
    assert set(flown(uwb(), duration_s=25.0).gps_inputs) == {4}


def test_the_demo_counts_and_draws(tmp_path):
    scenario = uwb()
    on, off = flown(scenario, duration_s=60.0), flown(scenario, duration_s=60.0, aided=False)
    with_service, without = figures(on, LOST_S, aided=True), figures(off, LOST_S, aided=False)
    assert with_service.located == 1.0
    assert with_service.navigation_rms_m < without.navigation_rms_m
    assert without.rmse_m is None
    picture = tmp_path / "demo.png"
    draw(scenario, 4, LOST_S, on, off, picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
