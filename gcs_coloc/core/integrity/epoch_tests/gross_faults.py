"""Gross faults: reported positions that are kilometres from where the ranges put them.

So far off are spoofed receivers that state an airport. Tests of an adjustment do not serve there: they move a position in the
fleet's plane, below which the earth falls away by 8 m at 10 km and by 800 m at 100 km.

Vehicles that are near each other belong to one group, and so do those whose ranges do not contradict their positions grossly.
The group with the majority of the reporting vehicles is assumed to be right, as in `isolation`.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from itertools import combinations
from math import dist

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch

_GROSS_M = 10_000.0
"""A range shorter than the distance of the positions by more contradicts them grossly. Chosen: no device errs by as much, and
up to twice as far off the tests of `isolation` name a receiver."""


def gross_faults(epoch: Epoch) -> dict[int, float]:
    """Return the reporting vehicles that the majority's ranges contradict grossly, with how far off, m.

    That is the least that one of the ranges shows. None are returned where no group has more than half of the reporting vehicles.
    """
    gross = [residual for residual in epoch.residuals if residual.residual_m < -_GROSS_M]
    if not gross:
        return {}
    right = max(_groups(epoch), key=lambda group: len(group & epoch.reporting))
    if 2 * len(right & epoch.reporting) <= len(epoch.reporting):
        return {}
    found: dict[int, float] = {}
    for residual in gross:
        for vehicle in epoch.reporting.intersection(residual.pair) - right:
            if not right.isdisjoint(residual.pair):
                found[vehicle] = min(-residual.residual_m, found.get(vehicle, -residual.residual_m))
    return found


def without_ranges_of(epoch: Epoch, vehicles: Collection[int]) -> Epoch:
    """Return the epoch without the ranges of some vehicles; itself where there are none."""
    if not vehicles:
        return epoch
    return replace(epoch, residuals=tuple(r for r in epoch.residuals if not any(v in vehicles for v in r.pair)))


def _groups(epoch: Epoch) -> list[frozenset[int]]:
    """Return the groups of vehicles near each other, or tied by ranges that fit, but for less than 10 km."""
    vehicles = {vehicle for residual in epoch.residuals for vehicle in residual.pair}
    places = {vehicle: epoch.priors[vehicle].position_enu_m for vehicle in vehicles}
    tied = [residual.pair for residual in epoch.residuals if residual.residual_m >= -_GROSS_M]
    tied += [pair for pair in combinations(vehicles, 2) if dist(*(places[vehicle] for vehicle in pair)) <= _GROSS_M]
    groups = [frozenset((vehicle,)) for vehicle in vehicles]
    for pair in tied:
        joined = [group for group in groups if not group.isdisjoint(pair)]
        groups = [group for group in groups if group not in joined] + [frozenset().union(*joined)]
    return groups
