import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st

from gcs_coloc.estimators.qu_zhang.cv_filter import (
    CvFilter,
    density,
    nis,
    position_rows,
    step_noise,
    transition,
    velocity_rows,
    white_acceleration_noise,
)


def fresh(axes: int = 2, density_m2ps3: float = 3.0) -> CvFilter:
    return CvFilter(10.0, np.arange(axes) + 1.0, 4.0 * np.eye(axes), np.full(axes, 5.0), 9.0, density_m2ps3, memory_s=1.0)


def test_a_start_lays_position_and_velocity_out_axis_by_axis() -> None:
    one = fresh()

    assert one.state == pytest.approx([1.0, 5.0, 2.0, 5.0])
    assert np.diag(one.covariance) == pytest.approx([4.0, 9.0, 4.0, 9.0])


def test_the_matrices_are_the_papers() -> None:
    assert transition(0.02, 2).tolist() == [[1, 0.02, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.02], [0, 0, 0, 1]]
    assert position_rows(2).tolist() == [[1, 0, 0, 0], [0, 0, 1, 0]]
    assert velocity_rows(2).tolist() == [[0, 1, 0, 0], [0, 0, 0, 1]]
    assert np.diag(step_noise(7.0, 2)).tolist() == [0, 7, 0, 7]


def test_white_acceleration_noise_agrees_with_filterpy() -> None:
    expected = Q_continuous_white_noise(dim=2, dt=0.7, spectral_density=2.5, block_size=2)

    assert white_acceleration_noise(0.7, 2.5, 2) == pytest.approx(expected)


def test_the_papers_q_is_the_same_velocity_noise_as_its_density() -> None:
    per_step = step_noise(5.0, 1)[1, 1]

    assert white_acceleration_noise(0.02, density(5.0, 0.02), 1)[1, 1] == pytest.approx(per_step)


@given(st.floats(0.001, 5), st.floats(0.001, 5), st.floats(0.01, 100))
def test_the_noise_of_a_span_does_not_depend_on_how_it_is_cut(first: float, second: float, spectral: float) -> None:
    F = transition(second, 2)
    in_two = F @ white_acceleration_noise(first, spectral, 2) @ F.T + white_acceleration_noise(second, spectral, 2)

    assert in_two == pytest.approx(white_acceleration_noise(first + second, spectral, 2))


def test_in_order_updates_agree_with_a_plain_filterpy_filter() -> None:
    rng = np.random.default_rng(1)
    ours, theirs = fresh(), KalmanFilter(dim_x=4, dim_z=2)
    theirs.x = np.array([[1.0], [5.0], [2.0], [5.0]])
    theirs.P = np.diag([4.0, 9.0, 4.0, 9.0])
    H, R = position_rows(2), np.array([[2.0, 0.5], [0.5, 3.0]])
    at_s = 10.0
    for dt_s in rng.uniform(0.01, 1.0, 50):
        at_s += dt_s
        z = rng.normal(0.0, 5.0, 2)
        theirs.predict(F=transition(dt_s, 2), Q=Q_continuous_white_noise(2, dt_s, 3.0, 2))
        theirs.update(z.reshape(2, 1), R=R, H=H)
        ours.update(z, R, H, at_s)

    assert ours.state == pytest.approx(theirs.x[:, 0], rel=1e-9)
    assert ours.covariance == pytest.approx(theirs.P, rel=1e-9)


def test_prediction_leaves_the_filter_as_it_is() -> None:
    one = fresh()
    state, covariance = one.predicted(12.0)

    assert state == pytest.approx([11.0, 5.0, 12.0, 5.0])
    assert covariance[0, 0] == pytest.approx(4 + 9 * 4 + 3 * 8 / 3)
    assert one.at_s == 10.0
    assert one.state == pytest.approx([1.0, 5.0, 2.0, 5.0])


def test_stepping_back_undoes_the_motion_and_adds_uncertainty() -> None:
    state, covariance = fresh().predicted(8.0)

    assert state == pytest.approx([-9.0, 5.0, -8.0, 5.0])
    assert covariance[0, 0] == pytest.approx(4 + 9 * 4 + 3 * 8 / 3)


