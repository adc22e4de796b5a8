"""A sender's clock mapped to the service's clock from one-way stamps.

The smallest difference between arrival and stamp over the last minute belongs to the message that waited least: offset
plus the link's least delay. Latency that varies from message to message therefore drops out; a constant part of it stays,
and is taken out by what `timesync` measures or by what the settings assume.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

_BUCKET_S = 10.0  # chosen: 100 messages at 10 Hz, of which one hardly waited
_BUCKETS = 30  # chosen: five minutes
_LEAST_OVER_S = 60.0  # chosen: a crystal drifts by a millisecond in it
JUMP_S = 2.0  # chosen: beyond what a radio keeps a message, below the time of a reboot
_LEAST_JUMP_S = 0.5  # chosen: queues that are let out reach it; below it nothing is told from waiting
_BEYOND_OVERTAKING = 1.5  # chosen: the most of a minute is not the most that there is
_OVERTAKING_KNOWN_S = 10.0  # chosen: one bucket; of less the most is not known
JUMPS_TO_BELIEVE = 3  # chosen: two may be damaged or forged alike, and a third is 0.3 s later at 10 Hz
_BUCKETS_FOR_DRIFT = 4  # chosen: a line through them leaves two to judge its noise by
_SLOT_S = 0.1  # chosen: ranges to all peers of one round come together and wait alike
_SLOTS = 12  # chosen: all of them wait longer than the mean once in 160,000, and at 5 Hz they are heard within 2.4 s
_MOST_DRIFT = 0.1  # a simulation may run slow by a per cent; a stamp that lags more is no clock that runs
CRYSTAL_DRIFT = 20e-6
"""1-sigma of an ordinary crystal: what is known before it was measured."""
_WRAP_S = 2**32 / 1e3  # time_boot_ms is a uint32_t of milliseconds


class Drift(NamedTuple):
    """How fast arrival minus stamp grows, seconds per second, with its 1-sigma."""

    rate: float
    sigma: float


def _unmeasured() -> Drift:
    return Drift(0.0, CRYSTAL_DRIFT)


@dataclass(slots=True)
class _Bucket:
    started_s: float
    least_at_s: float
    least_s: float
    overtaken_s: float = 0.0
    sum_s: float = 0.0
    count: int = 0


@dataclass(slots=True)
class SenderClock:
    """One clock of one sender, learnt from the stamps of its messages.

    A stamp that jumps is refused until two more agree with it. A stamp jumps if it is more than 2 s ahead of what the least
    delay allows. It also jumps if it is further behind the newest stamp than messages overtake each other on this link: 1.5
    times the most of the last minute, but at least 0.5 s and at most 2 s. (What waits in a queue comes late, but in order.)
    After one such jump, a stamp that is behind the newest one, and later by that much than the least delay, is another jump.

    Three jumps that agree with each other, with no newer stamp of the old clock in between, are a new clock (a reboot): the old
    one is forgotten. A step of 2^32 ms is no jump: boot times of 32 bits wrap after 49.7 days. After five minutes of silence
    the clock begins anew, too.

    `began_at_s` is the service time at which the clock last began anew, `resets` is how often it did because of a jump.
    `newest_stamp_s` is the newest stamp. `last_difference_s` is arrival minus stamp of the message that came last.
    """

    resets: int = 0
    began_at_s: float = float("-inf")
    newest_stamp_s: float = float("-inf")
    last_difference_s: float = 0.0
    drift: Drift = field(default_factory=_unmeasured)
    _buckets: deque[_Bucket] = field(default_factory=lambda: deque(maxlen=_BUCKETS))
    # What `least_difference_s` and `mean_wait_s` answer until a bucket begins, ends, has a lesser least or twice as many stamps.
    _least_s: float | None = None
    _wait_s: float | None = None
    _jumps: list[float] = field(default_factory=list)
    # When a slot began, and the least difference in it.
    _slots: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=_SLOTS))

    @property
    def known(self) -> bool:
        """Whether any stamp was taken."""
        return bool(self._buckets)

    def learn(self, stamp_s: float, received_at_s: float) -> bool:
        """Learn from one stamp (s); return False where it jumps and must not be used."""
        while self._buckets and received_at_s - self._buckets[0].started_s > _BUCKETS * _BUCKET_S:
            self._buckets.popleft()
            self._least_s = self._wait_s = None
        stamp_s = self.unwrapped(stamp_s)
        difference_s = received_at_s - stamp_s
        if self._buckets and (jump_s := self._jumped(stamp_s, difference_s, received_at_s)) is not None:
            self._jumps = [j for j in self._jumps if abs(j - difference_s) < jump_s]
            self._jumps.append(difference_s)
            if len(self._jumps) < JUMPS_TO_BELIEVE:
                return False
            self.begin_anew()
        if not self._buckets:
            self.began_at_s, self.drift, self.newest_stamp_s = received_at_s, _unmeasured(), float("-inf")
        behind_s = self.newest_stamp_s - stamp_s
        if behind_s < 0.0:
            self.newest_stamp_s = stamp_s
            self._jumps.clear()
        if not self._buckets or received_at_s - self._buckets[-1].started_s >= _BUCKET_S:
            self._learn_drift()
            self._buckets.append(_Bucket(received_at_s, received_at_s, difference_s))
            self._least_s = self._wait_s = None
        elif difference_s < self._buckets[-1].least_s:
            self._buckets[-1].least_at_s, self._buckets[-1].least_s = received_at_s, difference_s
            self._least_s = self._wait_s = None
        self.last_difference_s = difference_s
        self._add_to_slot(difference_s, received_at_s)
        newest = self._buckets[-1]
        newest.sum_s += difference_s
        newest.count += 1
        if newest.count.bit_count() == 1:
            # Twice as many as when the mean wait was last computed.
            self._wait_s = None
        if behind_s > newest.overtaken_s:
            newest.overtaken_s = behind_s
        return True

    def begin_anew(self, *, is_reset: bool = True) -> None:
        """Forget the clock: the next stamp begins a new one. `is_reset`: it counts as a reboot."""
        self.resets += is_reset
        self._buckets.clear()
        self._slots.clear()
        self._least_s = self._wait_s = None

    def unwrapped(self, stamp_s: float) -> float:
        """Return a stamp (s) corrected for the wrap of 32 bits of ms, where it then fits the clock so far."""
        if not self._buckets:
            return stamp_s
        expected_s = self.newest_stamp_s
        turned_s = stamp_s + round((expected_s - stamp_s) / _WRAP_S) * _WRAP_S
        silence_s = _BUCKETS * _BUCKET_S
        return turned_s if -JUMP_S <= turned_s - expected_s <= silence_s else stamp_s

    def least_difference_s(self) -> float:
        """Return service clock minus sender's clock plus the link's least delay, in s.

        It is that of the newest stamps. Only valid while the clock is known.
        """
        if self._least_s is None:
            newest = self._buckets[-1]
            self._least_s = min(
                bucket.least_s + self.drift.rate * (newest.least_at_s - bucket.least_at_s)
                for bucket in self._buckets
                if newest.started_s - bucket.started_s <= _LEAST_OVER_S
            )
        return self._least_s

    def mean_wait_s(self) -> float:
        """Return how much longer than the least delay messages wait on average, in s.

        The least delay is that of each ten seconds, the average that of a minute. Only valid while the clock is known.
        """
        if self._wait_s is None:
            last_s = self._buckets[-1].started_s
            of_late = [bucket for bucket in self._buckets if last_s - bucket.started_s <= _LEAST_OVER_S]
            drifted_s = abs(self.drift.rate) * _BUCKET_S / 2.0
            waited_s = sum(max(b.sum_s - b.count * (b.least_s + drifted_s), 0.0) for b in of_late)
            self._wait_s = waited_s / sum(b.count for b in of_late)
        return self._wait_s

    def held_back_s(self) -> float:
        """Return how much longer than the least delay even the quickest new message seems to wait, in s.

        Either all of the newest messages wait in a queue, or the clock was set back by as much. It is 0 where that may be chance,
        and until enough messages came. Only valid while the clock is known.
        """
        if len(self._slots) < _SLOTS:
            return 0.0
        held_s = min(least_s for _, least_s in self._slots) - self.least_difference_s()
        return held_s if held_s > self.mean_wait_s() else 0.0

    def to_service(self, stamp_s: float) -> float:
        """Return the service time of a learnt stamp, too late by the link's least delay; both in s."""
        return self.unwrapped(stamp_s) + self.least_difference_s()

    def _add_to_slot(self, difference_s: float, received_at_s: float) -> None:
        if self._slots and received_at_s - self._slots[-1][0] < _SLOT_S:
            began_s, least_s = self._slots[-1]
            self._slots[-1] = began_s, min(least_s, difference_s)
        else:
            self._slots.append((received_at_s, difference_s))

    def _jumped(self, stamp_s: float, difference_s: float, received_at_s: float) -> float | None:
        """Return the limit in s that makes a stamp a jump; None where it is no jump."""
        if difference_s < self.least_difference_s() - JUMP_S:
            return JUMP_S
        off_s = self.newest_stamp_s - stamp_s
        if self._jumps and off_s > 0.0:
            off_s = max(off_s, difference_s - self.least_difference_s())
        if off_s <= _LEAST_JUMP_S:
            return None
        jump_s = self._overtaking_s(received_at_s)
        return jump_s if off_s > jump_s else None

    def _overtaking_s(self, received_at_s: float) -> float:
        """Return how far behind a newer message one may come, s."""
        if received_at_s - self.began_at_s < _OVERTAKING_KNOWN_S:
            return JUMP_S
        seen_s = max((b.overtaken_s for b in self._buckets if received_at_s - b.started_s <= _LEAST_OVER_S), default=JUMP_S)
        return min(max(_BEYOND_OVERTAKING * seen_s, _LEAST_JUMP_S), JUMP_S)

    def _learn_drift(self) -> None:
        """Fit a line to the buckets' minima, weighed against what crystals do.

        A stamp that stands still (a sender that leaves it at 0) is not followed: what bears it then grows older and older.
        """
        if len(self._buckets) < _BUCKETS_FOR_DRIFT:
            return
        t = np.array([b.least_at_s for b in self._buckets])
        d = np.array([b.least_s for b in self._buckets])
        t, d = t - t.mean(), d - d.mean()
        spread = float(t @ t)
        slope = float(t @ d) / spread
        if abs(slope) > _MOST_DRIFT:
            self.drift = _unmeasured()
            return
        noise2 = float(np.sum((d - slope * t) ** 2)) / (len(t) - 2) + 1e-8  # stamps of whole milliseconds
        precision = spread / noise2 + CRYSTAL_DRIFT**-2
        self.drift = Drift(slope * (spread / noise2) / precision, precision**-0.5)
