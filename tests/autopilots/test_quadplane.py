"""Four real QuadPlanes in the closed loop: on wings, on rotors, and between the two, without GPS."""

from __future__ import annotations

import pytest
from ardupilot_flight import ArduPilotFlight
from flight_figures import LEAST_COVERED, at_least, at_most
from flown_place import vtol_mission
from four_ship import Case
from simulator_faults import lose_gps, restore
from simulators import QUADPLANE

AUTOPILOT = "arduplane"
pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]

FLOWN_AS = ArduPilotFlight("quadplane", QUADPLANE, auto_mode=10, half_sides_m=(250.0, 180.0), mission=vtol_mission)


def test_loss(flown):
    _, [f] = flown(Case("QuadPlane, loss", begin=lose_gps, end=restore, after_s=20.0))
    assert f.suspects == []
    at_most(ekf_rmse=(f.ekf_rmse_m, 1.5), ours=(f.our_rmse_m, 1.0), beyond_3_bounds=(f.beyond_3_bounds, 0))
    at_least(bound_covers=(f.bound_covers, LEAST_COVERED))
