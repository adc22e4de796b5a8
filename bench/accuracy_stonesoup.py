"""Stone Soup's extended Kalman filter (Dstl) on the same ranges. Import this only where stonesoup is installed."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import ExtendedKalmanPredictor
from stonesoup.types.array import CovarianceMatrix, StateVector
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
from stonesoup.updater.kalman import ExtendedKalmanUpdater

from bench.accuracy_peers import DENSITY_M2PS3, RangePeer
from gcs_coloc.core.measurements import FloatArray, RangeMeasurement

_ORIGIN = datetime(2020, 1, 1, tzinfo=UTC)


class _RangeOnly(NonLinearGaussianMeasurement):  # type: ignore[misc] # it has no types
    """A range to a place in the plane; Stone Soup itself has ranges with bearings only."""

    place_m: FloatArray = np.zeros(2)

    @property
    def ndim_meas(self) -> int:
        return 1

    def function(self, state, **_):  # type: ignore[no-untyped-def]
        away = np.asarray(state.state_vector[[0, 2], :], dtype=float) - self.place_m[:, np.newaxis]
        return StateVector([[np.hypot(away[0, 0], away[1, 0])]])

    def jacobian(self, state, **_):  # type: ignore[no-untyped-def]
        away = np.asarray(state.state_vector[[0, 2], 0], dtype=float) - self.place_m
        unit = away / np.hypot(away[0], away[1])
        return np.array([[unit[0], 0.0, unit[1], 0.0]])


class StoneSoupEkf(RangePeer):
    """stonesoup.updater.kalman.ExtendedKalmanUpdater with a constant-velocity transition model."""

    def initialise(self, mean: FloatArray, covariance: FloatArray, at_s: float) -> None:
        """Start the filter."""
        motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(DENSITY_M2PS3), ConstantVelocity(DENSITY_M2PS3)])
        self._predictor = ExtendedKalmanPredictor(motion)
        self._updater = ExtendedKalmanUpdater(None)
        self._state = GaussianState(StateVector(mean), CovarianceMatrix(covariance), timestamp=_time(at_s))

    def add_range(self, place_m: FloatArray, covariance_m2: FloatArray, m: RangeMeasurement) -> None:
        """Predict to the range and correct with it."""
        prediction = self._predictor.predict(self._state, timestamp=_time(m.measured_at_s))
        away = np.asarray(prediction.state_vector[[0, 2], 0], dtype=float) - place_m
        unit = away / np.hypot(away[0], away[1])
        R = m.sigma_m**2 + float(unit @ covariance_m2 @ unit)
        model = _RangeOnly(ndim_state=4, mapping=(0, 2), noise_covar=CovarianceMatrix([[R]]))
        model.place_m = place_m
        detection = Detection(StateVector([[m.range_m]]), timestamp=prediction.timestamp, measurement_model=model)
        self._state = self._updater.update(SingleHypothesis(prediction, detection))

    def state(self, at_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the prediction."""
        prediction = self._predictor.predict(self._state, timestamp=_time(at_s))
        return np.asarray(prediction.state_vector[:, 0], dtype=float), np.asarray(prediction.covar, dtype=float)


def _time(at_s: float) -> datetime:
    return _ORIGIN + timedelta(seconds=at_s)
