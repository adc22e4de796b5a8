"""How a vehicle's states move between measurements, and where they lie in its block.

Steady flight is constant velocity disturbed by white acceleration. With a fresh bank angle the air velocity turns at
g tan(roll) / V (a coordinated turn) and the wind carries the vehicle along; what is left to chance is then much less.
All slow errors are first-order Gauss-Markov processes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import cast

import numpy as np

POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
WIND = slice(6, 8)
AIRSPEED_ERROR = 8
HEADING_ERROR = 9
BARO_ERROR = 10
REPORT_ERROR = slice(11, 14)
STAMP_ERROR = 14
TURN = 15
SIZE = 16
"""The block of one vehicle: position and velocity (3 each, ENU), wind (east, north), errors of airspeed (m/s), heading (rad),
barometric height (m), position reports (3, m) and time stamps (s: what it reports is of this much later than it says), and the
turn rate (rad/s, clockwise). A fixed anchor has a block of its position alone."""

GRAVITY_MPS2 = 9.80665
STEEPEST_BANK_RAD = 1.2
"""No vehicle in a coordinated turn is banked more."""
_LEAST_TURN_RAD = 1e-4
_SLOW_DIAGONAL = tuple(range(WIND.start * (SIZE + 1), SIZE * SIZE, SIZE + 1))
_E, _N, _U, _VE, _VN, _VU, _WE, _WN = range(8)


def turn_rate_radps(roll_rad: float, airspeed_mps: float) -> float:
    """Return the rate of a coordinated turn, clockwise positive: g tan(roll) / V."""
    return GRAVITY_MPS2 * math.tan(roll_rad) / airspeed_mps


class Step:
    """The Jacobian F and the noise Q, both (16, 16), of one step of one vehicle; filled anew for each step.

    The entries are written through flat views: to write single elements of an array costs twice the time.
    """

    __slots__ = ("F", "Q", "_f", "_q")

    def __init__(self) -> None:
        self.F = np.eye(SIZE)
        self.Q = np.zeros((SIZE, SIZE))
        self._f = cast("memoryview[float]", self.F.reshape(-1).data)
        self._q = cast("memoryview[float]", self.Q.reshape(-1).data)

    def __reduce__(self) -> tuple[type[Step], tuple[()]]:
        """A copy is a new one: nothing in it outlasts a step."""
        return Step, ()

    def move(self, x: Sequence[float], step_s: float, turn_radps: float, *, in_wind: bool) -> tuple[float, ...]:
        """Set F but for the decay of the slow states; return the mean of the first five states after it, from `x` (16,).

        With `in_wind` the air velocity turns and the wind carries the vehicle along; without, the velocity over ground turns.
        """
        angle = turn_radps * step_s
        if abs(angle) < _LEAST_TURN_RAD:
            along, across = step_s, 0.5 * angle * step_s
        else:
            along, across = math.sin(angle) / turn_radps, (1.0 - math.cos(angle)) / turn_radps
        c, s = math.cos(angle), math.sin(angle)
        f = self._f
        # Position and velocity over ground follow from the air velocity v - w that turns, and the wind w that does not.
        f[_E * SIZE + _VE] = f[_N * SIZE + _VN] = along
        f[_E * SIZE + _VN] = across
        f[_N * SIZE + _VE] = -across
        f[_U * SIZE + _VU] = step_s
        f[_VE * SIZE + _VE] = f[_VN * SIZE + _VN] = c
        f[_VE * SIZE + _VN] = s
        f[_VN * SIZE + _VE] = -s
        e, n, u, ve, vn, vu, we, wn = x[:8]
        if not in_wind:
            we = wn = 0.0
        ae, an = ve - we, vn - wn
        drift, turned, swept = (step_s - along, 1.0 - c, s) if in_wind else (0.0, 0.0, 0.0)
        aside = across if in_wind else 0.0
        f[_E * SIZE + _WE] = f[_N * SIZE + _WN] = drift
        f[_E * SIZE + _WN] = -aside
        f[_N * SIZE + _WE] = aside
        f[_VE * SIZE + _WE] = f[_VN * SIZE + _WN] = turned
        f[_VE * SIZE + _WN] = -swept
        f[_VN * SIZE + _WE] = swept
        for row in (_E, _N, _VE, _VN):
            f[row * SIZE + TURN] = 0.0
        return (
            e + along * ae + across * an + step_s * we,
            n - across * ae + along * an + step_s * wn,
            u + step_s * vu,
            c * ae + s * an + we,
            c * an - s * ae + wn,
        )

    def turn(self, step_s: float, lasting_s: float, ve_mps: float, vn_mps: float) -> None:
        """Set the column of F that tells what an error of the turn rate does to position and velocity over a step.

        `ve_mps`, `vn_mps` are the velocity after the step; `lasting_s` is by how much the heading changes for each rad/s.
        """
        f, east, north = self._f, vn_mps * lasting_s, -ve_mps * lasting_s
        f[_VE * SIZE + TURN], f[_VN * SIZE + TURN] = east, north
        f[_E * SIZE + TURN], f[_N * SIZE + TURN] = 0.5 * step_s * east, 0.5 * step_s * north

    def disturb(self, length_s: float, horizontal: float, vertical: float) -> None:
        """Set the noise of a step in which white acceleration of the given densities (m^2/s^3) acts."""
        q, half, third = self._q, 0.5 * length_s * length_s, length_s * length_s * length_s / 3.0
        q[_E * SIZE + _E] = q[_N * SIZE + _N] = horizontal * third
        q[_E * SIZE + _VE] = q[_VE * SIZE + _E] = q[_N * SIZE + _VN] = q[_VN * SIZE + _N] = horizontal * half
        q[_VE * SIZE + _VE] = q[_VN * SIZE + _VN] = horizontal * length_s
        q[_U * SIZE + _U] = vertical * third
        q[_U * SIZE + _VU] = q[_VU * SIZE + _U] = vertical * half
        q[_VU * SIZE + _VU] = vertical * length_s

    def fade(self, length_s: float, times_s: Sequence[float], sigmas: Sequence[float]) -> None:
        """Let the ten states from the wind on, first-order Gauss-Markov processes, fade towards zero over a step of a length.

        `times_s` and `sigmas` are their correlation times and standard deviations.
        """
        f, q, before_s = self._f, self._q, math.nan
        decay = fresh = 0.0
        for diagonal, time_s, sigma in zip(_SLOW_DIAGONAL, times_s, sigmas, strict=True):
            if time_s != before_s:
                before_s, decay = time_s, math.exp(-length_s / time_s)
                fresh = 1.0 - decay * decay
            f[diagonal] = decay
            q[diagonal] = sigma * sigma * fresh
