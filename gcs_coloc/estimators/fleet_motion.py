"""How a vehicle's states move between measurements, and where they lie in its block.

Steady flight is constant velocity disturbed by white acceleration. With a fresh bank angle the air velocity turns at
g tan(roll) / V (a coordinated turn) and the wind carries the vehicle along; what is left to chance is then much less.
All slow errors are first-order Gauss-Markov processes.
"""

from __future__ import annotations

import math

import numpy as np

from gcs_coloc.core.measurements import FloatArray

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
_EYE = np.eye(SIZE)
_SLOW_DIAGONAL = slice(WIND.start * (SIZE + 1), None, SIZE + 1)


def turn_rate_radps(roll_rad: float, airspeed_mps: float) -> float:
    """Return the rate of a coordinated turn, clockwise positive: g tan(roll) / V."""
    return GRAVITY_MPS2 * math.tan(roll_rad) / airspeed_mps


def transition(step_s: float, turn_radps: float, *, in_wind: bool) -> FloatArray:
    """Return F (16, 16) over a step without the decay of the slow states.

    With `in_wind` the air velocity turns and the wind carries the vehicle along; without, the velocity over ground turns.
    """
    F = _EYE.copy()
    F[2, 5] = step_s
    angle = turn_radps * step_s
    if abs(angle) < _LEAST_TURN_RAD:
        along, across = step_s, 0.5 * angle * step_s
    else:
        along, across = math.sin(angle) / turn_radps, (1.0 - math.cos(angle)) / turn_radps
    c, s = math.cos(angle), math.sin(angle)
    # Position and velocity over ground follow from the air velocity v - w that turns, and the wind w that does not.
    F[0, 3] = F[1, 4] = along
    F[0, 4], F[1, 3] = across, -across
    F[3, 3] = F[4, 4] = c
    F[3, 4], F[4, 3] = s, -s
    if not in_wind:
        return F
    F[0, 6] = F[1, 7] = step_s - along
    F[0, 7], F[1, 6] = -across, across
    F[3, 6] = F[4, 7] = 1.0 - c
    F[3, 7], F[4, 6] = -s, s
    return F


def set_turn_column(F: FloatArray, step_s: float, lasting_s: float, ve_mps: float, vn_mps: float) -> None:
    """Set the column of F (16, 16) that tells what an error of the turn rate does to position and velocity over a step.

    `ve_mps`, `vn_mps` are the velocity after the step; `lasting_s` is by how much the heading changes for each rad/s.
    """
    F[3, TURN], F[4, TURN] = vn_mps * lasting_s, -ve_mps * lasting_s
    F[0, TURN], F[1, TURN] = 0.5 * step_s * F[3, TURN], 0.5 * step_s * F[4, TURN]


def acceleration_noise(step_s: float, horizontal: float, vertical: float) -> FloatArray:
    """Return Q (16, 16) of a step in which white acceleration of the given densities (m^2/s^3) acts."""
    Q = np.zeros((SIZE, SIZE))
    half, third = 0.5 * step_s * step_s, step_s * step_s * step_s / 3.0
    Q[0, 0] = Q[1, 1] = horizontal * third
    Q[0, 3] = Q[3, 0] = Q[1, 4] = Q[4, 1] = horizontal * half
    Q[3, 3] = Q[4, 4] = horizontal * step_s
    Q[2, 2] = vertical * third
    Q[2, 5] = Q[5, 2] = vertical * half
    Q[5, 5] = vertical * step_s
    return Q


def fade_slow_states(
    mean: FloatArray, F: FloatArray, Q: FloatArray, length_s: float, times_s: tuple[float, ...], sigmas: tuple[float, ...]
) -> None:
    """Let the states from the wind on, each a first-order Gauss-Markov process, fade towards zero over a step of a length.

    `times_s` and `sigmas` are their correlation times and standard deviations. `mean` (16,), F and Q (16, 16) are changed.
    """
    decays = np.exp(-length_s / np.array(times_s))
    spread = np.array(sigmas)
    F.reshape(-1)[_SLOW_DIAGONAL] = decays
    mean[WIND.start :] *= decays
    Q.reshape(-1)[_SLOW_DIAGONAL] = spread * spread * (1.0 - decays * decays)
