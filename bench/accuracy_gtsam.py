"""GTSAM's incremental fixed-lag smoother with range factors, on the same ranges. Import this only where gtsam is installed."""

from __future__ import annotations

from typing import SupportsFloat, SupportsIndex, SupportsInt

import gtsam
import numpy as np

from bench.accuracy_peers import DENSITY_M2PS3, RangePeer, predicted
from gcs_coloc.core.measurements import FloatArray, RangeMeasurement
from gcs_coloc.estimators.qu_zhang.cv_filter import transition, white_acceleration_noise

_LAG_S = 5.0
_ORDER = [0, 2, 1, 3]
"""From [e, ve, n, vn] to [e, n, ve, vn]: the smoother's keys are a place and a velocity of two values each."""


# As gtsam's own signatures want them.
_Key = SupportsInt | SupportsIndex
_Stamp = SupportsFloat | SupportsIndex


class GtsamSmoother(RangePeer):
    """gtsam.IncrementalFixedLagSmoother (iSAM2), 5 s; each neighbour is a variable with a prior of its filter's covariance."""

    def initialise(self, mean: FloatArray, covariance: FloatArray, at_s: float) -> None:
        """Start the smoother with a prior on place and velocity, which are independent at the start."""
        self._smoother = gtsam.IncrementalFixedLagSmoother(_LAG_S)
        self._count = 0
        self._at_s = at_s
        self._mean = mean.copy()
        self._open_epoch()
        spread = covariance[np.ix_(_ORDER, _ORDER)]
        place, velocity = (gtsam.noiseModel.Gaussian.Covariance(spread[k : k + 2, k : k + 2]) for k in (0, 2))
        self._graph.add(gtsam.PriorFactorPoint2(self._place_key(), mean[[0, 2]], place))
        self._graph.add(gtsam.PriorFactorPoint2(self._velocity_key(), mean[[1, 3]], velocity))
        self._finish_epoch()

    def add_range(self, place_m: FloatArray, covariance_m2: FloatArray, m: RangeMeasurement) -> None:
        """Add a range factor; the epoch before is solved when a range of a new one comes."""
        if m.measured_at_s > self._at_s:
            self._finish_epoch()
            step_s = m.measured_at_s - self._at_s
            before = (self._place_key(), self._velocity_key())
            self._at_s = m.measured_at_s
            self._count += 1
            self._mean = transition(step_s, 2) @ self._mean
            self._open_epoch()
            keys = (*before, self._place_key(), self._velocity_key())
            Q = white_acceleration_noise(step_s, DENSITY_M2PS3, 2)[np.ix_(_ORDER, _ORDER)]
            self._graph.add(gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(Q), keys, _Motion(step_s)))
        neighbour = gtsam.symbol("n", 8 * self._count + m.to_vehicle)
        self._values.insert(neighbour, place_m)
        self._stamps[neighbour] = self._at_s
        self._graph.add(gtsam.PriorFactorPoint2(neighbour, place_m, gtsam.noiseModel.Gaussian.Covariance(covariance_m2)))
        noise = gtsam.noiseModel.Isotropic.Sigma(1, m.sigma_m)
        self._graph.add(gtsam.RangeFactor2(self._place_key(), neighbour, m.range_m, noise))
        self._pending = True

    def state(self, at_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the prediction from the newest epoch. Place and velocity are taken for uncorrelated: only that is asked for."""
        self._finish_epoch()
        P = np.zeros((4, 4))
        isam = self._smoother.getISAM2()
        P[np.ix_([0, 2], [0, 2])] = isam.marginalCovariance(self._place_key())
        P[np.ix_([1, 3], [1, 3])] = isam.marginalCovariance(self._velocity_key())
        return predicted(self._mean, P, at_s - self._at_s)

    def _open_epoch(self) -> None:
        self._graph = gtsam.NonlinearFactorGraph()
        self._values = gtsam.Values()
        self._values.insert(self._place_key(), self._mean[[0, 2]])
        self._values.insert(self._velocity_key(), self._mean[[1, 3]])
        self._stamps: dict[_Key, _Stamp] = {self._place_key(): self._at_s, self._velocity_key(): self._at_s}
        self._pending = True

    def _finish_epoch(self) -> None:
        if not self._pending:
            return
        self._smoother.update(self._graph, self._values, self._stamps)
        # A second pass moves the linearisation to where the first one led.
        self._smoother.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), {})
        self._mean[[0, 2]] = self._smoother.calculateEstimatePoint2(self._place_key())
        self._mean[[1, 3]] = self._smoother.calculateEstimatePoint2(self._velocity_key())
        self._graph, self._values, self._stamps, self._pending = gtsam.NonlinearFactorGraph(), gtsam.Values(), {}, False

    def _place_key(self) -> int:
        return int(gtsam.symbol("p", self._count))

    def _velocity_key(self) -> int:
        return int(gtsam.symbol("v", self._count))


class _Motion:
    """The error of constant velocity over a step: (place, velocity) after less what (place, velocity) before foresees."""

    def __init__(self, step_s: float) -> None:
        self._F = np.eye(4)
        self._F[0, 2] = self._F[1, 3] = step_s
        # Fortran order is what the library takes its Jacobians in.
        eye = np.eye(4)
        columns = (-self._F[:, :2], -self._F[:, 2:], eye[:, :2], eye[:, 2:])
        self._jacobians = [np.asfortranarray(block) for block in columns]

    def __call__(self, factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[FloatArray] | None) -> FloatArray:
        before = np.concatenate([values.atPoint2(key) for key in factor.keys()[:2]])
        after = np.concatenate([values.atPoint2(key) for key in factor.keys()[2:]])
        if jacobians is not None:
            for i, block in enumerate(self._jacobians):
                jacobians[i] = block
        residual: FloatArray = after - self._F @ before
        return residual
