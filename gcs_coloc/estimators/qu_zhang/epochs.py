"""Epochs: the ranges of one vehicle that were measured at nearly the same time.

They are gathered in whatever order they arrive.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from gcs_coloc.core.measurements import RangeMeasurement

_PARTNER_MEMORY_S = 2.0
"""An epoch waits for a peer that was ranged within this time. Chosen: twice the period of slow ranging, 1 Hz."""

_OPEN_LIMIT = 64
"""Most epochs open at a time; the oldest are closed beyond. Chosen: bounds memory, 20 Hz for three seconds."""


@dataclass(slots=True, eq=False)
class RangeEpoch:
    """Ranges from one vehicle to distinct peers, by peer, measured within one window."""

    opened_at_s: float
    ranges: dict[int, RangeMeasurement] = field(default_factory=dict)

    @property
    def newest_s(self) -> float:
        """When the last of its ranges was measured."""
        return max(one.measured_at_s for one in self.ranges.values())

    def spread_with_s(self, measured_at_s: float) -> float:
        """Return the time that the ranges would span with one more at the given time."""
        times = [one.measured_at_s for one in self.ranges.values()]
        return max(*times, measured_at_s) - min(*times, measured_at_s)


class RangeEpochGatherer:
    """Sorts the ranges of one vehicle into epochs.

    An epoch is complete, and handed out at once, when every peer heard lately is in it; otherwise it is handed out as it is
    when `wait_s` have passed since its first range arrived. A range goes to the epoch that it is nearest to in time, among those
    whose ranges then span at most `window_s` and that have none of its peer yet.
    """

    def __init__(self, window_s: float, wait_s: float) -> None:
        self._window_s = window_s
        self._wait_s = wait_s
        self._open: list[RangeEpoch] = []
        self._heard_at_s: dict[int, float] = {}

    def add(self, peer: int, measurement: RangeMeasurement) -> RangeEpoch | None:
        """Add a range to a peer; return the epoch that it completes, if any."""
        now_s = measurement.arrived_at_s
        self._heard_at_s[peer] = now_s
        self._heard_at_s = {who: when for who, when in self._heard_at_s.items() if now_s - when <= _PARTNER_MEMORY_S}
        spreads = [
            (epoch.spread_with_s(measurement.measured_at_s), index)
            for index, epoch in enumerate(self._open)
            if peer not in epoch.ranges
        ]
        if spreads and min(spreads)[0] <= self._window_s:
            epoch = self._open[min(spreads)[1]]
        else:
            epoch = RangeEpoch(opened_at_s=now_s)
            self._open.append(epoch)
        epoch.ranges[peer] = measurement
        if len(epoch.ranges) >= 3 and self._heard_at_s.keys() <= epoch.ranges.keys():
            self._open.remove(epoch)
            return epoch
        return None

    def pop_due(self, now_s: float) -> list[RangeEpoch]:
        """Return the epochs that have waited long enough, oldest first."""
        due = [epoch for epoch in self._open if now_s - epoch.opened_at_s > self._wait_s]
        waiting = [epoch for epoch in self._open if epoch not in due]
        due += waiting[: max(0, len(waiting) - _OPEN_LIMIT)]
        self._open = [epoch for epoch in waiting if epoch not in due]
        return sorted(due, key=lambda epoch: epoch.newest_s)
