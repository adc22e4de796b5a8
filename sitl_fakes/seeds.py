"""One random stream per vehicle and purpose, so that a change in one sensor's settings leaves all other draws as they were."""

from __future__ import annotations

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
