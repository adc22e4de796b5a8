"""Noise model: how much worse ranges, heights and positions are in a fleet than they state.

Its numbers are the variance components of the tests.

A single fault is explained in `isolation`. Where every device has a lasting error, or every barometer, no single fault explains,
and nobody is at fault more than the others: the noise that the tests assume is too small. One component of it is then enlarged
until ranges and positions agree. Among the components that bring this about the likeliest counts, by

    -2 log L = T + log det V + log det (A' V^-1 A),    T = r' (V^-1 - V^-1 A (A' V^-1 A)^-1 A' V^-1) r

with r the residuals of one epoch, V their covariance, and A the columns of the positions without prior. A fault of one receiver
costs less than noise of all: the determinant grows with every residual.

A device has one error in all that it measures and one in all that it answers, each half of the variance of a range: few numbers
explain the residuals of many pairs. The tests of faults take these errors as independent by pair.

What blocked ranges brought about goes again: a smaller component that is clearly likelier for a while takes its place, with some
pairs off where need be.

All components last: between two epochs they change with the ranges, or as a position error does. A step or a ramp is still found
by the tests against earlier epochs.

Source: K.-R. Koch, Parameter Estimation and Hypothesis Testing in Linear Models (1999), section 3.6, variance components;
H. D. Patterson and R. Thompson, Biometrika 58 (1971), restricted likelihood.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import exp, hypot
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.integrity.epoch_tests.epoch import MIN_INFORMATION_PER_M2, Epoch, PositionPrior, range_jacobian
from gcs_coloc.core.integrity.epoch_tests.fault_tests import REST_LEVEL, RULED_OUT_MARGIN, chi2_limit
from gcs_coloc.core.integrity.epoch_tests.pair_outliers import FURTHER_PAIR_PENALTY, Pair, pair_outliers, unordered, without_pairs

_RANGE_BIASES_M = (1.0, 2.0, 4.0, 8.0)  # chosen: uncalibrated devices; beyond it the protection level is beyond the alert limit
_DEVICE_SCALES = (0.002, 0.005, 0.01, 0.02)  # chosen: clocks and atmosphere 1e-5, devices that are set wrongly 1e-2
_HEIGHT_SIGMAS_M = (5.0, 10.0, 20.0)  # chosen: pressure of another day or place; 8 m for 1 hPa
_POSITION_FACTORS = (2.0, 4.0)  # chosen: receivers that state a half or a quarter of their error
_USUAL_SIGMAS = 1.25  # chosen: the tests take the error of a device as one of each pair, which makes a large one rare
_PAIR_OFF_M = 20.0
"""1-sigma of the ranges of a pair that is off. Chosen: a detour past a building or hill is of some metres to some tens."""
_FORGOTTEN_S = 600.0  # chosen: devices and weather change within hours


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """How much larger than stated the noise is: 1-sigmas beyond those stated.

    `range_bias_m` is the lasting error of each pair's ranges. `device_bias_m` is that of the devices, `device_scale` the same
    as a share of the range. `height_sigma_m` is the least 1-sigma of heights, `position_factor` the factor on the sigmas of
    reported positions. `pairs_off` are the pairs whose ranges are off at the moment. `unisolated` are pairs and devices
    (one vehicle) of which the ranges of some are off, and it is open which.
    """

    range_bias_m: float = 0.0
    device_bias_m: float = 0.0
    device_scale: float = 0.0
    height_sigma_m: float = 0.0
    position_factor: float = 1.0
    pairs_off: frozenset[Pair] = frozenset()
    unisolated: frozenset[tuple[int, ...]] = frozenset()

    @property
    def is_as_stated(self) -> bool:
        """Whether nothing is added to what is stated."""
        lengths = self.range_bias_m, self.device_bias_m, self.device_scale, self.height_sigma_m
        return not any(lengths) and self.position_factor == 1.0

    @property
    def text(self) -> str:
        """What is larger than stated, in words; empty where nothing is."""
        parts = (
            f"lasting errors of ranges of about {_about(self.range_bias_m)} m" if self.range_bias_m > 0.0 else "",
            f"lasting errors of devices of about {_about(self.device_bias_m)} m" if self.device_bias_m > 0.0 else "",
            f"errors of devices of {_about(100.0 * self.device_scale)} % of the range" if self.device_scale > 0.0 else "",
            f"errors of heights of about {_about(self.height_sigma_m)} m" if self.height_sigma_m > 0.0 else "",
            f"positions {self.position_factor:.1f} times worse than stated" if self.position_factor > 1.0 else "",
        )
        return ", ".join(filter(None, parts))

    @property
    def isolated_pairs(self) -> frozenset[Pair]:
        """The pairs that are off, and no other ones instead."""
        return self.pairs_off - self.unisolated

    def select(self, epoch: Epoch) -> Epoch:
        """Return the epoch without the pairs that are off, which is consistent."""
        return without_pairs(epoch, self.pairs_off)

    def expose(self, epoch: Epoch) -> Epoch:
        """Return the epoch without the isolated pairs: bound and level show what others may have done."""
        return without_pairs(epoch, self.isolated_pairs)

    def apply(self, epoch: Epoch) -> Epoch:
        """Return the epoch with this noise."""
        if self.is_as_stated:
            return epoch
        devices_m = np.hypot(self.device_bias_m, self.device_scale * epoch.arrays.ranges_m).tolist()
        return epoch.with_noise(
            {vehicle: self.prior(prior) for vehicle, prior in epoch.priors.items()},
            tuple(
                r._replace(bias_m=hypot(r.bias_m, self.range_bias_m), devices_m=hypot(r.devices_m, of_devices_m))
                for r, of_devices_m in zip(epoch.residuals, devices_m, strict=True)
            ),
        )

    def after(self, elapsed_s: float) -> NoiseModel:
        """Return what is left of the model after some time (s), without the pairs that are off.

        What still acts is found anew. A component below a tenth of its smallest step is gone.
        """
        kept = exp(-elapsed_s / _FORGOTTEN_S)

        def left(component: float, smallest: float) -> float:
            return component * kept if component * kept > 0.1 * smallest else 0.0

        return NoiseModel(
            left(self.range_bias_m, _RANGE_BIASES_M[0]),
            left(self.device_bias_m, _RANGE_BIASES_M[0]),
            left(self.device_scale, _DEVICE_SCALES[0]),
            left(self.height_sigma_m, _HEIGHT_SIGMAS_M[0]),
            1.0 + left(self.position_factor - 1.0, _POSITION_FACTORS[0] - 1.0),
        )

    def larger(self) -> Iterator[NoiseModel]:
        """Yield the models with one component enlarged."""
        yield from (replace(self, range_bias_m=bias_m) for bias_m in _RANGE_BIASES_M if bias_m > self.range_bias_m)
        yield from (replace(self, device_bias_m=bias_m) for bias_m in _RANGE_BIASES_M if bias_m > self.device_bias_m)
        yield from (replace(self, device_scale=scale) for scale in _DEVICE_SCALES if scale > self.device_scale)
        yield from (replace(self, height_sigma_m=sigma_m) for sigma_m in _HEIGHT_SIGMAS_M if sigma_m > self.height_sigma_m)
        yield from (replace(self, position_factor=factor) for factor in _POSITION_FACTORS if factor > self.position_factor)

    def with_device_error(self, size_m: float) -> NoiseModel | None:
        """Return the model in which a device error of this size (m) is usual; None where there is no new one."""
        least_m = size_m / _USUAL_SIGMAS
        enough = (replace(self, device_bias_m=bias_m) for bias_m in _RANGE_BIASES_M if bias_m >= least_m)
        return next(enough, None) if least_m > self.device_bias_m else None

    def with_coarser_positions(self) -> NoiseModel | None:
        """Return the model with twice the factor on positions; None beyond the largest factor that counts."""
        factor = 2.0 * self.position_factor
        return replace(self, position_factor=factor) if factor <= _POSITION_FACTORS[-1] else None

    def smaller(self) -> Iterator[NoiseModel]:
        """Yield the models with one component made smaller, down to what is stated."""
        yield from (replace(self, range_bias_m=bias_m) for bias_m in (0.0, *_RANGE_BIASES_M) if bias_m < self.range_bias_m)
        yield from (replace(self, device_bias_m=bias_m) for bias_m in (0.0, *_RANGE_BIASES_M) if bias_m < self.device_bias_m)
        yield from (replace(self, device_scale=scale) for scale in (0.0, *_DEVICE_SCALES) if scale < self.device_scale)
        yield from (
            replace(self, height_sigma_m=sigma_m) for sigma_m in (0.0, *_HEIGHT_SIGMAS_M) if sigma_m < self.height_sigma_m
        )
        yield from (
            replace(self, position_factor=factor) for factor in (1.0, *_POSITION_FACTORS) if factor < self.position_factor
        )

    def lasting_m(self, range_m: float) -> float:
        """Return the 1-sigma of the lasting errors of a range beyond that stated, m."""
        return hypot(self.range_bias_m, self.device_bias_m, self.device_scale * range_m)

    def prior(self, prior: PositionPrior) -> PositionPrior:
        """Return what is known of a position with this noise."""
        return prior._replace(
            sigma_h_m=prior.sigma_h_m * self.position_factor, sigma_v_m=max(prior.sigma_v_m, self.height_sigma_m)
        )


AS_STATED = NoiseModel()
"""Nothing is worse than stated."""


class Likelihood(NamedTuple):
    """The statistic T of an epoch, its degrees of freedom, and -2 log L."""

    statistic: float
    degrees_of_freedom: int
    cost: float


def restricted_likelihood(epoch: Epoch) -> Likelihood:
    """Return the likelihood of an epoch's residuals if there is no fault."""
    arrays = epoch.arrays
    H = range_jacobian(arrays.unit_vectors, arrays.ends, len(arrays.vehicles))
    known = np.where(arrays.has_prior, 1.0 / arrays.sqrt_information, 0.0)
    V = arrays.range_covariance_m2 + (H * known**2) @ H.T
    A = H[:, arrays.states_without_prior]
    r = arrays.residuals_m
    VA, Vr = np.linalg.solve(V, A), np.linalg.solve(V, r)
    information = A.T @ VA + MIN_INFORMATION_PER_M2 * np.eye(A.shape[1])
    statistic = float(r @ Vr - (A.T @ Vr) @ np.linalg.solve(information, A.T @ Vr))
    unknowns = int(np.linalg.matrix_rank(A)) if A.size else 0
    cost = statistic + float(np.linalg.slogdet(V)[1]) + float(np.linalg.slogdet(information)[1])
    return Likelihood(statistic, len(r) - unknowns, cost)


