"""What explains an inconsistency of a whole fleet: noise of all, several pairs, or one fault. Random geometries, seeds fixed."""

import numpy as np
import pytest

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, PositionPrior, RangeResidual
from gcs_coloc.core.integrity.epoch_tests.fault_tests import REST_LEVEL, RULED_OUT_MARGIN, chi2_limit, run_tests
from gcs_coloc.core.integrity.epoch_tests.noise_evidence import explain_inconsistency
from gcs_coloc.core.integrity.epoch_tests.noise_model import (
    NoiseModel,
    clearly_smaller_noise,
    likeliest_noise,
    restricted_likelihood,
)
from gcs_coloc.core.integrity.epoch_tests.pair_outliers import pair_outliers

SIGMA_GPS_M, SIGMA_RANGE_M = 1.5, 0.6
SEEDS = range(12)


def epoch(
    rng, *, device_bias_m=0.0, devices_off=range(1, 7), scale=0.0, answered=0.0, height_m=0.0, factor=1.0, off=(),
    walked_m=0.0, also_walked_m=0.0, spread_up_m=40.0, vehicles=6,
):  # fmt: skip
    """A fleet that ranges among all. `off`: pairs whose ranges are 8 to 30 m too long; `walked_m`: vehicle 2's receiver east,
    `also_walked_m`: vehicle 3's north; `answered`: the share of its scale error that a device has in what it answers.
    """
    ids = range(1, vehicles + 1)
    true = {v: np.append(rng.uniform(-600.0, 600.0, 2), 100.0 + rng.uniform(-spread_up_m, spread_up_m)) for v in ids}
    of_device = {v: device_bias_m * (v in devices_off) * rng.choice((-1.0, 1.0)) * rng.uniform(0.5, 1.5) for v in ids}
    scales = {v: scale * rng.choice((-1.0, 1.0)) for v in ids}
    detours = {pair: rng.uniform(8.0, 30.0) for pair in off}
    priors, residuals = {}, []
    for v, position in true.items():
        error = factor * SIGMA_GPS_M * rng.standard_normal(3)
        error[2] = height_m * rng.standard_normal() if height_m else SIGMA_GPS_M * rng.standard_normal()
        error[0] += walked_m * (v == 2)
        error[1] += also_walked_m * (v == 3)
        priors[v] = PositionPrior(tuple((position + error).tolist()), SIGMA_GPS_M, SIGMA_GPS_M, False)
    for i in ids:
        for j in ids:
            if i != j:
                factor_ij = 1.0 + scales[i] + answered * scales[j]
                measured_m = np.linalg.norm(true[i] - true[j]) * factor_ij + SIGMA_RANGE_M * rng.standard_normal()
                measured_m += of_device[i] + detours.get((min(i, j), max(i, j)), 0.0)
                computed_m = np.linalg.norm(np.subtract(priors[i].position_enu_m, priors[j].position_enu_m))
                residuals.append(RangeResidual(i, j, float(measured_m - computed_m), SIGMA_RANGE_M, 0.3))
    return Epoch(0.0, priors, tuple(residuals))


def explained(seed, **errors):
    whole = epoch(np.random.default_rng(seed), **errors)
    (result,) = run_tests(whole, [(None, 0.0)])
    return explain_inconsistency(whole, result, NoiseModel(), ())


def test_devices_with_lasting_errors_are_noise_of_about_their_size():
    """The ladder has factors of two; the devices' errors are 2 to 6 m, 4.3 m rms."""
    found = [explained(seed, device_bias_m=4.0) for seed in SEEDS]
    assert all(2.0 <= noise.device_bias_m <= 8.0 for noise in found)
    assert all(not noise.pairs_off for noise in found)


def test_one_device_that_is_off_is_noise_of_devices_too():
    """The ranges tell it from every other fault. Its error is 2 to 6 m; where that contradicts nothing, nothing is found."""
    found = [explained(seed, device_bias_m=4.0, devices_off=(1,)) for seed in SEEDS]
    assert all(4.0 <= noise.device_bias_m <= 8.0 for noise in found if not noise.is_as_stated)
    assert sum(not noise.is_as_stated for noise in found) >= 6


