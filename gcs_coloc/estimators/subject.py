"""A vehicle that is located by fixes: its gathering of ranges, its gate, and the part of its error that never averages out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.estimators.cv import CvFilter, nis, position_rows
from gcs_coloc.estimators.epochs import EpochGatherer
from gcs_coloc.estimators.fix import Fix
from gcs_coloc.estimators.gating import NisGate

CONFIRMATIONS = 3
"""Fixes that must agree after a start from ranges alone, before the first answer: one may be a guess."""


@dataclass(slots=True)
class Subject:
    """State of one vehicle without GPS beside its filters.

    `systematic` holds for each vehicle whose lasting error has entered, the sensitivity (4, k) of the state to it and its
    covariance (k, k): a Schmidt ("consider") part of the covariance, which shrinks only as its sensitivity does.
    `reason` says in words why the last epoch gave no fix, and is None if it gave one.
    """

    gatherer: EpochGatherer
    gate: NisGate
    last_fix_s: float = -math.inf
    confirmations: int = 0
    reason: str | None = "no ranges yet"
    peers: tuple[int, ...] = ()
    hdop: float = math.inf
    systematic: dict[int, tuple[FloatArray, FloatArray]] = field(default_factory=dict)

    def judge(self, horizontal: CvFilter, fix: Fix, R: FloatArray, at_s: float) -> tuple[float, float, float]:
        """Return NIS, innovation length and its sigma, m, of a fix of covariance R (2, 2) against the filter's prediction.

        Filter and fix share the peers' lasting errors: their difference carries the difference of the sensitivities only.
        """
        H = position_rows(2)
        innovation, S = horizontal.innovation(fix.position_m, R, H, at_s)
        differences = {vehicle: (H @ sensitivity, B) for vehicle, (sensitivity, B) in self.systematic.items()}
        for vehicle, (of_fix, B) in fix.systematic.items():
            of_state = differences[vehicle][0] if vehicle in differences else np.zeros_like(of_fix)
            differences[vehicle] = (of_state - of_fix, B)
        for difference, B in differences.values():
            S = S + difference @ B @ difference.T
        return nis(innovation, S), float(np.linalg.norm(innovation)), float(np.sqrt(np.trace(S)))

    def take(self, horizontal: CvFilter, fix: Fix, R: FloatArray, at_s: float) -> None:
        """Update the filter with a fix, and the sensitivities with it."""
        F = horizontal.propagate(at_s)
        K, H = horizontal.update(fix.position_m, R, position_rows(2), at_s)
        keep = (np.eye(4) - K @ H) @ F
        self.systematic = {vehicle: (keep @ sensitivity, B) for vehicle, (sensitivity, B) in self.systematic.items()}
        for vehicle, (of_fix, B) in fix.systematic.items():
            before = self.systematic[vehicle][0] if vehicle in self.systematic else 0.0
            self.systematic[vehicle] = (before + K @ of_fix, B)
        self._remember(fix, at_s)

    def start(self, fix: Fix, at_s: float) -> None:
        """Take a fix that the filter has been started from."""
        place = position_rows(2).T
        self.systematic = {vehicle: (place @ of_fix, B) for vehicle, (of_fix, B) in fix.systematic.items()}
        self.confirmations = 0
        self.gate.refused_in_a_row = 0
        self._remember(fix, at_s)

    def systematic_covariance(self, F: FloatArray) -> FloatArray:
        """Return the lasting part of the covariance, shape (4, 4), after a transition F (4, 4)."""
        total = np.zeros((4, 4))
        for sensitivity, B in self.systematic.values():
            total += F @ sensitivity @ B @ sensitivity.T @ F.T
        return total

    def _remember(self, fix: Fix, at_s: float) -> None:
        self.last_fix_s = max(self.last_fix_s, at_s)
        self.confirmations += 1
        self.reason = None
        self.peers, self.hdop = fix.peers, fix.hdop
