"""What a vehicle of each class does: limits, and process noise that is learned where manoeuvres recur."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.motion_profiles import PROFILES, motion_profile
from gcs_coloc.estimators.fleet.settings import FleetSettings

DENIED = 9
PEERS = {1: (200.0, 0.0), 2: (-120.0, 170.0), 3: (-100.0, -180.0), 4: (30.0, 250.0)}
STEP_S, LEARNED_S, END_S = 0.2, 25.0, 105.0


def course(acceleration_mps2: float, rng: np.random.Generator) -> np.ndarray:
    """Accelerate fully to a random side every three seconds, below 12 m/s; return positions (N, 2) at each step, m."""
    place, velocity, target, places = np.zeros(2), np.zeros(2), np.zeros(2), []
    for k in range(round(END_S / 0.02)):
        if k % 150 == 0:
            target = rng.uniform(-12.0, 12.0, 2) if acceleration_mps2 > 0.0 else np.zeros(2)
            target -= np.clip(place / 10.0, -6.0, 6.0)
        push = target - velocity
        velocity = velocity + push * min(1.0, 0.02 * acceleration_mps2 / max(float(np.linalg.norm(push)), 1e-9))
        place = place + 0.02 * velocity
        if k % 10 == 9:
            places.append(place)
    return np.array(places)


def flown(acceleration_mps2: float, vehicle_class: VehicleClass | None, seed: int) -> tuple[float, float]:
    """Return the RMSE (m) and the share within the 95 % bound, once the noise can be learned."""
    rng, estimator, errors, bounds = np.random.default_rng(seed), FleetFilter(), [], []
    places = course(acceleration_mps2, rng)
    if vehicle_class is not None:
        estimator.add(VehicleClassReport(DENIED, 0.0, 0.0, vehicle_class))
    for k, place in enumerate(places):
        t = STEP_S * (k + 1)
        if k == 10:
            estimator.set_denied({DENIED}, t)
        for peer, where in PEERS.items():
            estimator.add(PositionMeasurement(peer, t, t, (*where, 50.0), 0.5, 0.5, (0.0, 0.0, 0.0), 0.2))
            range_m = math.dist((*place, 50.0), (*where, 50.0)) + rng.normal()
            estimator.add(RangeMeasurement(DENIED, peer, t, t, range_m, 1.0))
        estimator.add(AltitudeMeasurement(DENIED, t, t, 50.0, 1.0))
        if k < 10:
            estimator.add(PositionMeasurement(DENIED, t, t, (*place, 50.0), 0.5, 0.5, (0.0, 0.0, 0.0), 0.5))
        elif t > LEARNED_S:
            answer = estimator.estimate(DENIED, t)
            assert isinstance(answer, Estimate)
            errors.append(float(np.linalg.norm(answer.position_enu_m[:2] - place)))
            bounds.append(horizontal_bound_95_m(answer.covariance))
    return math.sqrt(np.mean(np.square(errors))), float(np.mean(np.less_equal(errors, bounds)))


def test_an_agile_multirotor_is_followed_and_its_bound_holds():
    rmse_m, covered = np.mean([flown(7.0, VehicleClass.MULTIROTOR, seed) for seed in (1, 2)], axis=0)
    unknown_m, unknown_covered = np.mean([flown(7.0, None, seed) for seed in (1, 2)], axis=0)
    assert rmse_m < unknown_m
    assert covered >= 0.9 > unknown_covered


def test_a_hovering_multirotor_is_no_worse_for_its_class():
    rmse_m, covered = np.mean([flown(0.0, VehicleClass.MULTIROTOR, seed) for seed in (1, 2)], axis=0)
    unknown_m, _ = np.mean([flown(0.0, None, seed) for seed in (1, 2)], axis=0)
    assert rmse_m <= unknown_m
    assert covered >= 0.93


@pytest.mark.parametrize("reported", [None, *VehicleClass])
def test_settings_prevail_over_the_class(reported):
    assert motion_profile(reported, FleetSettings()) is PROFILES[reported]
    assert motion_profile(reported, FleetSettings(vehicle_class="boat")) is PROFILES[VehicleClass.BOAT]
    limited = motion_profile(reported, FleetSettings(max_speed_mps=1.5, max_acceleration_mps2=2.0))
    assert (limited.max_speed_mps, limited.max_acceleration_mps2) == (1.5, 2.0)
    assert limited.max_climb_mps <= 1.5
    assert limited.noise_levels == PROFILES[reported].noise_levels
