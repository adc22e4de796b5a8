"""Four real ArduRovers in the closed loop: slow, on the ground, without airspeed."""

from __future__ import annotations

import pytest
from ardupilot_flight import ArduPilotFlight
from flight_figures import LEAST_COVERED, at_least, at_most
from flown_place import ground_mission
from four_ship import Case
from simulator_faults import lose_gps, restore
from simulators import ROVER

AUTOPILOT = "ardurover"
pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]

FLOWN_AS = ArduPilotFlight("rover", ROVER, auto_mode=10, half_sides_m=(60.0, 40.0), mission=ground_mission, climbed_m=None)


def test_loss(flown):
    _, [f] = flown(Case("loss", begin=lose_gps, end=restore, after_s=20.0))
    assert f.suspects == []
    at_most(ekf_rmse=(f.ekf_rmse_m, 1.0), ours=(f.our_rmse_m, 0.9), beyond_3_bounds=(f.beyond_3_bounds, 0))
    at_least(bound_covers=(f.bound_covers, LEAST_COVERED))
