"""The constant-velocity model and its Kalman filter (Qu & Zhang, Eq. 27-31).

The state interleaves position and velocity axis by axis, [x, vx, y, vy] as in the paper, in m and m/s; with one axis it is
[z, vz]. Process noise is a white acceleration. The paper states it as q, a variance of velocity PER STEP of its computing cycle;
here it is a spectral density, m^2/s^3, which does not depend on a step: `density` converts.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from filterpy.kalman import KalmanFilter

from gcs_coloc.core.measurements import FloatArray


def density(q_per_step_m2ps2: float, step_s: float) -> float:
    """Return the spectral density, m^2/s^3, of a velocity variance of q per step."""
    return q_per_step_m2ps2 / step_s


def transition(dt_s: float, axes: int) -> FloatArray:
    """Return F, shape (2 axes, 2 axes), of Eq. 28 for a step of `dt_s`, which may be negative."""
    return _each_axis([[1.0, dt_s], [0.0, 1.0]], axes)


def step_noise(q_per_step_m2ps2: float, axes: int) -> FloatArray:
    """Return Q as in the paper, shape (2 axes, 2 axes): q on each velocity and nothing on position (Eq. 28 and 38)."""
    return _each_axis([[0.0, 0.0], [0.0, q_per_step_m2ps2]], axes)


def white_acceleration_noise(dt_s: float, density_m2ps3: float, axes: int) -> FloatArray:
    """Return Q, shape (2 axes, 2 axes), of a continuous white acceleration over `dt_s` >= 0.

    Unlike `step_noise` it gives the same answer however a time span is cut into steps; both agree for short ones.
    """
    return density_m2ps3 * _each_axis([[dt_s**3 / 3.0, dt_s**2 / 2.0], [dt_s**2 / 2.0, dt_s]], axes)


@cache
def position_rows(axes: int) -> FloatArray:
    """Return H, shape (axes, 2 axes), that picks the positions out of the state (Eq. 29)."""
    return _constant(_each_axis([[1.0, 0.0]], axes))


@cache
def velocity_rows(axes: int) -> FloatArray:
    """Return H, shape (axes, 2 axes), that picks the velocities out of the state."""
    return _constant(_each_axis([[0.0, 1.0]], axes))


class CvFilter:
    """The Kalman filter of one vehicle over one or two axes, with the time that its state holds at.

    Args:
        at_s: time of the state.
        position_m: shape (axes,).
        position_covariance: shape (axes, axes), m^2.
        velocity_mps: shape (axes,).
        velocity_variance: m^2/s^2 on each axis.
        density_m2ps3: spectral density of the white acceleration.

    """

    def __init__(
        self,
        at_s: float,
        position_m: FloatArray,
        position_covariance: FloatArray,
        velocity_mps: FloatArray,
        velocity_variance: float,
        density_m2ps3: float,
    ) -> None:
        self.at_s = at_s
        self.axes = len(position_m)
        self._density = density_m2ps3
        place, speed = position_rows(self.axes), velocity_rows(self.axes)
        self._filter = KalmanFilter(dim_x=2 * self.axes, dim_z=self.axes)
        self._filter.x = (place.T @ position_m + speed.T @ velocity_mps).reshape(-1, 1)
        self._filter.P = place.T @ position_covariance @ place + velocity_variance * speed.T @ speed

    @property
    def state(self) -> FloatArray:
        """The state, shape (2 axes,), m and m/s."""
        return np.asarray(self._filter.x[:, 0])

    @property
    def covariance(self) -> FloatArray:
        """The state's covariance, shape (2 axes, 2 axes)."""
        return np.asarray(self._filter.P)

    def widen(self, factor: float) -> None:
        """Multiply the covariance by a factor >= 1."""
        self._filter.P = self._filter.P * factor

    def add_position_variance(self, variance_m2: float) -> None:
        """Add to the variance of each position axis, m^2."""
        place = position_rows(self.axes)
        self._filter.P = self._filter.P + variance_m2 * place.T @ place

    def propagate(self, to_s: float) -> FloatArray:
        """Carry the state on to a later time, and return F, shape (2 axes, 2 axes); an earlier time changes nothing."""
        dt_s = max(0.0, to_s - self.at_s)
        F = transition(dt_s, self.axes)
        if dt_s > 0.0:
            self._filter.predict(F=F, Q=white_acceleration_noise(dt_s, self._density, self.axes))
            self.at_s = to_s
        return F

    def predicted(self, at_s: float) -> tuple[FloatArray, FloatArray]:
        """Return state, shape (2 axes,), and covariance, shape (2 axes, 2 axes), at any time, and leave the filter as it is.

        Before the filter's time the state is stepped back, with the noise of the step added: what has been learned since is
        kept, at the price of a covariance that is a little too large.
        """
        dt_s = at_s - self.at_s
        F = transition(dt_s, self.axes)
        return F @ self.state, F @ self.covariance @ F.T + white_acceleration_noise(abs(dt_s), self._density, self.axes)

    def innovation(self, z: FloatArray, R: FloatArray, H: FloatArray, at_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the innovation, shape (m,), and its covariance, shape (m, m), of a measurement z = H x made at `at_s`."""
        state, covariance = self.predicted(at_s)
        return z - H @ state, H @ covariance @ H.T + R

    def update(self, z: FloatArray, R: FloatArray, H: FloatArray, at_s: float) -> tuple[FloatArray, FloatArray]:
        """Take in a measurement z = H x + noise of covariance R, made at `at_s`.

        A newer one carries the filter on to its time. An older one is related to the present state by stepping back, and the
        process noise of that step adds to R.

        Args:
            z: shape (m,).
            R: shape (m, m).
            H: shape (m, 2 axes).
            at_s: when the measurement was made.

        Returns:
            the gain K, shape (2 axes, m), and the H, shape (m, 2 axes), that it was used with.

        """
        self.propagate(at_s)
        back_s = at_s - self.at_s
        H_now = H @ transition(back_s, self.axes)
        R_now = R + H @ white_acceleration_noise(-back_s, self._density, self.axes) @ H.T
        # filterpy updates in Joseph form: the covariance stays positive definite.
        self._filter.update(z.reshape(-1, 1), R=R_now, H=H_now)
        self._filter.P = 0.5 * (self._filter.P + self._filter.P.T)
        return np.asarray(self._filter.K), H_now


def nis(innovation: FloatArray, covariance: FloatArray) -> float:
    """Return the normalised innovation squared of shapes (m,) and (m, m): chi-square with m degrees of freedom if consistent."""
    return float(innovation @ np.linalg.solve(covariance, innovation))


def _constant(matrix: FloatArray) -> FloatArray:
    matrix.setflags(write=False)
    return matrix


def _each_axis(block: list[list[float]], axes: int) -> FloatArray:
    """Return the block-diagonal matrix with the same block for every axis."""
    rows = len(block)
    matrix = np.zeros((rows * axes, 2 * axes))
    for axis in range(axes):
        matrix[rows * axis : rows * (axis + 1), 2 * axis : 2 * axis + 2] = block
    return matrix
