"""Random processes: one generator per vehicle and purpose, and the Gauss-Markov process."""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """What a random stream is for."""

    GPS = 1
    JAMMING = 2
    RANGES = 3
    PAIR_BIAS = 4
    AIR_SENSORS = 5
    WIND = 6
    DOWNLINK = 7
    UPLINK = 8
    CLOCK = 9
    PHASES = 10


def stream(seed: int, purpose: Purpose, *keys: int) -> np.random.Generator:
    """Return the generator for a purpose; `keys` are system ids."""
    return np.random.default_rng([seed, int(purpose), *keys])


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
