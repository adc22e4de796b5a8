import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcs_coloc.core.error_ellipse import horizontal_dilution_of


def compass(*bearings_deg: float) -> list[tuple[float, float, float]]:
    return [(math.sin(math.radians(bearing)), math.cos(math.radians(bearing)), 0.0) for bearing in bearings_deg]


def test_four_peers_on_the_compass_points() -> None:
    # G'G = diag(2, 2).
    assert horizontal_dilution_of(compass(0, 90, 180, 270)) == pytest.approx(1.0)


def test_two_peers_at_an_angle() -> None:
    # For two directions alpha apart, trace((G'G)^-1) = 2 / sin(alpha)^2.
    assert horizontal_dilution_of(compass(10, 50)) == pytest.approx(math.sqrt(2) / math.sin(math.radians(40)))


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_peers_are_infinite(count: int) -> None:
    assert horizontal_dilution_of(compass(0, 90)[:count]) == math.inf


def test_parallel_directions_are_infinite() -> None:
    assert horizontal_dilution_of(compass(30, 30, 210)) == math.inf


@given(st.lists(st.floats(0, 360), min_size=2, max_size=8))
def test_the_dilution_is_the_root_of_the_inverse_trace(bearings: list[float]) -> None:
    u = np.array(compass(*bearings))[:, :2]
    normal = u.T @ u
    if np.linalg.cond(normal) < 1e8:
        assert horizontal_dilution_of(compass(*bearings)) == pytest.approx(math.sqrt(np.trace(np.linalg.inv(normal))), rel=1e-6)


@given(st.lists(st.tuples(st.floats(0, 360), st.floats(-90, 90)), max_size=6))
def test_one_more_peer_never_makes_it_worse(directions: list[tuple[float, float]]) -> None:
    level, elevations = compass(*[bearing for bearing, _ in directions], 77.0), [*[each for _, each in directions], 12.0]
    u = [
        (e * math.cos(math.radians(up)), n * math.cos(math.radians(up)), math.sin(math.radians(up)))
        for (e, n, _), up in zip(level, elevations, strict=True)
    ]
    fewer, more = horizontal_dilution_of(u[:-1]), horizontal_dilution_of(u)
    assert more <= fewer * (1 + 1e-6) or fewer > 1e6
