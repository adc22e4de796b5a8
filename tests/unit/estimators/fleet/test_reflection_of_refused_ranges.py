from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import AltitudeMeasurement, Estimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.ambiguity.range_evidence import plane_of_refused_ranges, update_reflection_evidence
from gcs_coloc.estimators.fleet.ekf.outcomes import Outcome, UpdateResult
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.fleet_model import FleetModel
from gcs_coloc.estimators.fleet.settings import FleetSettings

DENIED, SPEED_MPS, HEIGHT_M = 9, 12.0, 100.0
LINE_M = {1: (-600.0, 0.0), 2: (650.0, 0.0)}
ASIDE_M = {3: (100.0, 700.0), 4: (-300.0, -650.0)}


def fly(
    peers: dict[int, tuple[float, float]], side: float, seed: int, late_from: int | None = None
) -> list[tuple[float, float, float]]:
    """Fly eastwards, 180 m north of the line of two peers, held to be at `side` times that; ranges of 1 m once a second.

    Returns time (s), horizontal error (m) and its 95 % bound (m) wherever a position is stated. The ranges to the peer
    `late_from` are all 40 m too long.
    """
    rng, estimator, out = np.random.default_rng(seed), FleetFilter(), []
    for v, (east_m, north_m) in peers.items():
        estimator.add(PositionMeasurement(v, 0.0, 0.0, (east_m, north_m, 0.0), 0.3, 0.3, static=True))
    start = (-200.0, 180.0 * side, HEIGHT_M)
    estimator.add(PositionMeasurement(DENIED, 0.0, 0.0, start, 1.5, 2.0, (SPEED_MPS, 0.0, 0.0), 0.3))
    estimator.set_denied({DENIED}, 0.05)
    for k in range(1, 25 * len(peers)):
        t = k / len(peers)
        here = (-200.0 + SPEED_MPS * t, 180.0, HEIGHT_M)
        estimator.add(AltitudeMeasurement(DENIED, t, t, HEIGHT_M + 0.3 * rng.normal(), 2.0))
        v = list(peers)[k % len(peers)]
        range_m = math.dist(here, (*peers[v], 0.0)) + rng.normal() + (40.0 if v == late_from else 0.0)
        estimator.add(RangeMeasurement(DENIED, v, t, t, range_m, 1.0))
        where = estimator.estimate(DENIED, t)
        if isinstance(where, Estimate):
            error_m = math.dist(where.position_enu_m[:2], here[:2])
            out.append((t, error_m, horizontal_bound_95_m(where.covariance)))
    return out


@pytest.mark.parametrize("aside", [(3,), (4,), (3, 4)])
@pytest.mark.parametrize("seed", [1, 2])
def test_one_held_to_be_at_its_mirror_image_is_found_by_the_ranges_that_it_refuses(aside, seed):
    stated = fly(LINE_M | {v: ASIDE_M[v] for v in aside}, -1.0, seed)
    late = [(error_m, bound_m) for t, error_m, bound_m in stated if t > 6.0]
    assert len(late) > 40
    assert max(error_m for error_m, _ in late) < 10.0
    assert max(bound_m for _, bound_m in late) < 20.0


def test_a_peer_whose_ranges_are_all_too_long_sends_nobody_to_the_other_side():
    stated = fly(LINE_M | {3: ASIDE_M[3]}, 1.0, 1, late_from=3)
    assert len(stated) > 70
    assert max(error_m for _, error_m, _ in stated) < 10.0


PLACES_M = {1: (-600.0, 0.0), 2: (650.0, 0.0), 3: (100.0, 700.0)}


@pytest.mark.parametrize(("refused", "opens"), [((3, 3), True), ((2, 3), False), ((2, 3, 3), True)])
def test_refused_ranges_count_together_only_on_the_other_side_of_the_same_peers(refused, opens):
    """Each fits at the mirror image beside the two other peers; the last one alone opened a hypothesis."""
    model, here = FleetModel(FleetSettings()), np.array([0.0, 180.0])
    for v, place_m in PLACES_M.items():
        model.apply(PositionMeasurement(v, 0.0, 0.0, (*place_m, 0.0), 0.3, 0.3, static=True))
    model.apply(PositionMeasurement(DENIED, 0.0, 0.0, (*here.tolist(), 0.0), 0.5, 0.5, (0.0, 0.0, 0.0), 0.3))
    model.set_denied(frozenset({DENIED}), 0.05)
    for v, place_m in PLACES_M.items():
        assert model.apply(RangeMeasurement(DENIED, v, 0.1, 0.1, math.dist(here, place_m), 1.0)).used
    cluster, evidence = model.clusters[DENIED], None
    for v in refused:
        first, second = (np.array(place_m) for other, place_m in PLACES_M.items() if other != v)
        along = (second - first) / np.linalg.norm(second - first)
        mirrored = 2.0 * (first + along * float(along @ (here - first))) - here
        m = RangeMeasurement(DENIED, v, 0.2, 0.2, math.dist(mirrored, PLACES_M[v]), 1.0)
        result = UpdateResult(Outcome.REFUSED_RANGE_GATE, 200.0, 2.0, 1e4, 1)
        evidence = update_reflection_evidence(evidence, cluster, DENIED, v, result, m)
    assert (plane_of_refused_ranges(evidence, cluster, DENIED, 0.2) is not None) is opens
