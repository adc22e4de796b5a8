"""Do ranges and claimed positions agree, and if not, which single fault explains it? Pure statistics, no memory.

Model, linearised at the given places: residual = range - |p_i - p_j| = -u.(e_i - e_j) + noise, u the unit vector from j to
i, e the error of a place. A claimed position has an error of its stated size, whatever its spread over time; a vehicle
without a claim has a free horizontal error. With the free errors projected out, r'Wr is chi-square under no fault.

A fault adds a column or two of unknown size: a vehicle's claim that is off by a horizontal vector, a pair whose ranges
are off, a device whose ranges are all off by one length. Each is left out in turn (its columns made free); the drop of the
statistic is twice the log likelihood ratio. A fault is a candidate when the rest is consistent without it.

Source: generalised likelihood ratio test of outliers in linear models (Baarda's data snooping; Teunissen, Testing Theory).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from math import hypot

import numpy as np
from scipy.special import chdtri

from gcs_coloc.core.measurements import FloatArray

_RANK_TOLERANCE = 1e-6
_LEAST_INFORMATION = 1e-9  # 1/m^2: what is known no better than to 30 km is not known
_NEWTON_STEPS = 3


@dataclass(frozen=True, slots=True)
class Place:
    """Where a vehicle is held to be: ENU (3,) in m, with the 1-sigma per axis in m; `free`: horizontally nothing is claimed."""

    position_enu_m: FloatArray
    sigma_h_m: float
    sigma_v_m: float
    free: bool


@dataclass(frozen=True, slots=True)
class Row:
    """What the ranges of one device to one peer say beyond the distance of the places: residual and its 1-sigma, m."""

    from_vehicle: int
    to_vehicle: int
    residual_m: float
    sigma_m: float


class Kind(Enum):
    """What may be at fault."""

    VEHICLE = "vehicle"
    PAIR = "pair"
    DEVICE = "device"


@dataclass(frozen=True, slots=True)
class Suspicion:
    """One possible fault: `vehicles` has the liar, the pair, or the owner of the device; `size_m` is how far it is off."""

    kind: Kind
    vehicles: tuple[int, ...]
    size_m: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """Outcome of one test. `consistent` at the alarm level; `clear` well below it. `possible`: the faults that explain what is
    not consistent about equally well, empty where no single one does; `involved` are all vehicles that claim a position.
    """

    statistic: float
    degrees_of_freedom: int
    consistent: bool
    clear: bool
    possible: tuple[Suspicion, ...]
    involved: frozenset[int]


@dataclass(frozen=True, slots=True)
class Levels:
    """Chances and margins of the test.

    `alarm`: chance of an alarm in one test without a fault. `clear`: chance that a sound fleet is not called clear.
    `rest`: chance that the rest of a fleet with one fault is not called consistent.
    `margin`: a fault whose explanation is worse than the best by this (twice the log likelihood ratio) is ruled out.
    """

    alarm: float = 1e-4
    clear: float = 1e-2
    rest: float = 1e-3
    margin: float = 10.0


def judge(places: Mapping[int, Place], rows: Sequence[Row], levels: Levels) -> Verdict | None:
    """Test the rows against the places; None where there are more unknowns than rows and nothing can be told.

    Every vehicle of a row must have a place, and no two places of a row may coincide.
    """
    vehicles = sorted({v for row in rows for v in (row.from_vehicle, row.to_vehicle)})
    if not vehicles:
        return None
    at = {vehicle: index for index, vehicle in enumerate(vehicles)}
    shift = np.zeros((len(vehicles), 3))
    free = [at[v] for v in vehicles if places[v].free]
    for _ in range(_NEWTON_STEPS if free else 1):
        H, r, W = _linearise(places, rows, at, shift)
        B = np.concatenate([H[:, 3 * i : 3 * i + 2] for i in free], axis=1) if free else np.zeros((len(rows), 0))
        gram, rank = _pinv(B.T @ W @ B)
        if free:
            step = gram @ (B.T @ W @ r)
            for k, i in enumerate(free):
                shift[i, :2] += step[2 * k : 2 * k + 2]
    WB = W @ B
    W = W - WB @ gram @ WB.T
    dof = len(rows) - rank
    if dof < 1:
        return None
    statistic = float(r @ W @ r)
    claiming = frozenset(v for v in vehicles if not places[v].free)
    consistent, clear = statistic <= chdtri(dof, levels.alarm), statistic <= chdtri(dof, levels.clear)
    possible = () if consistent else _possible(places, rows, at, H, r, W, statistic, dof, levels)
    return Verdict(statistic, dof, bool(consistent), bool(clear), possible, claiming)


def _linearise(
    places: Mapping[int, Place], rows: Sequence[Row], at: Mapping[int, int], shift: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the design matrix (rows, 3 vehicles), the residuals (rows,) at the shifted places, and their weight matrix."""
    H: FloatArray = np.zeros((len(rows), 3 * len(at)))
    r: FloatArray = np.zeros(len(rows))
    for k, row in enumerate(rows):
        i, j = at[row.from_vehicle], at[row.to_vehicle]
        d = places[row.from_vehicle].position_enu_m - places[row.to_vehicle].position_enu_m
        moved = d + shift[i] - shift[j]
        distance_m = float(np.linalg.norm(moved))
        unit = moved / distance_m
        H[k, 3 * i : 3 * i + 3], H[k, 3 * j : 3 * j + 3] = unit, -unit
        r[k] = row.residual_m + float(np.linalg.norm(d)) - distance_m
    variances = np.zeros(3 * len(at))
    for vehicle, i in at.items():
        place = places[vehicle]
        variances[3 * i : 3 * i + 3] = (0.0 if place.free else place.sigma_h_m**2,) * 2 + (place.sigma_v_m**2,)
    S = (H * variances) @ H.T + np.diag([row.sigma_m**2 for row in rows])
    return H, r, np.asarray(np.linalg.inv(S), dtype=np.float64)


