"""The test of ranges against reported positions: its false alarm rate, and what a fault moves."""

import numpy as np
import pytest

from gcs_coloc.core.integrity.epoch_tests import fault_tests
from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, PositionPrior, RangeResidual
from gcs_coloc.core.integrity.epoch_tests.fault_tests import run_tests
from gcs_coloc.core.integrity.epoch_tests.isolation import isolate

SIGMA_GPS_M, SIGMA_RANGE_M = 1.5, 0.6
TRUE = {
    1: (0.0, 0.0, 100.0),
    2: (1200.0, 100.0, 120.0),
    3: (300.0, 1400.0, 90.0),
    4: (-900.0, 700.0, 140.0),
    5: (200.0, 600.0, 110.0),
}


def result_of(now, then=None, correlation=0.0):
    (result,) = run_tests(now, [(then, correlation)])
    return result


def epoch(rng, *, mutual, faults=None, free=(5,), pair_error=None, device_error=None):
    priors, residuals = {}, []
    for vehicle, true in TRUE.items():
        off = np.array([8.0, -6.0, 0.5]) if vehicle in free else SIGMA_GPS_M * rng.standard_normal(3)
        off = off + np.array((faults or {}).get(vehicle, (0.0, 0.0, 0.0)))
        priors[vehicle] = PositionPrior(np.array(true) + off, SIGMA_GPS_M, SIGMA_GPS_M, vehicle in free)
    for i in TRUE:
        for j in TRUE:
            if i != j and (i == 5 or (mutual and j != 5)):
                measured = np.linalg.norm(np.subtract(TRUE[i], TRUE[j])) + SIGMA_RANGE_M * rng.standard_normal()
                measured += (pair_error or {}).get((i, j), 0.0) + (device_error or {}).get(i, 0.0)
                reported = np.linalg.norm(priors[i].position_enu_m - priors[j].position_enu_m)
                residuals.append(RangeResidual(i, j, float(measured - reported), SIGMA_RANGE_M))
    return Epoch(0.0, priors, tuple(residuals))


@pytest.mark.parametrize("mutual", [True, False])
def test_the_false_alarm_rate_is_the_one_that_is_set(monkeypatch, mutual):
    """600 fault-free epochs at an alarm level of 4 %: 24 expected, sigma 4.8; the band is four sigmas to either side."""
    monkeypatch.setattr(fault_tests, "ALARM_LEVEL", 0.04)
    rng = np.random.default_rng(7)
    results = [result_of(epoch(rng, mutual=mutual)) for _ in range(600)]
    assert 5 <= sum(not v.is_consistent for v in results if v is not None) <= 43


def test_a_vehicle_without_prior_far_off_costs_nothing():
    """The statistic of a denied vehicle that is placed 10 m off is chi-square with the number of residuals less its two
    unknowns.
    """
    rng = np.random.default_rng(1)
    results = [result_of(epoch(rng, mutual=False)) for _ in range(400)]
    assert {v.degrees_of_freedom for v in results} == {2}
    # Mean of 400 values of variance 4: sigma 0.1, band of four.
    assert np.mean([v.statistic for v in results]) == pytest.approx(2.0, abs=0.4)


def test_without_redundancy_there_is_no_result():
    full = epoch(np.random.default_rng(0), mutual=False)
    assert result_of(Epoch(0.0, full.priors, full.residuals[:2])) is None
    assert result_of(Epoch(0.0, full.priors, ())) is None


def wandered(rng, before, share):
    """The epoch some time later: every position error kept by that share, the rest drawn anew, and new ranges."""
    later = epoch(rng, mutual=True)
    keep = np.sqrt(1.0 - share**2)
    priors = {}
    for vehicle, place in later.priors.items():
        then, now = before.priors[vehicle].position_enu_m - TRUE[vehicle], place.position_enu_m - TRUE[vehicle]
        error = now if place.no_prior else share * then + keep * now
        priors[vehicle] = PositionPrior(np.array(TRUE[vehicle]) + error, place.sigma_h_m, place.sigma_v_m, place.no_prior)
    residuals = []
    for residual in later.residuals:
        reported_m = [priors[v].position_enu_m for v in residual.pair]
        drawn = [later.priors[v].position_enu_m for v in residual.pair]
        range_m = residual.residual_m + np.linalg.norm(drawn[0] - drawn[1])
        residuals.append(
            RangeResidual(*residual.pair, float(range_m - np.linalg.norm(reported_m[0] - reported_m[1])), residual.sigma_m)
        )
    return Epoch(5.0, priors, tuple(residuals))


