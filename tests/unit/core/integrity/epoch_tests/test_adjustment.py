"""The adjustment's parts against textbook forms, and the whole against the reference adjustment."""

from dataclasses import replace

import numpy as np
import pytest
from reference_adjustment import Adjustment as ReferenceAdjustment

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, PositionPrior, RangeResidual
from gcs_coloc.core.integrity.epoch_tests.fault_tests import adjust
from gcs_coloc.core.integrity.epoch_tests.normal_equations import pseudo_inverse


@pytest.mark.parametrize("scale", [0.1, 1.0, 1e4])
def test_the_pseudo_inverse_is_that_of_the_singular_values(scale):
    rng = np.random.default_rng(3)
    for _ in range(200):
        root = rng.standard_normal((2, 2)) * scale
        A = root @ root.T
        if np.linalg.cond(A) < 1e5:
            inverse, rank = pseudo_inverse(A)
            assert rank == 2
            np.testing.assert_allclose(inverse, np.linalg.pinv(A), rtol=1e-6)
        one = np.outer(root[0], root[0])
        inverse, rank = pseudo_inverse(one)
        assert rank == 1
        np.testing.assert_allclose(inverse, np.linalg.pinv(one, rcond=1e-6), rtol=1e-6, atol=1e-12 / scale**2)


def test_directions_without_information_have_no_inverse():
    inverse, rank = pseudo_inverse(np.zeros((2, 2)))
    assert rank == 0
    assert not inverse.any()


def drawn_epoch(rng, vehicles, at_s, free):
    """A fleet in 2 km, priors of metres, vehicles without prior tens of metres off, any of its pairs with a range."""
    priors, true = {}, {v: rng.uniform(-1000.0, 1000.0, 3) for v in range(1, vehicles + 1)}
    for v, where in true.items():
        off = rng.uniform(-30.0, 30.0, 3) if v in free else 2.0 * rng.standard_normal(3)
        priors[v] = PositionPrior(where + off, rng.uniform(0.5, 4.0), rng.uniform(0.5, 8.0), v in free)
    residuals = []
    for i in true:
        for j in true:
            if i != j and rng.random() < 0.7:
                measured = np.linalg.norm(true[i] - true[j]) + rng.choice([0.5, 15.0], p=[0.9, 0.1]) * rng.standard_normal()
                reported = np.linalg.norm(priors[i].position_enu_m - priors[j].position_enu_m)
                residuals.append(RangeResidual(i, j, float(measured - reported), rng.uniform(0.2, 2.0), rng.choice([0.0, 0.3])))
    return Epoch(at_s, priors, tuple(residuals))


def fleets():
    """Fleets of two to nine, none to two vehicles without prior; pasts like the present, with other pairs, or with another
    vehicle without prior.
    """
    rng = np.random.default_rng(11)
    for vehicles in (2, 3, 4, 4, 5, 6, 9) * 6:
        free = set(rng.choice(np.arange(1, vehicles + 1), size=rng.integers(0, 3), replace=False).tolist())
        now = drawn_epoch(rng, vehicles, 20.0, free)
        same_pairs = drawn_epoch(rng, vehicles, 18.0, free)
        same_pairs = replace(
            same_pairs, residuals=tuple(residual._replace(residual_m=rng.normal()) for residual in now.residuals)
        )
        pasts = [
            (None, 0.0),
            (same_pairs, 0.9),
            (drawn_epoch(rng, vehicles, 15.0, free), 0.8),
            (drawn_epoch(rng, vehicles, 8.0, {1}), 0.6),
            (drawn_epoch(rng, max(vehicles - 1, 2), 8.0, free), 0.6),
        ]
        yield now, pasts


