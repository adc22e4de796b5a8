"""What a vehicle of each class does: limits, and process noise that is learned, from its reports and from its ranges."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Estimate,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet.ekf.possible_motion import PROFILES, motion_profile
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.fleet_model import FleetModel
from gcs_coloc.estimators.fleet.settings import FleetSettings

DENIED = 9
PEERS = {1: (200.0, 0.0), 2: (-120.0, 170.0), 3: (-100.0, -180.0), 4: (30.0, 250.0)}
STEP_S, LEARNED_S, END_S = 0.2, 25.0, 80.0


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


def turning(rng: np.random.Generator) -> np.ndarray:
    """Fly at 20 m/s, straight and in turns of 30 degrees of bank in turns; return positions (N, 2) at each step, m."""
    heading, turn_radps, until_s, place, places = rng.uniform(0.0, 2.0 * math.pi), 0.0, 0.0, np.zeros(2), []
    for k in range(round(END_S / STEP_S)):
        if STEP_S * k >= until_s:
            until_s = STEP_S * k + rng.uniform(4.0, 10.0)
            turn_radps = 0.0 if turn_radps else float(rng.choice((-0.28, 0.28)))
        heading += turn_radps * STEP_S
        place = place + 20.0 * STEP_S * np.array([math.sin(heading), math.cos(heading)])
        places.append(place)
    return np.array(places)


def covered_after_loss(places: np.ndarray, reported: VehicleClass, seed: int, lost_s: float, until_s: float) -> float:
    """Lose the GPS at `lost_s` among ranges of 12 m every 0.8 s; return the share within the 95 % bound until `until_s`."""
    rng, estimator, covered = np.random.default_rng(seed), FleetFilter(), []
    velocities = np.gradient(places, STEP_S, axis=0)
    estimator.add(VehicleClassReport(DENIED, 0.0, 0.0, reported))
    peers = {peer: (10.0 * east, 10.0 * north) for peer, (east, north) in PEERS.items()}
    for k, (place, velocity) in enumerate(zip(places, velocities, strict=True)):
        t = STEP_S * (k + 1)
        if t > until_s:
            break
        if k == round(lost_s / STEP_S):
            estimator.set_denied({DENIED}, t)
        for peer, where in peers.items():
            estimator.add(PositionMeasurement(peer, t, t, (*where, 50.0), 0.5, 0.5, (0.0, 0.0, 0.0), 0.2))
            if k % 4 == peer % 4:
                range_m = math.dist((*place, 50.0), (*where, 50.0)) + 12.0 * rng.normal()
                estimator.add(RangeMeasurement(DENIED, peer, t, t, range_m, 12.0))
        estimator.add(AltitudeMeasurement(DENIED, t, t, 50.0, 1.0))
        if t < lost_s:
            noisy = velocity + 0.2 * rng.normal(size=2)
            estimator.add(PositionMeasurement(DENIED, t, t, (*place, 50.0), 0.5, 0.5, (*noisy, 0.0), 0.2))
        elif t > lost_s + 2.0:
            answer = estimator.estimate(DENIED, t)
            if isinstance(answer, Estimate):
                error_m = float(np.linalg.norm(answer.position_enu_m[:2] - place))
                covered.append(error_m <= horizontal_bound_95_m(answer.covariance))
    return float(np.mean(covered))


def test_what_a_multirotor_did_with_gps_is_in_its_bound_right_after_the_loss():
    """Coarse ranges show it too late: without what it did before 70 % are covered."""
    flights = [(course(7.0, np.random.default_rng(seed)), seed) for seed in range(1, 13)]
    assert np.mean([covered_after_loss(p, VehicleClass.MULTIROTOR, seed, 40.0, 50.0) for p, seed in flights]) >= 0.9


def test_the_turns_of_a_plane_without_attitude_are_in_its_bound_among_coarse_ranges():
    """Without a level of its own 72 % are covered."""
    flights = [(turning(np.random.default_rng(seed)), seed) for seed in range(1, 9)]
    assert np.mean([covered_after_loss(p, VehicleClass.PLANE, seed, 40.0, END_S) for p, seed in flights]) >= 0.9


def mean_bound_m(reported: VehicleClass | None) -> float:
    """Fly in turns without GPS from 30 s on, with ranges of 0.3 m at 5 Hz; return the mean of the 95 % bound after 10 s."""
    rng, model, bounds = np.random.default_rng(1), FleetModel(FleetSettings()), []
    if reported is not None:
        model.apply(VehicleClassReport(DENIED, 0.0, 0.0, reported))
    places = turning(rng)
    for k, (place, velocity) in enumerate(zip(places, np.gradient(places, STEP_S, axis=0), strict=True)):
        t = STEP_S * (k + 1)
        if k == 150:
            model.set_denied(frozenset({DENIED}), t)
        for peer, (east, north) in PEERS.items():
            where = (10.0 * east, 10.0 * north, 50.0)
            model.apply(PositionMeasurement(peer, t, t, where, 0.05, 0.05, (0.0, 0.0, 0.0), 0.2))
            range_m = math.dist((*place, 50.0), where) + 0.3 * rng.normal()
            model.apply(RangeMeasurement(DENIED, peer, t, t, range_m, 0.3))
        if k < 150:
            model.apply(PositionMeasurement(DENIED, t, t, (*place, 50.0), 0.5, 0.5, (*velocity, 0.0), 0.2))
        elif k > 200:
            answer = model.estimate(DENIED, t)
            assert isinstance(answer, Estimate)
            bounds.append(horizontal_bound_95_m(answer.covariance))
    return float(np.mean(bounds))


def test_good_ranges_leave_the_process_noise_of_a_plane_as_it_is():
    """Eq. (42): a turn shows in them at once. Without it the bound is 1.4 times as large."""
    assert mean_bound_m(VehicleClass.PLANE) < 1.1 * mean_bound_m(None)


def test_the_level_of_gusts_and_that_of_manoeuvres_are_learned_apart():
    """Attitudes that fail for some seconds leave what was learned of the gusts."""
    rng, model, levels = np.random.default_rng(1), FleetModel(FleetSettings()), []
    model.apply(VehicleClassReport(DENIED, 0.0, 0.0, VehicleClass.PLANE))
    for k, place in enumerate(turning(rng)[:200]):
        t = STEP_S * (k + 1)
        if k == 10:
            model.set_denied(frozenset({DENIED}), t)
        for peer, where in PEERS.items():
            model.apply(PositionMeasurement(peer, t, t, (*where, 50.0), 0.5, 0.5, (0.0, 0.0, 0.0), 0.2))
            range_m = math.dist((*place, 50.0), (*where, 50.0)) + rng.normal()
            model.apply(RangeMeasurement(DENIED, peer, t, t, range_m, 1.0))
        if k < 10:
            model.apply(PositionMeasurement(DENIED, t, t, (*place, 50.0), 0.5, 0.5, (0.0, 0.0, 0.0), 5.0))
        if t < 25.0:
            model.apply(AttitudeMeasurement(DENIED, t, t, 0.0, 0.0, 0.0, 20.0))
        record = model.records[DENIED]
        levels.append((t, record.gust_noise.log_level, record.manoeuvre_noise.log_level))
    _, gusts, manoeuvres = zip(*(each for each in levels if each[0] > 27.0), strict=True)
    assert len(set(gusts)) == 1
    assert gusts[0] != 0.0
    assert len(set(manoeuvres)) > 1


@pytest.mark.parametrize("reported", [None, *VehicleClass])
def test_settings_prevail_over_the_class(reported):
    assert motion_profile(reported, FleetSettings()) is PROFILES[reported]
    assert motion_profile(reported, FleetSettings(vehicle_class="boat")) is PROFILES[VehicleClass.BOAT]
    limited = motion_profile(reported, FleetSettings(max_speed_mps=1.5, max_acceleration_mps2=2.0))
    assert (limited.max_speed_mps, limited.max_acceleration_mps2) == (1.5, 2.0)
    assert limited.max_climb_mps <= 1.5
    assert limited.noise_levels == PROFILES[reported].noise_levels
