"""Four real PX4 airplanes (SIH) in the closed loop, with the parameters of the guide: does each flight reach its goal?"""

from __future__ import annotations

import pytest
from flight_figures import at_most
from four_ship import Case
from px4_flight import DIRECT, GUIDE, Px4AirplaneFlight, lose_gps, restore, stays_in_its_orbit

AUTOPILOT = "px4"
pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]

AIRPLANE = {
    "SIH_F_T_MAX": 6.0,  # N: the model's file names the parameter of older versions, and with 2 N it never leaves the ground
    "FW_AIRSPD_TRIM": 13.0,  # as fast as it flies level
    "RWTO_TKOFF": 0,  # off the runway it dives to the ground at the end of the climb
    "MIS_TKO_LAND_REQ": 0,  # a mission without a landing
}
FLOWN_AS = Px4AirplaneFlight({**GUIDE, **AIRPLANE})


def test_loss(flown):
    case = Case("airplane, loss", begin=lose_gps, duration_s=120.0, end=restore, after_s=20.0, configuration=DIRECT)
    ship, [f] = flown(case)
    assert f.suspects == []
    assert stays_in_its_orbit(ship)
    at_most(
        ekf_rmse=(f.ekf_rmse_m, 2.0),
        ekf_over_stated=(f.ekf_stated_ratio, 1.3),
        beyond_3_bounds=(f.beyond_3_bounds, 0),
    )
