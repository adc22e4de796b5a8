"""What the estimator made of the ranges of late: the newest residual of each pair, and each vehicle's consistency."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable
from functools import lru_cache
from statistics import median

from scipy.special import gammaincinv

from gcs_coloc.core.measurements import Residual
from gcs_coloc.core.view import Consistency, RangeView

_KEPT_S = 5.0
_MOST = 4000
_LEAST_FOR_MISFIT = 12


class ResidualLog:
    """The residuals measured in the last 5 s, at most 4000 of them. Fixes (residuals without a peer) are left out."""

    def __init__(self) -> None:
        self._recent: deque[Residual] = deque(maxlen=_MOST)

    def take(self, residuals: Iterable[Residual], now_s: float) -> None:
        """Add what the estimator has handed out, and forget what is too old."""
        self._recent.extend(r for r in residuals if r.to_vehicle is not None)
        while self._recent and now_s - self._recent[0].measured_at_s > _KEPT_S:
            self._recent.popleft()

    def ranges(self, now_s: float) -> tuple[RangeView, ...]:
        """The newest residual of each pair, in the order of the pairs."""
        newest: dict[tuple[int, int], Residual] = {}
        for r in self._recent:
            assert r.to_vehicle is not None
            pair = (r.from_vehicle, r.to_vehicle)
            if pair not in newest or r.measured_at_s >= newest[pair].measured_at_s:
                newest[pair] = r
        return tuple(
            RangeView(a, b, now_s - r.measured_at_s, r.innovation_m, r.sigma_m, r.nis, r.refused)
            for (a, b), r in sorted(newest.items())
        )

    def consistency(self) -> dict[int, Consistency]:
        """For each vehicle that measured ranges: its mean NIS per degree of freedom, refused ranges included, and the band.

        Refused ranges count: leaving them out would make every filter look consistent.
        """
        sums: dict[int, tuple[float, int]] = {}
        for r in self._recent:
            nis, degrees = sums.get(r.from_vehicle, (0.0, 0))
            sums[r.from_vehicle] = (nis + r.nis, degrees + r.degrees_of_freedom)
        out = {}
        for vehicle, (nis, degrees) in sums.items():
            if degrees > 0:
                low, high = _band_95(degrees)
                out[vehicle] = Consistency(nis / degrees, low, high, degrees)
        return out

    def misfit(self) -> dict[int, float]:
        """For each vehicle with enough ranges, its own and those to it: the median NIS per degree of freedom, refused ones
        included.

        It is 0.45 for a consistent filter, and outliers hardly change it.
        """
        found: defaultdict[int, list[float]] = defaultdict(list)
        for r in self._recent:
            assert r.to_vehicle is not None
            nis = r.nis / r.degrees_of_freedom if r.degrees_of_freedom > 1 else r.nis
            found[r.from_vehicle].append(nis)
            found[r.to_vehicle].append(nis)
        return {vehicle: median(nis) for vehicle, nis in found.items() if len(nis) >= _LEAST_FOR_MISFIT}


@lru_cache(maxsize=1024)
def _band_95(degrees: int) -> tuple[float, float]:
    """Where the mean of a consistent filter's NIS per degree of freedom lies with 95 %."""
    # The chi-square quantile through the inverse incomplete gamma function: scipy.stats takes half a second to import.
    low, high = (2.0 * float(gammaincinv(0.5 * degrees, p)) for p in (0.025, 0.975))
    return low / degrees, high / degrees
