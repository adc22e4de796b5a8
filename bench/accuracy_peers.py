"""Other people's filters on the same measurements: filterpy's EKF and UKF, and what the other peers share with them.

Each healthy vehicle has a constant-velocity Kalman filter of its own (filterpy). A range enters with its neighbour's predicted
position as known, and that position's variance along the line of sight added to the range's. The plane is the peers' world.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from importlib.util import find_spec

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from gcs_coloc.core.measurements import Estimate, FloatArray, Measurement, NoEstimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.qu_zhang.cv_filter import transition, white_acceleration_noise

DENSITY_M2PS3 = 10.0
"""Of the peers' white acceleration, the best of 1, 3, 10 and 30 in hindsight on this very flight."""

_PLACE = [0, 2]


class RangePeer(ABC):
    """A constant-velocity filter of one denied vehicle, state [e, ve, n, vn] in m and m/s, fed with ranges. Meets `Locator`."""

    def __init__(self) -> None:
        self._neighbours: dict[int, tuple[float, KalmanFilter]] = {}
        self._denied_vehicle: int | None = None

    @abstractmethod
    def initialise(self, mean: FloatArray, covariance: FloatArray, at_s: float) -> None:
        """Start from a state (4,) and its covariance (4, 4)."""

    @abstractmethod
    def add_range(self, place_m: FloatArray, covariance_m2: FloatArray, m: RangeMeasurement) -> None:
        """Take a range to a neighbour at a place (2,) with covariance (2, 2), at its own time."""

    @abstractmethod
    def state(self, at_s: float) -> tuple[FloatArray, FloatArray]:
        """Return mean (4,) and covariance (4, 4) at a time not before the newest measurement."""

    def set_denied(self, denied: Sequence[int], at_s: float) -> None:
        """Locate one vehicle from now on, from where its own filter has it."""
        (self._denied_vehicle,) = denied
        filtered = self._neighbour(self._denied_vehicle, at_s)
        self.initialise(filtered.x[:, 0], filtered.P, at_s)

    def add(self, measurement: Measurement) -> None:
        """Take one measurement: positions of neighbours and ranges of the denied vehicle; heights mean nothing in a plane."""
        t = measurement.measured_at_s
        if isinstance(measurement, PositionMeasurement):
            place = np.array(measurement.position_enu_m[:2])
            if measurement.vehicle not in self._neighbours:
                self._neighbours[measurement.vehicle] = (t, _own_filter(place, measurement))
                return
            self._neighbour(measurement.vehicle, t).update(place[:, np.newaxis])
        elif isinstance(measurement, RangeMeasurement):
            neighbour = self._neighbour(measurement.to_vehicle, t)
            self.add_range(neighbour.x[_PLACE, 0], neighbour.P[np.ix_(_PLACE, _PLACE)], measurement)

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """Answer where the denied vehicle is."""
        mean, P = self.state(at_s)
        covariance = np.eye(6)
        covariance[:2, :2] = P[np.ix_(_PLACE, _PLACE)]
        return Estimate(vehicle, at_s, np.array([mean[0], mean[2], 0.0]), np.array([mean[1], mean[3], 0.0]), covariance, None, 0)

    def _neighbour(self, vehicle: int, at_s: float) -> KalmanFilter:
        since_s, own = self._neighbours[vehicle]
        if at_s > since_s:
            own.predict(F=transition(at_s - since_s, 2), Q=white_acceleration_noise(at_s - since_s, DENSITY_M2PS3, 2))
            self._neighbours[vehicle] = (at_s, own)
        return own


