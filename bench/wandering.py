"""Flights with one denied vehicle among peers, all of which turn at random, as the engine hears them; seeded."""

from __future__ import annotations

from math import atan2, cos, hypot, pi, radians, remainder, sin, tan

import numpy as np

from bench.integrity_flights import DENIED, STEP_S, Flight, Scenario
from gcs_coloc.core.measurements import FloatArray

EXTENT_M = 900.0
_DENIED_SHARE = 0.7
_SPEED_MPS = (15.0, 25.0)
_HEIGHT_M = (80.0, 160.0)
_STEEPEST_RAD = radians(45.0)
_BACK_RAD = radians(30.0)
_STRAIGHT_SHARE = 0.4
_LEAST_HELD_S, _MEAN_HELD_S = 2.0, 14.0
_SUBSTEPS = 10
_GRAVITY_MPS2 = 9.80665


class Wander:
    """A level course at constant speed: a bank of up to 45 degrees drawn anew every 14 s or so, none in two of five draws.

    Beyond `extent_m` from the origin the vehicle turns back.
    """

    def __init__(self, rng: np.random.Generator, extent_m: float, duration_s: float) -> None:
        speed_mps, height_m = rng.uniform(*_SPEED_MPS), rng.uniform(*_HEIGHT_M)
        place, heading = rng.uniform(-extent_m, extent_m, 2), rng.uniform(0.0, 2.0 * pi)
        self._places, self._velocities = [], []
        step_s, held_until_s, rate_radps = STEP_S / _SUBSTEPS, 0.0, 0.0
        for k in range((round(duration_s / STEP_S) + 1) * _SUBSTEPS):
            velocity = speed_mps * np.array((sin(heading), cos(heading)))
            if k % _SUBSTEPS == 0:
                self._places.append(np.array((*place, height_m)))
                self._velocities.append(np.array((*velocity, 0.0)))
            if k * step_s >= held_until_s:
                held_until_s = k * step_s + _LEAST_HELD_S + rng.exponential(_MEAN_HELD_S - _LEAST_HELD_S)
                bank_rad = 0.0 if rng.random() < _STRAIGHT_SHARE else rng.uniform(-_STEEPEST_RAD, _STEEPEST_RAD)
                rate_radps = _GRAVITY_MPS2 * tan(bank_rad) / speed_mps
            rate = rate_radps
            off = remainder(atan2(-place[0], -place[1]) - heading, 2.0 * pi)
            if hypot(*place) > extent_m and abs(off) > _BACK_RAD:
                rate = float(np.copysign(_GRAVITY_MPS2 * tan(_BACK_RAD) / speed_mps, off))
            heading += rate * step_s
            place = place + velocity * step_s

    def at(self, t: float) -> tuple[FloatArray, FloatArray]:
        """Return place (m) and velocity (m/s) at a step's time, (3,) each, ENU."""
        step = round(t / STEP_S)
        return self._places[step], self._velocities[step]


class WanderingFlight(Flight):
    """A draw of a scenario in which everybody turns at random for a time; its radii, speeds and extent are not used."""

    def __init__(self, scenario: Scenario, seed: int, duration_s: float) -> None:
        super().__init__(scenario, seed)
        rng = np.random.default_rng([seed, 2])
        self.courses = {
            v: Wander(rng, EXTENT_M * (_DENIED_SHARE if v == DENIED else 1.0), duration_s) for v in sorted(self.courses)
        }
