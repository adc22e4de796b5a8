"""Antennas beside a body's reference point: their lever arms, turned by the attitudes, go into ranges.

A range between two antennas is |x + d|, with x from one body's reference point to the other's and d the difference of the two
lever arms. Where an attitude is unknown, the direction of d is too: its length goes into the sigma.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import cos, hypot, sin, sqrt

import numpy as np

from gcs_coloc.core.measurements import AttitudeMeasurement, FloatArray, Measurement, RangeMeasurement, Vector3

_ATTITUDE_HOLDS_S = 0.5
"""An attitude holds for so long; chosen: as long as the fleet filter takes one to hold."""


class Attitudes:
    """The attitudes of a data set by vehicle, in order of time."""

    def __init__(self, measurements: Sequence[Measurement]) -> None:
        rows: dict[int, list[tuple[float, float, float, float]]] = {}
        for m in measurements:
            if isinstance(m, AttitudeMeasurement):
                rows.setdefault(m.vehicle, []).append((m.measured_at_s, m.roll_rad, m.pitch_rad, m.yaw_rad))
        self._rows = {vehicle: np.array(sorted(of_vehicle)) for vehicle, of_vehicle in rows.items()}

    def lever_arm_enu_m(self, vehicle: int, body_m: Vector3, at_s: float) -> FloatArray | None:
        """Return a lever arm (forward, right, down) as ENU (3,), m; None without an attitude."""
        rows = self._rows.get(vehicle)
        if rows is None:
            return None
        row = rows[int(np.clip(np.searchsorted(rows[:, 0], at_s), 0, len(rows) - 1))]
        before = rows[max(int(np.searchsorted(rows[:, 0], at_s)) - 1, 0)]
        nearest = row if abs(row[0] - at_s) < abs(before[0] - at_s) else before
        return body_to_enu(body_m, *nearest[1:]) if abs(nearest[0] - at_s) <= _ATTITUDE_HOLDS_S else None


def body_to_enu(body_m: Vector3, roll_rad: float, pitch_rad: float, yaw_rad: float) -> FloatArray:
    """Turn a vector (forward, right, down) into east, north, up (3,).

    By the usual rotations about z, y and x.
    """
    x, y, z = body_m
    sr, cr, sp, cp, sy, cy = sin(roll_rad), cos(roll_rad), sin(pitch_rad), cos(pitch_rad), sin(yaw_rad), cos(yaw_rad)
    north = cy * cp * x + (cy * sp * sr - sy * cr) * y + (cy * sp * cr + sy * sr) * z
    east = sy * cp * x + (sy * sp * sr + cy * cr) * y + (sy * sp * cr - cy * sr) * z
    return np.array((east, north, sp * x - cp * sr * y - cp * cr * z))


def antenna_range(
    m: RangeMeasurement, arms: Sequence[Vector3], attitudes: Attitudes, anchors: Mapping[int, Vector3]
) -> RangeMeasurement:
    """Return a range with its lever arms, of `from` and `to`; those of an anchor are north, east, down.

    An unknown direction costs the length of the lever arm over the root of three in the sigma.
    """
    turned, unknown_m = [], 0.0
    for vehicle, arm in zip(m.ends, arms, strict=True):
        at_anchor = body_to_enu(arm, 0.0, 0.0, 0.0) if vehicle in anchors else None
        found = at_anchor if at_anchor is not None else attitudes.lever_arm_enu_m(vehicle, arm, m.measured_at_s)
        turned.append(found if found is not None else np.zeros(3))
        unknown_m = hypot(unknown_m, 0.0 if found is not None else float(np.linalg.norm(arm)))
    e, n, u = (turned[1] - turned[0]).tolist()
    return replace(m, offset_enu_m=(e, n, u), sigma_m=hypot(m.sigma_m, unknown_m / sqrt(3.0)))
