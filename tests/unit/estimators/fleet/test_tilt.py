"""A multirotor is accelerated by its tilt, but for what drag, wind and a wrong trim make of it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gcs_coloc.core.measurements import (
    AttitudeMeasurement,
    Estimate,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet.ekf.tilt import GRAVITY_MPS2, Tilt, missed_motion, tilt_after, tilted_velocity_mps
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.fleet_model import FleetModel
from gcs_coloc.estimators.fleet.settings import FleetSettings

DENIED, LOST_S, END_S, STEP_S = 9, 10.0, 50.0, 0.05
PEERS_M = {1: (-300.0, 500.0), 2: (900.0, 600.0), 3: (400.0, -500.0), 4: (1100.0, -300.0)}
BRAKES_S, BRAKE_MPS2, SPEED_MPS, DRAG_PER_S, WIND_MPS = (30.3, 40.7), 7.0, 12.0, 0.3, np.array([-5.0, 3.0])


def attitude(at_s, roll_deg, pitch_deg, yaw_deg=0.0):
    return AttitudeMeasurement(DENIED, at_s, at_s, *(math.radians(each) for each in (roll_deg, pitch_deg, yaw_deg)), None)


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg", "yaw_deg", "to"),
    [(0, -20, 0, (0, 1)), (0, -20, 90, (1, 0)), (0, 20, 90, (-1, 0)), (20, 0, 0, (1, 0)), (20, 0, 90, (0, -1))],
)
def test_thrust_leans_to_where_it_tilts(roll_deg, pitch_deg, yaw_deg, to):
    tilt = tilt_after(None, attitude(0.0, roll_deg, pitch_deg, yaw_deg))
    expected = GRAVITY_MPS2 * math.tan(math.radians(20.0)) * np.array(to)
    assert (tilt.east_mps2, tilt.north_mps2) == pytest.approx(tuple(expected))


def test_a_steady_tilt_accelerates_nothing_and_a_new_one_as_long_as_drag_has_not_caught_up():
    tilt = tilt_after(None, attitude(0.0, 0.0, -15.0))
    assert tilt.acceleration_mps2 == (0.0, 0.0)
    found = []
    for k in range(1, 100):
        tilt = tilt_after(tilt, attitude(0.1 * k, 0.0, 15.0))
        found.append(tilt.acceleration_mps2[1])
    assert -2.0 * GRAVITY_MPS2 * math.tan(math.radians(15.0)) < found[0] < -5.0
    assert found == sorted(found)
    assert found[-1] == pytest.approx(0.0, abs=0.1)


def test_attitudes_with_a_long_gap_between_tell_nothing_of_it():
    before = tilt_after(None, attitude(0.0, 0.0, 0.0))
    assert tilt_after(before, attitude(2.0, 0.0, -20.0)).acceleration_mps2 == (0.0, 0.0)
    assert tilt_after(before, attitude(-0.1, 0.0, -20.0)).acceleration_mps2 == (0.0, 0.0)


@pytest.mark.parametrize("interval_s", [0.1, 1.0])
def test_missed_motion_is_that_of_a_change_at_any_time_between_two_attitudes(interval_s):
    """Monte Carlo: from 1 m/s² east to 4 m/s² west; the filter has held the first for half a second."""
    rng = np.random.default_rng(4)
    lasted_s = interval_s * rng.uniform(size=200_000)
    unheld_s = max(interval_s - 0.5, 0.0)
    metres, speeds = unheld_s**2 / 2.0 - 5.0 * lasted_s**2 / 2.0, unheld_s - 5.0 * lasted_s
    before, now = Tilt(7.0, 1.0, 0.0, 0.0, 0.0), Tilt(7.0 + interval_s, -4.0, 0.0, 0.0, 0.0)
    mean, covariance = missed_motion(before, now, -math.inf)
    np.testing.assert_allclose(mean, [metres.mean(), 0.0, speeds.mean(), 0.0], rtol=0.02, atol=1e-9)
    np.testing.assert_allclose(covariance[::2, ::2], np.cov(metres, speeds), rtol=0.02)
    assert not covariance[1::2].any()


def test_what_a_reported_velocity_holds_is_not_missed():
    before, now = Tilt(7.0, 1.0, 0.0, 0.0, 0.0), Tilt(8.0, -4.0, 0.0, 0.0, 0.0)
    short = missed_motion(Tilt(7.9, 1.0, 0.0, 0.0, 0.0), now, -math.inf)[1]
    np.testing.assert_allclose(missed_motion(before, now, 7.9)[1], short)
    for each in missed_motion(before, now, 8.1):
        assert not each.any()


def flight():
    """Return place and velocity (2,) in each step, and the thrust: north-east, with two brakes to a stop of two seconds."""
    place, speed, ways, to = np.array([200.0, -300.0]), SPEED_MPS, [], np.array([0.8, 0.6])
    for k in range(round(END_S / STEP_S)):
        stops = any(start <= k * STEP_S < start + 4.0 for start in BRAKES_S)
        rate = max(-BRAKE_MPS2, -speed / STEP_S) if stops else min(BRAKE_MPS2, (SPEED_MPS - speed) / STEP_S)
        velocity = speed * to
        ways.append((place, velocity, rate * to + DRAG_PER_S * (velocity - WIND_MPS)))
        speed += rate * STEP_S
        place = place + STEP_S * velocity
    return ways


def velocities(seed, attitude_s, *, vehicle=VehicleClass.MULTIROTOR, yaw_off=0.0, trim=0.0):
    """Fly it; return the velocity's error in the brakes and its stated sigma, m/s, ten times a second."""
    rng, found, estimator, yaw = np.random.default_rng(seed), [], FleetFilter(), 0.7
    estimator.add(VehicleClassReport(DENIED, 0.0, 0.0, vehicle))
    for k, (place, velocity, (east, north)) in enumerate(flight()):
        t = k * STEP_S
        if k == round(LOST_S / STEP_S):
            estimator.set_denied({DENIED}, t)
        if k % 4 == 0:
            for peer, at_m in PEERS_M.items():
                estimator.add(PositionMeasurement(peer, t, t, (*at_m, 100.0), 1.0, 1.5, (0.0, 0.0, 0.0), 0.3))
            if t < LOST_S:
                own_m, own_mps = (*place.tolist(), 100.0), (*velocity.tolist(), 0.0)
                estimator.add(PositionMeasurement(DENIED, t, t, own_m, 1.0, 1.5, own_mps, 0.3))
        if attitude_s is not None and k % round(attitude_s / STEP_S) == 0:
            forward, right = east * math.sin(yaw) + north * math.cos(yaw), east * math.cos(yaw) - north * math.sin(yaw)
            roll = math.atan2(right, math.hypot(forward, GRAVITY_MPS2)) + trim
            pitch = -math.atan2(forward, GRAVITY_MPS2) + trim
            estimator.add(AttitudeMeasurement(DENIED, t, t, roll, pitch, yaw + yaw_off, None))
        for peer, at_m in PEERS_M.items():
            if k % 20 == 4 * peer - 1:
                range_m = math.hypot(*(place - at_m)) + rng.normal()
                estimator.add(RangeMeasurement(DENIED, peer, t, t, range_m, 1.0))
        if k % 2 == 0 and any(start <= t < start + 3.0 for start in BRAKES_S):
            where = estimator.estimate(DENIED, t)
            assert isinstance(where, Estimate)
            sigma_mps = math.sqrt(np.linalg.eigvalsh(where.covariance[3:5, 3:5])[1])
            found.append((math.hypot(*(where.velocity_enu_mps[:2] - velocity)), sigma_mps))
    return np.array(found).T


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("attitude_s", "wrong"),
    [(0.1, {}), (0.5, {}), (0.5, {"yaw_off": math.radians(20.0)}), (0.5, {"trim": math.radians(3.0)}), (1.0, {})],
)
def test_a_brake_is_seen_in_the_tilt(seed, attitude_s, wrong):
    """Real copters braked from 11.5 m/s: the velocity was 4 to 8 m/s off at a stated 2 m/s, and they landed by failsafe."""
    off_mps, sigma_mps = velocities(seed, attitude_s, **wrong)
    unseen_mps, _ = velocities(seed, None)
    assert np.mean(off_mps > 2.45 * sigma_mps) <= 0.05
    assert np.sqrt(np.mean(off_mps**2)) < 0.5 * np.sqrt(np.mean(unseen_mps**2))


