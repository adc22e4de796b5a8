"""Each hypothesis of the solution separation is the least-squares solution that a direct adjustment without the fault gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import cos, hypot, pi, sin

import numpy as np
import pytest

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, PositionPrior, RangeResidual
from gcs_coloc.core.integrity.epoch_tests.fault_tests import adjust
from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel
from gcs_coloc.core.integrity.solution_separation import (
    FaultClass,
    Separation,
    SolutionSeparation,
    noise_excess_m2,
    range_excess_m2,
)

DENIED = 9
SIGMA_M, RANGE_SIGMA_M = 1.5, 0.6
AMONG, BESIDE = (0.0, 0.0, 0.0), (2000.0, 500.0, 0.0)


def fleet(peers: int, *, mutual: bool = True, seed: int = 1, place: tuple[float, float, float] = AMONG) -> Epoch:
    """A denied vehicle and peers around the origin, with drawn residuals."""
    rng = np.random.default_rng(seed)
    places = {n: (400.0 * cos(2 * pi * n / peers), 400.0 * sin(2 * pi * n / peers), 20.0 * n) for n in range(1, peers + 1)}
    priors = {n: PositionPrior(place, SIGMA_M, SIGMA_M, no_prior=False) for n, place in places.items()}
    priors[DENIED] = PositionPrior(place, 0.0, 5.0, no_prior=True)
    pairs = [(DENIED, n) for n in places]
    if mutual:
        pairs += [(a, b) for a in places for b in places if a < b]
    residuals = tuple(RangeResidual(a, b, float(rng.normal(0.0, 2.0)), RANGE_SIGMA_M, 0.3) for a, b in pairs)
    return Epoch(0.0, priors, residuals)


def adjusted(epoch: Epoch, *, without: tuple[int, ...] = (), extra: np.ndarray | None = None) -> tuple[float, float]:
    """Separation and 1-sigma of the denied vehicle by a direct adjustment, m; `extra` (rows,) multiplies an unknown."""
    a = epoch.arrays
    H = np.zeros((len(a.pairs), 3 * len(a.vehicles)))
    for row, (i, j) in enumerate(zip(*a.ends, strict=True)):
        H[row, 3 * i : 3 * i + 3], H[row, 3 * j : 3 * j + 3] = a.unit_vectors[row], -a.unit_vectors[row]
    prior = np.where(a.has_prior, a.sqrt_information**2, 1e-6)
    for vehicle in without:
        prior[3 * a.index[vehicle] : 3 * a.index[vehicle] + 2] = 1e-6
    if extra is not None:
        H, prior = np.column_stack([H, extra]), np.append(prior, 0.0)
    W = np.diag(1.0 / a.variances_m2)
    C = np.linalg.inv(H.T @ W @ H + np.diag(prior))
    x = C @ H.T @ W @ a.residuals_m
    at = 3 * a.index[DENIED]
    return hypot(x[at], x[at + 1]), float(np.sqrt(np.linalg.eigvalsh(C[at : at + 2, at : at + 2])[-1]))


def hypotheses(epoch: Epoch, fault: FaultClass) -> list[Separation]:
    return [each for each in SolutionSeparation(epoch).of(DENIED) if each.fault is fault]


@pytest.mark.parametrize("mutual", [True, False])
@pytest.mark.parametrize("peers", [3, 4, 6])
def test_receiver_hypotheses_are_adjustments_without_those_positions(peers, mutual):
    epoch = fleet(peers, mutual=mutual)
    found = hypotheses(epoch, FaultClass.RECEIVERS)
    assert {len(each.vehicles) for each in found} == set(range(1, peers // 2 + 1))
    for each in found:
        separation_m, sigma_m = adjusted(epoch, without=each.vehicles)
        if sigma_m < 100.0:  # beyond, the solution hangs on the last digits
            assert (each.separation_m, each.sigma_m) == pytest.approx((separation_m, sigma_m), rel=1e-3)
        else:
            assert each.sigma_m > 50.0


def test_the_motion_hypothesis_is_the_adjustment_of_all_ranges():
    epoch = fleet(5)
    (motion,) = hypotheses(epoch, FaultClass.MOTION)
    assert (motion.separation_m, motion.sigma_m) == pytest.approx(adjusted(epoch), rel=1e-6)


def test_range_hypotheses_are_adjustments_with_an_unknown_length_or_factor():
    epoch = fleet(5)
    a = epoch.arrays
    device = np.array([float(i == DENIED) for i, _ in a.pairs])
    expected = [adjusted(epoch, extra=device), adjusted(epoch, extra=device * a.ranges_m / a.ranges_m.mean())]
    expected += [adjusted(epoch, extra=np.array([float(pair == (DENIED, n)) for pair in a.pairs])) for n in range(1, 6)]
    found = [(each.separation_m, each.sigma_m) for each in hypotheses(epoch, FaultClass.RANGES)]
    assert np.array(sorted(found)) == pytest.approx(np.array(sorted(expected)), rel=1e-6)


def test_without_a_wrong_peer_the_solution_is_where_the_others_put_it():
    """A peer 100 m off pulls the denied vehicle; its own hypothesis has the whole separation and no other has more."""
    clean = fleet(5, mutual=False)
    east_m = 100.0
    unit = clean.arrays.unit_vectors
    # The estimate is right, so ranges to the wrong place of vehicle 1 are off by its component along the line of sight.
    residuals = tuple(
        residual._replace(residual_m=float(unit[row, 0] * east_m) if residual.to_vehicle == 1 else 0.0)
        for row, residual in enumerate(clean.residuals)
    )
    found = hypotheses(Epoch(0.0, clean.priors, residuals), FaultClass.RECEIVERS)
    without = {each.vehicles: each.separation_m for each in found}
    assert without[(1,)] < 1e-3
    assert min(without[(n,)] for n in range(2, 6)) > 10.0


def test_one_peer_cannot_be_tested():
    epoch = fleet(1)
    (single,) = hypotheses(epoch, FaultClass.RECEIVERS)
    assert single.vehicles == (1,)
    assert single.sigma_m > 500.0


def shift_m(epoch: Epoch, lengthened: Callable[[RangeResidual], float]) -> np.ndarray:
    """By how much (2,) the adjustment places the denied vehicle elsewhere if ranges are longer."""
    longer = tuple(r._replace(residual_m=r.residual_m + lengthened(r)) for r in epoch.residuals)
    before, after = (adjust(each, [(None, 0.0)])[0] for each in (epoch, replace(epoch, residuals=longer)))
    return after.horizontal(DENIED, after.corrections_m) - before.horizontal(DENIED, before.corrections_m)


@pytest.mark.parametrize("place", [AMONG, BESIDE], ids=["among its peers", "beside them"])
def test_errors_of_devices_cost_what_each_of_them_moves_the_vehicle_by(place):
    """Each device errs in what it measures, and otherwise in what it answers, both with half of the variance."""
    epoch = fleet(5, place=place)
    scale = 1e-4  # so small that nothing bends
    excess_m2 = noise_excess_m2(epoch, NoiseModel(device_scale=scale).apply(epoch))[DENIED]
    errors_m = dict(zip(epoch.arrays.pairs, (scale * epoch.arrays.ranges_m * 0.5**0.5).tolist(), strict=True))
    moves = [
        shift_m(epoch, lambda r, end=end, device=device: errors_m[r.pair] * (r.pair[end] == device))
        for end in (0, 1)
        for device in epoch.arrays.vehicles
    ]
    assert excess_m2 == pytest.approx(sum(np.outer(move, move) for move in moves), rel=0.03)


def test_coarser_positions_cost_what_each_of_them_moves_the_vehicle_by():
    """Receivers that state half of their error have three more times the stated variance, east and north."""
    epoch = fleet(5)
    excess_m2 = noise_excess_m2(epoch, NoiseModel(position_factor=2.0).apply(epoch))[DENIED]
    units = dict(zip(epoch.arrays.pairs, epoch.arrays.unit_vectors.tolist(), strict=True))
    moves = [
        shift_m(
            epoch,
            lambda r, peer=peer, axis=axis: 1e-3 * units[r.pair][axis] * ((r.to_vehicle == peer) - (r.from_vehicle == peer)),
        )
        for peer in range(1, 6)
        for axis in (0, 1)
    ]
    assert excess_m2 == pytest.approx(3.0 * (SIGMA_M / 1e-3) ** 2 * sum(np.outer(move, move) for move in moves), rel=0.03)


@pytest.mark.parametrize("place", [AMONG, BESIDE], ids=["among its peers", "beside them"])
def test_an_error_of_its_own_device_cancels_among_the_peers_and_not_beside_them(place):
    """An error of each pair, as large, is the standard; beside the peers in the direction to them."""
    epoch = fleet(5, mutual=False, place=place)
    of_device = NoiseModel(device_bias_m=2.0).apply(epoch)
    of_pairs = NoiseModel(range_bias_m=2.0).apply(epoch)
    to_them = np.array(BESIDE[:2]) / np.hypot(*BESIDE[:2])
    device_m2, pairs_m2 = (float(to_them @ noise_excess_m2(epoch, found)[DENIED] @ to_them) for found in (of_device, of_pairs))
    assert (device_m2 < 0.6 * pairs_m2) if place == AMONG else (device_m2 > 2.0 * pairs_m2)


def test_a_range_has_the_noise_of_its_pair_and_of_the_positions_at_both_ends():
    epoch = fleet(3)
    assert range_excess_m2(epoch, epoch) == {}
    of_ranges = range_excess_m2(epoch, NoiseModel(range_bias_m=2.0, device_scale=0.01).apply(epoch))
    assert of_ranges == pytest.approx(
        {pair: 4.0 + (0.01 * length_m) ** 2 for pair, length_m in zip(epoch.arrays.pairs, epoch.arrays.ranges_m, strict=True)}
    )
    of_positions = range_excess_m2(epoch, NoiseModel(position_factor=2.0).apply(epoch))
    for pair, (east, north, _) in zip(epoch.arrays.pairs, epoch.arrays.unit_vectors, strict=True):
        reporting = 1 if DENIED in pair else 2
        assert of_positions[pair] == pytest.approx(reporting * 3.0 * SIGMA_M**2 * (east**2 + north**2))
    (height_m2,) = {
        round(excess_m2 / up**2, 6)
        for (pair, excess_m2), (_, _, up) in zip(
            range_excess_m2(epoch, NoiseModel(height_sigma_m=4.0).apply(epoch)).items(), epoch.arrays.unit_vectors, strict=True
        )
        if DENIED not in pair
    }
    assert height_m2 == pytest.approx(2 * (4.0**2 - SIGMA_M**2))


def by_noise(epoch: Epoch, rng: np.random.Generator) -> Epoch:
    """The epoch with residuals that the errors of ranges and reported positions make, the vehicle's estimate being true."""
    a = epoch.arrays
    errors_m = np.where(np.array(a.no_prior)[:, np.newaxis], 0.0, rng.normal(0.0, SIGMA_M, (len(a.vehicles), 3)))
    i, j = a.ends
    made_m = np.einsum("rk,rk->r", a.unit_vectors, errors_m[i] - errors_m[j]) + np.sqrt(a.variances_m2) * rng.standard_normal(
        len(i)
    )
    residuals = tuple(one._replace(residual_m=value) for one, value in zip(epoch.residuals, made_m.tolist(), strict=True))
    return replace(epoch, residuals=residuals)


