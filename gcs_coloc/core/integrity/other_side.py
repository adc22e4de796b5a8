"""The other side of the peers of several vehicles that are located by ranges to each other.

Denied vehicles that range each other are a figure that its anchors alone hold: the vehicles with a position of their own. Two
anchors, or several on one line, hold it on either side of that line as well, and one anchor anywhere around it. Only motion tells
the side. That of one vehicle can be followed; but where each of several may have moved, a figure that has turned about one anchor
while the other was not heard fits the ranges on either side.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch

_SEPARATED = 16.0  # chosen: four sigmas between the ranges of both sides
_UNHELD_M = 10_000.0  # of a figure without anchors, which may be anywhere; chosen: beyond any alert limit, and a number


class OpenSides:
    """The vehicles that were in a figure whose side was open, and whose own side has been open since."""

    def __init__(self) -> None:
        self._vehicles: set[int] = set()

    def other_side_m(self, epoch: Epoch, vehicle: int) -> float:
        """Return how far off the other side is, as the function of that name; of one that leaves a figure too."""
        found_m = other_side_m(epoch, vehicle, was_open=vehicle in self._vehicles)
        if found_m > 0.0:
            self._vehicles.add(vehicle)
        else:
            self._vehicles.discard(vehicle)
        return found_m

    def forget(self, vehicles: Iterable[int]) -> None:
        """Forget vehicles whose own position is believed again, or that make room for others."""
        self._vehicles.difference_update(vehicles)


def other_side_m(epoch: Epoch, vehicle: int, *, was_open: bool = False) -> float:
    """Return how far apart both sides of its anchors are for the figure of a vehicle without prior, in m.

    It is that of the vehicle of the figure farthest from the line of the anchors, or from the one anchor: what turned the figure
    moved all of it. It is 0 where the ranges tell the sides apart. A vehicle alone is no figure, unless its side `was_open`
    before: it may have come out of a figure on the wrong one.
    """
    arrays = epoch.arrays
    pairs = [(int(a), int(b)) for a, b in arrays.ends.T]
    group, edge = {arrays.index[vehicle]}, [arrays.index[vehicle]]
    while edge:
        one = edge.pop()
        for pair in pairs:
            if one in pair and (other := pair[0] + pair[1] - one) not in group and arrays.no_prior[other]:
                group.add(other)
                edge.append(other)
    if len(group) < 2 and not was_open:
        return 0.0
    places_m = np.array([epoch.priors[v].position_enu_m[:2] for v in arrays.vehicles])
    anchors = sorted({end for pair in pairs if group & set(pair) for end in pair if end not in group})
    if not anchors:
        return _UNHELD_M
    centre_m = places_m[anchors].mean(axis=0)
    if len(anchors) == 1:
        return 2.0 * float(np.linalg.norm(places_m[sorted(group)] - centre_m, axis=1).max())
    offsets_m = places_m[anchors] - centre_m
    normal = np.linalg.eigh(offsets_m.T @ offsets_m)[1][:, 0]
    away_m = (places_m - centre_m) @ normal
    separation = 0.0
    for (a, b), variance_m2 in zip(pairs, arrays.variances_m2.tolist(), strict=True):
        if (a in group) != (b in group):
            one, anchor = (a, b) if a in group else (b, a)
            distance_m = max(math.dist(places_m[one], places_m[anchor]), 1.0)
            separation += (2.0 * away_m[one] * away_m[anchor] / distance_m) ** 2 / variance_m2
    return 0.0 if separation > _SEPARATED else 2.0 * float(np.abs(away_m[sorted(group)]).max())
