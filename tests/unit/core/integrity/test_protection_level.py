"""The protection level covers each cause, grows with what is not known, and says which receivers and devices nothing tests."""

from __future__ import annotations

from dataclasses import replace
from math import exp, hypot, inf, sqrt

import numpy as np
import pytest

from gcs_coloc.core.integrity.protection_level import (
    Exposure,
    FaultLevel,
    ProtectionSettings,
    fault_level,
    protection_level,
    radius_at_risk,
    ranged_until_s,
)
from gcs_coloc.core.integrity.solution_separation import FaultClass, Separation
from gcs_coloc.core.measurements import Estimate

KNOWN = Exposure(delay_is_known=True, shown_until_s=inf)
SETTINGS = ProtectionSettings()
SIGMA_M, SIGMA_V_M = 2.0, 3.0


def estimate(at_s: float = 10.0, sigma_m: float = SIGMA_M, speed_mps: float = 20.0) -> Estimate:
    covariance = np.diag([sigma_m**2, sigma_m**2, SIGMA_V_M**2, 1.0, 1.0, 1.0])
    return Estimate(4, at_s, np.zeros(3), np.array([speed_mps, 0.0, 0.0]), covariance, 1.2, 4)


def level(*hypotheses: Separation) -> FaultLevel:
    return fault_level(hypotheses, estimate(), 10.0, SETTINGS)


def test_who_may_be_off_beside_a_fault_that_was_found_counts_in_full():
    """With a probability of a fifth, and with the sigma that the others leave: nothing of it is assumed away."""
    hypotheses = [receiver(1, 0.0, 1.0), receiver(2, 0.0, 20.0)]
    found = fault_level(hypotheses, estimate(), 10.0, SETTINGS, {frozenset((2,)): 0.2})
    assert level(*hypotheses).level_m < 40.0
    assert fault_level(hypotheses, estimate(), 10.0, SETTINGS, {}).level_m > 50.0
    risk = 0.5 * SETTINGS.integrity_risk_per_h
    assert found.level_m == pytest.approx(hypot(20.0, SETTINGS.common_gnss_sigma_m) * radius_at_risk(risk / 0.2), rel=0.01)


def receiver(vehicle: int, separation_m: float, sigma_m: float) -> Separation:
    return Separation(FaultClass.RECEIVERS, (vehicle,), separation_m, sigma_m)


@pytest.mark.parametrize("probability", [0.1, 1e-3, 1e-7])
def test_the_radius_is_exceeded_with_that_probability(probability):
    """In closed form: a round plane Gaussian exceeds k sigmas with probability exp(-k^2 / 2)."""
    assert exp(-0.5 * radius_at_risk(probability) ** 2) == pytest.approx(probability)


def test_a_round_gaussian_exceeds_the_radius_as_often_as_stated():
    """200,000 draws at 1 %: 2,000 +- 45 (one sigma); the band is five of these."""
    errors = np.random.default_rng(1).normal(size=(200_000, 2))
    beyond = int((np.hypot(*errors.T) > radius_at_risk(0.01)).sum())
    assert abs(beyond - 2000) < 225


def test_a_trusted_vehicle_has_the_nominal_level():
    stated = protection_level(estimate(), None, KNOWN, SETTINGS)
    common_m = SETTINGS.common_gnss_sigma_m
    assert stated.horizontal_m == pytest.approx(SETTINGS.nominal_sigmas * hypot(SIGMA_M, common_m))
    assert stated.vertical_m > SETTINGS.nominal_sigmas * SIGMA_V_M
    assert stated.untested == ()


def test_a_smaller_risk_raises_the_level():
    cautious = replace(SETTINGS, integrity_risk_per_h=1e-7)
    assert protection_level(estimate(), None, KNOWN, cautious) > protection_level(estimate(), None, KNOWN, SETTINGS)


def test_the_separation_of_any_hypothesis_is_in_the_level():
    near, far = level(receiver(1, 0.0, 1.0), receiver(2, 0.0, 1.0)), level(receiver(1, 40.0, 1.0), receiver(2, 0.0, 1.0))
    # Half of the equation is gone beyond 40 m, so that the level is a little less than 40 m more.
    assert near.level_m + 39.0 < far.level_m <= near.level_m + 40.0
    assert protection_level(estimate(), far, KNOWN, SETTINGS).horizontal_m > 40.0


def test_the_level_is_exceeded_with_the_stated_risk_when_all_hypotheses_are_added():
    found = [receiver(1, 3.0, 1.5), receiver(2, 1.0, 4.0), Separation(FaultClass.MOTION, (4,), 2.0, 2.0)]
    level_m = level(*found).level_m
    exposed = 10.0  # ten minutes of a fault are ten independent errors
    per_h = sum(
        SETTINGS.rate_per_h(each) * exposed * exp(-0.5 * ((level_m - each.separation_m) / hypot(each.sigma_m, 2.0)) ** 2)
        for each in found
    )
    assert per_h == pytest.approx(0.5 * SETTINGS.integrity_risk_per_h, rel=1e-3)


@pytest.mark.parametrize("fault", FaultClass)
def test_the_level_does_not_fall_as_a_test_becomes_worse(fault):
    """Found in a flight: a peer was drawn off, and as its test became coarser than 6 m the level fell from 30 to 17 m."""
    levels_m = [level(Separation(fault, (2,), 1.8 * sigma_m, sigma_m)).level_m for sigma_m in (4.0, 5.9, 6.1, 10.0, 800.0)]
    assert levels_m[0] < levels_m[1] < levels_m[2]
    assert levels_m[3:] == pytest.approx([levels_m[2]] * 2, abs=0.01)


