"""What positions are tested on against ranges: where the fleet is held to be at one time, and what ranges say beyond that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gcs_coloc.core.measurements import FloatArray, Vector3

LEAST_SIGMA_M = 0.01
"""No position is known better, and no distance is shorter."""
LEAST_INFORMATION = 1e-9
"""1/m^2: what is known no better than to 30 km is not known."""


class PositionPrior(NamedTuple):
    """Where a vehicle is held to be: ENU in m, with the 1-sigma per axis in m; `free`: horizontally nothing is claimed."""

    position_enu_m: Vector3
    sigma_h_m: float
    sigma_v_m: float
    free: bool


class RangeResidual(NamedTuple):
    """What the ranges of one device to one peer say beyond the distance of the places, m: residual, its 1-sigma, and the
    1-sigma of the part of the error that lasts.
    """

    from_vehicle: int
    to_vehicle: int
    residual_m: float
    sigma_m: float
    bias_m: float = 0.0

    @property
    def pair(self) -> tuple[int, int]:
        """The device's vehicle and its peer."""
        return self.from_vehicle, self.to_vehicle


@dataclass(frozen=True, slots=True)
class EpochArrays:
    """A scene's rows and their vehicles as arrays, in the order of `pairs` and of `vehicles` (`at`: a vehicle's place in that).

    `ends` (2, rows) are the places of a row's two vehicles in `vehicles`, `apart_m` (rows, 3) the vectors from the second to the
    first and `units` their directions, `roots` (3 vehicles,) the root of what is known of each axis of the places, 1/m, and
    `claimed` whether that is more than nothing. `free_states` are those, of 3 for each vehicle, of which nothing is claimed.
    Lengths in m, variances in m^2.
    """

    pairs: tuple[tuple[int, int], ...]
    vehicles: tuple[int, ...]
    at: Mapping[int, int]
    free: tuple[bool, ...]
    free_states: NDArray[np.intp]
    ends: NDArray[np.intp]
    apart_m: FloatArray
    units: FloatArray
    ranges_m: FloatArray
    residuals_m: FloatArray
    variances_m2: FloatArray
    biases_m: FloatArray
    roots: FloatArray
    claimed: NDArray[np.bool_]


@dataclass(frozen=True)
class Epoch:
    """The fleet at one time. Every vehicle of a row has a place, and no two places of a row coincide."""

    at_s: float
    places: Mapping[int, PositionPrior]
    rows: tuple[RangeResidual, ...]

    @cached_property
    def arrays(self) -> EpochArrays:
        """The rows and their vehicles as arrays; a scene is looked at again as long as it is remembered."""
        pairs = tuple(row.pair for row in self.rows)
        vehicles = tuple(sorted({v for pair in pairs for v in pair}))
        at = {vehicle: index for index, vehicle in enumerate(vehicles)}
        places = [self.places[v] for v in vehicles]
        positions = np.array([place.position_enu_m for place in places]).reshape(-1, 3)
        ends = np.array([(at[i], at[j]) for i, j in pairs], dtype=np.intp).reshape(-1, 2).T
        apart_m = positions[ends[0]] - positions[ends[1]]
        distances_m = np.maximum(np.sqrt(np.einsum("ij,ij->i", apart_m, apart_m)), LEAST_SIGMA_M)
        told = np.array([(row.residual_m, row.sigma_m, row.bias_m) for row in self.rows]).reshape(-1, 3).T
        known: list[float] = []
        for place in places:
            horizontal = sqrt(LEAST_INFORMATION) if place.free else 1.0 / max(place.sigma_h_m, LEAST_SIGMA_M)
            known += [horizontal, horizontal, 1.0 / max(place.sigma_v_m, LEAST_SIGMA_M)]
        free = [3 * n + axis for n, place in enumerate(places) if place.free for axis in (0, 1)]
        claimed = np.ones(len(known), dtype=bool)
        claimed[free] = False
        return EpochArrays(
            pairs=pairs,
            vehicles=vehicles,
            at=at,
            free=tuple(place.free for place in places),
            free_states=np.array(free, dtype=np.intp),
            ends=ends,
            apart_m=apart_m,
            units=apart_m / distances_m[:, np.newaxis],
            ranges_m=told[0] + distances_m,
            residuals_m=told[0],
            variances_m2=told[1] ** 2 + told[2] ** 2,
            biases_m=told[2],
            roots=np.array(known),
            claimed=claimed,
        )