def test_gauss_markov_errors_make_the_statistic_of_two_epochs_chi_square():
    rng = np.random.default_rng(8)
    results = []
    for _ in range(300):
        before = epoch(rng, mutual=True)
        results.append(result_of(wandered(rng, before, 0.9), before, 0.9))
    degrees = {v.degrees_of_freedom for v in results}
    assert degrees == {2 * (16 - 2)}
    # Mean of 300 values of variance 56: sigma 0.43, band of four.
    assert np.mean([v.statistic for v in results]) == pytest.approx(28.0, abs=1.8)


def test_a_fault_below_the_stated_sigma_is_detected_in_its_change():
    """5 m are hidden by receivers of 1.5 m, but not where errors keep 95 % of themselves between the epochs."""
    rng = np.random.default_rng(9)
    alone, changed, named = 0, 0, 0
    for _ in range(40):
        before = epoch(rng, mutual=True)
        fault_free = wandered(rng, before, 0.95)
        fault = np.array([4.0, -3.0, 0.0])
        priors = dict(fault_free.priors)
        priors[1] = PositionPrior(priors[1].position_enu_m + fault, SIGMA_GPS_M, SIGMA_GPS_M, no_prior=False)
        residuals = []
        for residual in fault_free.residuals:
            was = np.linalg.norm(np.subtract(*(fault_free.priors[v].position_enu_m for v in residual.pair)))
            now = np.linalg.norm(np.subtract(*(priors[v].position_enu_m for v in residual.pair)))
            residuals.append(RangeResidual(*residual.pair, float(residual.residual_m + was - now), residual.sigma_m))
        faulted = Epoch(5.0, priors, tuple(residuals))
        alone += not result_of(faulted).is_consistent
        result = result_of(faulted, before, 0.95)
        changed += not result.is_consistent
        named += isolate(faulted, (before, 0.95)).isolated.keys() == {1}
    assert alone <= 4
    assert changed >= 36
    assert named >= 30


def test_the_separation_is_the_displacement_without_the_faulty_vehicle():
    """The vehicle is placed 10 m off: without a fault its offset is just that; with one of 20 m the solution separation is what
    it adds.
    """
    rng = np.random.default_rng(10)
    offsets = [result_of(epoch(rng, mutual=True)).offset_m(5) for _ in range(40)]
    # Where four ranges put it against priors of 1.5 m: sigma about 1.5 m per axis, of the mean of 40 about 0.25 m.
    np.testing.assert_allclose(np.mean(offsets, axis=0), [-8.0, 6.0], atol=1.0)
    fault_free = result_of(epoch(rng, mutual=True))
    assert not fault_free.separation_m2[5].any()
    faulted = result_of(epoch(rng, mutual=True, faults={1: (16.0, -12.0, 0.0)}))
    # The offset without the faulty vehicle is the 10 m again, to three sigmas of the place that three ranges give.
    assert np.sqrt(np.trace(faulted.separation_m2[5])) == pytest.approx(10.0, abs=7.0)


def test_near_the_line_of_two_peers_the_noise_of_a_range_separates_by_metres_not_by_hundreds():
    """Without the third peer the ranges to both others say nothing of where it is across their line.

    A plane that came within 90 m of such a line had no fix for 14 s: an error of 3 m was a separation of 210 m.
    """
    true = {1: (0.0, 650.0, 100.0), 2: (600.0, -350.0, 130.0), 3: (-600.0, -350.0, 160.0), 5: (0.0, -340.0, 120.0)}
    priors = {v: PositionPrior(np.array(at), 0.5, 0.5, v == 5) for v, at in true.items()}
    residuals = tuple(RangeResidual(5, peer, error_m, SIGMA_RANGE_M) for peer, error_m in ((1, 1.0), (2, 1.6), (3, 1.6)))
    tested = result_of(Epoch(0.0, priors, residuals))
    assert tested is not None
    assert tested.is_consistent
    assert tested.separation_m2[5].any()
    assert np.sqrt(np.trace(tested.separation_m2[5])) < 20.0
