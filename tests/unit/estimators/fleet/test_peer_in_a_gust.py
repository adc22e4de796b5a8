"""A peer whose air data no longer explain its way: its GPS is believed at once, whatever its neighbours' ranges say."""

import math

import numpy as np
import pytest

from gcs_coloc.core.measurements import (
    AttitudeMeasurement,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet.fleet_model import FleetModel
from gcs_coloc.estimators.fleet.settings import FleetSettings

DENIED, PEER, AIRSPEED_MPS, JUMPS_S, STEP_S = 9, 1, 22.0, 20.2, 0.1
HERE_M = np.array([300.0, 400.0])


@pytest.mark.parametrize("seed", range(3))
def test_reports_once_a_second_are_used_between_ranges_when_the_wind_jumps(seed):
    """Its reports were tried with a manoeuvre since the last range, not since the last report, and refused for ten seconds."""
    rng, model, place, outcomes = np.random.default_rng(seed), FleetModel(FleetSettings()), np.zeros(2), []
    model.apply(VehicleClassReport(PEER, 0.0, 0.0, VehicleClass.PLANE))
    for k in range(300):
        t = STEP_S * k
        velocity_mps = np.array([AIRSPEED_MPS + (26.0 if t >= JUMPS_S else 0.0), 0.0])
        if k == 50:
            model.set_denied(frozenset({DENIED}), t)
        if k < 50 and k % 10 == 0:
            model.apply(PositionMeasurement(DENIED, t, t, (*HERE_M.tolist(), 100.0), 1.0, 1.5, (0.0, 0.0, 0.0), 0.3))
        if k % 10 == 5:
            at_m, way_mps = (*place.tolist(), 100.0), (*velocity_mps.tolist(), 0.0)
            outcomes.append(model.apply(PositionMeasurement(PEER, t, t, at_m, 1.0, 1.5, way_mps, 0.3)))
        if k % 10 == 6:
            model.apply(AttitudeMeasurement(PEER, t, t, 0.0, 0.0, math.pi / 2.0, AIRSPEED_MPS))
        if k > 50 and k % 2 == 1:
            range_m = math.hypot(*(place - HERE_M)) + rng.normal()
            model.apply(RangeMeasurement(DENIED, PEER, t, t, range_m, 1.0))
        place = place + STEP_S * velocity_mps
    after = outcomes[round(JUMPS_S) :]
    assert all(result.used for result in after)
    # The first contradicts the wind that was learned; the later ones the one before them no more.
    assert max(result.nis for result in after[3:]) < 50.0
