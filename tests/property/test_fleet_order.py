"""Two orders of arrival of the same measurements give the same answer; no geometry breaks the covariance."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Estimate,
    Measurement,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.estimators.fleet.ekf.state import UnknownKey
from gcs_coloc.estimators.fleet.filter import FleetFilter


def measurements(delays: list[float], seed: int) -> list[Measurement]:
    """Two denied vehicles, each kind of measurement, clocks that are off, and now and then a range that is far too long."""
    rng = np.random.default_rng(seed)
    made: list[Measurement] = []
    i = 0

    def arrival(t: float) -> float:
        nonlocal i
        i += 1
        return t + delays[i % len(delays)]

    for k in range(30):
        t = 0.1 * k
        for v, (e, n) in {1: (0.0, 0.0), 2: (900.0, 100.0), 3: (200.0, 800.0), 4: (500.0, 400.0), 5: (300.0, 250.0)}.items():
            if v < 4 or k < 8:
                p = (e + 20.0 * t + rng.normal(), n + rng.normal(), 100.0 + rng.normal())
                made.append(PositionMeasurement(v, t, arrival(t), p, 1.0, 1.0, (20.0, 0.0, 0.0), 0.5, time_sigma_s=0.02))
            else:
                made.append(AltitudeMeasurement(v, t, arrival(t), 100.0 + rng.normal(), 2.0))
            made.append(AttitudeMeasurement(v, t, arrival(t), 0.02 * rng.normal(), 0.0, 1.57 + 0.02 * rng.normal(), 20.0))
            for denied_vehicle in (4, 5) if v < 4 and k >= 8 else ():
                here = (500.0, 400.0) if denied_vehicle == 4 else (300.0, 250.0)
                r = float(np.hypot(here[0] - e, here[1] - n)) + rng.normal() + (80.0 if rng.random() < 0.05 else 0.0)
                made.append(RangeMeasurement(denied_vehicle, v, t, arrival(t), r, 1.0, 0, denied_vehicle, 0.02, 0.4))
        if k >= 8:
            made.append(RangeMeasurement(4, 5, t, arrival(t), 250.0 + rng.normal(), 1.0))
    return made


@settings(
    max_examples=10,
    deadline=None,
    phases=(Phase.explicit, Phase.reuse, Phase.generate),
    suppress_health_check=[HealthCheck.too_slow],
)
@given(
    st.lists(st.floats(0.0, 0.9), min_size=1, max_size=40),
    st.lists(st.floats(0.0, 0.9), min_size=1, max_size=40),
    st.integers(0, 5),
)
def test_any_two_orders_of_arrival_give_the_same_answer(first, second, seed):
    answers = []
    for delays in (first, second):
        estimator = FleetFilter()
        told = False
        for i, m in enumerate(sorted(measurements(delays, seed), key=lambda m: m.arrived_at_s)):
            if not told and m.arrived_at_s >= 0.8:
                estimator.set_denied({4, 5}, 0.8)
                told = True
            estimator.add(m)
            if i % 17 == 0:
                estimator.estimate(4, m.arrived_at_s)
        answers.append([estimator.estimate(vehicle, 3.0) for vehicle in (1, 4, 5)])
    for one, other in zip(*answers, strict=True):
        assert isinstance(one, Estimate)
        assert isinstance(other, Estimate)
        np.testing.assert_allclose(one.position_enu_m, other.position_enu_m, rtol=1e-9)
        np.testing.assert_allclose(one.velocity_enu_mps, other.velocity_enu_mps, rtol=1e-9)
        np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-9, atol=1e-12)


distance = st.sampled_from([0.0, 0.01, 3.0, 120.0, 10_000.0])
place = st.tuples(distance, distance, st.sampled_from([0.0, 0.5, 400.0]))


@settings(
    max_examples=25,
    deadline=None,
    phases=(Phase.explicit, Phase.reuse, Phase.generate),
    suppress_health_check=[HealthCheck.too_slow],
)
@given(
    st.lists(place, min_size=0, max_size=4),
    place,
    st.sampled_from([0.05, 1.0, 20.0]),
    st.booleans(),
    st.sampled_from([0.3, 60.0, 1200.0]),
    st.integers(0, 3),
)
def test_no_geometry_and_no_length_of_flight_breaks_the_covariance(
    peers, denied_vehicle, sigma_m, with_altitude, spacing_s, seed
):
    """Collinear, coincident, one, none, near, far, overhead; with 1200 s between rounds the flight lasts 13 hours."""
    rng = np.random.default_rng(seed)
    estimator = FleetFilter()
    here = np.array(denied_vehicle)
    estimator.add(PositionMeasurement(9, 0.0, 0.0, denied_vehicle, 1.0, 1.0, (0.0, 0.0, 0.0), 0.5))
    estimator.set_denied({9}, 0.01)
    for k in range(1, 40):
        t = spacing_s * k
        for v, peer in enumerate(peers):
            estimator.add(PositionMeasurement(v, t, t, peer, 1.0, 1.0, (0.0, 0.0, 0.0), 0.5))
            r = max(0.0, float(np.linalg.norm(here - np.array(peer))) + sigma_m * rng.normal())
            estimator.add(RangeMeasurement(9, v, t, t, r, sigma_m))
        if with_altitude:
            estimator.add(AltitudeMeasurement(9, t, t, denied_vehicle[2], 2.0))
        for vehicle in (9, *range(len(peers))):
            where = estimator.estimate(vehicle, t)
            if isinstance(where, Estimate):
                P = where.covariance
                np.testing.assert_array_equal(P, P.T)
                assert np.linalg.eigvalsh(P)[0] > 0.0
                assert math.isfinite(float(where.position_enu_m.sum()))


def circle(vehicle: int, t: float) -> np.ndarray:
    radius, speed = 300.0 + 100.0 * vehicle, 20.0 + vehicle
    angle = speed * t / radius + vehicle
    return np.array(
        [(500.0 * vehicle) % 1100.0 + radius * math.sin(angle), (400.0 * vehicle) % 900.0 + radius * math.cos(angle), 100.0]
    )


def test_after_an_hour_the_joint_covariance_is_symmetric_and_definite_to_rounding():
    """Two denied vehicles that range each other and share peers, with ranges as sharp as 5 cm: the worst for a covariance that is
    reduced by subtraction. The bound is a thousand times the rounding error of correlations of 90 states."""
    rng = np.random.default_rng(0)
    estimator = FleetFilter()
    for k in range(900):
        t = 4.0 * k
        if k == 5:
            estimator.set_denied({4, 5}, t)
        for v in range(1, 6):
            velocity = (circle(v, t + 0.01) - circle(v, t - 0.01)) / 0.02
            if v < 4 or k < 5:
                p, u = circle(v, t) + 0.3 * rng.normal(size=3), velocity + 0.1 * rng.normal(size=3)
                estimator.add(
                    PositionMeasurement(v, t, t, tuple(p.tolist()), 0.6, 0.9, tuple(u.tolist()), 0.3, time_sigma_s=0.01)
                )
            elif v == 4:
                estimator.add(AltitudeMeasurement(v, t, t, 100.0 + 0.3 * rng.normal(), 2.0))
        for a, b in ((4, 1), (4, 2), (4, 3), (5, 1), (5, 2), (4, 5)):
            r = float(np.linalg.norm(circle(a, t) - circle(b, t))) + 0.05 * rng.normal()
            estimator.add(RangeMeasurement(a, b, t, t, r, 0.05, 0, a, 0.01, 0.1))
        if k % 300 == 299:
            joint = estimator._buffer.process().main.clusters[4].joint
            np.testing.assert_array_equal(joint.A, joint.A.T)
            # Sensitivities to unknown biases have no covariance among themselves.
            states = [
                i for key, block in joint.where.items() if not isinstance(key, UnknownKey) for i in range(*block.indices(10**6))
            ]
            P = joint.A[np.ix_(states, states)]
            sigma = np.sqrt(np.diag(P))
            sigma[sigma == 0.0] = 1.0
            assert np.linalg.eigvalsh(P / np.outer(sigma, sigma))[0] > -1e-11
            where = estimator.estimate(4, t)
            assert isinstance(where, Estimate)
            e = (where.position_enu_m - circle(4, t))[:2]
            # Six sigmas: neither lost nor confident.
            assert float(e @ np.linalg.solve(where.covariance[:2, :2], e)) < 36.0
