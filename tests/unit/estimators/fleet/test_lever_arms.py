"""Antennas beside the reference point: every part of the fleet filter predicts the range between the antennas."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    Measurement,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.qu_zhang.filter import QuZhangFilter

BODY, SIGMA_M, EVERY_S = 9, 0.1, 0.05
ANCHORS = {1: (-4.0, 0.0, 1.5), 2: (4.0, 0.0, 1.5)}
ANTENNAS = [(0.3, 0.3), (0.3, -0.3), (-0.3, 0.3), (-0.3, -0.3)]
NO_ARM = (0.0, 0.0, 0.0)


def body_at(t: float, side: float) -> np.ndarray:
    return np.array([2.0 * math.sin(0.3 * t), side * (2.5 + math.cos(0.25 * t)), 1.0])


def lever_arms(t: float, yaw_error_rad: float = 0.0) -> list[np.ndarray]:
    """Those of the antennas, ENU in m, as the body turns."""
    c, s = math.cos(0.4 * t + yaw_error_rad), math.sin(0.4 * t + yaw_error_rad)
    return [np.array([c * x - s * y, s * x + c * y, 0.0]) for x, y in ANTENNAS]


def between_two_anchors(side: float, *, yaw_error_rad: float = 0.0, is_from: bool = True) -> Iterator[Measurement]:
    """Ranges of a body with four antennas to two anchors, and its heights; the lever arms as they are given."""
    rng = np.random.default_rng(1)
    yield VehicleClassReport(BODY, 0.0, 0.0, VehicleClass.INDOOR)
    for anchor, place in ANCHORS.items():
        yield PositionMeasurement(anchor, 0.0, 0.0, place, 0.03, 0.03, static=True)
    for t in np.arange(0.0, 12.0, EVERY_S).tolist():
        here, arms, said = body_at(t, side), lever_arms(t), lever_arms(t, yaw_error_rad)
        yield AltitudeMeasurement(BODY, t, t, here[2] + 0.05 * rng.normal(), 0.1)
        for anchor, place in ANCHORS.items():
            i = int(rng.integers(len(arms)))
            range_m = math.dist(here + arms[i], place) + SIGMA_M * rng.normal()
            e, n, u = said[i].tolist()
            if is_from:
                yield RangeMeasurement(BODY, anchor, t, t, range_m, SIGMA_M, i + 1, offset_enu_m=(-e, -n, -u))
            else:
                yield RangeMeasurement(anchor, BODY, t, t, range_m, SIGMA_M, i + 1, offset_enu_m=(e, n, u))


def located(measurements: Iterator[Measurement], side: float) -> list[tuple[float, float]]:
    """The horizontal errors and 95 % bounds, m, at the estimates of a body that was never located before."""
    estimator, found = FleetFilter(), []
    estimator.set_denied({BODY}, 0.0)
    for m in measurements:
        estimator.add(m)
        if isinstance(m, AltitudeMeasurement) and isinstance(where := estimator.estimate(BODY, m.measured_at_s), Estimate):
            error_m = math.dist(where.position_enu_m[:2], body_at(m.measured_at_s, side)[:2])
            found.append((error_m, horizontal_bound_95_m(where.covariance[:3, :3])))
    return found


@pytest.mark.parametrize("is_from", [True, False])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_four_antennas_between_two_anchors_are_located_on_the_right_side(side: float, is_from: bool):
    """The reference points alone leave both sides of the anchors open."""
    found = located(between_two_anchors(side, is_from=is_from), side)
    assert len(found) > 0.9 * 12.0 / EVERY_S
    assert math.sqrt(np.mean([error_m**2 for error_m, _ in found])) < 0.15
    assert all(error_m < 2.0 * bound_m for error_m, bound_m in found)


@pytest.mark.parametrize("yaw_error_deg", [-10.0, 10.0])
def test_a_wrong_attitude_is_within_the_bound(yaw_error_deg: float):
    found = located(between_two_anchors(1.0, yaw_error_rad=math.radians(yaw_error_deg)), 1.0)
    assert np.mean([error_m <= bound_m for error_m, bound_m in found]) > 0.9
    assert all(error_m < 3.0 * bound_m for error_m, bound_m in found)


AROUND = {1: (0.0, 0.0, 0.0), 2: (60.0, 5.0, 10.0), 3: (30.0, 50.0, 3.0), 4: (-10.0, 40.0, 8.0)}


def ranged_by_four(*, are_virtual: bool) -> Iterator[Measurement]:
    """Exact ranges of a body to four anchors, each with a lever arm of its own, or to virtual anchors without any."""
    arms = {1: (2.0, 0.0, 0.0), 2: (0.0, 2.0, 0.0), 3: (-1.0, 1.0, 1.0), 4: (0.0, -2.0, -1.0)}
    virtual = {anchor: tuple(np.add(place, arms[anchor]).tolist()) for anchor, place in AROUND.items()}
    for anchor in AROUND:
        place = virtual[anchor] if are_virtual else AROUND[anchor]
        yield PositionMeasurement(anchor, 0.0, 0.0, place, 0.1, 0.1, static=True)
    for k in range(100):
        t = 0.1 * k
        yield AltitudeMeasurement(BODY, t, t, 5.0, 0.3)
        for anchor, seen in virtual.items():
            range_m = math.dist((20.0 + t, 25.0 - t, 5.0), seen)
            yield RangeMeasurement(BODY, anchor, t, t, range_m, 0.5, offset_enu_m=NO_ARM if are_virtual else arms[anchor])


@pytest.mark.parametrize("estimator_class", [FleetFilter, QuZhangFilter])
def test_a_lever_arm_makes_of_an_anchor_a_virtual_one(estimator_class: type[FleetFilter | QuZhangFilter]):
    answers = []
    for are_virtual in (True, False):
        estimator = estimator_class()
        estimator.set_denied({BODY}, 0.0)
        for m in ranged_by_four(are_virtual=are_virtual):
            estimator.add(m)
        answers.append(estimator.estimate(BODY, 10.0))
    virtual, with_arms = answers
    assert isinstance(virtual, Estimate)
    assert isinstance(with_arms, Estimate)
    assert virtual.position_enu_m == pytest.approx((30.0, 15.0, 5.0), abs=1.0)
    np.testing.assert_allclose(with_arms.position_enu_m, virtual.position_enu_m, atol=1e-3)
    np.testing.assert_allclose(with_arms.covariance, virtual.covariance, rtol=1e-2, atol=1e-3)


def test_two_bodies_take_the_range_between_their_antennas():
    """The lever arms are as long as the antennas of the one are ahead, and those of the other behind."""
    estimator, known = FleetFilter(), (0.0, 0.0, 0.0)
    estimator.add(PositionMeasurement(BODY, 0.0, 0.0, (0.0, 29.0, 0.0), 1.0, 1.0, NO_ARM, 0.1))
    estimator.set_denied({BODY}, 0.05)
    for t in np.arange(0.1, 3.0, 0.1).tolist():
        estimator.add(PositionMeasurement(1, t, t, known, 0.05, 0.05, NO_ARM, 0.05))
        estimator.add(RangeMeasurement(1, BODY, t, t, 27.0, SIGMA_M, offset_enu_m=(0.0, -2.0 - 1.0, 0.0)))
    where = estimator.estimate(BODY, 3.0)
    assert isinstance(where, Estimate)
    assert where.position_enu_m[1] == pytest.approx(30.0, abs=0.3)
