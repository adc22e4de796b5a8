"""The data of a recording that the checks compare: position tracks, ranges and heights by vehicle."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import hypot

import numpy as np
from numpy.typing import NDArray

from gcs_coloc.core.measurements import AltitudeMeasurement, FloatArray, PositionMeasurement, RangeMeasurement
from gcs_coloc.evaluation.data_checks.findings import median_residual_m
from gcs_coloc.evaluation.dataset import Dataset

_GAP_SPACINGS = 2.5  # chosen: one lost sample is no gap
_SHORTEST_GAP_S = 2.0  # chosen: less is a pause of the radio
_LONGEST_GAP_S = 30.0
"""Reports further apart than 2.5 times their median spacing, within 2 to 30 s, are a gap; chosen: one lost report is none."""
_FINE_S = np.linspace(-2.0, 2.0, 81)
_COARSE_S = np.concatenate((np.linspace(-30.0, 30.0, 241), np.arange(31.0, 121.0), -np.arange(31.0, 121.0)))
"""Time offsets tried, s: 0.05 s apart to 2 s, 0.25 s to 30 s, 1 s to 2 min; chosen: a vehicle at 20 m/s is 20 m off at 1 s."""

_NO_VELOCITY = (float("nan"),) * 3
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class PositionTrack:
    """Positions (T, 3), ENU in m, at ascending times (T,) in s, with 1-sigma (T,) of each, m.

    Velocities (T, 3) are ENU in m/s, NaN where unknown. The static track of an anchor has one position, which holds always.
    """

    times_s: FloatArray
    positions_enu_m: FloatArray
    sigmas_m: FloatArray
    velocities_enu_mps: FloatArray | None = None
    is_static: bool = False
    gap_s: float = field(init=False)
    """Positions further apart than this are not interpolated."""

    def __post_init__(self) -> None:
        spacing_s = float(np.median(np.diff(self.times_s))) if len(self.times_s) > 1 else 0.0
        object.__setattr__(self, "gap_s", min(max(_GAP_SPACINGS * spacing_s, _SHORTEST_GAP_S), _LONGEST_GAP_S))

    def at(self, times_s: FloatArray) -> tuple[FloatArray, Mask]:
        """Return positions (N, 3) at times (N,), linear between two reports, and whether each is known (N,)."""
        if self.is_static:
            return np.broadcast_to(self.positions_enu_m[0], (len(times_s), 3)), np.ones(len(times_s), dtype=bool)
        if len(self.times_s) < 2:
            return np.zeros((len(times_s), 3)), np.zeros(len(times_s), dtype=bool)
        # Called a hundred thousand times for the clocks of one data set: np.clip and masks that select all cost most of it.
        after = np.minimum(np.maximum(self.times_s.searchsorted(times_s), 1), len(self.times_s) - 1)
        before = after - 1
        begins_s, ends_s = self.times_s[before], self.times_s[after]
        span_s = ends_s - begins_s
        known = (times_s >= begins_s) & (times_s <= ends_s) & (span_s <= self.gap_s)
        share = np.minimum(np.maximum((times_s - begins_s) / np.where(span_s > 0.0, span_s, 1.0), 0.0), 1.0)[:, np.newaxis]
        return (1.0 - share) * self.positions_enu_m[before] + share * self.positions_enu_m[after], known


def position_track(rows: FloatArray) -> PositionTrack:
    """Return the track of rows (T, 5 or 8) in any order.

    A row has time s, east, north, up m, sigma m, and velocity ENU m/s.
    """
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return PositionTrack(rows[:, 0], rows[:, 1:4], rows[:, 4], rows[:, 5:8] if rows.shape[1] == 8 else None)


@dataclass(frozen=True, slots=True)
class RecordedData:
    """What the checks compare, by vehicle number."""

    names: Mapping[int, str]
    """What a user calls each vehicle."""
    reports: Mapping[int, PositionTrack]
    """Positions that vehicles report, and those of anchors."""
    truth: Mapping[int, PositionTrack]
    ranges: FloatArray
    """(N, 5): time in s, the numbers of the two vehicles, range and sigma in m."""
    heights: Mapping[int, FloatArray] = field(default_factory=dict)
    """Of each vehicle (T, 3): time in s, height and sigma in m."""
    origin_height_m: float = 0.0
    """Height of the frame's origin above mean sea level, where heights were brought into the frame from there."""


