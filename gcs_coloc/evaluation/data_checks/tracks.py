"""Where vehicles say that they are, or truly are, as functions of time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gcs_coloc.core.measurements import FloatArray

_GAP_SPACINGS = 2.5
_SHORTEST_GAP_S = 2.0
_LONGEST_GAP_S = 30.0

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class PositionTrack:
    """Positions (T, 3), ENU in metres, at times (T,) in seconds, ascending, with one standard deviation (T,) of each, m.

    Velocities (T, 3), ENU in m/s, are NaN where there are none, all of them where they are left out. A track of an anchor has one
    position, which holds always.
    """

    times_s: FloatArray
    positions_enu_m: FloatArray
    sigmas_m: FloatArray
    velocities_enu_mps: FloatArray | None = None
    is_static: bool = False
    gap_s: float = field(init=False)
    """Positions further apart than this are not interpolated between."""

    def __post_init__(self) -> None:
        spacing_s = float(np.median(np.diff(self.times_s))) if len(self.times_s) > 1 else 0.0
        object.__setattr__(self, "gap_s", min(max(_GAP_SPACINGS * spacing_s, _SHORTEST_GAP_S), _LONGEST_GAP_S))

    def at(self, times_s: FloatArray) -> tuple[FloatArray, Mask]:
        """Positions (N, 3) at times (N,), linear between two reports, and whether there are any (N,)."""
        if self.is_static:
            return np.broadcast_to(self.positions_enu_m[0], (len(times_s), 3)), np.ones(len(times_s), dtype=bool)
        after = np.clip(np.searchsorted(self.times_s, times_s), 1, max(len(self.times_s) - 1, 1))
        if len(self.times_s) < 2:
            return np.zeros((len(times_s), 3)), np.zeros(len(times_s), dtype=bool)
        before = after - 1
        span_s = self.times_s[after] - self.times_s[before]
        known = (times_s >= self.times_s[before]) & (times_s <= self.times_s[after]) & (span_s <= self.gap_s)
        share = np.clip((times_s - self.times_s[before]) / np.where(span_s > 0.0, span_s, 1.0), 0.0, 1.0)[:, np.newaxis]
        return (1.0 - share) * self.positions_enu_m[before] + share * self.positions_enu_m[after], known


def track(rows: FloatArray) -> PositionTrack:
    """A track of rows (T, 5) or (T, 8) in any order: time in s, east, north, up in m, sigma in m, and velocity ENU in m/s."""
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return PositionTrack(rows[:, 0], rows[:, 1:4], rows[:, 4], rows[:, 5:8] if rows.shape[1] == 8 else None)