def _possible(
    places: Mapping[int, Place],
    rows: Sequence[Row],
    at: Mapping[int, int],
    H: FloatArray,
    r: FloatArray,
    W: FloatArray,
    statistic: float,
    dof: int,
    levels: Levels,
) -> tuple[Suspicion, ...]:
    scored: list[tuple[float, Suspicion]] = []
    Wr = W @ r
    for kind, vehicles, B in _faults(places, rows, at, H):
        A = B.T @ W @ B
        inverse, rank = _pinv(A)
        g = B.T @ Wr
        size = inverse @ g
        gain = float(g @ size)
        rest = dof - rank
        # With nothing left over, any fault would fit: it is possible, and so is every other.
        if rank and (rest == 0 or statistic - gain <= chdtri(rest, levels.rest)):
            scored.append((gain, Suspicion(kind, vehicles, hypot(*size))))
    best = max((gain for gain, _ in scored), default=0.0)
    return tuple(suspicion for gain, suspicion in scored if gain >= best - levels.margin)


def _faults(
    places: Mapping[int, Place], rows: Sequence[Row], at: Mapping[int, int], H: FloatArray
) -> list[tuple[Kind, tuple[int, ...], FloatArray]]:
    faults: list[tuple[Kind, tuple[int, ...], FloatArray]] = [
        (Kind.VEHICLE, (vehicle,), H[:, 3 * i : 3 * i + 2]) for vehicle, i in at.items() if not places[vehicle].free
    ]
    pairs = sorted({tuple(sorted((row.from_vehicle, row.to_vehicle))) for row in rows})
    for pair in pairs:
        column = [1.0 if {row.from_vehicle, row.to_vehicle} == set(pair) else 0.0 for row in rows]
        faults.append((Kind.PAIR, pair, np.array(column)[:, np.newaxis]))
    for owner in sorted({row.from_vehicle for row in rows}):
        column = [1.0 if row.from_vehicle == owner else 0.0 for row in rows]
        if sum(column) > 1.0:
            faults.append((Kind.DEVICE, (owner,), np.array(column)[:, np.newaxis]))
    return faults


def _pinv(A: FloatArray) -> tuple[FloatArray, int]:
    """Return the pseudo-inverse of a symmetric matrix and its rank; directions that nothing measures are left out."""
    if A.shape[0] == 0:
        return A, 0
    values, vectors = np.linalg.eigh(A)
    kept = values > max(float(values[-1]) * _RANK_TOLERANCE, _LEAST_INFORMATION)
    return (vectors[:, kept] / values[kept]) @ vectors[:, kept].T, int(kept.sum())