@given(st.permutations(range(6)), st.integers(0, 2**32 - 1))
def test_the_order_of_arrival_makes_no_difference(order: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    H, R = position_rows(2), np.array([[2.0, 0.5], [0.5, 3.0]])
    measurements = [(10.5 + 0.15 * k, rng.normal(0.0, 5.0, 2), {9: rng.normal(size=(2, 3))}) for k in range(6)]
    in_order, shuffled = fresh(density_m2ps3=50.0), fresh(density_m2ps3=50.0)
    # The first is the same for both: nothing may be older than the state that a filter starts from.
    for one in (in_order, shuffled):
        one.update(np.zeros(2), R, H, 10.4)
    for at_s, z, lasting in measurements:
        in_order.update(z, R, H, at_s, lasting)
    for k in order:
        at_s, z, lasting = measurements[k]
        shuffled.update(z, R, H, at_s, lasting)

    assert shuffled.at_s == in_order.at_s
    assert shuffled.state == pytest.approx(in_order.state, rel=1e-9)
    assert shuffled.covariance == pytest.approx(in_order.covariance, rel=1e-9)
    assert shuffled.sensitivities[9] == pytest.approx(in_order.sensitivities[9], rel=1e-9)


def test_what_is_older_than_the_memory_is_too_late() -> None:
    one = fresh()
    H, R = position_rows(2), np.eye(2)
    assert one.is_too_late(9.9)
    for at_s in (10.5, 11.0, 12.0):
        one.update(np.zeros(2), R, H, at_s)

    assert not one.is_too_late(11.1)
    assert one.is_too_late(10.9)
    with pytest.raises(ValueError, match="too late"):
        one.update(np.zeros(2), R, H, 10.9)


def test_a_lasting_error_enters_as_far_as_the_sensitivities_say() -> None:
    # The filter is linear: feed it the same measurements with and without an offset, and compare.
    rng = np.random.default_rng(2)
    H, R, offset = position_rows(2), 4.0 * np.eye(2), np.array([3.0, -1.0, 2.0])
    place = rng.normal(size=(2, 3))
    clean = CvFilter(0.0, np.zeros(2), R, np.zeros(2), 100.0, 5.0, memory_s=1.0)
    off = CvFilter(0.0, place @ offset, R, np.zeros(2), 100.0, 5.0, memory_s=1.0, sensitivities={4: place})
    for step in range(1, 20):
        z, sensitivity = rng.normal(0.0, 2.0, 2), rng.normal(size=(2, 3))
        clean.update(z, R, H, 0.3 * step)
        off.update(z + sensitivity @ offset, R, H, 0.3 * step, {4: sensitivity})

    assert off.state - clean.state == pytest.approx(off.sensitivities[4] @ offset, rel=1e-9)
    late = off.predicted(7.0)[0] - clean.predicted(7.0)[0]
    assert late == pytest.approx(off.predicted_sensitivities(7.0)[4] @ offset, rel=1e-9)


def test_the_filter_is_consistent_on_its_own_model() -> None:
    # 300 independent runs of 2 position axes: the mean NEES of 4 states is chi-square with 1200 degrees of freedom over 300, so
    # its standard deviation is sqrt(2 * 4 / 300) = 0.163; the band is 4 of these.
    rng = np.random.default_rng(7)
    spectral, R, H = 2.0, 9.0 * np.eye(2), position_rows(2)
    total = 0.0
    for _ in range(300):
        truth = rng.normal(0.0, [3.0, 4.0, 3.0, 4.0])
        one = CvFilter(0.0, np.zeros(2), 9.0 * np.eye(2), np.zeros(2), 16.0, spectral, memory_s=1.0)
        for step in range(1, 11):
            truth = transition(0.3, 2) @ truth
            truth = truth + rng.multivariate_normal(np.zeros(4), white_acceleration_noise(0.3, spectral, 2))
            one.update(H @ truth + rng.normal(0.0, 3.0, 2), R, H, 0.3 * step)
        total += nis(truth - one.state, one.covariance)

    assert total / 300 == pytest.approx(4.0, abs=4 * 0.163)


def test_hours_of_updates_keep_the_covariance_definite() -> None:
    one = fresh(density_m2ps3=25.0)
    H = position_rows(2)
    for step in range(1, 20_001):
        one.update(np.array([step * 1.0, -step * 1.0]), np.diag([1e-4, 1e8]), H, 10.0 + 0.5 * step)

    assert one.covariance.tolist() == one.covariance.T.tolist()
    assert np.linalg.eigvalsh(one.covariance).min() > 0.0
