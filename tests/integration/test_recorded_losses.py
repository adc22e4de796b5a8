"""Real ArduPlanes in turbulence that lose GPS: accuracy and coverage of the bound, one lost and two that range each other."""

from __future__ import annotations

import pytest
from recordings import recording

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder.flight_report import FlightReport
from gcs_coloc.recorder.replay import Replay
from gcs_coloc.recorder.side_tables import read_truth
from gcs_coloc.recorder.tlog import TlogReader

pytestmark = pytest.mark.integration

HEALTHY_AGAIN_S = 15.0
"""So long after the return of GPS the replay goes on: the last position has been scored by then."""


@pytest.mark.parametrize(
    ("flight", "back_unix_s", "lost", "rmse_m", "largest_m", "covered"),
    [
        # With a bank angle taken for exact, as until 0.1: 1.30 m, 11.6 m at most; of two lost the bound covered 74 to 75 %.
        ("loss-gust", 1795313204.93, (4,), 1.0, 6.0, 0.93),
        ("two-lost", 1795314018.08, (3, 4), 1.55, 10.0, 0.88),
    ],
)
def test_gusts_are_followed_and_are_in_the_bound(flight, back_unix_s, lost, rmse_m, largest_m, covered):
    directory = recording(f"arduplane-flights/{flight}")
    engine = Engine(load_estimator("fleet", {}))
    truth = [point for point in read_truth(directory / "truth.csv") if point.unix_s < back_unix_s + HEALTHY_AGAIN_S]
    report = FlightReport(engine, truth)
    through = Replay(engine, TlogReader(directory / "flight.tlog"), (), report.add_outputs)
    for at_s in report.observation_times():
        while through.next_s is not None and through.next_s <= at_s:
            through.step()
        through.advance(at_s)
        report.observe(at_s)
    for vehicle in lost:
        assert engine.gps_state(vehicle) is GpsState.HEALTHY
        score = report.score(vehicle)
        assert score.horizontal.rmse_m <= rmse_m
        assert score.horizontal.max_m <= largest_m
        assert score.covered_95 >= covered
        assert score.beyond_three_bounds <= 0.002
