"""The NLOS detector, which finds ranges that change faster than vehicles move.

Behind a building, a hill or a wing (non-line-of-sight, NLOS) the radio finds a way around: for seconds a range is too long by
metres. The test compares a range with its own predecessors. No position takes part in it, so it hides no fault of a receiver.

A way around is never shorter than the straight line. So a range that jumps down has come back, or the one before was too long. A
step up that lasts is believed after a while: from then on it is a matter for the fault tests. So is, at once, a step that all
ranges of a device make together: then the device is off, and there is no way around.

Source of the prediction: least squares of a line, its variance at the next point.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import inf, sqrt
from typing import NamedTuple

_SAMPLES = 6  # chosen: a second at 5 Hz; over a longer time a turn bends the line
_LEAST_SAMPLES = 4
_WINDOW_S = 1.6  # chosen: ranges at 2.5 Hz; more seldom ones are not judged
_SIGMAS = 4.0  # chosen: of 15 ranges a second one in eighteen minutes is refused in vain
_ACCELERATION_MPS2 = 15.0  # chosen: two planes that turn at 37 degrees, to or from each other
_LEAST_RANGE_M = 1.0  # below it the direction turns at once
_BELIEVED_AFTER_S = 20.0  # chosen: longer than it takes to fly past a building
_NOISE_GAIN = 0.05  # of each range; chosen: four seconds at 5 Hz
_MOST_SQUARE = 9.0  # chosen: one outlier counts as no more than three sigmas
_MOST_PAIRS = 512  # chosen: bounds the memory; 32 vehicles with 16 peers each


class _Departed(NamedTuple):
    """A range that left the line of its predecessors: its time (s), itself, and by how much (m)."""

    at_s: float
    range_m: float
    departure_m: float


@dataclass(slots=True)
class RangeTrack:
    """The recent ranges of one device to one peer.

    `excess_m`: by how much they are too long since they jumped.
    """

    excess_m: float = 0.0
    _samples: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=_SAMPLES))
    _jumped_at_s: float = 0.0
    _noise_m2: float = 0.0
    _departed: _Departed | None = None

    def add(self, at_s: float, range_m: float, sigma_m: float, speed_mps: float) -> bool:
        """Add a range; return whether it is not to be used.

        The time is in s, the range and its 1-sigma in m. `speed_mps` is the relative speed of its ends. A range that is no newer
        than the last one is not judged: it came late, or by a second link.
        """
        samples, departed = self._samples, self._departed
        newest_s = departed.at_s if departed is not None else samples[-1][0] if samples else -inf
        if newest_s - at_s > _WINDOW_S:
            # The device's clock has jumped.
            samples.clear()
            self._departed = None
        elif at_s <= newest_s:
            return self.excess_m > 0.0 or (at_s == newest_s and departed is not None)
        while samples and at_s - samples[0][0] > _WINDOW_S:
            samples.popleft()
        if not samples or at_s - self._jumped_at_s > _BELIEVED_AFTER_S:
            self.excess_m = 0.0
        if len(samples) < _LEAST_SAMPLES:
            samples.append((at_s, range_m))
            self._departed = None
            return self.excess_m > 0.0
        departure_m, spread, bent_s2 = self._prediction(at_s, range_m)
        acceleration_mps2 = _ACCELERATION_MPS2 + speed_mps**2 / max(range_m, _LEAST_RANGE_M)
        noise_m = max(sigma_m, sqrt(self._noise_m2))
        bent_m = acceleration_mps2 * bent_s2
        limit_m = _SIGMAS * noise_m * sqrt(spread) + bent_m
        # One that is too long will come back, and by how much is known: half of that is nearer to back than to still too long.
        needed_m = min(limit_m, 0.5 * self.excess_m) if self.excess_m > 0.0 and departure_m < 0.0 else limit_m
        if (second := self._is_second(at_s, departure_m, needed_m)) or abs(departure_m) > needed_m:
            return self._depart(_Departed(at_s, range_m, departure_m), limit_m, second=second)
        self._departed = None
        # What a turn explains is no noise, or the next jump in a turn is not seen.
        square_m2 = max(departure_m**2 - bent_m**2, 0.0) / spread
        self._noise_m2 += _NOISE_GAIN * (min(square_m2, _MOST_SQUARE * noise_m**2) - self._noise_m2)
        samples.append((at_s, range_m))
        return self.excess_m > 0.0

    def is_steady(self, now_s: float) -> bool:
        """Whether the ranges of late have come, and have not jumped."""
        return (
            self.excess_m == 0.0 and self._departed is None and bool(self._samples) and now_s - self._samples[-1][0] <= _WINDOW_S
        )

    def _prediction(self, at_s: float, range_m: float) -> tuple[float, float, float]:
        """Return how far a range departs from the line of its predecessors, and how exact that line is.

        The values are the departure (m), its variance in units of a range's variance, and the departure that an acceleration
        causes, per acceleration (s^2).
        """
        n = len(self._samples)
        mean_s, mean_m = sum(t for t, _ in self._samples) / n, sum(r for _, r in self._samples) / n
        centred = [(t - mean_s, r - mean_m) for t, r in self._samples]
        squares_s2, cubes_s3 = sum(t * t for t, _ in centred), sum(t * t * t for t, _ in centred)
        ahead_s = at_s - mean_s
        departure_m = range_m - mean_m - ahead_s * sum(t * r for t, r in centred) / squares_s2
        bent_s2 = 0.5 * abs(ahead_s**2 - squares_s2 / n - ahead_s * cubes_s3 / squares_s2)
        return departure_m, 1.0 + 1.0 / n + ahead_s**2 / squares_s2, bent_s2

    def _is_second(self, at_s: float, departure_m: float, needed_m: float) -> bool:
        """Return whether a range departs as the one before it did.

        Half the limit is enough for it, as the first one was beyond chance.
        """
        before = self._departed
        return (
            before is not None
            and at_s - before.at_s <= _WINDOW_S
            and abs(departure_m - before.departure_m) <= max(needed_m, abs(before.departure_m))
            and departure_m * before.departure_m > 0.0
            and abs(departure_m) > 0.5 * needed_m
        )

    def _depart(self, now: _Departed, limit_m: float, *, second: bool) -> bool:
        """Add a range that departs; return whether it is not to be used.

        A single one is an outlier. After two in a row the ranges have jumped: they are too long from then on, or have come back.
        """
        before, self._departed = self._departed, now
        if before is None or not second:
            return True
        jump_m = 0.5 * (now.departure_m + before.departure_m)
        excess_m = self.excess_m + jump_m
        self.excess_m = excess_m if excess_m > 0.5 * limit_m else 0.0
        self._jumped_at_s, self._departed = now.at_s, None
        moved = [(t, r + jump_m) for t, r in self._samples]
        self._samples.extend([*moved, (before.at_s, before.range_m), (now.at_s, now.range_m)])
        return self.excess_m > 0.0


class NlosDetector:
    """Finds the ranges that are too long, or outliers, among those of one vehicle's ranging devices."""

    def __init__(self) -> None:
        self._tracks: dict[tuple[int, int], RangeTrack] = {}

    def add(self, peer: int, device_id: int, at_s: float, range_m: float, sigma_m: float, speed_mps: float) -> bool:
        """Add a range as `RangeTrack.add`; return whether it is not to be used.

        That is where the range is off and other ranges of its device are not.
        """
        key = (peer, device_id)
        track = self._tracks.get(key)
        if track is None:
            if len(self._tracks) >= _MOST_PAIRS:
                del self._tracks[next(iter(self._tracks))]
            track = self._tracks[key] = RangeTrack()
        return track.add(at_s, range_m, sigma_m, speed_mps) and any(
            other.is_steady(at_s) for (_, device), other in self._tracks.items() if device == device_id
        )