class LikeliestNoise(NamedTuple):
    """A noise model and its cost.

    `cost` is twice its negative log likelihood. It is comparable with the costs of `isolation` under the present model.
    """

    model: NoiseModel
    cost: float


def likeliest_noise(epoch: Epoch, present: NoiseModel) -> LikeliestNoise | None:
    """Return the likeliest larger model with which an epoch is consistent; None where none is.

    A larger model has one component of `present` enlarged. The noise of the epoch is as stated.
    """
    base = restricted_likelihood(_as_tested(present.apply(epoch)))
    found: list[LikeliestNoise] = []
    for model in present.larger():
        likelihood = restricted_likelihood(model.apply(epoch))
        if likelihood.statistic <= chi2_limit(likelihood.degrees_of_freedom, REST_LEVEL):
            found.append(LikeliestNoise(model, likelihood.cost - base.cost + base.statistic))
    return min(found, key=lambda each: each.cost, default=None)


def _as_tested(epoch: Epoch) -> Epoch:
    """Return the epoch with the errors of devices independent by pair, as the tests of faults take them."""
    apart = (r._replace(bias_m=hypot(r.bias_m, r.devices_m), devices_m=0.0) for r in epoch.residuals)
    return epoch.with_noise(epoch.priors, tuple(apart))


