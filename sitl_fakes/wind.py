"""The air around one aircraft."""

from __future__ import annotations

import math

from sitl_fakes.noise import GaussMarkov
from sitl_fakes.scenario import Wind
from sitl_fakes.seeds import Purpose, stream


class LocalWind:
    """The wind at one aircraft: the scenario's steady wind and a slow change of its own."""

    def __init__(self, settings: Wind, sysid: int, seed: int) -> None:
        towards = math.radians(settings.from_deg + 180.0)
        self._steady = (settings.speed_mps * math.sin(towards), settings.speed_mps * math.cos(towards))
        rng = stream(seed, Purpose.WIND, sysid)
        self._change = GaussMarkov(rng, settings.variation_mps, settings.variation_time_s, 2)

    def advance(self, by_s: float) -> tuple[float, float]:
        """Move on by a step and return the wind, towards east and north, m/s."""
        east, north = self._change.advance(by_s)
        return self._steady[0] + east, self._steady[1] + north