@pytest.mark.parametrize("answered", [0.0, 0.5])
def test_devices_with_wrong_scales_are_noise_that_grows_with_the_range(answered):
    found = [explained(seed, scale=0.01, answered=answered) for seed in SEEDS]
    assert {noise.device_scale for noise in found} == {0.01}


@pytest.mark.parametrize("answered", [0.0, 0.5, 1.0])
def test_errors_of_devices_are_far_likelier_than_an_error_of_each_pair(answered):
    """Twelve numbers, of six devices as they measure and as they answer, explain thirty residuals."""
    for seed in SEEDS:
        stated = epoch(np.random.default_rng(seed), scale=0.01, answered=answered)
        of_devices = restricted_likelihood(NoiseModel(device_scale=0.01).apply(stated)).cost
        of_pairs = min(restricted_likelihood(NoiseModel(range_bias_m=size_m).apply(stated)).cost for size_m in (2.0, 4.0, 8.0))
        assert of_devices < of_pairs - RULED_OUT_MARGIN


@pytest.mark.parametrize("answered", [0.0, 0.5, 1.0])
def test_with_the_noise_that_is_found_the_tests_find_no_contradiction(answered):
    """They take the errors of devices as independent by pair, which the likelihood does not."""
    for seed in SEEDS:
        stated = epoch(np.random.default_rng(seed), scale=0.01, answered=answered)
        found = likeliest_noise(stated, NoiseModel())
        if found is not None:
            (result,) = run_tests(found.model.apply(stated), [(None, 0.0)])
            assert result.statistic <= chi2_limit(result.degrees_of_freedom, REST_LEVEL)


@pytest.mark.parametrize("noise", [NoiseModel(range_bias_m=8.0), NoiseModel(device_bias_m=8.0)], ids=["pairs", "devices"])
def test_errors_that_last_hide_no_step(noise):
    for seed in SEEDS:
        then, now = (noise.apply(epoch(np.random.default_rng(seed), walked_m=walked_m)) for walked_m in (0.0, 15.0))
        (result,) = run_tests(now, [(then, 0.9)])
        assert not result.is_consistent


def test_barometers_of_another_day_are_noise_of_heights():
    """Where ranges are nearly level they show nothing of heights, and nothing is found: 4 of the 12 geometries."""
    found = [explained(seed, height_m=15.0, spread_up_m=200.0) for seed in SEEDS]
    assert {noise.height_sigma_m for noise in found if not noise.is_as_stated} <= {10.0, 20.0}
    assert sum(noise.is_as_stated for noise in found) == 4


def test_pairs_out_of_sight_are_left_out_and_nothing_else():
    off = {(1, 4), (2, 3), (5, 6)}
    for seed in SEEDS:
        noise = explained(seed, off=off)
        assert noise.pairs_off >= off
        assert len(noise.pairs_off) <= len(off) + 1
        assert noise.is_as_stated


@pytest.mark.parametrize("walked_m", [15.0, 60.0, 200.0])
def test_a_receiver_that_is_off_is_no_noise(walked_m):
    """It is left to the tests of single faults, and no pair of it is left out."""
    for seed in SEEDS:
        assert explained(seed, walked_m=walked_m) == NoiseModel()


@pytest.mark.parametrize("vehicles", [4, 5, 6])
@pytest.mark.parametrize("walked_m", [15.0, 60.0, 200.0])
def test_two_receivers_that_are_off_each_its_own_way_are_no_noise(walked_m, vehicles):
    """Noise of all that explains them as well would hide them, until a sound receiver is named in their place."""
    for seed in SEEDS:
        assert explained(seed, walked_m=walked_m, also_walked_m=0.8 * walked_m, vehicles=vehicles).is_as_stated


def test_a_sound_fleet_is_as_stated():
    for seed in range(100):
        assert explained(seed) == NoiseModel()


def test_a_pair_is_isolated_only_where_the_others_have_the_redundancy_for_it():
    """Vehicle 1 of four has no position of its own: its three ranges contradict each other, no other one tells which is off."""
    for seed in SEEDS:
        whole = pair_outliers(epoch(np.random.default_rng(seed), off={(1, 3)}))
        assert (whole.pairs, whole.unisolated) == ({(1, 3)}, set())
        few = epoch(np.random.default_rng(seed), off={(1, 3)}, vehicles=4).without_priors({1})
        found, known = pair_outliers(few), pair_outliers(few, {(1, 3)})
        assert found.unisolated == {(1, 2), (1, 3), (1, 4)}
        assert (known.pairs, known.unisolated) == ({(1, 3)}, set())