def recorded_data(dataset: Dataset) -> RecordedData:
    """Return what the checks compare of a data set.

    In a flat one the heights say nothing of the distances.
    """
    positions: dict[int, list[tuple[float, ...]]] = defaultdict(list)
    heights: dict[int, list[tuple[float, ...]]] = defaultdict(list)
    ranges: list[tuple[float, ...]] = []
    height = 1.0 if dataset.dims == 3 else 0.0
    for m in dataset.measurements:
        if isinstance(m, PositionMeasurement):
            e, n, u = m.position_enu_m
            row = (m.measured_at_s, e, n, height * u, m.sigma_h_m, *(m.velocity_enu_mps or _NO_VELOCITY))
            positions[m.vehicle].append(row)
        elif isinstance(m, RangeMeasurement):
            # Between antennas it is a range between the bodies within the lever arms.
            arm_m = hypot(*m.offset_enu_m)
            ranges.append((m.measured_at_s, m.from_vehicle, m.to_vehicle, m.range_m, hypot(m.sigma_m, arm_m)))
        elif isinstance(m, AltitudeMeasurement) and dataset.dims == 3:
            heights[m.vehicle].append((m.measured_at_s, m.up_m, m.sigma_m))
    reports = {vehicle: position_track(np.array(rows)) for vehicle, rows in positions.items()}
    for node in dataset.nodes:
        if node.place_enu_m is not None and node.sigma_m is not None:
            place = np.array([node.place_enu_m]) * (1.0, 1.0, height)
            reports[node.vehicle] = PositionTrack(np.zeros(1), place, np.array([node.sigma_m]), is_static=True)
    return RecordedData(
        names={node.vehicle: node.id for node in dataset.nodes},
        reports=reports,
        truth={
            vehicle: PositionTrack(true.times_s, true.positions_enu_m * (1.0, 1.0, height), np.zeros(len(true.times_s)))
            for vehicle, true in dataset.truth.items()
        },
        ranges=np.array(ranges, dtype=float).reshape(-1, 5),
        heights={vehicle: np.array(rows) for vehicle, rows in heights.items()},
    )


def thinned(rows: FloatArray, most: int) -> FloatArray:
    """Return at most `most` of the rows, evenly spaced."""
    return rows if len(rows) <= most else rows[np.linspace(0, len(rows) - 1, most).astype(int)]


ResidualOfOffset = Callable[[float], FloatArray]
"""The residuals (N,), m, if positions of so many seconds later are used; NaN where nothing can be compared."""


def find_time_offset_s(residual: ResidualOfOffset) -> tuple[float, float]:
    """Return the offset within 2 minutes that leaves the least median residual, s, and that residual, m."""
    coarse_s, _ = _best_offset(residual, np.concatenate((_FINE_S, _COARSE_S)))
    return _best_offset(residual, coarse_s + np.linspace(-0.05, 0.05, 11) * max(1.0, min(abs(coarse_s), 10.0)))


def find_small_time_offset_s(residual: ResidualOfOffset) -> tuple[float, float]:
    """Return the offset within 2 seconds that leaves the least median residual, s, and that residual, m."""
    return _best_offset(residual, _FINE_S)


def _best_offset(residual: ResidualOfOffset, offsets_s: FloatArray) -> tuple[float, float]:
    medians_m = [median_residual_m(residual(float(offset_s))) for offset_s in offsets_s]
    best = int(np.argmin(medians_m))
    return float(offsets_s[best]), medians_m[best]
