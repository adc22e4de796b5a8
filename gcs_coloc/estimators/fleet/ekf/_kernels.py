"""Unrolled kernels for speed: F and Q of one vehicle and the range Jacobian, entry by entry.

They write in flat views of the matrices. Writing single elements of a numpy array costs twice the time. The plain matrix forms
stand in tests/unit/estimators/fleet/reference.py; tests hold that both are equal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, cast

import numpy as np

from gcs_coloc.core.measurements import FloatArray, Vector3
from gcs_coloc.estimators.fleet.ekf.state import SIZE, TIME_STAMP_OFFSET, TURN, VELOCITY, WIND

_LEAST_TURN_RAD = 1e-4
"""Below this angle the turn is expanded to first order: sin(a)/a rounds badly. The error is a^2/6 of the step, 2e-9."""
_E, _N, _U, _VE, _VN, _VU, _WE, _WN = range(8)


def _entries(row: int, *columns: int) -> tuple[int, ...]:
    """Return the indices of entries of one row of a (16, 16) block in its flat view."""
    return tuple(row * SIZE + column for column in columns)


_E_E, _E_VE, _E_VN, _E_WE, _E_WN, _E_TURN = _entries(_E, _E, _VE, _VN, _WE, _WN, TURN)
_N_N, _N_VE, _N_VN, _N_WE, _N_WN, _N_TURN = _entries(_N, _N, _VE, _VN, _WE, _WN, TURN)
_U_U, _U_VU = _entries(_U, _U, _VU)
_VE_E, _VE_VE, _VE_VN, _VE_WE, _VE_WN, _VE_TURN = _entries(_VE, _E, _VE, _VN, _WE, _WN, TURN)
_VN_N, _VN_VE, _VN_VN, _VN_WE, _VN_WN, _VN_TURN = _entries(_VN, _N, _VE, _VN, _WE, _WN, TURN)
_VU_U, _VU_VU = _entries(_VU, _U, _VU)
_WE_WE, _WN_WN, _AIRSPEED, _HEADING, _BARO, _REPORT_E, _REPORT_N, _REPORT_U, _STAMP, _TURN = (
    state * (SIZE + 1) for state in range(WIND.start, SIZE)
)


class Transition:
    """F and Q, both (16, 16), of one step of one vehicle. The same arrays are filled anew for each step."""

    __slots__ = ("F", "Q", "_f", "_q")

    def __init__(self) -> None:
        self.F = np.eye(SIZE)
        self.Q = np.zeros((SIZE, SIZE))
        self._f = cast("memoryview[float]", self.F.reshape(-1).data)
        self._q = cast("memoryview[float]", self.Q.reshape(-1).data)

    def __reduce__(self) -> tuple[type[Transition], tuple[()]]:
        """Copy it as a new transition: nothing in it outlasts a step."""
        return Transition, ()

    def set_motion(self, x: Sequence[float], step_s: float, turn_radps: float, *, in_wind: bool) -> tuple[float, ...]:
        """Write F of eq. (3) and (4); return the first five components of the mean after the step.

        `x` (16,) is the mean before the step. With `in_wind` the velocity through the air turns, without (w = 0) the velocity
        over ground. The decay of the Gauss-Markov components is not written here.
        """
        angle = turn_radps * step_s
        if abs(angle) < _LEAST_TURN_RAD:
            along, across = step_s, 0.5 * angle * step_s
        else:
            along, across = math.sin(angle) / turn_radps, (1.0 - math.cos(angle)) / turn_radps
        c, s = math.cos(angle), math.sin(angle)
        f = self._f
        f[_E_VE] = f[_N_VN] = along
        f[_E_VN] = across
        f[_N_VE] = -across
        f[_U_VU] = step_s
        f[_VU_VU] = 1.0
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
        """Write F's column of the turn rate, eq. (5); `lasting_s` is the change of heading per rad/s of it."""
        f, east, north = self._f, vn_mps * lasting_s, -ve_mps * lasting_s
        f[_VE_TURN], f[_VN_TURN] = east, north
        f[_E_TURN], f[_N_TURN] = 0.5 * step_s * east, 0.5 * step_s * north

    def decay_velocity(self, decay: float, decay_v: float) -> None:
        """Scale the rows of F for the velocity, horizontal and vertical, eq. (28)."""
        f = self._f
        for entry in (_VE_VE, _VE_VN, _VN_VE, _VN_VN, _VE_TURN, _VN_TURN):
            f[entry] *= decay
        f[_VU_VU] *= decay_v

    def set_acceleration_noise(self, length_s: float, horizontal: float, vertical: float) -> None:
        """Write Q of white acceleration, eq. (6), with densities in m^2/s^3."""
        q, half, third = self._q, 0.5 * length_s * length_s, length_s * length_s * length_s / 3.0
        q[_E_E] = q[_N_N] = horizontal * third
        q[_E_VE] = q[_VE_E] = q[_N_VN] = q[_VN_N] = horizontal * half
        q[_VE_VE] = q[_VN_VN] = horizontal * length_s
        q[_U_U] = vertical * third
        q[_U_VU] = q[_VU_U] = vertical * half
        q[_VU_VU] = vertical * length_s

    def set_gauss_markov(self, length_s: float, times_s: Sequence[float], sigmas: Sequence[float]) -> None:
        """Write F and Q of the ten first-order Gauss-Markov components, from the wind on, eq. (7).

        `times_s` are the correlation times of wind, air data errors, barometric height, reports, time stamps, and turn rate.
        `sigmas` are the steady-state sigmas of wind, errors of airspeed, heading, barometric height, reports (horizontal,
        vertical), time stamps, and turn rate.
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


class RangeEnd(NamedTuple):
    """One end of a range: a vehicle with its position and velocity.

    `where` is its slice of the joint state. The position is that of eq. (10), m. The velocity is in m/s. A static anchor has
    neither velocity nor time-stamp offset.
    """

    vehicle: int
    where: slice
    position: Vector3
    velocity: Vector3 = (0.0, 0.0, 0.0)
    time_stamp_offset_s: float | None = None


def range_jacobian(size: int, a: RangeEnd, b: RangeEnd, unit: Vector3) -> FloatArray:
    """Return the Jacobian (4, size) of the vector `b` to `a` by all states, along `unit`, east, north, up."""
    G = np.zeros((4, size))
    flat = cast("memoryview[float]", G.reshape(-1).data)
    _write_position(flat, size, a, unit, 1.0)
    _write_position(flat, size, b, unit, -1.0)
    return G


def _write_position(g: memoryview[float], n: int, end: RangeEnd, unit: Vector3, sign: float) -> None:
    """Write sign times the Jacobian of eq. (10) into four flat rows of n: along `unit`, east, north, up."""
    e, offset_s = end.where.start, end.time_stamp_offset_s
    ux, uy, uz = unit
    g[e], g[e + 1], g[e + 2] = sign * ux, sign * uy, sign * uz
    g[n + e] = g[2 * n + e + 1] = g[3 * n + e + 2] = sign
    if offset_s is None:
        return
    offset_s *= -sign
    v, s = e + VELOCITY.start, e + TIME_STAMP_OFFSET
    g[v], g[v + 1], g[v + 2] = offset_s * ux, offset_s * uy, offset_s * uz
    g[n + v] = g[2 * n + v + 1] = g[3 * n + v + 2] = offset_s
    ve, vn, vu = end.velocity
    g[s] = -sign * (ux * ve + uy * vn + uz * vu)
    g[n + s], g[2 * n + s], g[3 * n + s] = -sign * ve, -sign * vn, -sign * vu
