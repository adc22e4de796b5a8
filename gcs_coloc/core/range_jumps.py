"""Have all ranges of one device come to be off by one length? Seen in what the estimator refuses, before it gives in to them.

Multipath makes single ranges too long, each by a length of its own. When the ranges to every peer are refused one after the
other, all off by about the same, it is the device, or the clock that it measures by. An estimator whose ranges are refused for
long must hold that it is wrong itself, and moves to where they point; so what it says is not to be claimed from the first such
row of ranges on, until it has been seen where it comes to rest.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot

from gcs_coloc.core.measurements import Residual

_REMEMBERED_S = 1.0
_HEARD_S = 2.0
_LEAST_PEERS = 2
_LEAST_RANGES = 3
_ALIKE_SIGMAS = 4.0
_KEPT = 64


@dataclass(frozen=True, slots=True)
class _Jump:
    at_s: float
    size_m: float


class RangeJumps:
    """The ranging devices of one fleet."""

    def __init__(self) -> None:
        self._refused: dict[int, deque[Residual]] = {}
        self._peers: dict[int, dict[int, float]] = {}
        self._jumps: dict[int, _Jump] = {}

    def add(self, residuals: Iterable[Residual], now_s: float) -> None:
        """Add what the estimator made of ranges, in the order in which it used them."""
        for r in residuals:
            if r.to_vehicle is None:
                continue
            self._peers.setdefault(r.from_vehicle, {})[r.to_vehicle] = r.measured_at_s
            if r.refused is None:
                self._refused.pop(r.from_vehicle, None)
            else:
                self._refused.setdefault(r.from_vehicle, deque(maxlen=_KEPT)).append(r)
                if self._all_by_one_length(r):
                    self._jumps[r.from_vehicle] = _Jump(now_s, r.innovation_m)

    def sizes_m(self, now_s: float) -> dict[int, float]:
        """By what length (m) all ranges of a vehicle were found to have jumped within the last second; others are left out."""
        self._jumps = {vehicle: jump for vehicle, jump in self._jumps.items() if now_s - jump.at_s <= _REMEMBERED_S}
        return {vehicle: jump.size_m for vehicle, jump in self._jumps.items()}

    def _all_by_one_length(self, newest: Residual) -> bool:
        heard = {peer for peer, at_s in self._peers[newest.from_vehicle].items() if newest.measured_at_s - at_s <= _HEARD_S}
        missing: set[int | None] = set(heard)
        for count, r in enumerate(reversed(self._refused[newest.from_vehicle]), start=1):
            if abs(r.innovation_m - newest.innovation_m) > _ALIKE_SIGMAS * hypot(r.sigma_m, newest.sigma_m):
                return False
            missing -= {r.to_vehicle}
            if not missing and count >= _LEAST_RANGES:
                return len(heard) >= _LEAST_PEERS
        return False
