"""The residual log: what the estimator made of the ranges of late, and devices that are off."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from math import hypot

from gcs_coloc.core.measurements import Residual

CONSISTENT_MEDIAN_NIS = 3.0
"""Up to this median NIS ranges agree with an estimate. It is 0.45 where the covariance is true (the median of chi-square with one
degree of freedom) and below 0.9 in all simulated flights; beyond it half of the ranges are off by more than 1.7 sigma.
"""
_KEPT_S = 5.0  # chosen: 25 ranges of a pair at 5 Hz, so that the median follows within seconds
_MOST = 4000  # chosen: bounds the cost; 160 pairs at 5 Hz
_LEAST_RANGES = 12  # chosen: by chance the median of as many is below 1.4 in 97.5 %, well below `CONSISTENT_MEDIAN_NIS`
_JUMP_REMEMBERED_S = 1.0  # chosen: several rounds of ranges; what keeps jumping is found anew in each
_JUMP_HEARD_S = 2.0  # chosen: a peer that is ranged at 1 Hz and lost once still counts
_JUMP_PEERS = 2  # one range that is off may as well be the peer's fault
_JUMP_RANGES = 3  # chosen: multipath makes two in a row long by chance, three by one length hardly ever
_JUMP_ALIKE_SIGMAS = 4.0  # chosen: the difference of two ranges is within it in all but one of 16,000
_JUMP_KEPT = 64  # chosen: bounds the cost; eight rounds of eight peers


@dataclass(frozen=True, slots=True)
class Consistency:
    """Whether the innovations of a vehicle's ranges have the size that the estimator states.

    Ranges of the vehicle and ranges to it count. `nis_median` is the median of their normalised innovation squared (NIS) over
    the last seconds, refused ones included. `band_low` and `band_high` are the 95 % band of that median for independent
    innovations. Of `ranges` in all, `refused` were not used.
    """

    nis_median: float
    band_low: float
    band_high: float
    ranges: int
    refused: int


@dataclass(frozen=True, slots=True)
class RangeSnapshot:
    """The newest range as the estimator saw it; `refused` says in words why it was not used.

    `to_sysid` is the other vehicle, or the node id (negative) of a station.
    """

    from_sysid: int
    to_sysid: int
    age_s: float
    innovation_m: float
    sigma_m: float
    nis: float
    refused: str | None


class ResidualLog:
    """The residuals of ranges measured in the last 5 s, at most 4000; those of fixes are left out."""

    def __init__(self) -> None:
        self._recent: deque[Residual] = deque()
        self._newest: dict[tuple[int, int], Residual] = {}
        self._nis: dict[int, list[float]] = {}  # of each vehicle, ascending
        self._refused: Counter[int] = Counter()
        self._consistency: dict[int, Consistency] = {}  # of those vehicles of which nothing has come or gone since

    def add(self, residuals: Iterable[Residual], now_s: float) -> None:
        """Add what the estimator has handed out, and forget what is too old."""
        recent, newest = self._recent, self._newest
        for r in residuals:
            if r.to_vehicle is None:
                continue
            if len(recent) == _MOST:
                self._drop(recent.popleft())
            recent.append(r)
            self._add(r)
            pair = (r.from_vehicle, r.to_vehicle)
            if pair not in newest or r.measured_at_s >= newest[pair].measured_at_s:
                newest[pair] = r
        while recent and now_s - recent[0].measured_at_s > _KEPT_S:
            self._drop(recent.popleft())
        for pair in [pair for pair, r in newest.items() if now_s - r.measured_at_s > _KEPT_S]:
            del newest[pair]

    def ranges(self, now_s: float) -> tuple[RangeSnapshot, ...]:
        """Return the newest residual of each pair, in the order of the pairs."""
        return tuple(
            RangeSnapshot(a, b, now_s - r.measured_at_s, r.innovation_m, r.sigma_m, r.nis, r.refused)
            for (a, b), r in sorted(self._newest.items(), key=lambda newest: newest[0])
        )

    def consistency(self) -> Mapping[int, Consistency]:
        """Return the consistency of each vehicle at an end of a range.

        It is valid until the next `add`.

        Refused ranges count: without them every filter would look consistent. A few ranges that multipath made too long hardly
        show in the median, while they would dominate the mean. Where half of the ranges contradict the position the median shows
        it.
        """
        found = self._consistency
        for end in self._nis.keys() - found.keys():
            nis = self._nis[end]
            found[end] = Consistency(_median(nis), *_band_95(len(nis)), len(nis), self._refused[end])
        return found

    def median_nis(self, excess_m2: Mapping[tuple[int, int], float]) -> dict[int, float]:
        """Return the median NIS of each vehicle that has enough ranges for it.

        It is 0.45 for a consistent filter.

        `excess_m2`: the variance of noise found in the ranges of each pair, which the estimator does not know but the protection
        level covers.
        """
        if not excess_m2:
            return {vehicle: c.nis_median for vehicle, c in self.consistency().items() if c.ranges >= _LEAST_RANGES}
        nis: dict[int, list[float]] = {}
        for r in self._recent:
            ends = _ends(r)
            for end in ends:
                nis.setdefault(end, []).append(_per_degree(r, excess_m2.get(ends, 0.0)))
        return {vehicle: _median(sorted(each)) for vehicle, each in nis.items() if len(each) >= _LEAST_RANGES}

    def _add(self, r: Residual) -> None:
        nis = _per_degree(r)
        for end in _ends(r):
            insort(self._nis.setdefault(end, []), nis)
            self._refused[end] += r.refused is not None
            self._consistency.pop(end, None)

    def _drop(self, r: Residual) -> None:
        nis = _per_degree(r)
        for end in _ends(r):
            ascending = self._nis[end]
            del ascending[bisect_left(ascending, nis)]
            self._refused[end] -= r.refused is not None
            self._consistency.pop(end, None)
            if not ascending:
                del self._nis[end], self._refused[end]


def _ends(r: Residual) -> tuple[int, int]:
    assert r.to_vehicle is not None
    return r.from_vehicle, r.to_vehicle


def _per_degree(r: Residual, more_m2: float = 0.0) -> float:
    nis = r.nis * r.sigma_m**2 / (r.sigma_m**2 + more_m2) if more_m2 else r.nis
    return nis / r.degrees_of_freedom if r.degrees_of_freedom > 1 else nis


def _median(ascending: list[float]) -> float:
    half = len(ascending) // 2
    return ascending[half] if len(ascending) % 2 else (ascending[half - 1] + ascending[half]) / 2


@lru_cache(maxsize=1024)
def _band_95(count: int) -> tuple[float, float]:
    """Return between what the median of `count` independent NIS lies with 95 %.

    Each NIS is chi-square distributed with one degree of freedom.

    Source: the distribution function at the median of n draws is beta distributed with both parameters (n + 1) / 2. That is
    exact for odd n, and nearly so for even n.
    """
    # Imported here: scipy.special takes a quarter of a second, which a start in flight does not have. Its gamma function gives
    # the chi-square quantile, as scipy.stats takes twice as long.
    from scipy.special import betaincinv, gammaincinv

    half = 0.5 * (count + 1)
    low, high = (2.0 * float(gammaincinv(0.5, float(betaincinv(half, half, p)))) for p in (0.025, 0.975))
    return low, high


@dataclass(slots=True)
class _Device:
    """What the ranges of one vehicle's device have shown.

    `peers`: when each of them was ranged last. `refused`: the ranges that were refused in a row. `jump_m`: by what length all of
    them were off at last, at `jumped_at_s`.
    """

    peers: dict[int, float] = field(default_factory=dict)
    refused: deque[Residual] = field(default_factory=lambda: deque(maxlen=_JUMP_KEPT))
    jump_m: float = 0.0
    jumped_at_s: float = float("-inf")

    def has_jumped(self, newest: Residual) -> bool:
        """Return whether all peers heard of late were refused by one length, up to the newest range."""
        heard = {peer for peer, at_s in self.peers.items() if newest.measured_at_s - at_s <= _JUMP_HEARD_S}
        missing: set[int | None] = set(heard)
        for count, r in enumerate(reversed(self.refused), start=1):
            if abs(r.innovation_m - newest.innovation_m) > _JUMP_ALIKE_SIGMAS * hypot(r.sigma_m, newest.sigma_m):
                return False
            missing -= {r.to_vehicle}
            if not missing and count >= _JUMP_RANGES:
                return len(heard) >= _JUMP_PEERS
        return False


class RangeJumps:
    """Finds devices whose ranges have all come to be off by one length.

    They show in the ranges that the estimator refuses, before it gives in to them.

    Multipath makes single ranges too long, each by a length of its own. When the ranges to every peer are refused one after the
    other, all off by about the same, it is the device, or the clock that it measures by. An estimator whose ranges are refused
    for long must assume that it is wrong itself, and moves to where they point. So its estimate is not to be stated from the
    first such row of ranges on, until it has been seen where it comes to rest.
    """

    def __init__(self) -> None:
        self._devices: defaultdict[int, _Device] = defaultdict(_Device)

    def forget(self, vehicle: int) -> None:
        """Forget a vehicle, as one that measures and as a peer."""
        self._devices.pop(vehicle, None)
        for device in self._devices.values():
            device.peers.pop(vehicle, None)

    def add(self, residuals: Iterable[Residual], now_s: float) -> None:
        """Add what the estimator made of ranges, in the order in which it used them."""
        for r in residuals:
            if r.to_vehicle is None:
                continue
            device = self._devices[r.from_vehicle]
            device.peers[r.to_vehicle] = r.measured_at_s
            if r.refused is None:
                device.refused.clear()
                continue
            device.refused.append(r)
            if device.has_jumped(r):
                device.jump_m, device.jumped_at_s = r.innovation_m, now_s

    def sizes_m(self, now_s: float) -> dict[int, float]:
        """Return by what length all ranges of a vehicle jumped within the last second, m, where they did."""
        return {
            vehicle: device.jump_m
            for vehicle, device in self._devices.items()
            if now_s - device.jumped_at_s <= _JUMP_REMEMBERED_S
        }
