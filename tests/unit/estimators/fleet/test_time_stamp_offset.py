from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from gcs_coloc.core.measurements import AltitudeMeasurement, Estimate, FloatArray, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.filter import FleetFilter

CLOCK_SIGMA_S = 0.05
DENIED = 4
LOST_S, SETTLED_S, END_S = 3.0, 10.0, 45.0


def circle(rng: np.random.Generator) -> Callable[[float], FloatArray]:
    centre, radius = rng.uniform(0.0, 1500.0, 2), float(rng.uniform(200.0, 500.0) * rng.choice([-1.0, 1.0]))
    height, rate, phase = rng.uniform(100.0, 200.0), rng.uniform(18.0, 26.0) / radius, rng.uniform(0.0, 2.0 * math.pi)
    return lambda t: np.array(
        [centre[0] + radius * math.sin(rate * t + phase), centre[1] + radius * math.cos(rate * t + phase), height]
    )


def fly(seed: int, *, stated: bool, stamped_by_denied: bool) -> tuple[list[float], list[float]]:
    """Circles at random; every vehicle's clock is off by 50 ms (1 sigma). Returns NEES and squared errors (m^2), each second."""
    rng = np.random.default_rng(seed)
    way = {vehicle: circle(rng) for vehicle in (1, 2, 3, DENIED)}
    late_s = {vehicle: float(rng.normal(0.0, CLOCK_SIGMA_S)) for vehicle in way}
    time_sigma_s = CLOCK_SIGMA_S if stated else 0.0

    def velocity(vehicle: int, t: float) -> FloatArray:
        return (way[vehicle](t + 0.01) - way[vehicle](t - 0.01)) / 0.02

    estimator = FleetFilter()
    nees, squares = [], []
    for k in range(round(END_S * 10.0)):
        t = 0.1 * k
        if k == round(LOST_S * 10.0):
            estimator.set_denied({DENIED}, t)
        for vehicle, path in way.items():
            noise, u = rng.normal(size=6), velocity(vehicle, t + late_s[vehicle])
            place = path(t + late_s[vehicle]) + 0.1 * noise[:3]
            if vehicle == DENIED and t >= LOST_S:
                estimator.add(AltitudeMeasurement(vehicle, t, t, float(place[2]) + 0.5, 2.0))
                continue
            sigma_m = math.hypot(0.5, float(np.hypot(u[0], u[1])) * CLOCK_SIGMA_S)
            reported = tuple((u + 0.1 * noise[3:]).tolist())
            estimator.add(
                PositionMeasurement(vehicle, t, t, tuple(place.tolist()), sigma_m, 0.5, reported, 0.3, time_sigma_s=time_sigma_s)
            )
        for peer in (1, 2, 3) if k % 2 == 0 and k > 10 else ():
            at_s = t + late_s[DENIED] if stamped_by_denied else t
            range_m = float(np.linalg.norm(way[DENIED](at_s) - way[peer](at_s)) + rng.normal())
            late_m = float(np.linalg.norm(velocity(DENIED, t) - velocity(peer, t))) * CLOCK_SIGMA_S if stamped_by_denied else 0.0
            measured = RangeMeasurement(DENIED, peer, t, t, range_m, math.hypot(1.0, late_m))
            if stated and stamped_by_denied:
                measured = RangeMeasurement(DENIED, peer, t, t, range_m, math.hypot(1.0, late_m), 0, DENIED, time_sigma_s, late_m)
            estimator.add(measured)
        if t >= SETTLED_S and k % 10 == 0:
            where = estimator.estimate(DENIED, t)
            assert isinstance(where, Estimate)
            e = (where.position_enu_m - way[DENIED](t))[:2]
            nees.append(float(e @ np.linalg.solve(where.covariance[:2, :2], e)))
            squares.append(float(e @ e))
    return nees, squares


@pytest.mark.parametrize("stamped_by_denied", [False, True])
def test_clocks_that_are_off_are_found_out_where_their_uncertainty_is_told(stamped_by_denied):
    stated = [fly(seed, stated=True, stamped_by_denied=stamped_by_denied) for seed in range(6)]
    as_noise = [fly(seed, stated=False, stamped_by_denied=stamped_by_denied) for seed in range(6)]
    # Six flights with one draw of clocks each: the mean of six independent NEES of 2 degrees of freedom is below 4.4 in 99.9 %.
    assert np.mean([nees for nees, _ in stated]) < 4.4
    assert np.mean([squares for _, squares in stated]) < 0.75 * np.mean([squares for _, squares in as_noise])


def test_a_receiver_that_says_that_it_got_worse_is_believed_at_once():
    estimator = FleetFilter()
    estimator.add(PositionMeasurement(DENIED, 0.0, 0.0, (300.0, 300.0, 100.0), 0.5, 0.5, (0.0, 0.0, 0.0), 0.3))
    estimator.set_denied({DENIED}, 0.01)
    rng = np.random.default_rng(1)
    places = {1: (0.0, 0.0, 100.0), 2: (600.0, 0.0, 110.0), 3: (0.0, 600.0, 90.0)}
    for k in range(1, 400):
        t, worse = 0.1 * k, k >= 300
        for vehicle, (east, north, up) in places.items():
            sigma_m, off_m = (5.0, 6.0) if worse and vehicle == 1 else (0.5, 0.0)
            reported = (east + off_m, north, up)
            estimator.add(PositionMeasurement(vehicle, t, t, reported, sigma_m, sigma_m, (0.0, 0.0, 0.0), 0.3))
            range_m = math.dist(places[vehicle], (300.0, 300.0, 100.0)) + rng.normal()
            estimator.add(RangeMeasurement(DENIED, vehicle, t, t, range_m, 1.0))
        if worse:
            where = estimator.estimate(1, t)
            assert isinstance(where, Estimate)
            assert abs(where.position_enu_m[0]) < 3.0 * math.sqrt(where.covariance[0, 0])
