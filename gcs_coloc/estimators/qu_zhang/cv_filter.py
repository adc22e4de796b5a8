"""The constant-velocity model and its Kalman filter (Qu & Zhang, Eq. 27-31).

The state interleaves position and velocity axis by axis, [x, vx, y, vy] as in the paper, in m and m/s; with one axis it is
[z, vz]. Process noise is a white acceleration. The paper states it as q, a variance of velocity PER STEP of its computing cycle;
here it is a spectral density, m^2/s^3, which does not depend on a step: `density` converts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

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
    """Return the paper's Q (2 axes, 2 axes): q on each velocity, nothing on position (Eq. 28 and 38)."""
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


Sensitivities = Mapping[int, FloatArray]
"""By vehicle, how a state or a measurement changes with that vehicle's lasting error: shape (rows, k), see `CvFilter`."""


@dataclass(frozen=True, slots=True)
class _Update:
    at_s: float
    z: FloatArray
    R: FloatArray
    H: FloatArray
    sensitivities: Sensitivities


@dataclass(frozen=True, slots=True)
class _Moment:
    """The filter as it was before an update, from where it can be run again."""

    at_s: float
    x: FloatArray
    P: FloatArray
    sensitivities: Sensitivities
    update: _Update


class CvFilter:
    """The Kalman filter of one vehicle over one or two axes, with the time that its state holds at.

    Beside the covariance of what is new in each measurement it carries how far the lasting errors of others (a peer's GPS error,
    the same for minutes) have entered the state: sensitivities, by vehicle (Schmidt's "consider" states). They change with the
    same gains as the state, and average out only where the geometry makes them.

    It starts at `at_s` from a position (axes,) with covariance (axes, axes), a velocity (axes,) with one variance for each axis,
    and the sensitivities (axes, k) of the position. `density_m2ps3` is that of the white acceleration. What comes late by up to
    `memory_s` counts as if it had come in order.
    """

    def __init__(
        self,
        at_s: float,
        position_m: FloatArray,
        position_covariance: FloatArray,
        velocity_mps: FloatArray,
        velocity_variance: float,
        density_m2ps3: float,
        *,
        memory_s: float,
        sensitivities: Sensitivities = MappingProxyType({}),
    ) -> None:
        self.at_s = at_s
        self.axes = len(position_m)
        self._density = density_m2ps3
        self._memory_s = memory_s
        self._past: list[_Moment] = []
        place, speed = position_rows(self.axes), velocity_rows(self.axes)
        self.sensitivities: Sensitivities = {vehicle: place.T @ one for vehicle, one in sensitivities.items()}
        self._filter = KalmanFilter(dim_x=2 * self.axes, dim_z=self.axes)
        self._filter.x = (place.T @ position_m + speed.T @ velocity_mps).reshape(-1, 1)
        self._filter.P = place.T @ position_covariance @ place + velocity_variance * speed.T @ speed

    @property
    def state(self) -> FloatArray:
        """The state, shape (2 axes,), m and m/s."""
        return np.asarray(self._filter.x[:, 0])

    @property
    def covariance(self) -> FloatArray:
        """The state's covariance without lasting errors, shape (2 axes, 2 axes)."""
        return np.asarray(self._filter.P)

    def inflate_covariance(self, factor: float) -> None:
        """Multiply the covariance by a factor >= 1."""
        self._filter.P = self._filter.P * factor
        # Updates before the inflation must not be run again without it.
        self._past.clear()

    def add_position_variance(self, variance_m2: float) -> None:
        """Add to the variance of each position axis, m^2."""
        place = position_rows(self.axes)
        self._filter.P = self._filter.P + variance_m2 * place.T @ place
        self._past.clear()

    def predicted(self, at_s: float) -> tuple[FloatArray, FloatArray]:
        """Return state and covariance at any time, and leave the filter as it is.

        Their shapes are (2 axes,) and (2 axes, 2 axes). Before the filter's time the state is stepped back, with the noise of the
        step added: what has been learned since is kept, at the price of a covariance that is a little too large.
        """
        dt_s = at_s - self.at_s
        F = transition(dt_s, self.axes)
        return F @ self.state, F @ self.covariance @ F.T + white_acceleration_noise(abs(dt_s), self._density, self.axes)

    def predicted_sensitivities(self, at_s: float) -> Sensitivities:
        """Return the sensitivities of the state at any time, each of shape (2 axes, k)."""
        F = transition(at_s - self.at_s, self.axes)
        return {vehicle: F @ one for vehicle, one in self.sensitivities.items()}

    def innovation(self, z: FloatArray, R: FloatArray, H: FloatArray, at_s: float) -> tuple[FloatArray, FloatArray]:
        """Return innovation (m,) and covariance (m, m) of a measurement z = H x made at `at_s`."""
        state, covariance = self.predicted(at_s)
        return z - H @ state, H @ covariance @ H.T + R

    def is_too_late(self, at_s: float) -> bool:
        """Whether a measurement made at `at_s` is older than the filter remembers."""
        return at_s < self.at_s and (at_s < self.at_s - self._memory_s or not self._past or at_s < self._past[0].at_s)

    def update(
        self, z: FloatArray, R: FloatArray, H: FloatArray, at_s: float, sensitivities: Sensitivities = MappingProxyType({})
    ) -> None:
        """Update with a measurement z = H x + noise of covariance R, made at `at_s`.

        A newer one carries the filter on to its time. For an older one the filter is run again from before it, so that the
        answer is that of ordered arrival. The sensitivities (m, k) are those of z to lasting errors.

        Raises:
            ValueError: it is too late (see `is_too_late`).

        """
        if self.is_too_late(at_s):
            raise ValueError(f"a measurement made at {at_s} s is too late for a filter at {self.at_s} s")
        again: list[_Update] = []
        while self._past and self._past[-1].update.at_s > at_s:
            moment = self._past.pop()
            self.at_s, self.sensitivities = moment.at_s, moment.sensitivities
            self._filter.x, self._filter.P = moment.x, moment.P
            again.insert(0, moment.update)
        for one in (_Update(at_s, z, R, H, sensitivities), *again):
            self._past.append(_Moment(self.at_s, self._filter.x, self._filter.P, self.sensitivities, one))
            self._apply(one)
        self._past = [moment for moment in self._past if moment.update.at_s >= self.at_s - self._memory_s]

    def _apply(self, update: _Update) -> None:
        dt_s = update.at_s - self.at_s
        F = transition(dt_s, self.axes)
        if dt_s > 0.0:
            self._filter.predict(F=F, Q=white_acceleration_noise(dt_s, self._density, self.axes))
            self.at_s = update.at_s
        # filterpy updates in Joseph form: the covariance stays positive definite.
        self._filter.update(update.z.reshape(-1, 1), R=update.R, H=update.H)
        self._filter.P = 0.5 * (self._filter.P + self._filter.P.T)
        K = np.asarray(self._filter.K)
        keep = (np.eye(2 * self.axes) - K @ update.H) @ F
        after = {vehicle: keep @ one for vehicle, one in self.sensitivities.items()}
        for vehicle, one in update.sensitivities.items():
            after[vehicle] = after.get(vehicle, 0.0) + K @ one
        self.sensitivities = after


def nis(innovation: FloatArray, covariance: FloatArray) -> float:
    """Return the normalised innovation squared of (m,) and (m, m): chi-square (m) if consistent."""
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
