import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from gcs_coloc.estimators.qu_zhang.fix import Fix, published_covariance, solve
from gcs_coloc.estimators.qu_zhang.trilateration import Circle, range_residual

MORE = {
    1: np.array([0.0, 0.0, 60.0]),
    2: np.array([900.0, 100.0, 140.0]),
    3: np.array([200.0, 700.0, 20.0]),
    4: np.array([800.0, 800.0, 90.0]),
    5: np.array([-300.0, 500.0, 120.0]),
}
PEERS = {who: MORE[who] for who in (1, 2, 3)}
OWN = np.array([350.0, 250.0, 100.0])


def circles(
    believed: dict[int, np.ndarray], own_height_m: float = OWN[2], errors_m: dict[int, float] | None = None
) -> list[Circle]:
    """Exact ranges to where the peers are, plus errors; centres where they are believed to be."""
    return [
        Circle(
            peer=peer,
            centre_m=place[:2],
            centre_covariance=0.25 * np.eye(2),
            range_m=float(np.linalg.norm(OWN - MORE[peer])) + (errors_m or {}).get(peer, 0.0),
            range_sigma_m=1.0,
            height_m=own_height_m - place[2],
            height_variance_m2=0.04,
            lasting_covariance=np.diag([4.0, 4.0, 9.0]),
        )
        for peer, place in believed.items()
    ]


def solved(of: list[Circle], predicted: tuple[np.ndarray, np.ndarray] | None = None) -> Fix:
    fix = solve(9, of, predicted, 0.5, min_flatness=0.05, nis_limit=15.0)
    assert isinstance(fix, Fix), fix
    return fix


def test_slant_ranges_to_peers_at_other_heights_give_the_place() -> None:
    fix = solved(circles(PEERS))

    assert fix.position_m == pytest.approx(OWN[:2], abs=1e-6)
    assert sorted(fix.peers) == [1, 2, 3]


@pytest.mark.parametrize("peer", [1, 2, 3])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_sensitivity_to_a_peers_error_is_that_of_a_finite_difference(peer: int, axis: int) -> None:
    step = 1e-4
    moved = {who: place + step * np.eye(3)[axis] * (who == peer) for who, place in PEERS.items()}
    change = (solved(circles(moved)).position_m - OWN[:2]) / step

    assert solved(circles(PEERS)).sensitivities[peer][:, axis] == pytest.approx(change, abs=1e-4)


def test_the_sensitivity_to_the_own_height_is_that_of_a_finite_difference() -> None:
    step = 1e-4
    change = (solved(circles(PEERS, own_height_m=OWN[2] + step)).position_m - OWN[:2]) / step

    assert solved(circles(PEERS)).sensitivities[9][:, 0] == pytest.approx(change, abs=1e-4)


def test_the_covariance_is_that_of_the_finite_differences_of_what_is_new() -> None:
    # Ranges, the peers' white errors and heights, and the own height, all independent; the second-order terms are below 1e-4.
    expected = np.zeros((2, 2))
    base = solved(circles(PEERS))
    for peer, place in PEERS.items():
        u = (OWN - place) / np.linalg.norm(OWN - place)
        of_range = base.sensitivities[peer][:, 0] / u[0]
        sensitivity = base.sensitivities[peer]
        expected += np.outer(of_range, of_range) + sensitivity @ np.diag([0.25, 0.25, 0.04]) @ sensitivity.T
    expected += 0.5 * base.sensitivities[9] @ base.sensitivities[9].T

    assert base.covariance == pytest.approx(expected, rel=1e-3)


def test_of_more_peers_the_three_of_least_covariance_are_used() -> None:
    fix = solved(circles(MORE))
    each = [solved([one for one in circles(MORE) if one.peer in trio]) for trio in combinations(MORE, 3)]

    assert np.trace(fix.covariance) == pytest.approx(min(np.trace(one.covariance) for one in each), rel=0.2)


@pytest.mark.parametrize("faulty", sorted(MORE))
def test_of_five_ranges_a_wrong_one_is_left_out(faulty: int) -> None:
    fix = solved(circles(MORE, errors_m={faulty: 90.0}))

    assert faulty not in fix.peers
    assert fix.position_m == pytest.approx(OWN[:2], abs=1e-6)


@pytest.mark.parametrize("faulty", [1, 2, 3, 4])
def test_of_four_ranges_the_prediction_tells_which_one_is_wrong_and_without_it_nothing_does(faulty: int) -> None:
    four = {who: MORE[who] for who in (1, 2, 3, 4)}
    with_fault = circles(four, errors_m={faulty: 90.0})
    cold = solve(9, with_fault, None, 0.5, min_flatness=0.05, nis_limit=15.0)

    assert faulty not in solved(with_fault, (OWN[:2] + 2.0, 9.0 * np.eye(2))).peers
    assert isinstance(cold, str) or faulty not in cold.peers


def test_reasons_are_in_words() -> None:
    line = {1: np.array([0.0, 0, 0]), 2: np.array([500.0, 1, 0]), 3: np.array([900.0, 0, 0])}
    near = {1: np.array([0.0, 0, 0]), 2: np.array([1.0, 0, 0]), 3: np.array([0.5, 0.9, 0])}
    noisy = [replace(one, centre_covariance=25.0 * np.eye(2)) for one in circles(near)]
    limits = {"min_flatness": 0.05, "nis_limit": 15.0}

    assert solve(9, circles(PEERS)[:2], None, 0.5, **limits) == "ranges to 2 of the 3 peers that a fix needs"
    assert solve(9, circles(line), None, 0.5, **limits) == "the peers are nearly in one line"
    # Three peers a metre apart whose places are known to 5 m may be in one line for all that is known.
    assert solve(9, noisy, None, 0.5, **limits) == "the peers are nearly in one line"
    assert "do not meet in one point" in str(solve(9, circles(PEERS, errors_m={1: 60.0}), None, 0.5, **limits))


def test_the_published_covariance_takes_the_peers_filters_alone() -> None:
    fix = solved(circles(PEERS))
    one = published_covariance(fix, circles(PEERS), None)
    louder = published_covariance(fix, [replace(each, range_sigma_m=50.0) for each in circles(PEERS)], None)
    wider = published_covariance(fix, [replace(each, centre_covariance=np.eye(2)) for each in circles(PEERS)], None)

    assert louder.tolist() == one.tolist()
    assert wider == pytest.approx(4.0 * one)


def test_a_height_one_sigma_off_is_no_more_in_the_residual_of_a_steep_range() -> None:
    """Its NIS was 15: the variance of the peer's height alone was counted, so a sound range from above looked wrong."""
    sigma_m, above_m, aside_m = 4.0, 400.0, np.array([30.0, 0.0])
    slant_m = math.hypot(30.0, above_m)
    steep = replace(circles(PEERS)[0], centre_m=OWN[:2] + aside_m, height_m=sigma_m - above_m, range_m=slant_m)
    predicted = np.array([OWN[0], 0.0, OWN[1], 0.0]), np.eye(4)
    residual = range_residual(9, steep, predicted, sigma_m**2, 0.0, None)
    assert residual.innovation_m == pytest.approx(sigma_m, rel=0.01)
    assert residual.nis == pytest.approx(sigma_m**2 / (sigma_m**2 + 1.0), rel=0.02)
