"""Watches the lines to each vehicle without GPS for a lie: what one may have done to it, and who is no longer to be believed.

The ranges between a vehicle without GPS and a peer since the last step make one line; the hypotheses are `lie_filters`'.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from math import hypot, sqrt
from statistics import median

import numpy as np

from gcs_coloc.core.integrity.epoch import PositionPrior
from gcs_coloc.core.integrity.fault_filters import FaultFilters, FaultFilterSettings, Line
from gcs_coloc.core.measurements import FloatArray, RangeMeasurement, Vector3

_LEAST_DISTANCE_M = 1.0
_MOST_PEERS = 8
_FORGOTTEN_S = 30.0


@dataclass(frozen=True, slots=True)
class FaultMonitorSettings:
    """When hypotheses have consequences.

    `counts_at`: from this chance on a lie counts in full in the covariance, below in proportion. A 95 % bound may leave out what
    is less than 5 % likely in all; here half of it counts, and all of twice as much. `honest`: below this chance that nobody lies
    those are suspected without whom all that is left is less likely than `left_out`. `least_peers`: with fewer nothing is told.
    `range_bias_m`: 1-sigma of what all ranges of a pair have in common, `slow_share` the share of their stated variance that no
    averaging removes.
    """

    counts_at: float = 0.1
    honest: float = 1e-4
    left_out: float = 0.01
    least_peers: int = 3
    range_bias_m: float = 0.3
    slow_share: float = 0.1
    lies: FaultFilterSettings = field(default_factory=FaultFilterSettings)


@dataclass(slots=True)
class _Ranges:
    """The ranges of one line: residuals and stated sigmas (m), claim and vector from the peer (m) of the newest."""

    residuals_m: list[float]
    sigmas_m: list[float]
    claim: PositionPrior
    own_sigma_v_m: float
    apart_m: Vector3


class FaultMonitor:
    """One fleet. Give it ranges with the places of both ends, then `step`."""

    def __init__(self, settings: FaultMonitorSettings | None = None) -> None:
        self.settings = settings if settings is not None else FaultMonitorSettings()
        self._filters: dict[int, FaultFilters] = {}
        self._lines: dict[int, dict[int, _Ranges]] = {}

    def range(self, m: RangeMeasurement, a: PositionPrior, b: PositionPrior) -> None:
        """Take a range with the places of both ends at its time; between two claims, or two vehicles without, it says nothing."""
        if a.free == b.free:
            return
        vehicle, peer, own, claim = (m.from_vehicle, m.to_vehicle, a, b) if a.free else (m.to_vehicle, m.from_vehicle, b, a)
        (e, n, u), (peer_e, peer_n, peer_u) = own.position_enu_m, claim.position_enu_m
        apart_m = e - peer_e, n - peer_n, u - peer_u
        distance_m = hypot(*apart_m)
        if distance_m < _LEAST_DISTANCE_M:
            return
        lines = self._lines.setdefault(vehicle, {})
        known = lines.setdefault(peer, _Ranges([], [], claim, own.sigma_v_m, apart_m))
        known.residuals_m.append(m.range_m - distance_m)
        known.sigmas_m.append(m.sigma_m)
        known.claim, known.own_sigma_v_m, known.apart_m = claim, own.sigma_v_m, apart_m

    def step(self, at_s: float, disbelieved: Collection[int]) -> None:
        """Weigh what was measured up to a time without those that are not believed, and forget who has had no lines for long."""
        for vehicle, ranged in self._lines.items():
            filters = self._filters.setdefault(vehicle, FaultFilters(self.settings.lies))
            filters.exclude(disbelieved)
            believed = sorted(set(ranged) - set(disbelieved))[:_MOST_PEERS]
            if believed and at_s > filters.at_s:
                filters.take({peer: self._line(ranged[peer]) for peer in believed}, at_s)
        self._lines = {}
        self._filters = {v: filters for v, filters in self._filters.items() if at_s - filters.at_s <= _FORGOTTEN_S}

    def forget(self, vehicle: int) -> None:
        """A vehicle is placed otherwise than before: what was held of it is nothing to go by."""
        self._filters.pop(vehicle, None)
        self._lines.pop(vehicle, None)

    def doubt_m2(self, now_s: float) -> Mapping[int, FloatArray]:
        """Return for each vehicle the second moment (2, 2) of how far lies that count may have moved it."""
        doubt_m2 = {}
        for vehicle, filters in self._telling():
            sum_ee = sum_en = sum_nn = 0.0
            for h in filters.hypotheses(now_s):
                counts, (ee, en, nn) = min(h.chance / self.settings.counts_at, 1.0), h.moved_m2
                sum_ee, sum_en, sum_nn = sum_ee + counts * ee, sum_en + counts * en, sum_nn + counts * nn
            doubt_m2[vehicle] = np.array([[sum_ee, sum_en], [sum_en, sum_nn]])
        return doubt_m2

    def suspects(self) -> frozenset[int]:
        """Return those of whom one lies, as far as can be told. None where a vehicle's own device is the likeliest to be off."""
        s, out = self.settings, set[int]()
        for _, filters in self._telling():
            chances = filters.chances()
            if sum(chance for _, chance in chances) < 1.0 - s.honest:
                continue
            left = 1.0
            for liar, chance in sorted(chances, key=lambda each: -each[1]):
                if left < s.left_out or (liar is None and left == 1.0):
                    break
                left -= chance
                out |= {liar} if liar is not None else set()
        return frozenset(out)

    def _telling(self) -> Iterable[tuple[int, FaultFilters]]:
        least = self.settings.least_peers
        return ((vehicle, filters) for vehicle, filters in self._filters.items() if len(filters.peers) >= least)

    def _line(self, r: _Ranges) -> Line:
        e, n, u = r.apart_m
        distance_m = hypot(e, n, u)
        level, up = hypot(e, n) / distance_m, abs(u) / distance_m
        count = len(r.residuals_m)
        shared = self.settings.slow_share * (1.0 - 1.0 / count)
        noise_m = median(r.sigmas_m) * sqrt(1.0 / count + shared)
        claim_m = hypot(r.claim.sigma_h_m * level, r.claim.sigma_v_m * up, r.own_sigma_v_m * up, self.settings.range_bias_m)
        return Line(median(r.residuals_m), noise_m, claim_m, (e / distance_m, n / distance_m))
