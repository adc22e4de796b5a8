"""Held motion: where a vehicle is later if it keeps its speed and its turn rate, and that rate."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import atan2, cos, hypot, remainder, sin, tau

from gcs_coloc.core.measurements import Vector3

_OVER_S = 5.0
"""A turn rate is that of so long. Chosen: gusts and noise of the velocity are within 0.01 rad/s of it, a plane's turn is 0.2."""
_LEAST_SPAN_S = 2.0  # chosen: a turn rate from less is noise
_LEAST_SPEED_MPS = 3.0  # below it a vehicle has no course
_FORMATION_TURN_RADPS, _FORMATION_SPEED_MPS = 0.03, 3.0
"""Within these of each other two vehicles fly in formation. Chosen: three times what noise and gusts leave of a turn rate, and
the sway of vehicles that keep their places; either, held for half a minute, tears a column of 300 m apart."""
_LEAST_FORMATION_MPS = 6.0
"""Slower ones do not. Chosen: twice the sway, so that what stands still is in no formation with what moves."""
_LEAST_TURN_RADPS = 1e-4  # below it the way is straight: 3 mrad in half a minute


@dataclass(frozen=True, slots=True)
class HeldMotion:
    """A motion that is held: a position, a velocity and a turn rate.

    `position` (east, north, up) is in m, `velocity` in m/s. `turn_radps` is clockwise as seen from above.
    """

    position: Vector3
    velocity: Vector3
    turn_radps: float = 0.0

    def after(self, span_s: float) -> HeldMotion:
        """Return the motion so much later: on a circle, or straight on."""
        (e, n, u), (ve, vn, vu), turn = self.position, self.velocity, self.turn_radps
        angle = turn * span_s
        if abs(turn) < _LEAST_TURN_RADPS:
            return HeldMotion((e + ve * span_s, n + vn * span_s, u + vu * span_s), self.velocity, turn)
        along, across = sin(angle) / turn, (1.0 - cos(angle)) / turn
        # Clockwise: what flies north turns east.
        position = (e + along * ve + across * vn, n + along * vn - across * ve, u + vu * span_s)
        velocity = (cos(angle) * ve + sin(angle) * vn, cos(angle) * vn - sin(angle) * ve, vu)
        return HeldMotion(position, velocity, turn)

    def in_formation_with(self, other: HeldMotion) -> HeldMotion:
        """Return this motion with velocity and turn rate of another vehicle, if both fly in formation.

        They do where both are alike: the difference is then noise and sway. Otherwise return this motion.
        """
        (ve, vn, _), (other_ve, other_vn, _) = self.velocity, other.velocity
        is_formation = (
            hypot(other_ve, other_vn) >= _LEAST_FORMATION_MPS
            and hypot(ve - other_ve, vn - other_vn) <= _FORMATION_SPEED_MPS
            and abs(self.turn_radps - other.turn_radps) <= _FORMATION_TURN_RADPS
        )
        return HeldMotion(self.position, other.velocity, other.turn_radps) if is_formation else self


class TurnRate:
    """The turn rate of one vehicle, from its velocities of the last seconds."""

    def __init__(self) -> None:
        self._courses: deque[tuple[float, float]] = deque()

    def add(self, at_s: float, east_mps: float, north_mps: float) -> None:
        """Add a velocity over ground; without a course the vehicle turns no more."""
        courses = self._courses
        if hypot(east_mps, north_mps) < _LEAST_SPEED_MPS:
            courses.clear()
            return
        courses.append((at_s, atan2(east_mps, north_mps)))
        while at_s - courses[0][0] > _OVER_S:
            courses.popleft()

    @property
    def radps(self) -> float:
        """The turn rate, rad/s clockwise; 0 where it is not known."""
        courses = self._courses
        if not courses or courses[-1][0] - courses[0][0] < _LEAST_SPAN_S:
            return 0.0
        turned, before = 0.0, courses[0][1]
        for _, course in courses:
            turned, before = turned + remainder(course - before, tau), course
        return turned / (courses[-1][0] - courses[0][0])