class FilterpyEkf(RangePeer):
    """filterpy.kalman.ExtendedKalmanFilter."""

    def initialise(self, mean: FloatArray, covariance: FloatArray, at_s: float) -> None:
        """Start the filter."""
        self._at_s = at_s
        self._filter = ExtendedKalmanFilter(dim_x=4, dim_z=1)
        self._filter.x, self._filter.P = mean.copy(), covariance.copy()

    def add_range(self, place_m: FloatArray, covariance_m2: FloatArray, m: RangeMeasurement) -> None:
        """Predict to the range and correct with it."""
        if m.measured_at_s > self._at_s:
            self._filter.F = transition(m.measured_at_s - self._at_s, 2)
            self._filter.Q = white_acceleration_noise(m.measured_at_s - self._at_s, DENSITY_M2PS3, 2)
            self._filter.predict()
            self._at_s = m.measured_at_s
        away = self._filter.x[_PLACE] - place_m
        distance = math.hypot(away[0], away[1])
        unit = away / distance
        R = m.sigma_m**2 + unit @ covariance_m2 @ unit
        H = np.array([[unit[0], 0.0, unit[1], 0.0]])
        self._filter.update(np.array([m.range_m]), lambda _: H, lambda _: np.array([distance]), R=np.array([[R]]))

    def state(self, at_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the prediction."""
        return predicted(self._filter.x, self._filter.P, at_s - self._at_s)


class FilterpyUkf(RangePeer):
    """filterpy.kalman.UnscentedKalmanFilter."""

    def initialise(self, mean: FloatArray, covariance: FloatArray, at_s: float) -> None:
        """Start the filter."""
        self._at_s = at_s
        self._place_m = mean[_PLACE]
        points = MerweScaledSigmaPoints(4, alpha=0.1, beta=2.0, kappa=-1.0)
        self._filter = UnscentedKalmanFilter(4, 1, 0.02, hx=self._distance, fx=lambda x, dt: transition(dt, 2) @ x, points=points)
        self._filter.x, self._filter.P = mean.copy(), covariance.copy()
        self._filter.sigmas_f = points.sigma_points(mean, covariance)

    def _distance(self, x: FloatArray) -> FloatArray:
        return np.array([math.hypot(x[0] - self._place_m[0], x[2] - self._place_m[1])])

    def add_range(self, place_m: FloatArray, covariance_m2: FloatArray, m: RangeMeasurement) -> None:
        """Predict to the range and correct with it; of ranges at one time the sigma points are drawn anew for each."""
        f = self._filter
        step_s = m.measured_at_s - self._at_s
        if step_s > 0.0:
            f.Q = white_acceleration_noise(step_s, DENSITY_M2PS3, 2)
            f.predict(dt=step_s)
            self._at_s = m.measured_at_s
        f.sigmas_f = f.points_fn.sigma_points(f.x, f.P)
        self._place_m = place_m
        unit = (f.x[_PLACE] - place_m) / self._distance(f.x)
        R = m.sigma_m**2 + unit @ covariance_m2 @ unit
        f.update(np.array([m.range_m]), R=np.array([[R]]))

    def state(self, at_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the prediction."""
        return predicted(self._filter.x, self._filter.P, at_s - self._at_s)


def predicted(x: FloatArray, P: FloatArray, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Return a state (4,) and covariance (4, 4) some seconds later."""
    F = transition(step_s, 2)
    return F @ x, F @ P @ F.T + white_acceleration_noise(step_s, DENSITY_M2PS3, 2)


def installed(package: str) -> bool:
    """Whether an optional peer can be imported."""
    return find_spec(package) is not None


def _own_filter(place_m: FloatArray, m: PositionMeasurement) -> KalmanFilter:
    own = KalmanFilter(dim_x=4, dim_z=2)
    own.H = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    own.R = np.eye(2) * m.sigma_h_m**2
    ve, vn = m.velocity_enu_mps[:2] if m.velocity_enu_mps is not None else (0.0, 0.0)
    sigma_mps = m.sigma_velocity_mps if m.sigma_velocity_mps is not None else 30.0
    own.x = np.array([[place_m[0]], [ve], [place_m[1]], [vn]])
    own.P = np.diag([m.sigma_h_m**2, sigma_mps**2] * 2)
    return own
