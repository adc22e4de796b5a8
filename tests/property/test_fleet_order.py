"""Two orders of arrival of the same measurements give the same answer; no geometry breaks the covariance."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from gcs_coloc.core.measurements import AltitudeMeasurement, Estimate, Measurement, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet_filter import FleetFilter


def measurements(delays: list[float], seed: int) -> list[Measurement]:
    rng = np.random.default_rng(seed)
    made: list[Measurement] = []
    i = 0

    def arrival(t: float) -> float:
        nonlocal i
        i += 1
        return t + delays[i % len(delays)]

    for k in range(30):
        t = 0.1 * k
        for v, (e, n) in {1: (0.0, 0.0), 2: (900.0, 100.0), 3: (200.0, 800.0), 4: (500.0, 400.0)}.items():
            if v < 4 or k < 8:
                p = (e + 20.0 * t + rng.normal(), n + rng.normal(), 100.0 + rng.normal())
                made.append(PositionMeasurement(v, t, arrival(t), p, 1.0, 1.0, (20.0, 0.0, 0.0), 0.5))
            if v < 4 and k >= 8:
                r = float(np.hypot(500.0 - e, 400.0 - n)) + rng.normal()
                made.append(RangeMeasurement(4, v, t, arrival(t), r, 1.0))
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
                estimator.set_subjects({4}, 0.8)
                told = True
            estimator.add(m)
            if i % 17 == 0:
                estimator.estimate(4, m.arrived_at_s)
        where = estimator.estimate(4, 3.0)
        assert isinstance(where, Estimate)
        answers.append(where)
    np.testing.assert_allclose(answers[0].position_enu_m, answers[1].position_enu_m, rtol=1e-9)
    np.testing.assert_allclose(answers[0].covariance, answers[1].covariance, rtol=1e-9, atol=1e-12)


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
def test_no_geometry_and_no_length_of_flight_breaks_the_covariance(peers, subject, sigma_m, with_altitude, spacing_s, seed):
    """Collinear, coincident, one, none, near, far, overhead; with 1200 s between rounds the flight lasts 13 hours."""
    rng = np.random.default_rng(seed)
    estimator = FleetFilter()
    here = np.array(subject)
    estimator.add(PositionMeasurement(9, 0.0, 0.0, subject, 1.0, 1.0, (0.0, 0.0, 0.0), 0.5))
    estimator.set_subjects({9}, 0.01)
    for k in range(1, 40):
        t = spacing_s * k
        for v, peer in enumerate(peers):
            estimator.add(PositionMeasurement(v, t, t, peer, 1.0, 1.0, (0.0, 0.0, 0.0), 0.5))
            r = max(0.0, float(np.linalg.norm(here - np.array(peer))) + sigma_m * rng.normal())
            estimator.add(RangeMeasurement(9, v, t, t, r, sigma_m))
        if with_altitude:
            estimator.add(AltitudeMeasurement(9, t, t, subject[2], 2.0))
        for vehicle in (9, *range(len(peers))):
            where = estimator.estimate(vehicle, t)
            if isinstance(where, Estimate):
                P = where.covariance
                np.testing.assert_array_equal(P, P.T)
                assert np.linalg.eigvalsh(P)[0] > 0.0
                assert math.isfinite(float(where.position_enu_m.sum()))
