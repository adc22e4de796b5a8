"""TIMESYNC exchanges with one autopilot: the offset of its clock from both directions of the link.

We send our time (ts1), the autopilot sends it back with its own (tc1). The way up and the way down each show the offset
with the opposite sign, plus their own delay. What makes the two delays cancel depends on the link, so two estimates are
kept and the one that scatters less is used: the difference of the least delays up and down (best where delay comes from
queues or has a sharp lower end), and the mean over all exchanges (best where it scatters like noise). Causality bounds
the offset whatever the link does: nothing arrives before it was sent.

Convention: MAVLink's Time Synchronization Protocol v2; ArduPilot and PX4 answer with nanoseconds since boot.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from itertools import chain, islice
from math import exp, hypot, sqrt
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.clocks.sender_clock import Drift
from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.core.reasons import CoreRefusal

_WINDOW_S = 300.0  # chosen: so many exchanges that some hardly waited; a drift over it is measured, and taken out
_MOST_EXCHANGES = 400  # chosen: the window at one request a second, with the quick ones
_MOST_PENDING = 16  # chosen: of one request a second as many, so that an answer long overdue is told as such
_OLDEST_ANSWER_S = 3.0  # chosen: beyond the round trip of a mobile network with a queue; an older one bounds nothing
_PLAUSIBLE_S = 0.5  # chosen: what a message may wait more than the least of the last minute
_QUICK_PERIOD_S = 0.2  # chosen: the least delay of a link is known within seconds
_QUICK_EXCHANGES = 50  # chosen: ten seconds of quick requests
_MOST_RECENT = 10  # chosen: two seconds of quick exchanges
_UNANSWERED = 20  # chosen: four seconds of quick requests
_UNANSWERED_SLOWDOWN = 10.0  # chosen: an autopilot that comes to answer is noticed within ten periods
_ENOUGH = 9  # eight spacings need nine delays
_SPACINGS = 8  # chosen: the mean of fewer spacings scatters by more than a third of itself
_FINEST_S = 0.0005  # chosen: stamps of a millisecond, and the loop of an autopilot that answers between two runs
_STEP_S = 0.1  # chosen: below it a drift and a slow simulation look alike; three metres at airspeed
_RECENT_S = 10.0  # chosen: at the rate a clock may be off, 0.5 s, beyond which causality says little
_MOST_RATE = 0.05  # how much faster or slower a clock may run; chosen: a simulation is 1 to 4 % off the host's clock
_WANDERING_SIGMA = 0.01  # 1-sigma of the rate of such a clock: it changes within seconds, by up to 0.03 on PX4's SIH
_RATE_SIGMA = 0.03  # 1-sigma of such a rate before it is measured
_WANDERING_S = 60.0  # chosen: how long a clock counts as no crystal after it was seen to be none
_WANDERING_KNOWN_S = 5.0  # chosen: in which such a clock goes wrong by up to 0.2 s
_OFF_FOR_S = 10.0  # chosen: a simulation that stood still once does so again
_RATE_EXCHANGES = 5  # by which the rate of such a clock is found; chosen: one second of quick exchanges
_CRYSTAL_OFF_S = 0.002  # stamps in whole milliseconds, and the processing on both sides
_CONTRADICTIONS_TO_BELIEVE = 2  # chosen: a single one may be a forged or damaged answer
_ASYMMETRY = 0.1  # how much the least delays up and down may differ, 1-sigma, as a share of one of them


class Synchronised(NamedTuple):
    """The offset of a sender's clock from the service clock, by TIMESYNC.

    `offset_s` is service clock minus sender's clock at `at_s` (service time), `sigma_s` its 1-sigma. `one_way_delay_s` is the
    link's least delay in one direction: the true offset is within it of the estimate, whatever the link does.
    """

    at_s: float
    offset_s: float
    sigma_s: float
    one_way_delay_s: float
    drift: Drift

    def offset_at_s(self, at_s: float) -> float:
        """Return the offset at another service time, s."""
        return self.offset_s + self.drift.rate * (at_s - self.at_s)

    def sigma_at_s(self, at_s: float) -> float:
        """Return the 1-sigma of the offset at another service time, s."""
        return hypot(self.sigma_s, self.drift.sigma * (at_s - self.at_s))


class _Exchange(NamedTuple):
    at_s: float
    up_s: float
    down_s: float


class Causality(NamedTuple):
    """The bounds of the clock offset that hold whatever the delays of the link are.

    The last exchanges show that the offset (service clock minus sender's clock) is between `low_s` and `high_s` at `at_s`. The
    bounds are widened by the most that a clock's rate is off.
    """

    at_s: float
    low_s: float
    high_s: float

    def is_too_early(self, stamp_s: float, received_at_s: float) -> bool:
        """Return whether a stamp was made after it arrived: the clock was stepped forward."""
        age_s = received_at_s - self.at_s
        return age_s <= _RECENT_S and self.early_s(stamp_s, received_at_s) > _STEP_S + _MOST_RATE * age_s

    def early_s(self, stamp_s: float, received_at_s: float) -> float:
        """Return by how much a stamp was made after it arrived, at least."""
        return stamp_s + self.low_s - received_at_s

    def excludes(self, exchange: _Exchange) -> bool:
        """Return whether an exchange was answered before it was asked, or heard before it was sent."""
        age_s = exchange.at_s - self.at_s
        off_s = _STEP_S + _MOST_RATE * age_s
        return age_s <= _RECENT_S and not (-exchange.up_s <= self.high_s + off_s and exchange.down_s >= self.low_s - off_s)


@dataclass(slots=True)
class RoundTrips:
    """The TIMESYNC exchanges of the last five minutes with one autopilot.

    They show when the next request is due, which answers count, and what the clock's offset is.

    `contradictions`: how many exchanges in a row no delay of the link explains. Such an exchange was answered before it was
    asked, or heard before it was sent. `causality` has the bounds that the last exchanges leave for the offset.

    Exchanges that contradict each other by less than a step show that the clock is no crystal: the clock of a simulation runs
    fast or slow by per cents and stands still at times. Then only the last exchanges count, for the offset and for the rate.
    The estimate is then as uncertain as recent exchanges were off what was expected.
    """

    contradictions: int = 0
    causality: Causality | None = None

    _pending: dict[int, float] = field(default_factory=dict)
    _exchanges: deque[_Exchange] = field(default_factory=lambda: deque(maxlen=_MOST_EXCHANGES))
    _requested_at_s: float = float("-inf")
    _unanswered: int = 0
    _estimate: Synchronised | None = None
    _wandered_at_s: float = float("-inf")
    _off_s: float = 0.0
    _last: deque[_Exchange] = field(default_factory=lambda: deque(maxlen=_RATE_EXCHANGES))

    def request(self, sysid: int, now_s: float, period_s: float) -> int | None:
        """Return our time in ns for a request that is due now: often at first, seldom where nobody answers."""
        if now_s - self._requested_at_s < self._wait_s(period_s, now_s) - 1e-6:
            return None
        self._requested_at_s = now_s
        self._unanswered += 1
        # The system id in the nanoseconds tells the answers of two vehicles apart, and no request is ever 0.
        ts1_ns = round(now_s * 1e9) + sysid
        self._pending[ts1_ns] = now_s
        # A request whose answer would still count is kept however many there are: 31 at the shortest period.
        while len(self._pending) > _MOST_PENDING and now_s - next(iter(self._pending.values())) > _OLDEST_ANSWER_S:
            del self._pending[next(iter(self._pending))]
        return ts1_ns

    def add_answer(
        self, ts1_ns: int, stamp_s: float, received_at_s: float, differences_s: tuple[float, float], drift: Drift
    ) -> CoreRefusal | None:
        """Add one answer; return why it is refused, or None where it is used.

        `ts1_ns` is our time as echoed, `stamp_s` the sender's clock. `differences_s` is arrival minus stamp of the sender's
        one-way stamps: the least of a minute, and the last one. `drift` is that of these stamps.
        """
        requested_at_s = self._pending.pop(ts1_ns, None)
        if requested_at_s is None:
            return CoreRefusal.TIMESYNC_NOT_REQUESTED
        round_trip_s = received_at_s - requested_at_s
        if not 0.0 <= round_trip_s <= _OLDEST_ANSWER_S:
            return CoreRefusal.TIMESYNC_TOO_OLD
        exchange = _Exchange(received_at_s, stamp_s - requested_at_s, received_at_s - stamp_s)
        if self._estimate is not None:
            off_s = abs((exchange.down_s - exchange.up_s) / 2.0 - self._estimate.offset_at_s(received_at_s))
            kept = exp(-(received_at_s - self._estimate.at_s) / _OFF_FOR_S)
            self._off_s = max(off_s, self._off_s * kept)
        if self.causality is not None and self.causality.excludes(exchange):
            self.contradictions += 1
            return CoreRefusal.TIMESYNC_CONTRADICTORY
        self.contradictions = 0
        least_s, last_s = differences_s
        if not least_s - _PLAUSIBLE_S <= received_at_s - stamp_s <= last_s + round_trip_s + _PLAUSIBLE_S:
            return CoreRefusal.TIMESYNC_OFF_BOOT_TIME
        self._unanswered = 0
        self._exchanges.append(exchange)
        self._last.append(exchange)
        while received_at_s - self._exchanges[0].at_s > _WINDOW_S:
            self._exchanges.popleft()
        columns = _columns(self._exchanges)
        agreeing = _agreeing(columns, drift)
        if agreeing < len(self._exchanges):
            self._wandered_at_s = received_at_s
            for _ in range(len(self._exchanges) - agreeing):
                self._exchanges.popleft()
        if self.wanders(received_at_s):
            last = _columns(self._last)
            now = _estimate(last, _rate_of(last))
            self._estimate = now._replace(sigma_s=hypot(now.sigma_s, self._off_s))
        else:
            self._estimate = _estimate(columns, drift)
        self.causality = _causality(self._exchanges)
        return None

    @property
    def stepped(self) -> bool:
        """Whether the sender's clock is seen to have been stepped."""
        return self.contradictions >= _CONTRADICTIONS_TO_BELIEVE

    def estimate(self, now_s: float) -> Synchronised | None:
        """Return the offset; None 5 min after the last exchange, or 5 s where the clock wanders."""
        is_crystal = self._estimate is None or self._estimate.drift.sigma < _WANDERING_SIGMA
        if self._estimate is None or now_s - self._estimate.at_s > (_WINDOW_S if is_crystal else _WANDERING_KNOWN_S):
            return None
        return self._estimate

    def wanders(self, now_s: float) -> bool:
        """Return whether the clock was seen to be no crystal within the last minute."""
        return now_s - self._wandered_at_s <= _WANDERING_S

    def forget(self) -> None:
        """Forget the clock: it was stepped, or is another one."""
        self._pending.clear()
        self._exchanges.clear()
        self._last.clear()
        self._estimate = None
        self.causality = None
        self._unanswered = 0
        self.contradictions = 0

    def _wait_s(self, period_s: float, now_s: float) -> float:
        if self._unanswered >= _UNANSWERED:
            return _UNANSWERED_SLOWDOWN * period_s
        is_quick = self.wanders(now_s) or self.contradictions > 0 or len(self._exchanges) < _QUICK_EXCHANGES
        return min(_QUICK_PERIOD_S, period_s) if is_quick else period_s


def _causality(exchanges: deque[_Exchange]) -> Causality:
    at_s = exchanges[-1].at_s
    recent = [exchange for exchange in islice(reversed(exchanges), _MOST_RECENT) if at_s - exchange.at_s <= _RECENT_S]
    low_s = max(-exchange.up_s - _MOST_RATE * (at_s - exchange.at_s) for exchange in recent)
    return Causality(at_s, low_s, min(exchange.down_s + _MOST_RATE * (at_s - exchange.at_s) for exchange in recent))


def _columns(exchanges: deque[_Exchange]) -> FloatArray:
    """Return exchanges as columns (3, N): when, delay up and delay down with the offset in them, s."""
    # Several times as fast as numpy's own way through nested sequences.
    return np.fromiter(chain.from_iterable(exchanges), float, 3 * len(exchanges)).reshape(-1, 3).T


def _agreeing(exchanges: FloatArray, drift: Drift) -> int:
    """Return how many of the newest exchanges leave an offset that none of them excludes."""
    at_s, up_s, down_s = exchanges[:, ::-1]
    age_s = at_s[0] - at_s
    unsure_s = _CRYSTAL_OFF_S + 3.0 * drift.sigma * age_s
    low_s = np.maximum.accumulate(drift.rate * age_s - up_s - unsure_s)
    high_s = np.minimum.accumulate(drift.rate * age_s + down_s + unsure_s)
    return int(np.count_nonzero(low_s <= high_s))


def _rate_of(exchanges: FloatArray) -> Drift:
    """Return the rate of a clock that is no crystal, by its last exchanges (3, N).

    It is the slope of the middles of these exchanges, weighed against the usual rates of such clocks.
    """
    at_s, up_s, down_s = exchanges
    at_s, middle_s = at_s - at_s.mean(), (down_s - up_s) / 2.0
    noise2 = float(np.mean((up_s + down_s) ** 2)) / 12.0 + _FINEST_S**2  # uniform between what causality leaves
    precision = float(at_s @ at_s) / noise2 + _RATE_SIGMA**-2
    rate = float(at_s @ (middle_s - middle_s.mean())) / noise2 / precision
    return Drift(min(max(rate, -_MOST_RATE), _MOST_RATE), max(precision**-0.5, _WANDERING_SIGMA))


def _estimate(exchanges: FloatArray, drift: Drift) -> Synchronised:
    at_s, up_s, down_s = exchanges
    now_s = float(at_s[-1])
    aged_s = drift.rate * (now_s - at_s)
    up_s, down_s = up_s - aged_s, down_s + aged_s
    each_s = (down_s - up_s) / 2
    up_s, down_s = np.sort(up_s), np.sort(down_s)
    least_up_s, least_down_s = float(up_s[0]), float(down_s[0])
    offset_s, one_way_s = (least_down_s - least_up_s) / 2, max((least_down_s + least_up_s) / 2, 0.0)
    n = len(at_s)
    if n < _ENOUGH:
        # Nothing is known but causality: uniform between its bounds.
        return Synchronised(now_s, offset_s, max(one_way_s / sqrt(3.0), _FINEST_S), one_way_s, drift)
    # The least of n delays exceeds the end of their distribution by about as much as the next ones are apart.
    sigma_s = hypot(up_s[_SPACINGS] - up_s[0], down_s[_SPACINGS] - down_s[0]) / _SPACINGS / 2
    mean_s, mean_sigma_s = float(each_s.mean()), float(each_s.std(ddof=1)) / sqrt(n)
    if mean_sigma_s < sigma_s:
        # Where the two contradict each other, queues in one direction have shifted the mean.
        contradiction_s = max(abs(mean_s - offset_s) - 3.0 * hypot(sigma_s, mean_sigma_s), 0.0)
        offset_s, sigma_s = min(max(mean_s, -least_up_s), least_down_s), hypot(mean_sigma_s, contradiction_s)
    drifted_s = drift.sigma * (now_s - float(at_s.mean()))
    return Synchronised(now_s, offset_s, max(hypot(sigma_s, _ASYMMETRY * one_way_s, drifted_s), _FINEST_S), one_way_s, drift)