def test_all_adjustments_at_once_equal_the_reference():
    """To 1e-3, of levels of 6 and more: beside weights of 10 / m^2 the 1e-9 of a coordinate without prior costs ten of the
    sixteen digits.
    """
    seen = 0
    for now, pasts in fleets():
        for fast, (then, correlation) in zip(adjust(now, pasts), pasts, strict=True):
            slow = ReferenceAdjustment(now, then, correlation)
            assert fast.degrees_of_freedom == slow.degrees_of_freedom
            assert list(fast.vehicles) == slow.vehicles
            assert fast.residuals == slow.residuals[0]
            if not slow.vehicles or np.abs(slow.corrections_m).max() > 500.0:
                continue  # a vehicle without prior or residuals: by kilometres the slow form's statistic becomes negative
            seen += 1
            assert fast.statistic == pytest.approx(slow.statistic, rel=1e-6, abs=1e-3)
            for vehicle in (v for v in slow.vehicles if not now.priors[v].no_prior):
                effect = fast.position_effect(vehicle)
                assert (effect.gain, effect.rank) == fast.position_gain(vehicle)
                # By this a test without a remarkable statistic need not look at any fault.
                assert effect.gain <= fast.statistic + 1e-3
                same_effect(fast, effect, slow, slow.position_effect(vehicle))
            for chosen in ([0], list(range(0, len(fast.residuals), 2))):
                same_effect(fast, fast.range_effect(chosen), slow, slow.range_effect(chosen))
    assert seen > 150


def same_effect(fast, effect, slow, expected):
    assert effect.gain == pytest.approx(expected.gain, rel=1e-5, abs=1e-3)
    if expected.gain < 0.01:
        return  # what explains nothing has a size of rounding errors, in directions that nothing measures
    assert effect.rank == expected.rank
    np.testing.assert_allclose(effect.size_m, expected.size_m, rtol=1e-3, atol=1e-3)
    for residual in fast.residuals:
        i, j = residual.pair
        apart = fast.priors[i].position_enu_m[:2] - fast.priors[j].position_enu_m[:2]
        moved = fast.horizontal(i, effect.corrections_m) - fast.horizontal(j, effect.corrections_m)
        wanted = slow.horizontal(i, expected.corrections_m) - slow.horizontal(j, expected.corrections_m)
        # Along the line that the residual measures; across it, there may be no information. To 1e-3 of the correction, as its
        # size above: how the slow form rounds depends on the machine's linear algebra.
        tolerance_m = max(0.03, 1e-3 * float(np.linalg.norm(wanted)))
        assert (moved - wanted) @ apart / np.linalg.norm(apart) == pytest.approx(0.0, abs=tolerance_m)


def two_ranges(angle_rad):
    """Vehicle 3 has no prior and is 40 m east of where it is said to be; two peers at 500 m, at an angle to each other."""
    away = [(500.0, 0.0), (500.0 * np.cos(angle_rad), 500.0 * np.sin(angle_rad))]
    priors = {v: PositionPrior((*place, 0.0), 1.0, 1.0, False) for v, place in enumerate(away, 1)}
    priors[3] = PositionPrior((-40.0, 0.0, 0.0), 1.0, 1.0, True)
    rng = np.random.default_rng(5)
    residuals = []
    for peer, place in enumerate(away, 1):
        measured = np.hypot(*place) + 0.5 * rng.standard_normal()
        residuals.append(RangeResidual(3, peer, float(measured - np.hypot(place[0] + 40.0, place[1])), 0.5))
    return adjust(Epoch(0.0, priors, tuple(residuals)), [(None, 0.0)])[0]


def test_an_offset_is_taken_as_far_as_the_ranges_determine_it():
    """Ranges at a right angle show where the vehicle is; those of one direction show nothing across it but noise."""
    assert np.hypot(*(two_ranges(np.pi / 2.0).placed_offset_m(3, 10.0) - (40.0, 0.0))) < 3.0
    along = two_ranges(2e-4)
    assert np.hypot(*along.horizontal(3, along.corrections_m)) > 100.0
    assert np.hypot(*(along.placed_offset_m(3, 10.0) - (40.0, 0.0))) < 3.0
