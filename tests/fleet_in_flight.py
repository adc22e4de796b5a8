"""A small simulated fleet for estimator tests: true motion, and the measurements that would be made of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from gcs_coloc.core.measurements import AltitudeMeasurement, FloatArray, Measurement, PositionMeasurement, RangeMeasurement

Path = Callable[[float], tuple[float, float, float]]


def straight(start: tuple[float, float, float], velocity: tuple[float, float, float]) -> Path:
    """Return the path of constant velocity."""
    return lambda t: (start[0] + velocity[0] * t, start[1] + velocity[1] * t, start[2] + velocity[2] * t)


def circling(centre: tuple[float, float], radius_m: float, speed_mps: float, height_m: float) -> Path:
    """Return the path of a level circle."""
    rate = speed_mps / radius_m
    return lambda t: (centre[0] + radius_m * np.sin(rate * t), centre[1] + radius_m * np.cos(rate * t), height_m)


FOUR: Mapping[int, Path] = {
    1: straight((0, 0, 100), (0, 20, 0)),
    2: straight((1500, 0, 140), (0, 20, 0)),
    3: straight((300, 1600, 80), (5, 18, 0)),
    4: straight((700, 500, 110), (3, 21, 0)),
}


@dataclass
class Fleet:
    """Vehicles on their paths, and noise with a seed. `lasting` shifts all positions that a vehicle reports."""

    paths: Mapping[int, Path] = field(default_factory=lambda: FOUR)
    seed: int = 0
    sigma_position_m: float = 1.0
    sigma_range_m: float = 1.0
    sigma_altitude_m: float = 0.5
    lasting: Mapping[int, tuple[float, float, float]] = field(default_factory=dict)
    stated_sigma_m: float | None = None
    latency_s: float = 0.05

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)

    def at(self, vehicle: int, t: float) -> FloatArray:
        """Return the true position."""
        return np.array(self.paths[vehicle](t), dtype=np.float64)

    def position(self, vehicle: int, t: float) -> PositionMeasurement:
        """Return what the vehicle's receiver says."""
        noise = self.rng.normal(0.0, self.sigma_position_m, 3) + np.array(self.lasting.get(vehicle, (0.0, 0.0, 0.0)))
        e, n, u = (self.at(vehicle, t) + noise).tolist()
        sigma = self.stated_sigma_m or self.sigma_position_m
        return PositionMeasurement(vehicle, t, t + self.latency_s, (e, n, u), sigma, sigma)

    def altitude(self, vehicle: int, t: float) -> AltitudeMeasurement:
        """Return what the vehicle's barometer says."""
        up = float(self.at(vehicle, t)[2] + self.rng.normal(0.0, self.sigma_altitude_m))
        return AltitudeMeasurement(vehicle, t, t + self.latency_s, up, self.sigma_altitude_m)

    def range(self, a: int, b: int, t: float, *, error_m: float = 0.0, latency_s: float | None = None) -> RangeMeasurement:
        """Return the slant range between two vehicles, with an extra error."""
        distance = float(np.linalg.norm(self.at(a, t) - self.at(b, t))) + self.rng.normal(0.0, self.sigma_range_m) + error_m
        return RangeMeasurement(
            a, b, t, t + (self.latency_s if latency_s is None else latency_s), max(distance, 0.0), self.sigma_range_m
        )

    def round(self, t: float, denied: tuple[int, ...]) -> list[Measurement]:
        """Return one round of everything: positions of the healthy, altitudes and ranges of the denied vehicles."""
        healthy = [vehicle for vehicle in self.paths if vehicle not in denied]
        out: list[Measurement] = [self.position(vehicle, t) for vehicle in healthy]
        out += [self.altitude(vehicle, t) for vehicle in denied]
        out += [self.range(vehicle, peer, t) for vehicle in denied for peer in healthy]
        return out
