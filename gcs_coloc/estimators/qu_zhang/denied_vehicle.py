"""State of a denied vehicle beside its track: its range epochs, its gate and the lasting errors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from gcs_coloc.core.measurements import FloatArray, NoEstimateReason, Unlocated
from gcs_coloc.estimators.qu_zhang.cv_filter import CvFilter, Sensitivities, nis, position_rows
from gcs_coloc.estimators.qu_zhang.epochs import RangeEpochGatherer
from gcs_coloc.estimators.qu_zhang.fix import Fix
from gcs_coloc.estimators.qu_zhang.track import NisGate, PeerTrack

CONFIRMATIONS = 3
"""Fixes that must agree after an initialisation from ranges alone, before the first estimate. Chosen: one may be an outlier."""


@dataclass(slots=True)
class DeniedVehicleFilter:
    """State of one denied vehicle beside its filters.

    `lasting` holds the covariance (k, k) of the lasting error of each vehicle that has entered the filter; the filter holds how
    far it has.
    `reason` says in words why the last epoch gave no fix, and is None if it gave one.
    """

    gatherer: RangeEpochGatherer
    gate: NisGate
    last_fix_s: float = -math.inf
    confirmations: int = 0
    reason: str | None = "no ranges yet"
    peers: tuple[int, ...] = ()
    hdop: float = math.inf
    lasting: dict[int, FloatArray] = field(default_factory=dict)

    @property
    def cause(self) -> str:
        """Why the last epoch gave no fix, as the end of a sentence; empty if it gave one."""
        return f": {self.reason}" if self.reason else ""

    def no_estimate_reason(self, track: PeerTrack | None, at_s: float, max_prediction_s: float) -> Unlocated | None:
        """Return why the vehicle's track gives no estimate at a time; None where it gives one."""
        if track is None or track.horizontal is None:
            return Unlocated(NoEstimateReason.NOT_LOCATED, detail=self.cause)
        if track.vertical is None:
            return Unlocated(NoEstimateReason.NO_HEIGHT)
        age_s = at_s - self.last_fix_s
        if age_s > max_prediction_s:
            return Unlocated(NoEstimateReason.NO_FIX, age_s, detail=self.cause)
        if self.confirmations < CONFIRMATIONS:
            return Unlocated(NoEstimateReason.CONFIRMING, self.confirmations, CONFIRMATIONS)
        return None

    def test_fix(self, horizontal: CvFilter, fix: Fix, at_s: float) -> tuple[float, float, float]:
        """Return NIS, innovation length and its sigma, m, of a fix against the filter's prediction.

        Filter and fix share the peers' lasting errors: only the difference of the sensitivities shows between them.
        """
        H = position_rows(2)
        innovation, S = horizontal.innovation(fix.position_m, fix.covariance, H, at_s)
        differences = {vehicle: H @ one for vehicle, one in horizontal.predicted_sensitivities(at_s).items()}
        for vehicle, one in fix.sensitivities.items():
            differences[vehicle] = differences.get(vehicle, 0.0) - one
        S = S + lasting_covariance(differences, {**self.lasting, **fix.lasting}, 2)
        return nis(innovation, S), float(np.linalg.norm(innovation)), float(np.sqrt(np.trace(S)))

    def accept(self, fix: Fix, at_s: float) -> None:
        """Record a fix that the filter has been updated with."""
        self.lasting.update(fix.lasting)
        self.last_fix_s = max(self.last_fix_s, at_s)
        self.confirmations += 1
        self.reason = None
        self.peers, self.hdop = fix.peers, fix.hdop

    def start(self, fix: Fix, at_s: float) -> None:
        """Record a fix that the filter has been initialised from."""
        self.confirmations = 0
        self.gate.refused_in_a_row = 0
        self.accept(fix, at_s)

    def covariance(self, horizontal: CvFilter, at_s: float) -> FloatArray:
        """Return the covariance, shape (4, 4), of the predicted state at a time.

        It includes the lasting errors.
        """
        white = horizontal.predicted(at_s)[1]
        return white + lasting_covariance(horizontal.predicted_sensitivities(at_s), self.lasting, 4)


def lasting_covariance(sensitivities: Sensitivities, lasting: dict[int, FloatArray], rows: int) -> FloatArray:
    """Return the covariance, shape (rows, rows), that independent lasting errors cause.

    `lasting` holds the covariance (k, k) of each error, and `sensitivities` how it enters, shape (rows, k), both by vehicle.
    """
    total = np.zeros((rows, rows))
    for vehicle, one in sensitivities.items():
        total += one @ lasting[vehicle] @ one.T
    return total