def test_the_own_ranging_device_that_no_range_tests_is_named_by_the_own_id_and_other_devices_are_not():
    """In a simulated flight with all peers to one side a device drifted by 2.3 m/s: 80 m in 35 s, and nothing was told."""
    own, other = Separation(FaultClass.RANGES, (4,), 20.0, 14.0), Separation(FaultClass.RANGES, (2,), 20.0, 14.0)
    assert level(receiver(1, 3.0, 1.5), own, other).untested == (4,)
    assert level(receiver(1, 3.0, 1.5), own._replace(sigma_m=5.0), other).untested == ()


def test_a_receiver_that_no_range_tests_is_named_and_counts_as_tested_by_6_m():
    found = level(receiver(1, 3.0, 1.5), receiver(2, 400.0, 800.0), Separation(FaultClass.RANGES, (1, 4), 1.0, 9.0))
    assert found.untested == (2,)
    assert found.level_m == pytest.approx(
        level(receiver(1, 3.0, 1.5), receiver(2, 3.0, 6.0), Separation(FaultClass.RANGES, (1, 4), 6.0 / 9.0, 6.0)).level_m
    )


def test_without_air_data_the_level_grows_by_what_the_vehicle_can_have_done():
    """I2: 9 s without ranges and a turn; half of 1 g times t squared."""
    found = level(receiver(1, 0.0, 1.0))
    blind = Exposure(delay_is_known=True, shown_until_s=None)
    fresh = protection_level(estimate(10.0), found, blind, SETTINGS).horizontal_m
    later = protection_level(estimate(12.0), found, blind, SETTINGS).horizontal_m
    assert later == pytest.approx(fresh + 0.5 * SETTINGS.max_acceleration_mps2 * 2.0**2)
    assert protection_level(estimate(19.0), found, blind, SETTINGS).horizontal_m > 154.0


def test_ranges_show_the_motion_until_they_have_come_from_every_direction():
    """A plane that turned was 48 m off at a level of 48 m: the newest range counted, and it was across the way it went."""
    east, north, aslant = (9.0, 1.0, 0.0), (9.8, 0.0, 1.0), (9.8, 0.1, sqrt(0.99))
    assert ranged_until_s([east, north], 10.0) == pytest.approx(9.0)
    assert ranged_until_s([(9.8, 0.0, 1.0), (9.8, 1.0, 0.0)], 10.0) == pytest.approx(10.0 - 0.2 * 2.0**0.25)
    # Two of nearly one direction: a displacement across both shows by its tenth part.
    assert ranged_until_s([north, aslant], 10.0) == pytest.approx(10.0 - 0.2 / sqrt(0.1))
    assert ranged_until_s([north], 10.0) == pytest.approx(10.0 - 0.2 / sqrt(0.01))


def test_the_other_side_of_its_peers_is_in_the_level_unless_its_motion_is_shown():
    found = level(receiver(1, 0.0, 1.0))
    beside = replace(found, other_side_m=320.0)
    blind = Exposure(delay_is_known=True, shown_until_s=None)
    assert protection_level(estimate(), beside, blind, SETTINGS).horizontal_m == pytest.approx(320.0)
    assert protection_level(estimate(), beside, KNOWN, SETTINGS) == protection_level(estimate(), found, KNOWN, SETTINGS)


def test_a_trusted_vehicle_that_falls_silent_may_turn_as_well():
    """A real ArduPlane whose radio was silent in a turn was 33 m off after 3 s, with a level of 23 m."""
    silent = Exposure(delay_is_known=True, shown_until_s=10.0)
    fresh, later = (protection_level(estimate(at_s), None, silent, SETTINGS) for at_s in (10.0, 13.0))
    moved_m = pytest.approx(0.5 * 9.8 * 3.0**2)
    assert later.horizontal_m - fresh.horizontal_m == moved_m
    assert later.vertical_m - fresh.vertical_m == moved_m
    shown = replace(silent, shown_until_s=13.0)
    assert protection_level(estimate(13.0), None, shown, SETTINGS) == fresh


def test_with_air_data_the_level_grows_with_the_estimates_covariance():
    found = level(receiver(1, 5.0, 4.0))
    grown = protection_level(estimate(20.0, sigma_m=SIGMA_M + 3.0), found, KNOWN, SETTINGS).horizontal_m
    assert grown >= found.level_m + 3.0 * SETTINGS.nominal_sigmas


def test_a_delay_that_nothing_shows_is_a_bias():
    unknown = Exposure(delay_is_known=False, shown_until_s=inf)
    known_m, late_m = (protection_level(estimate(speed_mps=20.0), None, each, SETTINGS).horizontal_m for each in (KNOWN, unknown))
    assert late_m == pytest.approx(known_m + 20.0 * SETTINGS.unknown_delay_s)


@pytest.mark.parametrize("key", ["integrity_risk_per_h", "independent_s", "receiver_fault_rate_per_h", "max_acceleration_mps2"])
def test_an_impossible_setting_is_refused_by_name(key):
    with pytest.raises(ValueError, match=key):
        ProtectionSettings(**{key: 0.0})
