"""The other side of the peers of several vehicles that are located by ranges to each other.

Denied vehicles that range each other are a figure that its anchors alone hold: the vehicles with a position of their own. Two
anchors, or several on one line, hold it on either side of that line as well, and one anchor anywhere around it. Only motion tells
the side. That of one vehicle can be followed; but where each of several may have moved, a figure that has turned about one anchor
while the other was not heard fits the ranges on either side.

Turning takes time. A figure that cannot have come to the line since its side was told last is on the side where it was then.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch
from gcs_coloc.core.measurements import FloatArray, Vector3

_SEPARATED = 16.0  # chosen: four sigmas between the ranges of both sides
_UNHELD_M = 10_000.0  # of a figure without anchors, which may be anywhere; chosen: beyond any alert limit, and a number
_TOLD_WITHIN_M = 10.0  # a place whose side was told may be off by so much; chosen: 95 % bounds of located vehicles are 2 to 8 m


@dataclass(frozen=True, slots=True)
class _ToldPlace:
    """Where a vehicle was, and how it moved, when the side of its peers was told last."""

    at_s: float
    position_enu_m: Vector3
    velocity_enu_mps: Vector3

    def course_m(self, at_s: float) -> FloatArray:
        """Return where (2,) its course has led since."""
        return np.array(self.position_enu_m[:2]) + (at_s - self.at_s) * np.array(self.velocity_enu_mps[:2])

    def off_course_m(self, at_s: float, max_acceleration_mps2: float) -> float:
        """Return how far off that course it may be."""
        return _TOLD_WITHIN_M + 0.5 * max_acceleration_mps2 * (at_s - self.at_s) ** 2


class OpenSides:
    """The sides of figures over time.

    It keeps where each vehicle was when its side was told last, and whose is open since.
    """

    def __init__(self, max_acceleration_mps2: float) -> None:
        self._max_acceleration_mps2 = max_acceleration_mps2
        self._told: dict[int, _ToldPlace] = {}
        self._open: set[int] = set()

    def note_side(self, vehicle: int, at_s: float, position_enu_m: Vector3, velocity_enu_mps: Vector3) -> None:
        """Note where a vehicle is whose side is known, and how it moves."""
        self._told[vehicle] = _ToldPlace(at_s, position_enu_m, velocity_enu_mps)
        self._open.discard(vehicle)

    def other_side_m(self, epoch: Epoch, vehicle: int, velocity_enu_mps: Vector3) -> float:
        """Return how far off a vehicle without prior may be by the other side, in m; 0 where its side is told."""
        found = _Figure.of(epoch, vehicle)
        is_told = found.is_told or (len(found.members) < 2 and vehicle not in self._open) or self._cannot_have_crossed(found)
        if is_told:
            self.note_side(vehicle, epoch.at_s, epoch.priors[vehicle].position_enu_m, velocity_enu_mps)
            return 0.0
        self._open.add(vehicle)
        told = self._told.get(vehicle)
        if told is None or not self._is_near(told, found.places_m[vehicle], epoch.at_s):
            return found.other_side_m
        return min(found.other_side_m, 2.0 * told.off_course_m(epoch.at_s, self._max_acceleration_mps2))

    def forget(self, vehicles: Iterable[int]) -> None:
        """Forget vehicles that make room for others."""
        for vehicle in vehicles:
            self._told.pop(vehicle, None)
            self._open.discard(vehicle)

    def _is_near(self, told: _ToldPlace, place_m: FloatArray, at_s: float) -> bool:
        """Return whether an estimate is where its vehicle can have come.

        One that jumped may have jumped to the other side.
        """
        off_m = float(np.linalg.norm(place_m - told.course_m(at_s)))
        return off_m <= told.off_course_m(at_s, self._max_acceleration_mps2)

    def _cannot_have_crossed(self, figure: _Figure) -> bool:
        """Return whether the vehicle of a figure farthest from its line cannot have come to it."""
        told = self._told.get(figure.farthest)
        if figure.line is None or told is None or not self._is_near(told, figure.places_m[figure.farthest], figure.at_s):
            return False
        centre_m, normal = figure.line
        before_m = float((told.course_m(told.at_s) - centre_m) @ normal)
        now_m = float((told.course_m(figure.at_s) - centre_m) @ normal)
        off_m = told.off_course_m(figure.at_s, self._max_acceleration_mps2)
        return before_m * now_m > 0.0 and min(abs(before_m), abs(now_m)) > off_m


@dataclass(frozen=True, slots=True)
class _Figure:
    """Vehicles without prior that range each other, and the anchors that they range, at one time.

    `places_m` (2,) is where each member is. `line`: a point of the line through the anchors and its normal; None for less than
    two. `farthest` is the member farthest from that line, or from the one anchor. `is_told`: the ranges tell the sides apart.
    `other_side_m`: how far apart both are for `farthest`, m: what turned the figure moved all of it.
    """

    at_s: float
    members: tuple[int, ...]
    places_m: dict[int, FloatArray]
    line: tuple[FloatArray, FloatArray] | None
    farthest: int
    is_told: bool
    other_side_m: float

    @classmethod
    def of(cls, epoch: Epoch, vehicle: int) -> _Figure:
        """Return the figure of a vehicle that has ranges in the epoch."""
        arrays = epoch.arrays
        group, edge = {vehicle}, [vehicle]
        while edge:
            one = edge.pop()
            for pair in arrays.pairs:
                if one in pair and (other := pair[0] + pair[1] - one) not in group and epoch.priors[other].no_prior:
                    group.add(other)
                    edge.append(other)
        members = tuple(sorted(group))
        place_m = {v: np.array(epoch.priors[v].position_enu_m[:2]) for v in arrays.vehicles}
        places_m = {v: place_m[v] for v in members}
        anchors = sorted({end for pair in arrays.pairs if group & set(pair) for end in pair if end not in group})
        if not anchors:
            return cls(epoch.at_s, members, places_m, None, vehicle, False, _UNHELD_M)
        centre_m = np.mean([place_m[v] for v in anchors], axis=0)
        if len(anchors) == 1:
            away_m = {v: float(np.linalg.norm(places_m[v] - centre_m)) for v in members}
            farthest = max(members, key=lambda v: away_m[v])
            return cls(epoch.at_s, members, places_m, None, farthest, False, 2.0 * away_m[farthest])
        offsets_m = np.array([place_m[v] - centre_m for v in anchors])
        normal = np.linalg.eigh(offsets_m.T @ offsets_m)[1][:, 0]
        away_m = {v: float((place_m[v] - centre_m) @ normal) for v in (*members, *anchors)}
        separation = 0.0
        for (a, b), variance_m2 in zip(arrays.pairs, arrays.variances_m2.tolist(), strict=True):
            if (a in group) != (b in group):
                distance_m = max(math.dist(place_m[a], place_m[b]), 1.0)
                separation += (2.0 * away_m[a] * away_m[b] / distance_m) ** 2 / variance_m2
        farthest = max(members, key=lambda v: abs(away_m[v]))
        other_side_m = 2.0 * abs(away_m[farthest])
        return cls(epoch.at_s, members, places_m, (centre_m, normal), farthest, separation > _SEPARATED, other_side_m)
