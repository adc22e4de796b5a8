"""An epoch: priors and range residuals of the fleet at one time, and the history of such epochs."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, inf, sqrt
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gcs_coloc.core.measurements import FloatArray, Vector3

MIN_SIGMA_M = 0.01
"""Smallest 1-sigma of a position and smallest distance. Chosen: below GNSS and ranging, above rounding."""
MIN_INFORMATION_PER_M2 = 1e-9
"""Information of a coordinate without prior: a 1-sigma of 30 km. Chosen: less costs digits of the adjustment."""
_LARGEST_SIGMA_V_M = 10.0  # of a height without prior in an adjustment; chosen: a free one would cost each range its information
PERIOD_S = 0.2
"""Tests run so often. Chosen: as often as ranges and positions come."""
INTERVALS_S = (2.0, 5.0, 12.0)
"""Tested are the present, and the change since so long ago. Chosen: a ramp of 5 m/s shows within the first, one of 1 m/s within
the last."""
CORRELATION_TIME_S = 30.0
"""A fault-free position error is a Gauss-Markov process of this time. Source: errors of GNSS positions are correlated for half a
minute to minutes."""
_TOLERANCE_S = 0.3  # so far an earlier epoch may be from the time that is wanted; chosen: one and a half periods

RANGE_BIAS_M = 0.3
"""1-sigma of the error that all ranges of a pair share. Source: lasting biases of 0.16 to 0.35 m in public ultra-wideband
data."""
COLOURED_SHARE = 0.1
"""Share of the stated variance of ranges that no averaging removes. Chosen: as `range_coloured_share` of the fleet filter."""

_at_s = attrgetter("at_s")


class PositionPrior(NamedTuple):
    """The position that a vehicle has before the adjustment: ENU in m, with the 1-sigma per axis in m.

    `no_prior`: the horizontal position is only a point of linearisation, without information.
    """

    position_enu_m: Vector3
    sigma_h_m: float
    sigma_v_m: float
    no_prior: bool


class RangeResidual(NamedTuple):
    """Range observed minus range computed from the priors, of one device to one peer, in m.

    `sigma_m` is the 1-sigma of its noise in one epoch, `bias_m` and `devices_m` are those of the errors that last from epoch to
    epoch: of the pair, and of the two devices, which have them in their other ranges as well.
    """

    from_vehicle: int
    to_vehicle: int
    residual_m: float
    sigma_m: float
    bias_m: float = 0.0
    devices_m: float = 0.0

    @property
    def pair(self) -> tuple[int, int]:
        """The device's vehicle and its peer."""
        return self.from_vehicle, self.to_vehicle


@dataclass(frozen=True, slots=True)
class EpochArrays:
    """The residuals and vehicles of an epoch as arrays.

    They are in the order of `pairs` and of `vehicles`. Lengths are in m, variances in m^2.

    `index` maps a vehicle to its place in `vehicles`. `ends` (2, residuals) are the indices of a residual's two vehicles,
    `baselines_m` (residuals, 3) the vectors from the second to the first, `unit_vectors` their directions. `biases_m` are the
    1-sigmas of all errors that last, `devices_m` those of the part that the devices have. `distance_times_sigma_m2` is the
    least product of a residual's distance and its sigma.

    States are the east, north and up corrections of each vehicle in turn. `sqrt_information` (3 vehicles,) is the root of their
    prior information in 1/m, `has_prior` whether there is any, `states_without_prior` are the indices where there is none.
    """

    pairs: tuple[tuple[int, int], ...]
    vehicles: tuple[int, ...]
    index: Mapping[int, int]
    no_prior: tuple[bool, ...]
    states_without_prior: NDArray[np.intp]
    ends: NDArray[np.intp]
    baselines_m: FloatArray
    unit_vectors: FloatArray
    ranges_m: FloatArray
    residuals_m: FloatArray
    variances_m2: FloatArray
    biases_m: FloatArray
    devices_m: FloatArray
    distance_times_sigma_m2: float
    sqrt_information: FloatArray
    has_prior: NDArray[np.bool_]

    @property
    def range_covariance_m2(self) -> FloatArray:
        """The covariance (residuals, residuals) of the ranges' noise.

        A device errs alike in all that it measures, and in all that it answers; the square of `devices_m` is half of each.
        """
        alike = sum((0.5 * (end[:, np.newaxis] == end) for end in self.ends), start=-np.eye(len(self.pairs)))
        return np.asarray(np.diag(self.variances_m2) + self.devices_m[:, np.newaxis] * alike * self.devices_m)