def test_more_than_half_of_the_pairs_are_never_left_out():
    off = {(i, j) for i in range(1, 5) for j in range(i + 1, 6)}
    assert pair_outliers(epoch(np.random.default_rng(1), off=off)) is None


def test_noise_is_forgotten_where_it_acts_no_longer():
    noise = NoiseModel(range_bias_m=4.0, pairs_off=frozenset({(1, 2)}))
    assert 3.0 < noise.after(60.0).range_bias_m < 4.0
    assert noise.after(0.2).pairs_off == frozenset()
    assert noise.after(3600.0) == NoiseModel()
    assert "ranges of about 4 m" in noise.text
    assert NoiseModel().text == ""


def test_noise_is_told_while_it_is_more_than_nothing_and_each_component_is_forgotten_by_itself():
    noise = NoiseModel(0.4, 0.3, 0.02, 5.0, 1.5)
    assert noise.after(600.0).text == (
        "lasting errors of ranges of about 0.1 m, lasting errors of devices of about 0.1 m, "
        "errors of devices of 0.7 % of the range, errors of heights of about 2 m, positions 1.2 times worse than stated"
    )
    assert noise.after(1200.0).text == "errors of devices of 0.3 % of the range, errors of heights of about 0.7 m"


def test_noise_that_blocked_ranges_brought_about_is_taken_back():
    """The ranges are as stated again; 8 m were the likeliest while half of them were off."""
    found = [clearly_smaller_noise(epoch(np.random.default_rng(seed)), NoiseModel(range_bias_m=8.0)) for seed in SEEDS]
    assert all(noise is not None and noise.range_bias_m <= 2.0 for noise in found)


def test_it_is_taken_back_while_some_pair_is_off_still():
    off = {(2, 3)}
    found = [clearly_smaller_noise(epoch(np.random.default_rng(seed), off=off), NoiseModel(device_scale=0.02)) for seed in SEEDS]
    assert all(noise is not None and noise.device_scale <= 0.005 for noise in found)
    assert sum(noise.pairs_off == off for noise in found) >= 10  # in two a smaller share of the range remains, which hides it


@pytest.mark.parametrize(
    ("errors", "present"),
    [
        ({"device_bias_m": 4.0}, NoiseModel(device_bias_m=4.0)),
        ({"scale": 0.01}, NoiseModel(device_scale=0.01)),
        ({"factor": 4.0}, NoiseModel(position_factor=4.0)),
    ],
)
def test_noise_that_acts_is_not_taken_back(errors, present):
    """In one draw of the twelve at most half of it may do, as the errors are drawn; a tenth of it never does."""
    found = [clearly_smaller_noise(epoch(np.random.default_rng(seed), **errors), present) for seed in SEEDS]
    assert sum(noise is not None for noise in found) <= 1
    assert all(noise is None or not noise.is_as_stated for noise in found)


def test_where_ranges_test_nothing_the_noise_stays():
    """Two vehicles and the range between them: as likely with any noise, as far as the positions allow."""
    whole = epoch(np.random.default_rng(1))
    pair = {v: whole.priors[v]._replace(no_prior=v == 2) for v in (1, 2)}
    residuals = tuple(r for r in whole.residuals if set(r.pair) == {1, 2})[:1]
    assert clearly_smaller_noise(Epoch(0.0, pair, residuals), NoiseModel(device_scale=0.02)) is None


@pytest.mark.parametrize(
    ("present_m", "size_m", "found_m"), [(0.0, 3.0, 4.0), (2.0, 4.9, 4.0), (4.0, 4.9, None), (0.0, 11.0, None)]
)
def test_a_devices_error_is_added_to_the_noise_where_it_is_not_in_it_and_a_model_is_that_coarse(present_m, size_m, found_m):
    found = NoiseModel(device_bias_m=present_m).with_device_error(size_m)
    assert (found.device_bias_m if found is not None else None) == found_m
