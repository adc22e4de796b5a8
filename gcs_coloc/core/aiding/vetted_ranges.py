"""Vetted ranges: ranges to trusted nodes that the estimator has used.

They are kept for the vehicles that are handed ranges.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from gcs_coloc.core.measurements import RangeMeasurement, Residual

_MAX_WAITING = 4096
"""Chosen: some seconds of a large fleet; the estimator tells of a range within its window."""
_MAX_READY = 64
"""Chosen: of one vehicle, more than is handed over in a second."""


class VettedRange(NamedTuple):
    """A vetted range of a vehicle to a node.

    `measured_at_s` is service time. `sigma_m` is 1-sigma.
    """

    peer: int
    measured_at_s: float
    range_m: float
    sigma_m: float


@dataclass(slots=True)
class _Waiting:
    """The ranges of one pair at one time, by device, and how many of them the estimator has used."""

    of_device: dict[int, RangeMeasurement] = field(default_factory=dict)
    used: int = 0


class VettedRanges:
    """The vetted ranges that have not been handed over yet.

    `wants` says of a system id whether that vehicle is handed ranges.
    """

    def __init__(self, wants: Callable[[int], bool]) -> None:
        self._wants = wants
        self._waiting: OrderedDict[tuple[int, int, float], _Waiting] = OrderedDict()
        self._ready: dict[int, list[VettedRange]] = {}

    def forget(self, vehicle: int) -> None:
        """Forget the vetted ranges of a vehicle."""
        self._ready.pop(vehicle, None)

    def add_range(self, m: RangeMeasurement) -> None:
        """Add a range that the estimator was given."""
        if not (self._wants(m.from_vehicle) or self._wants(m.to_vehicle)):
            return
        self._waiting.setdefault((m.from_vehicle, m.to_vehicle, m.measured_at_s), _Waiting()).of_device[m.device_id] = m
        if len(self._waiting) > _MAX_WAITING:
            self._waiting.popitem(last=False)

    def add_residuals(self, residuals: Iterable[Residual], is_trusted: Callable[[int], bool]) -> None:
        """Add what the estimator made of ranges: those that it used become vetted ones.

        A range to a node that is not trusted is left out. A residual does not name its device: of several that ranged one peer at
        one time all must have been used.
        """
        if not self._waiting:
            return
        for r in residuals:
            if r.to_vehicle is None or (waiting := self._waiting.get((r.from_vehicle, r.to_vehicle, r.measured_at_s))) is None:
                continue
            waiting.used += 1
            if r.refused is None and waiting.used < len(waiting.of_device):
                continue
            del self._waiting[r.from_vehicle, r.to_vehicle, r.measured_at_s]
            if r.refused is None:
                for m in waiting.of_device.values():
                    self._add_vetted(m, is_trusted)

    def _add_vetted(self, m: RangeMeasurement, is_trusted: Callable[[int], bool]) -> None:
        for vehicle, peer in ((m.from_vehicle, m.to_vehicle), (m.to_vehicle, m.from_vehicle)):
            if self._wants(vehicle) and is_trusted(peer):
                ready = self._ready.setdefault(vehicle, [])
                ready.append(VettedRange(peer, m.measured_at_s, m.range_m, m.sigma_m))
                del ready[:-_MAX_READY]

    def drain(self, vehicle: int) -> tuple[VettedRange, ...]:
        """Return the vetted ranges of a vehicle since the last call."""
        return tuple(self._ready.pop(vehicle, ()))
