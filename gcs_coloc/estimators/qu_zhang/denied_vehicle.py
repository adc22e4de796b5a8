"""State of a denied vehicle beside its track: its range epochs, its gate and the lasting errors.

An epoch is the ranges that were measured at nearly the same time. They are gathered in whatever order they arrive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from gcs_coloc.core.measurements import FloatArray, NoEstimateReason, RangeMeasurement, Unlocated
from gcs_coloc.estimators.qu_zhang.cv_filter import CvFilter, Sensitivities, nis, position_rows
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
        """Return the covariance (4, 4) of the predicted state at a time, lasting errors included."""
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


_PARTNER_MEMORY_S = 2.0
"""An epoch waits for a peer that was ranged within this time. Chosen: twice the period of slow ranging, 1 Hz."""

_OPEN_LIMIT = 64  # most epochs open at a time; the oldest are closed beyond; chosen: bounds memory, 20 Hz for three seconds


@dataclass(slots=True, eq=False)
class RangeEpoch:
    """Ranges from one vehicle to distinct peers, by peer, measured within one window."""

    opened_at_s: float
    ranges: dict[int, RangeMeasurement] = field(default_factory=dict)

    @property
    def newest_s(self) -> float:
        """When the last of its ranges was measured."""
        return max(one.measured_at_s for one in self.ranges.values())

    def spread_with_s(self, measured_at_s: float) -> float:
        """Return the time that the ranges would span with one more at the given time."""
        times = [one.measured_at_s for one in self.ranges.values()]
        return max(*times, measured_at_s) - min(*times, measured_at_s)


class RangeEpochGatherer:
    """Sorts the ranges of one vehicle into epochs.

    An epoch is complete, and handed out at once, when every peer heard lately is in it; otherwise it is handed out as it is
    when `wait_s` have passed since its first range arrived. A range goes to the epoch that it is nearest to in time, among those
    whose ranges then span at most `window_s` and that have none of its peer yet.
    """

    def __init__(self, window_s: float, wait_s: float) -> None:
        self._window_s = window_s
        self._wait_s = wait_s
        self._open: list[RangeEpoch] = []
        self._heard_at_s: dict[int, float] = {}

    def add(self, peer: int, measurement: RangeMeasurement) -> RangeEpoch | None:
        """Add a range to a peer; return the epoch that it completes, if any."""
        now_s = measurement.arrived_at_s
        self._heard_at_s[peer] = now_s
        self._heard_at_s = {who: when for who, when in self._heard_at_s.items() if now_s - when <= _PARTNER_MEMORY_S}
        spreads = [
            (epoch.spread_with_s(measurement.measured_at_s), index)
            for index, epoch in enumerate(self._open)
            if peer not in epoch.ranges
        ]
        if spreads and min(spreads)[0] <= self._window_s:
            epoch = self._open[min(spreads)[1]]
        else:
            epoch = RangeEpoch(opened_at_s=now_s)
            self._open.append(epoch)
        epoch.ranges[peer] = measurement
        if len(epoch.ranges) >= 3 and self._heard_at_s.keys() <= epoch.ranges.keys():
            self._open.remove(epoch)
            return epoch
        return None

    def pop_due(self, now_s: float) -> list[RangeEpoch]:
        """Return the epochs that have waited long enough, oldest first."""
        due = [epoch for epoch in self._open if now_s - epoch.opened_at_s > self._wait_s]
        waiting = [epoch for epoch in self._open if epoch not in due]
        due += waiting[: max(0, len(waiting) - _OPEN_LIMIT)]
        self._open = [epoch for epoch in waiting if epoch not in due]
        return sorted(due, key=lambda epoch: epoch.newest_s)
