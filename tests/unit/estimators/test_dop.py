import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcs_coloc.estimators.qu_zhang.dop import cofactor_diagonal, dilution, horizontal_dilution, horizontal_dilution_of


def compass(*bearings_deg: float) -> np.ndarray:
    angles = np.radians(bearings_deg)
    return np.column_stack([np.sin(angles), np.cos(angles)])


# Regular tetrahedron: the sum of u u' over its 4 corners is (4/3) I, and the sum of u is 0.
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / math.sqrt(3)


def test_regular_tetrahedron_has_the_textbook_values() -> None:
    d = dilution(TETRAHEDRON, clock=True)

    assert d.pdop == pytest.approx(1.5)
    assert d.hdop == pytest.approx(math.sqrt(1.5))
    assert d.vdop == pytest.approx(math.sqrt(0.75))
    assert d.tdop == pytest.approx(0.5)
    assert d.gdop == pytest.approx(math.sqrt(2.5))


def test_without_a_clock_gdop_is_pdop() -> None:
    d = dilution(TETRAHEDRON, clock=False)

    assert d.tdop is None
    assert d.gdop == d.pdop == pytest.approx(1.5)


def test_four_peers_on_the_compass_points() -> None:
    # G'G = diag(2, 2) and with a clock diag(2, 2, 4).
    plane = compass(0, 90, 180, 270)

    assert dilution(plane, clock=False).hdop == pytest.approx(1.0)
    with_clock = dilution(plane, clock=True)
    assert with_clock.hdop == pytest.approx(1.0)
    assert with_clock.tdop == pytest.approx(0.5)
    assert with_clock.vdop is None


def test_two_peers_at_an_angle() -> None:
    # For two directions alpha apart, trace((G'G)^-1) = 2 / sin(alpha)^2.
    assert horizontal_dilution(compass(10, 50)) == pytest.approx(math.sqrt(2) / math.sin(math.radians(40)))


def test_a_cone_of_three_satellites_and_one_overhead() -> None:
    # Three at elevation e, evenly spread, and the zenith: the classic four-satellite geometry. By symmetry the horizontal block
    # of G'G is (3/2) cos(e)^2 I; up and clock form [[3 s^2 + 1, 3 s + 1], [3 s + 1, 4]] with determinant 3 (1 - s)^2.
    elevation = math.radians(5)
    s, c = math.sin(elevation), math.cos(elevation)
    ring = np.column_stack([c * compass(0, 120, 240), np.full(3, s)])
    d = dilution(np.vstack([ring, [0, 0, 1]]), clock=True)

    assert d.hdop == pytest.approx(math.sqrt(2 / (1.5 * c**2)))
    assert d.vdop == pytest.approx(math.sqrt(4 / (3 * (1 - s) ** 2)))
    assert d.tdop == pytest.approx(math.sqrt((3 * s**2 + 1) / (3 * (1 - s) ** 2)))


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_peers_are_infinite(count: int) -> None:
    assert horizontal_dilution(compass(0, 90)[:count]) == math.inf
    assert dilution(compass(0, 90)[:count], clock=True).gdop == math.inf


def test_parallel_directions_are_infinite() -> None:
    assert horizontal_dilution(compass(30, 30, 210)) == math.inf


def test_a_clock_column_makes_equal_directions_singular_and_leaves_others_alone() -> None:
    # Two peers in one direction: two distinct rows for three unknowns.
    assert dilution(compass(0, 0, 90), clock=True).hdop == math.inf
    assert math.isfinite(dilution(compass(0, 0, 90), clock=False).hdop)


def test_a_level_fleet_sees_no_height_but_a_fine_horizontal_position() -> None:
    level = np.column_stack([compass(0, 90, 180, 270), np.zeros(4)])
    d = dilution(level, clock=False)

    assert d.vdop == math.inf
    assert d.pdop == math.inf
    assert d.hdop == pytest.approx(1.0)


def test_stacks_of_geometries_agree_with_one_by_one() -> None:
    stack = np.stack([compass(0, 90, 200), compass(0, 10, 20), compass(45, 45, 45)])

    assert horizontal_dilution(stack) == pytest.approx([float(horizontal_dilution(one)) for one in stack])


@given(st.lists(st.floats(0, 360), min_size=2, max_size=8))
def test_the_dilution_is_the_root_of_the_inverse_trace(bearings: list[float]) -> None:
    u = compass(*bearings)
    normal = u.T @ u
    if np.linalg.cond(normal) < 1e8:
        assert horizontal_dilution(u) == pytest.approx(math.sqrt(np.trace(np.linalg.inv(normal))), rel=1e-6)


@given(st.lists(st.tuples(st.floats(0, 360), st.floats(-90, 90)), max_size=6), st.booleans())
def test_one_more_peer_never_makes_it_worse(directions: list[tuple[float, float]], clock: bool) -> None:
    bearings = compass(*[bearing for bearing, _ in directions], 77.0)
    elevations = np.radians([*[elevation for _, elevation in directions], 12.0])
    u = np.column_stack([bearings * np.cos(elevations)[:, np.newaxis], np.sin(elevations)])

    fewer, more = dilution(u[:-1], clock=clock).hdop, dilution(u, clock=clock).hdop

    assert not math.isnan(more)
    assert more <= fewer * (1 + 1e-6) or fewer > 1e6


def test_a_direction_that_does_not_exist_counts_for_nothing() -> None:
    with_nan = np.vstack([compass(0, 90), [math.nan, math.nan]])

    assert horizontal_dilution(with_nan) == horizontal_dilution(compass(0, 90))


def test_the_cofactor_diagonal_is_scale_free() -> None:
    assert cofactor_diagonal(np.array([[1e-200, 0.0], [0.0, 1e-200]])) == pytest.approx([math.inf, math.inf])
    assert cofactor_diagonal(np.array([[1e-9, 0.0], [0.0, 1e-9]])) == pytest.approx([1e18, 1e18])


@given(st.lists(st.tuples(st.floats(0.0, 6.28), st.floats(-1.5, 1.5)), min_size=2, max_size=8))
def test_the_quick_horizontal_dilution_is_the_thorough_one(directions) -> None:
    units = [(math.sin(a) * math.cos(up), math.cos(a) * math.cos(up), math.sin(up)) for a, up in directions]
    thorough = float(horizontal_dilution(np.array(units)))
    quick = horizontal_dilution_of(units)
    # Below that the squares have lost what tells the directions apart; nobody flies by a dilution of a million.
    assert quick == pytest.approx(thorough, rel=1e-3) if thorough < 1e5 else quick > 1e4


def test_parallel_directions_have_no_quick_dilution_either() -> None:
    assert horizontal_dilution_of([(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)]) == math.inf
    assert horizontal_dilution_of([]) == math.inf
