"""Pulls the last known position along each range by a fixed share of the residual."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from gcs_coloc import (
    AltitudeMeasurement,
    Estimate,
    Measurement,
    NoEstimate,
    NoEstimateReason,
    PositionMeasurement,
    RangeMeasurement,
    Residual,
    Unlocated,
)


@dataclass(frozen=True)
class RangePullSettings:
    share: float = 0.3
    sigma_m: float = 25.0


class RangePull:
    name = "range_pull"

    def __init__(self, settings: RangePullSettings) -> None:
        self.settings = settings
        self.positions: dict[int, np.ndarray] = {}
        self.denied: set[int] = set()
        self.used = 0

    def set_denied(self, denied: Collection[int], at_s: float) -> None:
        self.denied = set(denied)

    def reset(self, vehicle: int, at_s: float) -> None:
        pass  # the ranges pull its position to where they agree, wherever it is now

    def add(self, measurement: Measurement) -> None:
        if isinstance(measurement, PositionMeasurement) and measurement.vehicle not in self.denied:
            self.positions[measurement.vehicle] = np.array(measurement.position_enu_m)
        elif isinstance(measurement, AltitudeMeasurement) and measurement.vehicle in self.positions:
            self.positions[measurement.vehicle][2] = measurement.up_m
        elif isinstance(measurement, RangeMeasurement):
            for own, peer in self.pairs(measurement):
                away = self.positions[own] - self.positions[peer]
                distance = float(np.linalg.norm(away)) or 1.0
                self.positions[own] += self.settings.share * (measurement.range_m / distance - 1.0) * away
                self.used += 1

    def pairs(self, measurement: RangeMeasurement) -> list[tuple[int, int]]:
        ends = measurement.from_vehicle, measurement.to_vehicle
        known = all(end in self.positions for end in ends)
        return [(a, b) for a, b in (ends, ends[::-1]) if known and a in self.denied and b not in self.denied]

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        if vehicle not in self.positions:
            return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.NOT_LOCATED))
        covariance = np.diag([self.settings.sigma_m**2] * 3 + [30.0**2] * 3)
        return Estimate(vehicle, at_s, self.positions[vehicle].copy(), np.zeros(3), covariance, None, 0)

    def drain_residuals(self) -> list[Residual]:
        return []

    def counts(self) -> Mapping[str, int]:
        return {"range used": self.used}
