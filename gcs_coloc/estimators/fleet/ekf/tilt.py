"""How the tilt of a multirotor accelerates it, eq. (47) and (48) of docs/explanation.

Its thrust leans with it. Against it stand the drag of air whose wind nobody tells, and the error of its trim. In steady flight
they balance, at rest in wind too: they are the mean of the tilt over the time in which drag takes the vehicle along with the air.
What differs from that mean is acceleration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.measurements import AttitudeMeasurement, FloatArray

GRAVITY_MPS2 = 9.80665
"""Standard gravity (CGPM 1901)."""
STEEPEST_BANK_RAD = 1.2
"""Chosen: 69 degrees, 2.8 g in a coordinated turn; a steeper bank is taken for aerobatics, where eq. (2) does not hold."""
_MEAN_TIME_S = 2.0
"""Time of the mean. Chosen: drag takes light multirotors along with the air at 0.5/s (Faessler, Franchi, Scaramuzza 2018)."""
_HELD_S = 0.5  # chosen: a brake from 10 m/s lasts one to two seconds, so a tilt tells little of what comes later
_EVERY_S = 0.15  # chosen: every other attitude at 10 Hz, which a propagation each would cost more than it tells
_JOINED_S = 1.5  # chosen: attitudes once a second with jitter; over a longer time a brake may have begun and ended
_ERROR_SHARE = 0.35
"""1-sigma of an acceleration's error as a share of it. Chosen: a heading off by 20 degrees turns it by a third of itself."""
_ERROR_TIME_S = 1.0
"""Chosen: correlation time of that error; its density is 2 T sigma^2 (Singer 1970)."""


class Tilt(NamedTuple):
    """The newest tilt of a multirotor: its thrust and the mean of it, east and north, m/s^2."""

    measured_at_s: float
    east_mps2: float
    north_mps2: float
    mean_east_mps2: float
    mean_north_mps2: float

    @property
    def acceleration_mps2(self) -> tuple[float, float]:
        """The acceleration, east and north."""
        return self.east_mps2 - self.mean_east_mps2, self.north_mps2 - self.mean_north_mps2

    @property
    def error_density_m2ps3(self) -> float:
        """The density of the white acceleration that its error amounts to."""
        return 2.0 * _ERROR_TIME_S * (_ERROR_SHARE * math.hypot(*self.acceleration_mps2)) ** 2

    def held_share(self, from_s: float, to_s: float) -> float:
        """Return the share of a step, to either side, in which it is held."""
        begins_s, length_s = min(from_s, to_s), abs(to_s - from_s)
        return min(max(self.measured_at_s + _HELD_S - begins_s, 0.0) / length_s, 1.0) if length_s > 0.0 else 0.0

    def is_enough(self, at_s: float) -> bool:
        """Whether an attitude at a time comes so soon after it that it tells nothing more."""
        return 0.0 <= at_s - self.measured_at_s < _EVERY_S

    def is_joined(self, at_s: float) -> bool:
        """Whether what has been between it and an attitude at a time is known."""
        return 0.0 < at_s - self.measured_at_s <= _JOINED_S


def tilt_after(before: Tilt | None, m: AttitudeMeasurement) -> Tilt:
    """Return the tilt with an attitude, and the mean until then, eq. (47)."""
    roll_rad, pitch_rad = (min(max(each, -STEEPEST_BANK_RAD), STEEPEST_BANK_RAD) for each in (m.roll_rad, m.pitch_rad))
    forward_mps2 = -GRAVITY_MPS2 * math.tan(pitch_rad)
    right_mps2 = GRAVITY_MPS2 * math.tan(roll_rad) / math.cos(pitch_rad)
    c, s = math.cos(m.yaw_rad), math.sin(m.yaw_rad)
    east, north = forward_mps2 * s + right_mps2 * c, forward_mps2 * c - right_mps2 * s
    if before is None or not before.is_joined(m.measured_at_s):
        return Tilt(m.measured_at_s, east, north, east, north)
    fresh = -math.expm1((before.measured_at_s - m.measured_at_s) / _MEAN_TIME_S)
    mean_east, mean_north = before.mean_east_mps2, before.mean_north_mps2
    mean_east += fresh * (0.5 * (before.east_mps2 + east) - mean_east)
    mean_north += fresh * (0.5 * (before.north_mps2 + north) - mean_north)
    return Tilt(m.measured_at_s, east, north, mean_east, mean_north)


def tilted_velocity_mps(attitudes: Sequence[AttitudeMeasurement], from_s: float, to_s: float) -> tuple[float, float]:
    """Return by how much a velocity changed between two times by the tilt, east and north, m/s.

    It is the integral of eq. (47) over some attitudes in order, as far as these reach.
    """
    east_mps, north_mps, before = 0.0, 0.0, None
    for m in attitudes:
        if before is not None and m.measured_at_s <= before.measured_at_s:
            continue
        now = tilt_after(before, m)
        if before is not None and before.is_joined(m.measured_at_s):
            length_s = max(min(m.measured_at_s, to_s) - max(before.measured_at_s, from_s), 0.0)
            (was_e, was_n), (is_e, is_n) = before.acceleration_mps2, now.acceleration_mps2
            east_mps += 0.5 * length_s * (was_e + is_e)
            north_mps += 0.5 * length_s * (was_n + is_n)
        before = now
    return east_mps, north_mps


def missed_motion(before: Tilt, now: Tilt, velocity_at_s: float) -> tuple[FloatArray, FloatArray]:
    """Return what the tilt before has missed until now: mean (4,) and covariance (4, 4), eq. (48).

    They are of the horizontal position and velocity. At some time since the attitude before, and since its velocity was reported,
    the acceleration has changed.
    """
    t_s = max(now.measured_at_s - max(before.measured_at_s, velocity_at_s), 0.0)
    unheld_s = min(max(now.measured_at_s - before.measured_at_s - _HELD_S, 0.0), t_s)
    was = np.array(before.acceleration_mps2)
    change = np.array(now.acceleration_mps2) - was
    moved_m = t_s**2 / 6.0 * change + 0.5 * unheld_s**2 * was
    times = np.array([[t_s**4 / 45.0, t_s**3 / 24.0], [t_s**3 / 24.0, t_s**2 / 12.0]])
    return np.concatenate([moved_m, 0.5 * t_s * change + unheld_s * was]), np.kron(times, np.outer(change, change))
