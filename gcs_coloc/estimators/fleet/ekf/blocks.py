"""How the blocks of a joint state begin: a vehicle from a report or a start, and the key of a ranging pair."""

from __future__ import annotations

import numpy as np

from gcs_coloc.core.measurements import FloatArray, PositionMeasurement
from gcs_coloc.estimators.fleet.ekf._kernels import (
    AIRSPEED_ERROR,
    HEADING_ERROR,
    POSITION,
    REPORT_ERROR,
    SIZE,
    STAMP_ERROR,
    TURN,
    VELOCITY,
)
from gcs_coloc.estimators.fleet.settings import FleetSettings

_UNKNOWN_VELOCITY_MPS = 30.0


def pair_key(a: int, b: int, device: int) -> tuple[int, int, int]:
    """Return the key of the bias block of a ranging pair: the bias belongs to both ends together."""
    return (a, b, device) if a < b else (b, a, device)


def block_from_report(
    report: PositionMeasurement, white: tuple[float, float], slow: tuple[float, float], stamp_s: float, s: FleetSettings
) -> tuple[FloatArray, FloatArray]:
    """Return mean (16,) and covariance (16, 16) of a vehicle from one report.

    Sigmas in m are (horizontal, vertical), `time_stamp_offset_sigma_s` is that of the report's time.
    """
    x = np.zeros(SIZE)
    P = np.zeros((SIZE, SIZE))
    x[POSITION] = report.position_enu_m
    for axis in range(3):
        w, c = white[axis // 2], slow[axis // 2]
        P[axis, axis] = w * w + c * c
        e = REPORT_ERROR.start + axis
        P[e, e] = c * c
        P[axis, e] = P[e, axis] = -c * c
    sigma = _UNKNOWN_VELOCITY_MPS
    if report.velocity_enu_mps is not None and report.sigma_velocity_mps is not None:
        x[VELOCITY] = report.velocity_enu_mps
        sigma = report.sigma_velocity_mps
    for axis in (3, 4, 5):
        P[axis, axis] = sigma * sigma
    _own_slow_states(P, stamp_s, s)
    return x, P


def block_from_estimate(mean: FloatArray, covariance: FloatArray, s: FleetSettings) -> tuple[FloatArray, FloatArray]:
    """Return mean (16,) and covariance (16, 16) of a vehicle from its position and velocity, (6,) and (6, 6)."""
    x = np.zeros(SIZE)
    P = np.zeros((SIZE, SIZE))
    x[:6] = mean
    P[:6, :6] = covariance
    _own_slow_states(P, s.stamp_sigma_s, s)
    return x, P


def _own_slow_states(P: FloatArray, stamp_s: float, s: FleetSettings) -> None:
    for axis in (6, 7):
        P[axis, axis] = s.wind_sigma_mps**2
    P[AIRSPEED_ERROR, AIRSPEED_ERROR] = s.airspeed_sigma_mps**2
    P[HEADING_ERROR, HEADING_ERROR] = s.heading_sigma_rad**2
    P[STAMP_ERROR, STAMP_ERROR] = stamp_s**2
    P[TURN, TURN] = s.turn_sigma_radps**2