@dataclass(frozen=True, slots=True)
class _Geometry:
    """What of `EpochArrays` is the same whatever the noise, and the distances (residuals,), m."""

    pairs: tuple[tuple[int, int], ...]
    vehicles: tuple[int, ...]
    index: Mapping[int, int]
    ends: NDArray[np.intp]
    baselines_m: FloatArray
    distances_m: FloatArray
    unit_vectors: FloatArray


@dataclass(frozen=True)
class Epoch:
    """The fleet at one time: position priors and range residuals.

    Every vehicle of a residual has a prior, and no two priors of a residual coincide. The ranges in it were measured between
    `began_s` and `ended_s`; two epochs are independent where these do not overlap.
    """

    at_s: float
    priors: Mapping[int, PositionPrior]
    residuals: tuple[RangeResidual, ...]
    began_s: float = float("-inf")
    ended_s: float = float("inf")

    @property
    def reporting(self) -> frozenset[int]:
        """The vehicles with a range and a position of their own."""
        return frozenset(v for residual in self.residuals for v in residual.pair if not self.priors[v].no_prior)

    def without_priors(self, vehicles: Collection[int]) -> Epoch:
        """Return the epoch without the horizontal priors of some vehicles; itself where nothing changes."""
        changed = {v: prior._replace(no_prior=True) for v in vehicles if (prior := self.priors.get(v)) and not prior.no_prior}
        return self.with_noise({**self.priors, **changed}, self.residuals) if changed else self

    def with_noise(self, priors: Mapping[int, PositionPrior], residuals: tuple[RangeResidual, ...]) -> Epoch:
        """Return the epoch with priors and residuals that differ by their noise alone.

        The geometry is the same, and is computed once for all of them.
        """
        changed = replace(self, priors=priors, residuals=residuals)
        changed.__dict__["_geometry"] = self._geometry
        return changed

    @cached_property
    def _geometry(self) -> _Geometry:
        pairs = tuple(residual.pair for residual in self.residuals)
        vehicles = tuple(sorted({v for pair in pairs for v in pair}))
        index = {vehicle: number for number, vehicle in enumerate(vehicles)}
        positions = np.array([self.priors[v].position_enu_m for v in vehicles]).reshape(-1, 3)
        ends = np.array([(index[i], index[j]) for i, j in pairs], dtype=np.intp).reshape(-1, 2).T
        baselines_m = positions[ends[0]] - positions[ends[1]]
        distances_m = np.maximum(np.sqrt(np.einsum("ij,ij->i", baselines_m, baselines_m)), MIN_SIGMA_M)
        return _Geometry(pairs, vehicles, index, ends, baselines_m, distances_m, baselines_m / distances_m[:, np.newaxis])

    @cached_property
    def arrays(self) -> EpochArrays:
        """The same as arrays; cached, because the history compares an epoch with many later ones."""
        geometry, distances_m = self._geometry, self._geometry.distances_m
        priors = [self.priors[v] for v in geometry.vehicles]
        columns = np.array([(r.residual_m, r.sigma_m, r.bias_m, r.devices_m) for r in self.residuals]).reshape(-1, 4).T
        sqrt_information: list[float] = []
        for prior in priors:
            horizontal = sqrt(MIN_INFORMATION_PER_M2) if prior.no_prior else 1.0 / max(prior.sigma_h_m, MIN_SIGMA_M)
            sqrt_information += [horizontal, horizontal, 1.0 / max(prior.sigma_v_m, MIN_SIGMA_M)]
        without = [3 * number + axis for number, prior in enumerate(priors) if prior.no_prior for axis in (0, 1)]
        has_prior = np.ones(len(sqrt_information), dtype=bool)
        has_prior[without] = False
        biases_m = np.hypot(columns[2], columns[3])
        variances_m2 = columns[1] ** 2 + biases_m**2
        return EpochArrays(
            pairs=geometry.pairs,
            vehicles=geometry.vehicles,
            index=geometry.index,
            no_prior=tuple(prior.no_prior for prior in priors),
            states_without_prior=np.array(without, dtype=np.intp),
            ends=geometry.ends,
            baselines_m=geometry.baselines_m,
            unit_vectors=geometry.unit_vectors,
            ranges_m=columns[0] + distances_m,
            residuals_m=columns[0],
            variances_m2=variances_m2,
            biases_m=biases_m,
            devices_m=columns[3],
            distance_times_sigma_m2=float((distances_m * np.sqrt(variances_m2)).min(initial=inf)),
            sqrt_information=np.array(sqrt_information),
            has_prior=has_prior,
        )


