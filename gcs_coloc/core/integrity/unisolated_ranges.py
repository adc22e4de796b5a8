"""Which pairs were isolated of late, and which ranges may be off while it is open which.

A contradiction that several pairs explain alike passes where the geometry no longer shows it. So ranges stay unisolated until a
test that would show it again has found nothing. A pair that was isolated just before goes on to explain what others would, too.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from math import inf

from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel
from gcs_coloc.core.integrity.epoch_tests.pair_outliers import Pair

_KNOWN_FOR_S = 10.0
"""A pair that was isolated explains a contradiction so much later. Chosen: ten samples; that it has become right and another one
wrong meanwhile is far rarer."""
_CLEARED_AFTER_S = 2.0
"""Ranges count as right again when they were tested for so long without a contradiction. Chosen: two samples."""
_LASTS_S = 600.0
"""Without a test they stay unisolated for so long. Chosen: as long as a fault that no test finds (`protection_level`)."""


@dataclass(slots=True)
class _Unisolated:
    """Ranges that may be off: when that was last seen, and since when they have been tested without it, s."""

    seen_at_s: float
    tested_since_s: float = inf


class UnisolatedRanges:
    """The ranges of one fleet that may be off, each by its pair or by the vehicle of its device."""

    def __init__(self) -> None:
        self._ranges: dict[tuple[int, ...], _Unisolated] = {}
        self._known_until_s: dict[Pair, float] = {}

    @property
    def ranges(self) -> Collection[tuple[int, ...]]:
        """The ranges of which some are off, or were of late, and it is open which."""
        return self._ranges.keys()

    def known(self, now_s: float) -> set[Pair]:
        """Return the pairs that were isolated of late."""
        return {pair for pair, until_s in self._known_until_s.items() if now_s < until_s}

    def add(self, noise: NoiseModel, now_s: float) -> None:
        """Add what a review has found."""
        self._known_until_s = {pair: self._known_until_s[pair] for pair in self.known(now_s)}
        self._known_until_s |= dict.fromkeys(noise.isolated_pairs, now_s + _KNOWN_FOR_S)
        self._ranges |= {who: _Unisolated(now_s) for who in noise.unisolated}

    def clear(self, tested: Collection[tuple[int, ...]], now_s: float) -> None:
        """Drop the ranges that were `tested` without a contradiction for a while, and old ones."""
        for who, found in self._ranges.items():
            is_clear = who in tested and found.seen_at_s < now_s
            found.tested_since_s = min(found.tested_since_s, now_s) if is_clear else inf
        self._ranges = {
            who: found
            for who, found in self._ranges.items()
            if now_s - found.tested_since_s < _CLEARED_AFTER_S and now_s - found.seen_at_s < _LASTS_S
        }

    def forget(self, vehicle: int) -> None:
        """Forget the ranges of a vehicle."""
        self._ranges = {who: found for who, found in self._ranges.items() if vehicle not in who}
        self._known_until_s = {pair: until_s for pair, until_s in self._known_until_s.items() if vehicle not in pair}
