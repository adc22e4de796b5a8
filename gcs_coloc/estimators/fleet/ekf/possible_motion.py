"""Possible motion: what vehicles of each class do at most, and what one may have done unshown.

Unshown is what a vehicle may have done in a gap beyond the manoeuvres shown before. Ranges after the gap rule it out step by
step, eq. (37).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gcs_coloc.core.measurements import FloatArray, VehicleClass
from gcs_coloc.estimators.fleet.settings import BY_REPORT, FleetSettings


@dataclass(frozen=True, slots=True)
class MotionProfile:
    """The most that a vehicle does, and its process noise.

    The most are the largest horizontal speed, horizontal acceleration and climb rate. `noise_levels`: bounds of the learned
    factor of the white acceleration without a fresh bank angle, eq. (30). A plane flies steadily between turns, which the
    manoeuvre detector finds. The manoeuvres of other vehicles recur (`is_recurring`). A vehicle of which nothing is known has the
    white acceleration of the settings. `leaves_at_once`: what hovered may accelerate as hard as it can the next moment.
    `tilts`: it accelerates to where it tilts, eq. (47).
    `climb_level`: factor of the vertical one where reports or a barometric height show the climbs.
    """

    max_speed_mps: float
    max_acceleration_mps2: float
    max_climb_mps: float
    noise_levels: tuple[float, float]
    is_recurring: bool
    climb_level: float = 1.0
    leaves_at_once: bool = False
    tilts: bool = False

    def reach_m(self, since_s: float, acceleration_mps2: float) -> float:
        """Return how far an acceleration may lead a vehicle off its course, m: min(a t^2 / 2, 2 V t)."""
        return min(0.5 * acceleration_mps2 * since_s * since_s, 2.0 * self.max_speed_mps * since_s)


_AS_SET = (1.0, 1.0), False
_TURNING = (1.0, 30.0), False
"""Chosen: to 9 m^2/s^3, turns of 30 degrees of bank between steady legs."""
_RECURRING = (0.03, 300.0), True  # chosen: from 0.03 m^2/s^3, at rest, to 300 m^2/s^3, 1 g in turns of a second to either side
_CLIMB_LEVEL_OF_A_MULTIROTOR = 15.0
"""To 0.3 m^2/s^3. Chosen: climbs of 8 m/s are followed to 4 m; a barometer that creeps away as fast as a climb leads astray."""
PROFILES: Mapping[VehicleClass | None, MotionProfile] = {
    None: MotionProfile(30.0, 9.8, 5.0, *_AS_SET),
    VehicleClass.PLANE: MotionProfile(50.0, 9.8, 5.0, *_TURNING),
    VehicleClass.MULTIROTOR: MotionProfile(
        20.0, 9.8, 5.0, *_RECURRING, _CLIMB_LEVEL_OF_A_MULTIROTOR, leaves_at_once=True, tilts=True
    ),
    VehicleClass.GROUND: MotionProfile(10.0, 4.0, 2.0, *_RECURRING),
    VehicleClass.BOAT: MotionProfile(15.0, 3.0, 0.5, *_RECURRING),
    VehicleClass.INDOOR: MotionProfile(3.0, 4.0, 2.0, *_RECURRING),
}
"""By class; None: it is not known. Chosen: accelerations of a level turn at 45 degrees of bank, of tyres on gravel, of a rudder,
and of a robot's motors; speeds that small vehicles of these classes seldom exceed."""


def motion_profile(reported: VehicleClass | None, s: FleetSettings) -> MotionProfile:
    """Return the profile of a vehicle by its reported class and the settings, which prevail."""
    profile = PROFILES[reported if s.vehicle_class == BY_REPORT else VehicleClass(s.vehicle_class)]
    if s.max_speed_mps is not None:
        profile = replace(profile, max_speed_mps=s.max_speed_mps, max_climb_mps=min(profile.max_climb_mps, s.max_speed_mps))
    if s.max_acceleration_mps2 is not None:
        profile = replace(profile, max_acceleration_mps2=s.max_acceleration_mps2)
    return profile


HORIZONTAL = np.ix_((0, 1, 3, 4), (0, 1, 3, 4))
"""Horizontal position and velocity in a covariance that begins with position and velocity."""
BOUND_95_SIGMAS = 2.4477
"""The 95 % bound of two equal axes in sigmas: sqrt(-2 ln 0.05)."""
CORRELATION = 0.9
"""Correlation of what a gap adds to position and velocity. Chosen: 0.87 of white acceleration, 1 of a constant one."""

Motion = tuple[float, float, float]
"""Of each horizontal axis: variance of the position, m^2, of the velocity, m^2/s^2, and their covariance, m^2/s."""


def add_motion(covariance: FloatArray, motion: Motion) -> None:
    """Add a motion to a covariance that begins with position and velocity."""
    position_m2, velocity_m2ps2, both_m2ps = motion
    for axis in (0, 1):
        covariance[axis, axis] += position_m2
        covariance[axis + 3, axis + 3] += velocity_m2ps2
        covariance[axis, axis + 3] += both_m2ps
        covariance[axis + 3, axis] += both_m2ps


@dataclass(frozen=True, slots=True)
class UnshownMotion:
    """Motion in a gap beyond that shown before, with the ranges since that may rule it out.

    The variances of each horizontal axis and their covariance hold at the end of the gap. `ee`, `en` and `nn` are the information
    of the ranges since, 1/m^2.
    """

    ended_at_s: float
    position_m2: float
    velocity_m2ps2: float
    both_m2ps: float
    ee: float = 0.0
    en: float = 0.0
    nn: float = 0.0

    def after_range(self, unit: tuple[float, float, float], sigma_m: float) -> UnshownMotion:
        """Return the motion after a range along `unit` that fitted; `sigma_m` is its innovation's sigma."""
        e, n = unit[0] / sigma_m, unit[1] / sigma_m
        return replace(self, ee=self.ee + e * e, en=self.en + e * n, nn=self.nn + n * n)

    def not_ruled_out(self) -> UnshownMotion:
        """Return the motion as if no range had been used since the gap.

        What is ruled out along a line is not ruled out along a wide arc.
        """
        return replace(self, ee=0.0, en=0.0, nn=0.0)

    def covariance(self, at_s: float) -> FloatArray:
        """Return the covariance (4, 4) of horizontal position and velocity at a time, eq. (37).

        It is large in directions in which no range was used since the gap.
        """
        since_s = max(at_s - self.ended_at_s, 0.0)
        both_m2ps = self.both_m2ps + since_s * self.velocity_m2ps2
        position_m2 = self.position_m2 + since_s * (self.both_m2ps + both_m2ps)
        left = np.linalg.inv(np.eye(2) + position_m2 * np.array([[self.ee, self.en], [self.en, self.nn]]))
        # Rounding leaves the inverse not quite symmetric.
        return np.kron(np.array([[position_m2, both_m2ps], [both_m2ps, self.velocity_m2ps2]]), 0.5 * (left + left.T))


def unshown_motion(at_s: float, possible: Motion, shown: Motion) -> UnshownMotion | None:
    """Return the motion possible in a gap up to `at_s` beyond manoeuvres shown before; None for none."""
    position_m2, velocity_m2ps2 = possible[0] - shown[0], max(possible[1] - shown[1], 0.0)
    if position_m2 <= 0.0:
        return None
    # The difference of two covariances is one only within this.
    most_m2ps = CORRELATION * math.sqrt(position_m2 * velocity_m2ps2)
    return UnshownMotion(at_s, position_m2, velocity_m2ps2, min(possible[2] - shown[2], most_m2ps))
