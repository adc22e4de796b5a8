"""Four real PX4 quadrotors (SIH) in the closed loop, with the parameters of the guide: does each flight reach its goal?"""

from __future__ import annotations

import pytest
from flight_figures import at_most
from four_ship import Case
from px4_flight import GUIDE, Px4Flight, lose_gps, restore

AUTOPILOT = "px4"
pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]

FLOWN_AS = Px4Flight("sihsim_quadx", GUIDE)
DIRECT = "[senders]\ncompanions_elsewhere = true"
"""PX4 forwards no message that it does not know: the companion computer sends its ranges to the service itself."""


def test_loss(flown):
    ship, [f] = flown(Case("loss", begin=lose_gps, duration_s=120.0, end=restore, after_s=20.0, configuration=DIRECT))
    assert ship.service is not None
    on_the_ground = [(n, state) for at_s, n, state in ship.service.states if at_s < ship.begins_s]
    assert [x for x in on_the_ground if x[1] == "suspect"] == []
    assert {mode for at_s, mode in ship.pilots[4].modes if at_s > ship.begins_s} == set()  # it stays in its orbit
    at_most(ekf_rmse=(f.ekf_rmse_m, 1.2), ekf_largest=(f.ekf_largest_m, 2.5), beyond_3_bounds=(f.beyond_3_bounds, 0))
