"""Four real PX4 quadrotors (SIH) in the closed loop, with the parameters of the guide: does each flight reach its goal?"""

from __future__ import annotations

import pytest
from flight_figures import at_most
from four_ship import Case
from px4_flight import DIRECT, GUIDE, Px4Flight, lose_gps, restore, stays_in_its_orbit, stick_gps

AUTOPILOT = "px4"
pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]

FLOWN_AS = Px4Flight(GUIDE)
VISION = {"EKF2_AGP0_CTRL": 0, "EKF2_AGP0_ID": 0, "EKF2_EV_CTRL": 1, "EKF2_EV_NOISE_MD": 0}
"""A PX4 that takes no auxiliary position, as released ones do not: it is aided by VISION_POSITION_ESTIMATE."""

RANGES = {"EKF2_AGP0_CTRL": 0, "EKF2_AGP0_ID": 0, "EKF2_RNGBC_CTRL": 1, "EKF2_RNGBC_NOISE": 1.0}
HANDED_OVER = f'{DIRECT}\n[aiding]\nmethod = "ranging_beacon"'
"""A PX4 that fuses the ranges itself: it is handed them with the peers' positions."""


def test_loss(flown):
    ship, [f] = flown(Case("loss", begin=lose_gps, duration_s=120.0, end=restore, after_s=20.0, configuration=DIRECT))
    assert ship.service is not None
    before = [(n, state) for at_s, n, state in ship.service.states if ship.ready_s <= at_s < ship.begins_s]
    assert [(n, state) for n, state in before if state != "healthy"] == []
    assert stays_in_its_orbit(ship)
    at_most(
        ekf_median=(f.ekf_median_m, 1.0),
        ekf_largest=(f.ekf_largest_m, 2.5),
        ekf_over_stated=(f.ekf_stated_ratio, 1.3),
        beyond_3_bounds=(f.beyond_3_bounds, 0),
    )


def test_a_receiver_that_is_stuck_is_switched_off_and_on_again(flown):
    """MAV_CMD_ESTIMATOR_SENSOR_ENABLE; without it EKF2 would go on with a fix that stays where it is."""
    configuration = f'{DIRECT}\n[aiding]\nswitch_primary = "auto"'
    ship, [f] = flown(Case("stuck", begin=stick_gps, duration_s=80.0, end=restore, after_s=40.0, configuration=configuration))
    assert ship.service is not None
    assert f.suspects == []
    assert stays_in_its_orbit(ship)
    said = ship.service.log.read_text(encoding="utf-8")
    for words in ("its own GPS is switched off", "its own GPS is switched on again"):
        assert said.count(words) == 1
    at_most(ekf_largest=(f.ekf_largest_m, 2.5), beyond_3_bounds=(f.beyond_3_bounds, 0))


def test_loss_with_ranges_of_15_m(flown):
    case = Case("loss, ranges of 15 m", begin=lose_gps, duration_s=120.0, range_sigma_m=15.0, configuration=DIRECT)
    ship, [f] = flown(case)
    assert stays_in_its_orbit(ship)
    at_most(ekf_over_stated=(f.ekf_stated_ratio, 1.3), beyond_3_bounds=(f.beyond_3_bounds, 0))


def test_loss_by_vision_position(flown):
    case = Case("loss, vision position", begin=lose_gps, duration_s=120.0, configuration=DIRECT, parameters=VISION)
    ship, [f] = flown(case)
    assert stays_in_its_orbit(ship)
    at_most(ekf_median=(f.ekf_median_m, 1.5))


def test_loss_by_ranging_beacon(flown):
    case = Case("loss, its own ranges", begin=lose_gps, duration_s=120.0, configuration=HANDED_OVER, parameters=RANGES)
    ship, [f] = flown(case)
    assert stays_in_its_orbit(ship)
    at_most(ekf_rmse=(f.ekf_rmse_m, 1.0), ekf_largest=(f.ekf_largest_m, 2.5))
