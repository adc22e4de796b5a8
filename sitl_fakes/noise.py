"""Random processes of the simulation, each drawn from a generator that its owner seeds."""

from __future__ import annotations

import math

import numpy as np


class GaussMarkov:
    """First-order Gauss-Markov process in `axes` dimensions with a stationary sigma; a correlation time of 0 s makes it white."""

    def __init__(self, rng: np.random.Generator, sigma: float, correlation_time_s: float, axes: int) -> None:
        self._rng = rng
        self._sigma = sigma
        self._time = correlation_time_s
        self._value: list[float] = (sigma * rng.standard_normal(axes)).tolist()

    @property
    def value(self) -> list[float]:
        """The value now, one number per axis."""
        return self._value

    def advance(self, by_s: float) -> list[float]:
        """Move on by a time step and return the new value."""
        keep = math.exp(-by_s / self._time) if self._time > 0.0 else 0.0
        fresh = self._sigma * math.sqrt(1.0 - keep * keep)
        self._value = [
            keep * x + fresh * g for x, g in zip(self._value, self._rng.standard_normal(len(self._value)), strict=True)
        ]
        return self._value
