import numpy as np
import pytest

from gcs_coloc.core.errors import UsageError
from gcs_coloc.estimators.qu_zhang.cv_filter import CvFilter, transition
from gcs_coloc.study.bound import BoundOptions, run_bound

TIMES = 0.5 * np.arange(41)
START = np.array([[0.0, 0], [1000, 0], [0, 1000], [400, 300]])
VELOCITY = np.array([[0.0, 10], [0, 12], [3, 10], [5, 9]])
POSITIONS = START[:, np.newaxis] + VELOCITY[:, np.newaxis] * TIMES[:, np.newaxis]


def test_without_process_noise_it_is_the_inverse_of_all_information() -> None:
    options = BoundOptions(range_sigma_m=2.0, peer_sigma_m=1.5, density_m2ps3=0.0)
    bound = run_bound(TIMES, POSITIONS, 3, options)
    total = np.diag([1 / 15.0**2, 1.0, 1 / 15.0**2, 1.0])
    for k in range(1, len(TIMES)):
        phi = transition(TIMES[k], 2)
        for peer in range(3):
            u = POSITIONS[3, k] - POSITIONS[peer, k]
            h = (np.array([u[0], 0, u[1], 0]) / np.linalg.norm(u)) @ phi
            total += np.outer(h, h) / (2.0**2 + 1.5**2)
    phi = transition(TIMES[-1], 2)

    assert bound.covariance[-1] == pytest.approx(phi @ np.linalg.inv(total) @ phi.T, rel=1e-6)


def test_with_process_noise_it_is_the_filter_that_knows_the_truth() -> None:
    options = BoundOptions(range_sigma_m=2.0, peer_sigma_m=0.0, density_m2ps3=3.0)
    bound = run_bound(TIMES, POSITIONS, 3, options)
    one = CvFilter(0.0, POSITIONS[3, 0], 225.0 * np.eye(2), VELOCITY[3], 1.0, 3.0, memory_s=1.0)
    for k in range(1, len(TIMES)):
        u = POSITIONS[3, k] - POSITIONS[:3, k]
        H = np.zeros((3, 4))
        H[:, ::2] = u / np.linalg.norm(u, axis=1, keepdims=True)
        one.update(H @ one.predicted(TIMES[k])[0], 4.0 * np.eye(3), H, TIMES[k])

    assert bound.covariance[-1] == pytest.approx(one.covariance, rel=1e-6)
    assert bound.horizontal_sigma_m[-1] == pytest.approx(np.sqrt(one.covariance[0, 0] + one.covariance[2, 2]))


def test_less_noise_never_makes_the_bound_larger() -> None:
    loose = run_bound(TIMES, POSITIONS, 3, BoundOptions())
    tight = run_bound(TIMES, POSITIONS, 3, BoundOptions(range_sigma_m=10.0))

    assert np.linalg.eigvalsh(loose.covariance - tight.covariance).min() > -1e-9
    assert tight.horizontal_rmse_m() < loose.horizontal_rmse_m()


def test_the_whole_flight_counts_from_the_uncertainty_of_its_start_on() -> None:
    bound = run_bound(TIMES, POSITIONS, 3, BoundOptions())

    assert bound.horizontal_sigma_m[0] == pytest.approx(np.sqrt(2) * 15.0)
    assert bound.horizontal_rmse_m() == pytest.approx(np.sqrt(np.mean(bound.horizontal_sigma_m**2)))


def test_three_dimensions_and_a_peer_at_the_same_place() -> None:
    positions = np.concatenate([POSITIONS, np.zeros((4, len(TIMES), 1))], axis=-1)
    positions[0] = positions[3]
    bound = run_bound(TIMES, positions, 3, BoundOptions())

    assert bound.covariance.shape == (41, 6, 6)
    assert np.isfinite(bound.covariance).all()
    # A level fleet tells nothing of height: what it grows to is the start's own uncertainty and the acceleration's.
    expected = 15.0**2 + 20.0**2 * 1.0 + 20.0**3 / 3
    assert bound.covariance[-1, 4, 4] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("bad", [{"range_sigma_m": 0.0}, {"peer_sigma_m": -1.0}, {"density_m2ps3": -1.0}])
def test_noises_without_a_bound_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(UsageError):
        BoundOptions(**bad)
