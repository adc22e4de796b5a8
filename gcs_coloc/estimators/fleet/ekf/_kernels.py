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
_E, _N, _U, _VE, _VN, _VU, _WE, _WN = range(8)


def _entries(row: int, *columns: int) -> tuple[int, ...]:
    """Where entries of a row of a block (16, 16) lie in it where it is flat."""
    return tuple(row * SIZE + column for column in columns)


# Known beforehand, for a step writes some forty of them.
_E_E, _E_VE, _E_VN, _E_WE, _E_WN, _E_TURN = _entries(_E, _E, _VE, _VN, _WE, _WN, TURN)
_N_N, _N_VE, _N_VN, _N_WE, _N_WN, _N_TURN = _entries(_N, _N, _VE, _VN, _WE, _WN, TURN)
_U_U, _U_VU = _entries(_U, _U, _VU)
_VE_E, _VE_VE, _VE_VN, _VE_WE, _VE_WN, _VE_TURN = _entries(_VE, _E, _VE, _VN, _WE, _WN, TURN)
_VN_N, _VN_VE, _VN_VN, _VN_WE, _VN_WN, _VN_TURN = _entries(_VN, _N, _VE, _VN, _WE, _WN, TURN)
_VU_U, _VU_VU = _entries(_VU, _U, _VU)
_WE_WE, _WN_WN, _AIRSPEED, _HEADING, _BARO, _REPORT_E, _REPORT_N, _REPORT_U, _STAMP, _TURN = (
    state * (SIZE + 1) for state in range(WIND.start, SIZE)
)


def turn_rate_radps(roll_rad: float, airspeed_mps: float) -> float:
    """Return the rate of a coordinated turn, clockwise positive: g tan(roll) / V."""
    return GRAVITY_MPS2 * math.tan(roll_rad) / airspeed_mps


class Transition:
    """The Jacobian F and the noise Q, both (16, 16), of one step of one vehicle; filled anew for each step.

    The entries are written through flat views: to write single elements of an array costs twice the time.
    """

    __slots__ = ("F", "Q", "_f", "_q")

    def __init__(self) -> None:
        self.F = np.eye(SIZE)
        self.Q = np.zeros((SIZE, SIZE))
        self._f = cast("memoryview[float]", self.F.reshape(-1).data)
        self._q = cast("memoryview[float]", self.Q.reshape(-1).data)

    def __reduce__(self) -> tuple[type[Transition], tuple[()]]:
        """A copy is a new one: nothing in it outlasts a step."""
        return Transition, ()

    def set_motion(self, x: Sequence[float], step_s: float, turn_radps: float, *, in_wind: bool) -> tuple[float, ...]:
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
        f[_E_VE] = f[_N_VN] = along
        f[_E_VN] = across
        f[_N_VE] = -across
        f[_U_VU] = step_s
        f[_VE_VE] = f[_VN_VN] = c
        f[_VE_VN] = s
        f[_VN_VE] = -s
        e, n, u, ve, vn, vu, we, wn = x[:8]
        if not in_wind:
            we = wn = 0.0
        ae, an = ve - we, vn - wn
        if in_wind:
            f[_E_WE] = f[_N_WN] = step_s - along
            f[_E_WN], f[_N_WE] = -across, across
            f[_VE_WE] = f[_VN_WN] = 1.0 - c
            f[_VE_WN], f[_VN_WE] = -s, s
        else:
            f[_E_WE] = f[_N_WN] = f[_E_WN] = f[_N_WE] = f[_VE_WE] = f[_VN_WN] = f[_VE_WN] = f[_VN_WE] = 0.0
        f[_E_TURN] = f[_N_TURN] = f[_VE_TURN] = f[_VN_TURN] = 0.0
        return (
            e + along * ae + across * an + step_s * we,
            n - across * ae + along * an + step_s * wn,
            u + step_s * vu,
            c * ae + s * an + we,
            c * an - s * ae + wn,
        )

    def set_turn_column(self, step_s: float, lasting_s: float, ve_mps: float, vn_mps: float) -> None:
        """Set the column of F that tells what an error of the turn rate does to position and velocity over a step.

        `ve_mps`, `vn_mps` are the velocity after the step; `lasting_s` is by how much the heading changes for each rad/s.
        """
        f, east, north = self._f, vn_mps * lasting_s, -ve_mps * lasting_s
        f[_VE_TURN], f[_VN_TURN] = east, north
        f[_E_TURN], f[_N_TURN] = 0.5 * step_s * east, 0.5 * step_s * north

    def set_acceleration_noise(self, length_s: float, horizontal: float, vertical: float) -> None:
        """Set the noise of a step in which white acceleration of the given densities (m^2/s^3) acts."""
        q, half, third = self._q, 0.5 * length_s * length_s, length_s * length_s * length_s / 3.0
        q[_E_E] = q[_N_N] = horizontal * third
        q[_E_VE] = q[_VE_E] = q[_N_VN] = q[_VN_N] = horizontal * half
        q[_VE_VE] = q[_VN_VN] = horizontal * length_s
        q[_U_U] = vertical * third
        q[_U_VU] = q[_VU_U] = vertical * half
        q[_VU_VU] = vertical * length_s

    def set_gauss_markov(self, length_s: float, times_s: Sequence[float], sigmas: Sequence[float]) -> None:
        """Let the ten states from the wind on, first-order Gauss-Markov processes, fade towards zero over a step of a length.

        `times_s` are the correlation times of wind, errors of air data, barometric height, reports and stamps, and turn rate.
        `sigmas` are the standard deviations of wind (each of both), errors of airspeed, heading, barometric height, reports
        (horizontally, vertically) and stamps, and turn rate.
        """
        exp, f, q = math.exp, self._f, self._q
        wind_s, air_s, baro_s, report_s, stamp_s, turn_s = times_s
        wind, airspeed, heading, baro, report_h, report_v, stamp, turn = sigmas
        decay = exp(-length_s / wind_s)
        f[_WE_WE] = f[_WN_WN] = decay
        q[_WE_WE] = q[_WN_WN] = wind * wind * (1.0 - decay * decay)
        decay = exp(-length_s / air_s)
        fresh = 1.0 - decay * decay
        f[_AIRSPEED] = f[_HEADING] = decay
        q[_AIRSPEED], q[_HEADING] = airspeed * airspeed * fresh, heading * heading * fresh
        decay = exp(-length_s / baro_s)
        f[_BARO], q[_BARO] = decay, baro * baro * (1.0 - decay * decay)
        decay = exp(-length_s / report_s)
        fresh = 1.0 - decay * decay
        f[_REPORT_E] = f[_REPORT_N] = f[_REPORT_U] = decay
        q[_REPORT_E] = q[_REPORT_N] = report_h * report_h * fresh
        q[_REPORT_U] = report_v * report_v * fresh
        decay = exp(-length_s / stamp_s)
        f[_STAMP], q[_STAMP] = decay, stamp * stamp * (1.0 - decay * decay)
        decay = exp(-length_s / turn_s)
        f[_TURN], q[_TURN] = decay, turn * turn * (1.0 - decay * decay)
