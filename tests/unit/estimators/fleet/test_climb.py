from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.measurements import Estimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.ambiguity.reflection import ReflectionPlane, reflect
from gcs_coloc.estimators.fleet.ekf.cluster import ClusterSet
from gcs_coloc.estimators.fleet.ekf.records import VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import TURN
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.initialisation import block_from_estimate
from gcs_coloc.estimators.fleet.settings import FleetSettings

DENIED = 9
LOST_S, CLIMB_S, TOP_S, END_S = 5.0, 30.0, 70.0, 75.0


def denied_at(t: float) -> np.ndarray:
    return np.array([-300.0 + 15.0 * t, 5.0 * t, 200.0 + 5.0 * (min(max(t, CLIMB_S), TOP_S) - CLIMB_S)])


def climb(seed: int) -> list[float]:
    """Four peers at 100 to 200 m; the vehicle climbs from 200 m and tells no height. Returns its errors upwards in sigmas."""
    rng = np.random.default_rng(seed)
    peers = {
        p: (rng.uniform(-1500.0, 1500.0, 2), rng.uniform(0.0, 2.0 * math.pi), rng.uniform(100.0, 200.0)) for p in range(1, 5)
    }

    def peer_at(p: int, t: float) -> np.ndarray:
        (east, north), course, height = peers[p]
        return np.array([east + 22.0 * t * math.cos(course), north + 22.0 * t * math.sin(course), height])

    estimator = FleetFilter()
    errors = []
    for k in range(round(END_S * 10.0)):
        t = 0.1 * k
        if k == round(LOST_S * 10.0):
            estimator.set_denied({DENIED}, t)
        reports = {p: (peer_at(p, t), (peer_at(p, t + 0.1) - peer_at(p, t - 0.1)) / 0.2) for p in peers}
        if t < LOST_S:
            reports[DENIED] = (denied_at(t), np.array([15.0, 5.0, 0.0]))
        for vehicle, (place, velocity) in reports.items():
            p, u = place + 0.5 * rng.normal(size=3), velocity + 0.1 * rng.normal(size=3)
            estimator.add(PositionMeasurement(vehicle, t, t, tuple(p.tolist()), 1.0, 1.5, tuple(u.tolist()), 0.3))
        for p in peers if k % 2 == 0 and k > 20 else ():
            range_m = float(np.linalg.norm(denied_at(t) - peer_at(p, t))) + 2.0 * rng.normal()
            estimator.add(RangeMeasurement(DENIED, p, t, t, range_m, 2.0))
        if t > LOST_S + 3.0 and k % 2 == 0:
            where = estimator.estimate(DENIED, t)
            if isinstance(where, Estimate):
                errors.append(float(where.position_enu_m[2] - denied_at(t)[2]) / math.sqrt(where.covariance[2, 2]))
    return errors


@pytest.mark.parametrize("seed", [6, 10, 14])
def test_a_climb_through_the_height_of_the_peers_that_nobody_tells_leaves_the_height_open(seed):
    errors = climb(seed)
    assert len(errors) > 250
    assert max(map(abs, errors)) < 6.0


def test_the_mirror_image_above_a_level_plane_sinks_where_the_state_climbs_and_turns_as_it_does():
    records = {1: VehicleRecord(denied_vehicle=True)}
    clusters = ClusterSet(FleetSettings(), records)
    state = block_from_estimate(np.array([10.0, 20.0, 130.0, 5.0, 6.0, 3.0]), np.eye(6), FleetSettings())
    state[0][TURN] = 0.1
    cluster = clusters.initialise(1, *state, 0.0)
    before = cluster.joint.covariance(1).copy()
    reflect(cluster, 1, ReflectionPlane(np.array([0.0, 0.0, 100.0]), np.array([0.0, 0.0, 1.0]), 1.0, ranges_separate=False))
    np.testing.assert_allclose(cluster.joint.mean(1)[:6], [10.0, 20.0, 70.0, 5.0, 6.0, -1.0])
    assert cluster.joint.mean(1)[TURN] == pytest.approx(0.1)
    np.testing.assert_allclose(cluster.joint.covariance(1), before, atol=1e-12)
