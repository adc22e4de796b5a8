"""Four real ArduCopters in the closed loop, with the parameters of the guide: does each flight reach its goal?"""

from __future__ import annotations

import pytest
from ardupilot_flight import ArduPilotFlight
from flight_figures import at_most
from four_ship import Case
from simulator_faults import lose_gps, restore
from simulators import COPTER

AUTOPILOT = "arducopter"
pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]

FLOWN_AS = ArduPilotFlight("+", COPTER, auto_mode=3, half_sides_m=(60.0, 45.0))


def test_loss(flown):
    ship, [f] = flown(Case("loss", begin=lose_gps, duration_s=90.0, end=restore, after_s=20.0))
    assert f.suspects == []
    assert {mode for at_s, mode in ship.pilots[4].modes if at_s > ship.begins_s} == set()  # it stays in AUTO
    at_most(
        ekf_rmse=(f.ekf_rmse_m, 1.0),
        ekf_largest=(f.ekf_largest_m, 3.0),
        ours=(f.our_rmse_m, 0.9),
        beyond_3_bounds=(f.beyond_3_bounds, 0),
    )
