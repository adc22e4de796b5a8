"""Several pairs whose ranges are off at once, as where buildings and terrain are in the way.

A fault of one pair is a hypothesis of `isolation`. Here the pair whose ranges explain most is left out, then the next, until the
rest is consistent: iterated data snooping. The rest keeps redundancy and more than half of the pairs.

Two pairs of one vehicle that are off look like a vehicle that is elsewhere: its position has two horizontal unknowns, as many as
there are ranges to explain. Where pairs have been off of late, that is an explanation beside a faulty receiver. So do the pairs
of two vehicles that a third alone ranges look like both elsewhere alike.

Source: W. Baarda, A testing procedure for use in geodetic networks (1968); N. L. Knight, J. Wang and C. Rizos, J. Geodesy 84
(2010), multiple outliers.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from itertools import combinations
from math import inf
from typing import NamedTuple

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, Past
from gcs_coloc.core.integrity.epoch_tests.fault_tests import REST_LEVEL, RULED_OUT_MARGIN, Adjustment, adjust, chi2_limit

FURTHER_PAIR_PENALTY = 9.2  # twice the log of 100: chosen, so much rarer is each further pair that is off at the same time

Pair = tuple[int, int]
"""Two vehicles, the smaller id first."""


class PairOutliers(NamedTuple):
    """Pairs whose ranges are off at once, and the cost of that explanation.

    `cost` is twice the negative log likelihood, comparable with the costs of `isolation`. `unisolated` are those of them instead
    of which another pair may be off as well, and that one: the rest has no redundancy that tells these apart.
    """

    pairs: frozenset[Pair]
    cost: float
    unisolated: frozenset[Pair]


def without_pairs(epoch: Epoch, pairs: Collection[Pair]) -> Epoch:
    """Return the epoch without the residuals of some pairs."""
    if not pairs:
        return epoch
    return replace(epoch, residuals=tuple(r for r in epoch.residuals if unordered(r.pair) not in pairs))


def pair_outliers(epoch: Epoch, known: Collection[Pair] = ()) -> PairOutliers | None:
    """Return the pairs without which an epoch is consistent; None where there is no such set.

    Fewer than half of the pairs may be left out, and the rest must keep redundancy. `known` pairs were isolated just before:
    where another one may be off instead, they go on to be.
    """
    off: set[Pair] = set()
    pairs = {unordered(residual.pair) for residual in epoch.residuals}
    while True:
        fit = adjust(without_pairs(epoch, off), [(None, 0.0)])[0]
        if fit.degrees_of_freedom < 1:
            return None
        if fit.statistic <= chi2_limit(fit.degrees_of_freedom, REST_LEVEL):
            cost = fit.statistic + FURTHER_PAIR_PENALTY * max(len(off) - 1, 0)
            unisolated = (_alternatives(epoch, off, pair) for pair in off.difference(known))
            return PairOutliers(frozenset(off), cost, frozenset().union(*unisolated))
        if 2 * (len(off) + 1) >= len(pairs):
            return None
        gains = _gains(fit)
        least = max(gains.values()) - RULED_OUT_MARGIN
        off.add(max(gains, key=lambda pair: (pair in known and gains[pair] > least, gains[pair])))


def _alternatives(epoch: Epoch, off: set[Pair], pair: Pair) -> frozenset[Pair]:
    """Return a pair that is left out with those that may be off instead; none where it is isolated."""
    gains = _gains(adjust(without_pairs(epoch, off - {pair}), [(None, 0.0)])[0])
    instead = {other for other, gain in gains.items() if gain > gains[pair] - RULED_OUT_MARGIN}
    return frozenset(instead) if len(instead) > 1 else frozenset()


def _gains(fit: Adjustment) -> dict[Pair, float]:
    """Return by how much the statistic of a fit falls without each pair."""
    rows: dict[Pair, list[int]] = {}
    for number, residual in enumerate(fit.residuals):
        rows.setdefault(unordered(residual.pair), []).append(number)
    return {pair: fit.range_effect(numbers).gain for pair, numbers in sorted(rows.items())}


def cost_of_two_pairs(now: Epoch, past: Past, vehicle: int) -> float:
    """Return the least cost of the explanation that two pairs of a vehicle are off.

    It is an explanation where pairs have been off of late. Two pairs are then not less likely than one faulty receiver: pairs
    are off within minutes, receivers hardly in a year.

    `past` is an earlier epoch, in which the same pairs are left out.
    """
    then, correlation = past
    pairs = sorted({unordered(residual.pair) for residual in now.residuals if vehicle in residual.pair})
    statistics = (
        adjust(without_pairs(now, two), [(without_pairs(then, two) if then is not None else None, correlation)])[0].statistic
        for two in combinations(pairs, 2)
    )
    return min(statistics, default=inf)


def cost_of_their_pairs(now: Epoch, past: Past, vehicles: Collection[int]) -> float:
    """Return the cost of the explanation that all pairs of some vehicles with others are off.

    Each pair is off by a length of its own. Where each of the vehicles is ranged by one other alone, these are as many unknowns
    as one offset of two of them has.
    """
    then, correlation = past
    pairs = {unordered(r.pair) for r in now.residuals if (r.from_vehicle in vehicles) != (r.to_vehicle in vehicles)}
    rest = without_pairs(now, pairs), (without_pairs(then, pairs) if then is not None else None, correlation)
    return adjust(rest[0], [rest[1]])[0].statistic + FURTHER_PAIR_PENALTY * (len(pairs) - 1)


def unordered(vehicles: Pair) -> Pair:
    """Return the pair, the smaller id first."""
    return min(vehicles), max(vehicles)
