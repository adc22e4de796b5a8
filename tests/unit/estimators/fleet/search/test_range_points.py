from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcs_coloc.estimators.fleet.search.gaussian_mixture import range_points

RANGE_M, FINE_M = 10.0, 1.5
OPEN, KNOWN = np.diag([400.0, 400.0, 400.0]), np.diag([400.0, 400.0, 0.01])


def total(point_m: np.ndarray, covariance_m2: np.ndarray) -> float:
    """Return the sum of eq. (27) at a place, over the points on its side of the peer: on the other one the range is another."""
    unit, along, spacing_m = range_points(np.array([0.0, 0.0, 2.0]), covariance_m2, RANGE_M, FINE_M)
    here = unit @ point_m > 0.0
    apart = np.einsum("kni,ki->kn", along[here], RANGE_M * unit[here] - point_m) / spacing_m
    return float((np.exp(-0.5 * apart**2) / math.sqrt(2.0 * math.pi)).prod(axis=1).sum())


@given(azimuth_rad=st.floats(0.0, 6.28), up=st.floats(-1.0, 1.0))
def test_where_the_height_is_open_no_part_of_the_sphere_counts_more_than_another(azimuth_rad: float, up: float):
    """Circles at several heights counted what is right above the peer many times, and so the vehicle came out there."""
    level = math.sqrt(1.0 - up * up)
    point_m = RANGE_M * np.array([level * math.sin(azimuth_rad), level * math.cos(azimuth_rad), up])
    # It is a little more than 1: the points are 0.37 of the radius apart, and a sphere bends away from its tangent plane.
    assert total(point_m, OPEN) == pytest.approx(1.25, rel=0.15)


@given(azimuth_rad=st.floats(0.0, 6.28))
def test_where_the_height_is_known_no_part_of_the_circle_counts_more_than_another(azimuth_rad: float):
    level_m = math.sqrt(RANGE_M**2 - 2.0**2)
    point_m = np.array([level_m * math.sin(azimuth_rad), level_m * math.cos(azimuth_rad), 2.0])
    assert total(point_m, KNOWN) == pytest.approx(1.0, rel=0.2)


@pytest.mark.parametrize("from_peer_m", [(3.0, 4.0, 2.0), (0.0, 0.0, 9.9), (0.0, 0.0, -30.0)])
@pytest.mark.parametrize("covariance_m2", [OPEN, KNOWN], ids=["open", "known"])
@pytest.mark.parametrize("fine_m", [0.01, 1.5, 20.0])
def test_points_are_at_the_range_and_their_directions_follow_the_sphere(from_peer_m, covariance_m2, fine_m):
    unit, along, spacing_m = range_points(np.array(from_peer_m), covariance_m2, RANGE_M, fine_m)
    assert 0 < len(unit) <= 90
    assert spacing_m > 0.0
    np.testing.assert_allclose(np.linalg.norm(unit, axis=1), 1.0)
    np.testing.assert_allclose(np.linalg.norm(along, axis=2), 1.0)
    np.testing.assert_allclose(np.einsum("kni,ki->kn", along, unit), 0.0, atol=1e-12)


def test_only_points_where_the_vehicle_may_be_are_taken_and_so_they_may_be_finer():
    everywhere = range_points(np.array([10.0, 0.0, 0.0]), OPEN, RANGE_M, 0.5)
    unit, _, spacing_m = range_points(np.array([10.0, 0.0, 0.0]), np.eye(3), RANGE_M, 0.5)
    assert spacing_m < 0.7 * everywhere.spacing_m
    assert unit[:, 0].min() > 0.0


def test_a_peer_right_above_has_no_circle():
    """All points of its circle are at one place there, and none is a little aside."""
    unit, along, _ = range_points(np.array([0.0, 0.0, -9.95]), KNOWN, RANGE_M, FINE_M)
    assert along.shape[1] == 2
    assert np.hypot(unit[:, 0], unit[:, 1]).min() < 0.2
