"""The ranges of each vehicle of the last seconds, as they were given to the estimator."""

from __future__ import annotations

from collections import deque

from gcs_coloc.core.measurements import RangeMeasurement

_KEPT_S = 10.0
"""Chosen: two ranges of a pair at 0.2 Hz, the slowest that the fleet filter selects a peer by."""
_MOST = 600
"""Ranges of one vehicle. Chosen: 10 s of six peers at 10 Hz; of more the last seconds tell the rates as well."""


class RecentRanges:
    """Ranges by vehicle, oldest first. A range is one of both its ends; stations keep none."""

    def __init__(self) -> None:
        self._of: dict[int, deque[RangeMeasurement]] = {}

    def add(self, measurement: RangeMeasurement) -> None:
        """Add a range."""
        for end in (measurement.from_vehicle, measurement.to_vehicle):
            if end > 0:
                ranges = self._of.get(end)
                if ranges is None:
                    ranges = self._of[end] = deque(maxlen=_MOST)
                ranges.append(measurement)

    def of(self, vehicle: int, now_s: float) -> list[RangeMeasurement]:
        """Return the ranges of a vehicle that were measured within the last 10 s."""
        oldest_s = now_s - _KEPT_S
        return [m for m in self._of.get(vehicle, ()) if m.measured_at_s >= oldest_s]
