from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from gcs_coloc.core.measurements import (
    AMBIGUOUS,
    AltitudeMeasurement,
    NoEstimate,
    NoEstimateReason,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.estimators.fleet.filter import FleetFilter

STEP_S = 0.2
LINE = {1: (0.0, -500.0), 2: (0.0, 500.0), 3: (0.0, 1500.0)}
ASIDE = {9: (900.0, 300.0)}
LOST_S = 3.0
UNTIL_S = 80.0


def track(kind: str, side: float) -> np.ndarray:
    """East and north every STEP_S of a flight at 20 m/s that comes up to the line of the peers (east = 0) and ...

    ... flies on straight, turns back at it, turns along and back, or weaves over it.
    """
    heading, place, places = math.radians(80.0), np.array([-300.0, 700.0]), []
    for k in range(round(UNTIL_S / STEP_S) + 1):
        t = k * STEP_S
        places.append(place * (side, 1.0))
        rate_degps = {
            "straight": 0.0,
            "bounce": -8.0 if 10.0 < t < 30.0 else 0.0,
            "graze": 8.0 if 8.0 < t < 20.0 else 0.0,
            "weave": 6.0 * math.sin(2.0 * math.pi * t / 40.0),
        }[kind]
        heading += math.radians(rate_degps) * STEP_S
        place = place + 20.0 * STEP_S * np.array([math.sin(heading), math.cos(heading)])
    return np.array(places)


@dataclass
class Flown:
    """Squared errors in sigmas and errors in m where an answer was given, by time in s; the reasons where not."""

    squares: dict[float, float]
    errors_m: dict[float, float]
    reasons: list[NoEstimateReason]


def fly(kind: str, seed: int, peers: dict[int, tuple[float, float]], aside_from_s: float = math.inf) -> Flown:
    """Fly with ranges of 2 m to the peers, and from a time on to one beside their line too."""
    rng = np.random.default_rng(seed)
    where = track(kind, 1.0 if seed % 2 else -1.0)
    estimator = FleetFilter()
    flown = Flown({}, {}, [])
    for k, here in enumerate(where[:-1]):
        t = round(k * STEP_S, 6)
        for v, place in (peers | ASIDE).items():
            report = (place[0] + rng.normal(), place[1] + rng.normal(), 100.0)
            estimator.add(PositionMeasurement(v, t, t, report, 1.0, 1.0, (0.0, 0.0, 0.0), 0.3))
        if t < LOST_S:
            ve, vn = ((where[k + 1] - here) / STEP_S).tolist()
            e, n = (here + rng.normal(size=2)).tolist()
            estimator.add(PositionMeasurement(4, t, t, (e, n, 120.0), 1.0, 1.0, (ve, vn, 0.0), 0.3))
            continue
        estimator.set_denied({4}, t)
        estimator.add(AltitudeMeasurement(4, t, t, 120.0 + 0.3 * rng.normal(), 1.0))
        for v, place in (peers | (ASIDE if t >= aside_from_s else {})).items():
            r = math.dist((*here, 120.0), (*place, 100.0)) + 2.0 * rng.normal()
            estimator.add(RangeMeasurement(4, v, t, t, r, 2.0))
        answer = estimator.estimate(4, t)
        if isinstance(answer, NoEstimate):
            flown.reasons.append(answer.reason.reason)
            continue
        d = answer.position_enu_m[:2] - here
        flown.errors_m[t] = float(np.hypot(*d))
        flown.squares[t] = float(d @ np.linalg.solve(answer.covariance[:2, :2], d))
    return flown


@pytest.mark.parametrize("kind", ["straight", "bounce", "graze", "weave"])
def test_beside_a_line_of_peers_the_wrong_side_is_never_stated_with_confidence(kind):
    flights = [fly(kind, seed, dict(list(LINE.items())[: 2 + seed // 2 % 2])) for seed in range(6)]
    squares = np.concatenate([list(f.squares.values()) for f in flights])
    # Two degrees of freedom: 36 is six sigmas, 1e-8 by chance. Of the mean, 2 if honest, flights of 80 s have some ten
    # independent parts each: 60 parts leave it below 2.9 with 99.9 %.
    assert squares.max() < 36.0
    assert squares.mean() < 2.9
    for f in flights:
        assert set(f.reasons) <= {*AMBIGUOUS, NoEstimateReason.TOO_UNCERTAIN}


def test_a_turn_at_the_line_leaves_both_sides_possible_and_a_straight_crossing_does_not():
    turned, straight = fly("bounce", 2, LINE), fly("straight", 2, LINE)
    assert not AMBIGUOUS.isdisjoint(turned.reasons)
    assert straight.reasons == []
    assert max(straight.errors_m.values()) < 20.0


@pytest.mark.parametrize("seed", range(4))
def test_a_peer_beside_the_line_decides_within_seconds(seed):
    flown = fly("bounce", seed, LINE, aside_from_s=50.0)
    assert min(t for t in flown.errors_m if t >= 50.0) < 53.0
    after = [e for t, e in flown.errors_m.items() if t >= 53.0]
    # Some 2 m of range noise averaged over seconds, dilution below 3.
    assert len(after) == round((UNTIL_S - 53.0) / STEP_S)
    assert max(after) < 15.0