@pytest.mark.parametrize("vehicle", [VehicleClass.PLANE, VehicleClass.GROUND, VehicleClass.BOAT, VehicleClass.INDOOR])
def test_no_other_vehicle_is_accelerated_by_its_tilt(vehicle):
    with_tilt, without = velocities(1, 0.5, vehicle=vehicle), velocities(1, None, vehicle=vehicle)
    np.testing.assert_allclose(with_tilt, without, rtol=1e-9)


def test_the_change_of_a_velocity_by_tilt_is_what_the_tilt_accelerates_meanwhile():
    """It brakes to the south from 3.0 s on for a second, in which drag catches up with e^(-t / 2 s) of it left."""
    braking = [attitude(0.05 * k, 0.0, 30.0 if k >= 60 else 0.0) for k in range(90)]
    east_mps, north_mps = tilted_velocity_mps(braking, 2.9, 4.0)
    assert east_mps == pytest.approx(0.0, abs=1e-9)
    lasting_s = 2.0 * (1.0 - math.exp(-0.5))
    assert north_mps == pytest.approx(-lasting_s * GRAVITY_MPS2 * math.tan(math.radians(30.0)), rel=0.05)
    assert tilted_velocity_mps(braking, 0.0, 2.0) == (0.0, 0.0)


def test_a_vtol_that_brakes_on_its_way_back_to_its_rotors_is_braked_by_its_first_tilt():
    """The mean of its tilt on wings is none: it began at 25 degrees, and the brake at 4.6 m/s² was not seen."""
    model = FleetModel(FleetSettings())
    model.apply(VehicleClassReport(DENIED, 0.0, 0.0, VehicleClass.PLANE))
    for k in range(11):
        t = 0.5 * k
        model.apply(PositionMeasurement(DENIED, t, t, (0.0, 20.0 * t, 50.0), 1.0, 1.0, (0.0, 20.0, 0.0), 0.3))
        model.apply(replace(attitude(t, 0.0, 0.0), airspeed_mps=20.0))
    model.set_denied(frozenset({DENIED}), 5.0)
    model.apply(replace(attitude(5.1, 0.0, 0.0), airspeed_mps=20.0))
    model.apply(VehicleClassReport(DENIED, 5.2, 5.2, VehicleClass.MULTIROTOR))
    model.apply(attitude(5.6, 0.0, 25.0))
    tilt = model.records[DENIED].tilt
    assert tilt is not None
    east_mps2, north_mps2 = tilt.acceleration_mps2
    assert (east_mps2, north_mps2) == pytest.approx((0.0, -4.1), abs=0.2)
