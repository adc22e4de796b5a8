"""Where an aircraft truly is, as the processes of one airspace tell each other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sitl_fakes.geodesy import Vector

_TOO_FAR_OFF_S = 1.0


@dataclass(frozen=True, slots=True)
class Whereabouts:
    """Where an aircraft is at a time (s): position (east, north, up, m) and velocity (m/s)."""

    sysid: int
    at_s: float
    position_m: Vector
    velocity_mps: Vector

    @classmethod
    def from_json(cls, said: Mapping[str, Any]) -> Whereabouts:
        """From the fields by name. Raises `ValueError`, `TypeError` or `KeyError` where they are not what they should be."""
        (e, n, u), (ve, vn, vu) = said["position_m"], said["velocity_mps"]
        if not all(math.isfinite(x) for x in (said["at_s"], e, n, u, ve, vn, vu)):
            raise ValueError("not finite")
        return cls(int(said["sysid"]), said["at_s"], (e, n, u), (ve, vn, vu))

    def position_at(self, at_s: float) -> Vector | None:
        """Position (m) at another time (s), flown straight on; None where that is too far off to tell."""
        dt = at_s - self.at_s
        if abs(dt) > _TOO_FAR_OFF_S:
            return None
        (e, n, u), (ve, vn, vu) = self.position_m, self.velocity_mps
        return e + ve * dt, n + vn * dt, u + vu * dt