@pytest.mark.parametrize("mutual", [False, True])
@pytest.mark.parametrize("peers", [4, 6])
def test_expected_separations_are_medians_of_those_that_noise_makes(peers, mutual):
    """A solution that is poor in one direction is off by 0.67 sigmas of it in the median, one alike in all by 1.18 sigmas.

    The median of 300 draws scatters by 9 %, of which a band of 15 % leaves room for the 60 hypotheses.
    """
    epoch, rng = fleet(peers, mutual=mutual), np.random.default_rng(5)
    drawn_m = np.median(
        [[one.separation_m for one in SolutionSeparation(by_noise(epoch, rng)).of(DENIED)] for _ in range(300)], axis=0
    )
    expected = SolutionSeparation(epoch).expected_of(DENIED, np.zeros((2, 2)))
    assert [(one.fault, one.vehicles) for one in expected] == [
        (e.fault, e.vehicles) for e in SolutionSeparation(epoch).of(DENIED)
    ]
    ratios = np.array([one.separation_m for one in expected]) / drawn_m
    assert ratios.min() > 0.674 / 1.18 / 1.15
    assert ratios.max() < 1.15


def test_a_solution_that_nothing_places_is_expected_at_the_estimate():
    """Two peers: without one of them a single range is left, and across it the solution stays where the estimate is."""
    for one in SolutionSeparation(fleet(2, mutual=False)).expected_of(DENIED, np.zeros((2, 2))):
        if one.fault is FaultClass.RECEIVERS:
            assert one.sigma_m > 500.0
            assert one.separation_m < 3.0


def test_what_the_estimate_has_in_common_with_a_solution_separates_nothing():
    epoch = fleet(5, mutual=False)
    separation = SolutionSeparation(epoch)
    motion, *_ = separation.expected_of(DENIED, separation.covariance_m2(DENIED))
    assert motion.separation_m == pytest.approx(0.0, abs=1e-6)
