"""The planned motion of all vehicles at the steps of a prediction, each read once for all steps."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gcs_coloc.core.measurements import AttitudeMeasurement, FloatArray, Vector3
from gcs_coloc.planning.fleet_plan import FleetPlan

_ATTITUDE_EVERY_S = 0.45
"""Chosen: below the half second for which the filter takes an attitude as fresh."""


class PlannedMotion:
    """Positions and velocities of a plan's vehicles at times (N,), s, at even steps; of each time by its index."""

    def __init__(self, plan: FleetPlan, times_s: FloatArray) -> None:
        self._sysids = list(plan.paths)
        at = [path.at(times_s) for path in plan.paths.values()]
        self._positions_m = np.stack([motion.positions_m for motion in at], axis=1)
        self._velocities_mps = np.stack([motion.velocities_mps for motion in at], axis=1)
        self._is_flying = np.stack([(path.begin_s <= times_s) & (times_s <= path.end_s) for path in plan.paths.values()], axis=1)

    def in_flight(self, k: int) -> tuple[dict[int, Vector3], dict[int, Vector3]]:
        """Return the positions, m, and the velocities, m/s, of the vehicles in flight."""
        flying = np.flatnonzero(self._is_flying[k]).tolist()
        places, velocities = self._positions_m[k, flying].tolist(), self._velocities_mps[k, flying].tolist()
        sysids = [self._sysids[i] for i in flying]
        return dict(zip(sysids, map(_vector, places), strict=True)), dict(zip(sysids, map(_vector, velocities), strict=True))


def planned_attitudes(plan: FleetPlan, sysid: int, times_s: FloatArray, step_s: float) -> list[list[AttitudeMeasurement]]:
    """Return what a vehicle measures of its attitude and airspeed within the step before each time, oldest first."""
    path = plan.paths[sysid]
    count = math.ceil(step_s / _ATTITUDE_EVERY_S)
    before_s = step_s * np.arange(count - 1, -1, -1) / count
    then_s = (times_s[:, None] - before_s).ravel()
    motion = path.at(then_s)
    ve, vn, vu = motion.velocities_mps.T
    speed = np.hypot(ve, vn)
    angles = np.column_stack([motion.bank_rad, np.arctan2(vu, np.maximum(speed, 0.1)), np.arctan2(ve, vn), speed])
    rows = zip(then_s.tolist(), angles.tolist(), (then_s >= path.begin_s).tolist(), strict=True)
    measured = [AttitudeMeasurement(sysid, t, t, *row) if is_flying else None for t, row, is_flying in rows]
    return [[m for m in measured[k : k + count] if m is not None] for k in range(0, len(measured), count)]


def _vector(row: Sequence[float]) -> Vector3:
    e, n, u = row
    return e, n, u
