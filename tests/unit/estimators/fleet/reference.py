"""The fleet filter as plain matrices, equations numbered as in docs/explanation/fleet-filter.md."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

P_, V_, W_ = slice(0, 3), slice(3, 6), slice(6, 8)
TAU, OMEGA, SIZE = 14, 15, 16
GAUSS_MARKOV_TIMES = (0, 0, 1, 1, 2, 3, 3, 3, 4, 5)
"""Which of the six correlation times each component from the wind on has."""
GAUSS_MARKOV_SIGMAS = (0, 0, 1, 2, 3, 4, 4, 5, 6, 7)
"""Which of the eight sigmas each component from the wind on has."""


def rotation(angle: float) -> np.ndarray:
    """C of eq. (3): turns an (east, north) vector clockwise."""
    return np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])


def integrated_rotation(omega: float, step_s: float) -> np.ndarray:
    """S of eq. (4): the integral of C over a step."""
    s, c = math.sin(omega * step_s) / omega, (1.0 - math.cos(omega * step_s)) / omega
    return np.array([[s, c], [-c, s]])


def transition(step_s: float, omega: float, *, in_wind: bool) -> np.ndarray:
    """F of eq. (3) and (4), (16, 16)."""
    C, S, eye = rotation(omega * step_s), integrated_rotation(omega, step_s), np.eye(2)
    F = np.eye(SIZE)
    F[0:2, 3:5], F[3:5, 3:5], F[2, 5] = S, C, step_s
    if in_wind:
        F[0:2, W_], F[3:5, W_] = step_s * eye - S, eye - C
    return F


def acceleration_noise(step_s: float, horizontal: float, vertical: float) -> np.ndarray:
    """Q of eq. (6), (16, 16)."""
    Q = np.zeros((SIZE, SIZE))
    density = np.diag([horizontal, horizontal, vertical])
    Q[:6, :6] = np.kron(np.array([[step_s**3 / 3.0, step_s**2 / 2.0], [step_s**2 / 2.0, step_s]]), density)
    return Q


def gauss_markov(step_s: float, times_s: np.ndarray, sigmas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Decay factors and variances of eq. (7), each (10,), of the components from the wind on."""
    decay = np.exp(-step_s / times_s[list(GAUSS_MARKOV_TIMES)])
    return decay, sigmas[list(GAUSS_MARKOV_SIGMAS)] ** 2 * (1.0 - decay**2)


def position(block: np.ndarray) -> np.ndarray:
    """Eq. (10): the position on the service's clock; a static anchor's block is its position."""
    return block[P_] - block[TAU] * block[V_] if len(block) == SIZE else block


def numerical_jacobian(h: Callable[[np.ndarray], np.ndarray], x: np.ndarray, d: float = 1e-5) -> np.ndarray:
    """Central differences of h (k,) by x (n,): (k, n)."""
    return np.column_stack([(h(x + d * e) - h(x - d * e)) / (2.0 * d) for e in np.eye(len(x))])


def second_order(unit: np.ndarray, distance_m: float, covariance: np.ndarray) -> tuple[float, float]:
    """Eq. (15): mean and variance of the second-order term of a range whose vector has this covariance (3, 3)."""
    M = (np.eye(3) - np.outer(unit, unit)) @ covariance / distance_m
    return 0.5 * float(np.trace(M)), 0.5 * float(np.trace(M @ M))


def correct(x: np.ndarray, P: np.ndarray, innovation: np.ndarray, H: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The Kalman correction with the gain K = P H' S^-1 and the covariance in Joseph's form."""
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    A = np.eye(len(x)) - K @ H
    return x + K @ innovation, A @ P @ A.T + K @ R @ K.T
