"""Range checks: ranges that a device only repeats, and ranges that change faster than vehicles move.

The very same range again and again, to the last bit, is no measurement any more. A range is noisy, so how often two in a row are
equal by chance follows from the step in which the device tells it and from its noise: step / (2 sqrt(pi) sigma) for a step that
is small against the noise.

Both are seen in the second differences of its values, which a steady motion does not enter: their spread is the noise, the
smallest one the step. How often it has repeated itself so far is seen as well; the larger of the two chances counts. A device
with steps as coarse as its noise, one without noise and one that tells each value several times repeat themselves in good
health: of these nothing is said.

Source: the chance that two draws of one Gaussian fall into one step, the integral of its squared density times the step.

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
from math import inf, pi, sqrt
from statistics import median
from typing import NamedTuple

_STUCK_CHANCE = 1e-9  # of so many equal values in a row: in a year of ranging at 10 Hz not once
_MOST_LIKELY = 0.5  # chosen: a value that is likelier than not to repeat shows nothing by repeating
_LEAST_CHANGES = 20  # chosen: of fewer changes the chance of a repeat is not known
_QUIETER = 3.0  # in steady flight the noise may be so much less than in the values before, on the move
_KEPT = 32  # chosen: more than the repeats that are beyond chance
_ROUNDING = 1e-6  # of a value: single precision and the difference of three of them
_MEDIAN_PER_SIGMA = 0.6745  # of the magnitude of a Gaussian
_SECOND_DIFFERENCE = sqrt(6.0)  # its sigma over that of the values

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


@dataclass(slots=True)
class RepeatedRange:
    """The ranges of one device to one peer. `stuck`: the newest ones are one value repeated beyond chance."""

    stuck: bool = False
    _values_m: deque[float] = field(default_factory=lambda: deque(maxlen=_KEPT))
    _measured_at_s: float | None = None
    _run: int = 0
    _needed: int | None = None
    _changes: int = 0
    _repeats: int = 0
    _step_m: float = inf

    def add(self, range_m: float, measured_at_s: float | None) -> bool:
        """Add a range (m); return `stuck`. By its device's time a measurement heard twice is no repeat."""
        if measured_at_s is not None and measured_at_s == self._measured_at_s:
            return self.stuck
        self._measured_at_s = measured_at_s
        if not self._values_m or range_m != self._values_m[-1]:
            self._change(range_m)
            return False
        self._run += 1
        if self._needed is None:
            self._needed = self._improbable_run()
        self.stuck = self._needed > 0 and self._run >= self._needed
        return self.stuck

    def _change(self, range_m: float) -> None:
        if not self.stuck:
            # A device that was stuck is judged by what it did before.
            self._repeats += self._run
        if self._values_m:
            self._changes += 1
        self._values_m.append(range_m)
        if len(self._values_m) > 2 and (bend_m := abs(self._bend_m(-1))) > _ROUNDING * range_m:
            self._step_m = min(self._step_m, bend_m)
        self._run, self._needed, self.stuck = 0, None, False

    def _bend_m(self, k: int) -> float:
        """Return the second difference that ends with a value."""
        v = self._values_m
        return v[k] - 2.0 * v[k - 1] + v[k - 2]

    def _improbable_run(self) -> int:
        """Return how many repeats in a row are beyond chance; 0 where no number is."""
        if self._changes < _LEAST_CHANGES:
            return 0
        bends_m = [abs(self._bend_m(k)) for k in range(2, len(self._values_m))]
        noise_m = median(bends_m) / (_MEDIAN_PER_SIGMA * _SECOND_DIFFERENCE)
        by_noise = _QUIETER * self._step_m / (2.0 * sqrt(pi) * noise_m) if noise_m > 0.0 else inf
        chance = max(by_noise, (self._repeats + 1) / (self._repeats + self._changes + 2))
        if chance > _MOST_LIKELY:
            return 0
        run, likely = 0, 1.0
        while likely > _STUCK_CHANCE:
            run, likely = run + 1, likely * chance
        return run


class _Departed(NamedTuple):
    """A range that left the line of its predecessors: its time (s), itself, and by how much (m)."""

    at_s: float
    range_m: float
    departure_m: float


@dataclass(slots=True)
class RangeTrack:
    """The recent ranges of one device to one peer; `excess_m` too long since they jumped."""

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
        """Return whether a range departs as the one before did; half the limit is enough for a second one."""
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


@dataclass(slots=True)
class CheckedPair:
    """The checks of the ranges of one device to one peer."""

    repeats: RepeatedRange = field(default_factory=RepeatedRange)
    track: RangeTrack = field(default_factory=RangeTrack)


class RangeChecks:
    """The checks of the ranges of one vehicle's ranging devices."""

    def __init__(self) -> None:
        self._pairs: dict[tuple[int, int], CheckedPair] = {}

    def of(self, peer: int, device_id: int) -> CheckedPair:
        """Return the checks of a device's ranges to a peer."""
        key = (peer, device_id)
        if key not in self._pairs:
            if len(self._pairs) >= _MOST_PAIRS:
                del self._pairs[next(iter(self._pairs))]
            self._pairs[key] = CheckedPair()
        return self._pairs[key]

    def has_jumped(self, peer: int, device_id: int, at_s: float, range_m: float, sigma_m: float, speed_mps: float) -> bool:
        """Add a range as `RangeTrack.add`; return whether it is not to be used.

        That is where the range is off and other ranges of its device are not.
        """
        return self.of(peer, device_id).track.add(at_s, range_m, sigma_m, speed_mps) and any(
            pair.track.is_steady(at_s) for (_, device), pair in self._pairs.items() if device == device_id
        )
