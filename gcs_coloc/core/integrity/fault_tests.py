"""Do ranges and claimed positions agree, and if not, which single fault explains it? Pure statistics, no memory.

A fault adds a column or two of unknown size to the model of `adjustment`: a vehicle's claim that is off by a horizontal vector, a
pair whose ranges are off, a device whose ranges are all off by one length; with an earlier scene, that came to be off since.
Each is left out in turn (its columns made free); the drop of the statistic is twice the log likelihood ratio. A fault is
possible when the rest is consistent without it.

How far a vehicle without a claim is from where it would be put without the fault is what the fault may have done to it: the
solution separation of receiver autonomous integrity monitoring.

Source: generalised likelihood ratio test of outliers in linear models (Baarda's data snooping; Teunissen, Testing Theory);
solution separation (Brown and McBurney, 1988).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from math import hypot

import numpy as np
from scipy.special import chdtri

from gcs_coloc.core.integrity.adjustment import Adjustment, Effect, Past, adjust
from gcs_coloc.core.integrity.epoch import Epoch
from gcs_coloc.core.measurements import FloatArray


class FaultKind(Enum):
    """What may be at fault."""

    VEHICLE = "vehicle"
    PAIR = "pair"
    DEVICE = "device"


@dataclass(frozen=True, slots=True)
class PossibleFault:
    """One possible fault: `vehicles` has the liar, the pair, or the owner of the device; `size_m` is how far it is off."""

    kind: FaultKind
    vehicles: tuple[int, ...]
    size_m: float


@dataclass(frozen=True, slots=True)
class FaultTestResult:
    """Outcome of one test.

    `consistent` at the alarm level; `clear` well below it. `possible`: the faults that explain what is not consistent about
    equally well, empty where no single one does; `involved` are all vehicles that claim a position.
    `offset_m`: how far each vehicle without a claim (2,) would be moved if nobody lied, `doubt_m2` the second moment (2, 2) of
    how far it would be moved without the faults that are likely enough to count, zero where none is.
    """

    statistic: float
    degrees_of_freedom: int
    consistent: bool
    clear: bool
    possible: tuple[PossibleFault, ...]
    involved: frozenset[int]
    offset_m: Mapping[int, FloatArray]
    doubt_m2: Mapping[int, FloatArray]


@dataclass(frozen=True, slots=True)
class SignificanceLevels:
    """Chances and margins of the test.

    `alarm`: chance of an alarm in one test without a fault. `clear`: chance that a sound fleet is not called clear.
    `doubted`, `feared`: a fault that is this unlikely to appear by chance begins to count in the bounds, and counts in full.
    `rest`: chance that the rest of a fleet with one fault is not called consistent.
    `margin`: a fault whose explanation is worse than the best by this (twice the log likelihood ratio) is ruled out.
    """

    alarm: float = 1e-6
    clear: float = 1e-2
    doubted: float = 5e-3
    feared: float = 5e-4
    rest: float = 1e-3
    margin: float = 10.0


_Fault = tuple[FaultKind, tuple[int, ...], Effect]


def run_tests(now: Epoch, levels: SignificanceLevels, pasts: Sequence[Past]) -> list[FaultTestResult | None]:
    """Test the ranges of a scene against its places, or what changed since earlier ones.

    A past is (None, 0) for the test of the present alone, else an earlier scene and the correlation of one vehicle's error at the
    two times. None where there are more unknowns than rows and nothing can be told.
    """
    return [run_test(fit, levels) for fit in adjust(now, pasts)]


def run_test(fit: Adjustment, levels: SignificanceLevels) -> FaultTestResult | None:
    """Judge one adjustment; None where there are more unknowns than rows and nothing can be told."""
    dof = fit.degrees_of_freedom
    if dof < 1:
        return None
    claiming = [v for v in fit.vehicles if not fit.places[v].free]
    # The whole and each claim are looked at: together they may not be wrong more often than one test may.
    each = levels.alarm / (1 + len(claiming))
    # No fault explains more than there is: where that is too little for any to count, none need be looked at.
    telling = fit.statistic > min(limit(1, levels.doubted), limit(1, each))
    gains = [fit.claim_gain(v) for v in claiming] if telling else []
    fear = max((_fear(gain, rank, levels) for gain, rank in gains), default=0.0)
    alarm = fit.statistic > limit(dof, each) or any(rank and gain > limit(rank, each) for gain, rank in gains)
    found: list[_Fault] = []
    if fear or alarm:
        found = [(FaultKind.VEHICLE, (v,), fit.vehicle_effect(v)) for v in claiming] + _range_faults(fit)
    best = max((effect.gain for _, _, effect in found if effect.rank), default=0.0)
    likely = [(kind, who, effect) for kind, who, effect in found if effect.rank and effect.gain >= best - levels.margin]
    free = [v for v in fit.vehicles if fit.places[v].free]
    doubt = {}
    for vehicle in free:
        moves = [fit.horizontal(vehicle, effect.corrections_m) for _, _, effect in likely] if fear else []
        doubt[vehicle] = fear * sum((np.outer(move, move) for move in moves), start=np.zeros((2, 2)))
    return FaultTestResult(
        statistic=fit.statistic,
        degrees_of_freedom=dof,
        consistent=not alarm,
        clear=not alarm and not fear and fit.statistic <= limit(dof, levels.clear),
        possible=_possible(likely, fit.statistic, dof, levels) if alarm else (),
        involved=frozenset(claiming),
        offset_m={v: fit.horizontal(v, fit.corrections_m) for v in free},
        doubt_m2=doubt,
    )


def _fear(gain: float, rank: int, levels: SignificanceLevels) -> float:
    """How much a fault counts in the bounds, 0 to 1."""
    if not rank:
        return 0.0
    low, high = limit(rank, levels.doubted), limit(rank, levels.feared)
    return min(max((gain - low) / (high - low), 0.0), 1.0)


def _possible(likely: list[_Fault], statistic: float, dof: int, levels: SignificanceLevels) -> tuple[PossibleFault, ...]:
    # With nothing left over, any fault would fit: it is possible, and so is every other.
    return tuple(
        PossibleFault(kind, who, hypot(*effect.size_m))
        for kind, who, effect in likely
        if dof == effect.rank or statistic - effect.gain <= limit(dof - effect.rank, levels.rest)
    )


def _range_faults(fit: Adjustment) -> list[_Fault]:
    faults: list[_Fault] = []
    pairs: dict[tuple[int, ...], list[int]] = {}
    devices: dict[int, list[int]] = {}
    for number, row in enumerate(fit.rows):
        pairs.setdefault(tuple(sorted(row.pair)), []).append(number)
        devices.setdefault(row.from_vehicle, []).append(number)
    faults += [(FaultKind.PAIR, pair, fit.rows_effect(numbers)) for pair, numbers in sorted(pairs.items())]
    faults += [(FaultKind.DEVICE, (owner,), fit.rows_effect(rows)) for owner, rows in sorted(devices.items()) if len(rows) > 1]
    return faults


@lru_cache(maxsize=1024)
def limit(dof: int, chance: float) -> float:
    """Return what a chi-square variable passes with this chance."""
    return float(chdtri(dof, chance))
