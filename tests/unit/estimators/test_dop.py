import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcs_coloc.estimators.qu_zhang.fix import cofactor_diagonal, horizontal_dilution


def compass(*bearings_deg: float) -> np.ndarray:
    angles = np.radians(bearings_deg)
    return np.column_stack([np.sin(angles), np.cos(angles)])


def test_four_peers_on_the_compass_points() -> None:
    # G'G = diag(2, 2).
    assert horizontal_dilution(compass(0, 90, 180, 270)) == pytest.approx(1.0)


def test_two_peers_at_an_angle() -> None:
    # For two directions alpha apart, trace((G'G)^-1) = 2 / sin(alpha)^2.
    assert horizontal_dilution(compass(10, 50)) == pytest.approx(math.sqrt(2) / math.sin(math.radians(40)))


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_peers_are_infinite(count: int) -> None:
    assert horizontal_dilution(compass(0, 90)[:count]) == math.inf


def test_parallel_directions_are_infinite() -> None:
    assert horizontal_dilution(compass(30, 30, 210)) == math.inf


def test_a_level_fleet_sees_no_height_but_a_fine_horizontal_position() -> None:
    level = np.column_stack([compass(0, 90, 180, 270), np.zeros(4)])

    assert cofactor_diagonal(level) == pytest.approx([0.5, 0.5, math.inf])
    assert horizontal_dilution(level) == pytest.approx(1.0)


def test_stacks_of_geometries_agree_with_one_by_one() -> None:
    stack = np.stack([compass(0, 90, 200), compass(0, 10, 20), compass(45, 45, 45)])

    assert horizontal_dilution(stack) == pytest.approx([float(horizontal_dilution(one)) for one in stack])


@given(st.lists(st.floats(0, 360), min_size=2, max_size=8))
def test_the_dilution_is_the_root_of_the_inverse_trace(bearings: list[float]) -> None:
    u = compass(*bearings)
    normal = u.T @ u
    if np.linalg.cond(normal) < 1e8:
        assert horizontal_dilution(u) == pytest.approx(math.sqrt(np.trace(np.linalg.inv(normal))), rel=1e-6)


@given(st.lists(st.tuples(st.floats(0, 360), st.floats(-90, 90)), max_size=6))
def test_one_more_peer_never_makes_it_worse(directions: list[tuple[float, float]]) -> None:
    bearings = compass(*[bearing for bearing, _ in directions], 77.0)
    elevations = np.radians([*[elevation for _, elevation in directions], 12.0])
    u = np.column_stack([bearings * np.cos(elevations)[:, np.newaxis], np.sin(elevations)])

    fewer, more = float(horizontal_dilution(u[:-1])), float(horizontal_dilution(u))

    assert not math.isnan(more)
    assert more <= fewer * (1 + 1e-6) or fewer > 1e6


def test_a_direction_that_does_not_exist_counts_for_nothing() -> None:
    with_nan = np.vstack([compass(0, 90), [math.nan, math.nan]])

    assert horizontal_dilution(with_nan) == horizontal_dilution(compass(0, 90))


def test_the_cofactor_diagonal_is_scale_free() -> None:
    assert cofactor_diagonal(np.array([[1e-200, 0.0], [0.0, 1e-200]])) == pytest.approx([math.inf, math.inf])
    assert cofactor_diagonal(np.array([[1e-9, 0.0], [0.0, 1e-9]])) == pytest.approx([1e18, 1e18])
