"""The check for repeated ranges, which tell that a ranging device is stuck.

The very same range again and again, to the last bit, is no measurement any more. A range is noisy, so how often two in a row are
equal by chance follows from the step in which the device tells it and from its noise: step / (2 sqrt(pi) sigma) for a step that
is small against the noise.

Both are seen in the second differences of its values, which a steady motion does not enter: their spread is the noise, the
smallest one the step. How often it has repeated itself so far is seen as well; the larger of the two chances counts. A device
with steps as coarse as its noise, one without noise and one that tells each value several times repeat themselves in good
health: of these nothing is said.

Source: the chance that two draws of one Gaussian fall into one step, the integral of its squared density times the step.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import inf, pi, sqrt
from statistics import median

_STUCK_CHANCE = 1e-9  # of so many equal values in a row: in a year of ranging at 10 Hz not once
_MOST_LIKELY = 0.5  # chosen: a value that is likelier than not to repeat shows nothing by repeating
_LEAST_CHANGES = 20  # chosen: of fewer changes the chance of a repeat is not known
_QUIETER = 3.0  # in steady flight the noise may be so much less than in the values before, on the move
_KEPT = 32  # chosen: more than the repeats that are beyond chance
_MOST_PAIRS = 512  # chosen: bounds the memory; 32 vehicles with 16 peers each
_ROUNDING = 1e-6  # of a value: single precision and the difference of three of them
_MEDIAN_PER_SIGMA = 0.6745  # of the magnitude of a Gaussian
_SECOND_DIFFERENCE = sqrt(6.0)  # its sigma over that of the values


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
        """Add a range (m) with the time on the device's own clock, if it has one; return `stuck`.

        The same measurement heard twice is known by its time and is no repeat.
        """
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


class RangeRepeats:
    """The checks of one vehicle's ranging devices for repeated ranges.

    `stuck` has (peer, device id) of those that repeat one value now.
    """

    def __init__(self) -> None:
        self.stuck: set[tuple[int, int]] = set()
        self._checks: dict[tuple[int, int], RepeatedRange] = {}

    def add(self, peer: int, device_id: int, range_m: float, measured_at_s: float | None) -> bool:
        """Add a range as `RepeatedRange.add`; return whether it is one that its device only repeats."""
        key = (peer, device_id)
        check = self._checks.get(key)
        if check is None:
            if len(self._checks) >= _MOST_PAIRS:
                forgotten = next(iter(self._checks))
                del self._checks[forgotten]
                self.stuck.discard(forgotten)
            check = self._checks[key] = RepeatedRange()
        if check.add(range_m, measured_at_s):
            self.stuck.add(key)
            return True
        self.stuck.discard(key)
        return False