def height_sigma_m(covariance: FloatArray) -> float:
    """Return the 1-sigma of an estimate's height as a prior, m; `covariance` is (3, 3), m^2."""
    return min(sqrt(float(covariance[2, 2])), _LARGEST_SIGMA_V_M)


def range_jacobian(unit_vectors: FloatArray, ends: NDArray[np.intp], vehicles: int) -> FloatArray:
    """Return H (..., residuals, 3 vehicles), the change of ranges with the positions of their ends.

    `unit_vectors` are (..., residuals, 3), `ends` is as in `EpochArrays`.
    """
    rows = np.arange(unit_vectors.shape[-2])
    H: FloatArray = np.zeros((*unit_vectors.shape[:-1], vehicles, 3))
    H[..., rows, ends[0], :] = unit_vectors
    H[..., rows, ends[1], :] = -unit_vectors
    return H.reshape(*unit_vectors.shape[:-1], 3 * vehicles)


Past = tuple[Epoch | None, float]
"""An earlier epoch, and the correlation of one vehicle's position error at the two times; None and 0 for the present alone."""


class EpochHistory:
    """The epochs of the last seconds, one each `PERIOD_S`, for as long as the longest of the intervals."""

    def __init__(self) -> None:
        self._epochs: deque[Epoch] = deque(maxlen=round(max(INTERVALS_S) / PERIOD_S) + 2)

    def append(self, epoch: Epoch) -> None:
        """Append an epoch that is newer than all before."""
        self._epochs.append(epoch)

    def pasts(self, at_s: float) -> dict[float, Past]:
        """Return the earlier epochs to compare an epoch at this time with, by interval in s.

        Interval 0 is the present alone, without an earlier epoch. An interval is missing where no epoch is near that long
        before.
        """
        pasts: dict[float, Past] = {0.0: (None, 0.0)}
        for interval_s in INTERVALS_S:
            earlier = self._nearest(at_s - interval_s)
            if earlier is not None:
                pasts[interval_s] = (earlier, exp(-interval_s / CORRELATION_TIME_S))
        return pasts

    def _nearest(self, wanted_s: float) -> Epoch | None:
        later = bisect_left(self._epochs, wanted_s, key=_at_s)
        neighbours = [self._epochs[n] for n in (later - 1, later) if 0 <= n < len(self._epochs)]
        nearest = min(neighbours, key=lambda epoch: abs(epoch.at_s - wanted_s), default=None)
        return nearest if nearest is not None and abs(nearest.at_s - wanted_s) <= _TOLERANCE_S else None
