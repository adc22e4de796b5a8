"""The 95 % bound against chi-square in its two limits and against sampling in between; HDOP against a decomposition."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m, horizontal_dilution_of, horizontal_sigma_m, worst_sigma


def test_a_round_error_gives_chi_square_with_two_degrees_of_freedom():
    assert horizontal_bound_95_m(np.eye(3) * 9.0) == pytest.approx(3.0 * np.sqrt(chi2.ppf(0.95, 2)), rel=1e-4)


def test_an_error_along_one_line_gives_chi_square_with_one():
    direction = np.array([3.0, 4.0, 0.0])
    assert horizontal_bound_95_m(np.outer(direction, direction)) == pytest.approx(5.0 * np.sqrt(chi2.ppf(0.95, 1)), rel=1e-4)


@pytest.mark.parametrize("ratio", [0.15, 0.45, 0.75, 0.95])
def test_in_between_the_bound_covers_95_percent(ratio):
    rng = np.random.default_rng(8)
    errors = rng.normal(size=(400_000, 2)) * (2.0, 2.0 * ratio)
    inside = np.mean(np.hypot(*errors.T) <= horizontal_bound_95_m(np.diag([4.0, 4.0 * ratio**2, 1.0])))
    # Binomial: sigma of the share is sqrt(0.95 * 0.05 / 4e5) = 3.4e-4; 4 sigma, and 5e-4 for the table's interpolation.
    assert inside == pytest.approx(0.95, abs=4 * 3.4e-4 + 5e-4)


@given(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3), st.floats(0.0, np.pi))
def test_it_does_not_depend_on_the_axes_directions(a, b, angle):
    c, s = np.cos(angle), np.sin(angle)
    turned = np.array([[c, -s], [s, c]]) @ np.diag([a, b]) @ np.array([[c, s], [-s, c]])
    assert horizontal_bound_95_m(turned) == pytest.approx(horizontal_bound_95_m(np.diag([a, b])), rel=1e-4)
    assert horizontal_sigma_m(turned) == pytest.approx(np.sqrt(max(a, b)), rel=1e-6)


def test_no_error_is_no_bound():
    assert horizontal_bound_95_m(np.zeros((3, 3))) == 0.0


def test_the_worst_of_three_directions_is_the_root_of_the_largest_eigenvalue():
    rng = np.random.default_rng(5)
    for k in range(300):
        root = rng.standard_normal((3, 3)) * 10.0 ** rng.uniform(-3.0, 3.0, 3)
        covariance = root @ root.T if k % 3 else np.diag(10.0 ** rng.integers(-2, 2, 3))
        assert worst_sigma(covariance) == pytest.approx(np.sqrt(np.linalg.eigvalsh(covariance)[-1]), rel=1e-7)
    assert worst_sigma(np.eye(3) * 4.0) == 2.0
    assert worst_sigma(np.zeros((3, 3))) == 0.0


@given(st.lists(st.tuples(st.floats(0.0, 6.28), st.floats(-1.5, 1.5)), min_size=2, max_size=8))
def test_the_quick_horizontal_dilution_is_the_thorough_one(directions) -> None:
    units = [(math.sin(a) * math.cos(up), math.cos(a) * math.cos(up), math.sin(up)) for a, up in directions]
    # trace((G'G)^-1) by the singular values of G, whose squares lose nothing.
    singular = np.linalg.svd(np.array(units)[:, :2], compute_uv=False).tolist()
    thorough = math.hypot(*(1.0 / each for each in singular)) if min(singular) > 1e-12 else math.inf
    quick = horizontal_dilution_of(units)
    # Below that the squares have lost what tells the directions apart; nobody flies by a dilution of a million.
    assert quick == pytest.approx(thorough, rel=1e-3) if thorough < 1e5 else quick > 1e4


def test_parallel_directions_have_no_quick_dilution_either() -> None:
    assert horizontal_dilution_of([(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)]) == math.inf
    assert horizontal_dilution_of([]) == math.inf