def clearly_smaller_noise(epoch: Epoch, present: NoiseModel) -> NoiseModel | None:
    """Return the likeliest smaller model, if it is clearly likelier than `present`; else None.

    The noise of the epoch is as stated. With the smaller model the epoch must be consistent, without some pairs that are off.
    Those pairs have `_PAIR_OFF_M` and the penalty of further pairs. Ranges that test nothing are as likely with either model.
    """
    limit = restricted_likelihood(present.apply(epoch)).cost - RULED_OUT_MARGIN
    found: list[LikeliestNoise] = []
    for model in present.smaller():
        outliers = pair_outliers(model.apply(epoch))
        if outliers is None:
            continue
        coarse = tuple(r._replace(bias_m=_PAIR_OFF_M) if unordered(r.pair) in outliers.pairs else r for r in epoch.residuals)
        likelihood = restricted_likelihood(model.apply(epoch.with_noise(epoch.priors, coarse)))
        cost = likelihood.cost + FURTHER_PAIR_PENALTY * len(outliers.pairs)
        if cost < limit:
            found.append(LikeliestNoise(replace(model, pairs_off=outliers.pairs, unisolated=outliers.unisolated), cost))
    return min(found, key=lambda each: each.cost).model if found else None


def _about(value: float) -> str:
    """Return a number as it is told: whole, or below 1 its first digit that is not zero."""
    return f"{value:.0f}" if value >= 1.0 else f"{value:.1g}"
