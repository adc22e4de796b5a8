"""The clocks of one vehicle, mapped to the service's clock with a 1-sigma.

They are the boot clock of its autopilot, and the clocks of its ranging devices.

Where TIMESYNC is answered, the round trips give the boot clock's offset. Where it is not, the least delay of the one-way stamps
bounds the offset, and the link's least delay is subtracted. The settings give that delay, or the vehicle's UTC (from GPS) shows
it against the host's. Where nothing shows it, it may be several times what messages wait beyond it.

A ranging device or companion computer may have booted apart from the autopilot, and does not answer TIMESYNC, but its stamps
come over the same link. Where they agree with the boot clock they are stamps of that clock. Otherwise the link's least delay,
once known, is subtracted from their own least difference. A device whose stamps all come later than they used to, while those of
the boot clock do not, waits in a queue of its own, or its clock was set back: what lies between the two is its uncertainty.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import hypot
from typing import NamedTuple

from gcs_coloc.core.clocks.sender_clock import CRYSTAL_DRIFT, JUMP_S, JUMPS_TO_BELIEVE, SenderClock
from gcs_coloc.core.clocks.timesync import RoundTrips, Synchronised
from gcs_coloc.core.reasons import CoreRefusal
from gcs_coloc.core.setting_bounds import between, check_bounds, positive

ONE_WAY = "one-way"
"""How a clock is known that neither TIMESYNC nor UTC shows: by the least delay of its stamps."""

_SAME_CLOCK_S = 0.05  # chosen: what the least delays of two streams of one sender differ by
_SAME_UNEVEN_CLOCK_S = 0.5  # chosen: what one of two messages waits more than the other
_ONE_WAY_SIGMA_S = 0.005  # how far the least of a minute's one-way delays may be from the link's least
_WAITS = 4.0  # a link's least delay, 1-sigma, in mean waits beyond it: radios have about one, mobile networks two to eight
_MOST_UNKNOWN_S = 0.25  # chosen: half a second of unknown delay is two sigmas; a link that waits longer shows it
# An autopilot's UTC is that of a fix when it came in: behind by the receiver's computing and its serial line, and since then by
# its own crystal, as it is not set anew while armed. 0.19 s on ArduPlane 4.7 with a simulated receiver.
_UTC_BEHIND_S, _UTC_SIGMA_S = 0.15, 0.08
_MOST_BY_UTC_S = 0.9  # beyond, another cause is likelier, such as a leap second that one of the two does not know

# Duplicate system ids
_APART_S = 10.0  # nearer, one sender's frames that waited somewhere would do for a second clock
_SAME_S = 2.0  # chosen: as a jump of one clock (`JUMP_S`)
_FOLLOWS = 0.01  # crystals drift; what was delayed must not draw the clock along
_TURNS = 6  # chosen: two senders take turns in every message, waiting frames once or twice
_TURN_S = 1.0  # what waited and is let out among fresh frames has left its place by the next
_TURNS_WITHIN_S = 20.0  # chosen: six turns of messages at 1 Hz, some of them lost
_HELD_S = 10.0  # chosen: ten messages at 1 Hz without a turn


@dataclass(frozen=True, slots=True)
class TimeSettings:
    """How the vehicles' clocks are found."""

    timesync_period_s: float = between(1.0, 0.1, 60.0)
    """An autopilot is asked for its time (TIMESYNC) this often: quicker for its first 50 answers, ten times slower after
    20 requests without one."""
    min_delay_s: float = between(0.0, 0.0)
    """Least one-way delay from a vehicle that does not answer TIMESYNC. 0: unknown, estimated for each link."""
    min_delay_sigma_s: float = positive(0.05)
    """1-sigma of that delay, and the smallest where it is unknown. Times its speed it adds to a measurement's noise."""
    require_synchronised_clock: bool = False
    """No aiding while the host's own clock is not known to be synchronised (NTP, PTP, GPS). Each change is logged once."""

    def __post_init__(self) -> None:
        check_bounds(self)


class ServiceTime(NamedTuple):
    """A stamp on the service's clock with its 1-sigma, both in seconds."""

    at_s: float
    sigma_s: float


class OneWay(NamedTuple):
    """The least one-way delay of a link, as it is assumed without TIMESYNC.

    `method` says how it is known, in a word. The delay is in s, with its 1-sigma.
    """

    method: str
    delay_s: float
    sigma_s: float


@dataclass(slots=True)
class DuplicateIdDetector:
    """The detector of two autopilots that use one system id, by their boot times.

    A reboot changes the clock once; two clocks take turns. Behind one address (a radio for several, a router) nothing else
    tells them apart, and what is sent to one reaches both. Two that booted less than 10 s apart are not told apart.
    """

    _differences_s: list[float] = field(default_factory=list)
    _newest: int = 0
    _turns_s: deque[float] = field(default_factory=lambda: deque(maxlen=_TURNS))

    def add(self, stamp_s: float, received_at_s: float) -> None:
        """Add one boot time (s) and the service time at which it arrived."""
        difference_s = received_at_s - stamp_s
        clocks = self._differences_s
        for number, clock_s in enumerate(clocks):
            if abs(difference_s - clock_s) > _SAME_S:
                continue
            clocks[number] += _FOLLOWS * (difference_s - clock_s)
            if number != self._newest:
                self._newest = number
                is_next = not self._turns_s or received_at_s - self._turns_s[-1] >= _TURN_S
                if is_next and abs(clocks[0] - clocks[1]) >= _APART_S:
                    self._turns_s.append(received_at_s)
            return
        if len(clocks) < 2:
            clocks.append(difference_s)
            self._newest = len(clocks) - 1
        else:
            self._newest = 1 - self._newest
            clocks[self._newest] = difference_s
        self._turns_s.clear()

    def detected(self, now_s: float) -> bool:
        """Return whether two clocks took turns six times within 20 s, a second apart, the last within 10 s."""
        turns_s = self._turns_s
        return len(turns_s) == _TURNS and turns_s[-1] - turns_s[0] <= _TURNS_WITHIN_S and now_s - turns_s[-1] <= _HELD_S


@dataclass(slots=True)
class VehicleClock:
    """The boot clock of one autopilot, from its one-way stamps and from TIMESYNC."""

    settings: TimeSettings = field(default_factory=TimeSettings)
    stamps: SenderClock = field(default_factory=SenderClock)
    round_trips: RoundTrips = field(default_factory=RoundTrips)
    duplicates: DuplicateIdDetector = field(default_factory=DuplicateIdDetector)
    _by_utc: OneWay | None = None
    _too_early: int = 0

    @property
    def resets(self) -> int:
        """How often the clock was begun anew: the reboots."""
        return self.stamps.resets

    def learn(self, stamp_s: float, received_at_s: float) -> bool:
        """Learn from one stamp (s); return False where it jumps and must not be used."""
        self.duplicates.add(stamp_s, received_at_s)
        causality = self.round_trips.causality
        # A stamp that has wrapped is far behind, so that this needs no unwrapping.
        if causality is not None and causality.is_too_early(stamp_s, received_at_s):
            self._too_early += 1
            if self._too_early < JUMPS_TO_BELIEVE:
                return False
            self._begin_anew(is_reboot=causality.early_s(stamp_s, received_at_s) >= JUMP_S)
        self._too_early = 0
        known, began_at_s = self.stamps.known, self.stamps.began_at_s
        taken = self.stamps.learn(stamp_s, received_at_s)
        if self.stamps.began_at_s != began_at_s:
            self._by_utc = None
            if known:
                self.round_trips.forget()
        return taken

    def add_answer(self, ts1_ns: int, tc1_s: float, received_at_s: float) -> CoreRefusal | None:
        """Add an answer to TIMESYNC; return why it is refused, or None where it is used."""
        if not self.stamps.known:
            return CoreRefusal.TIMESYNC_BEFORE_BOOT_TIME
        differences_s = self.stamps.least_difference_s(), self.stamps.last_difference_s
        stamp_s = self.stamps.unwrapped(tc1_s)
        refusal = self.round_trips.add_answer(ts1_ns, stamp_s, received_at_s, differences_s, self.stamps.drift)
        if self.round_trips.stepped:
            # A reboot sets the clock back; a simulation that stood still for a while goes on where it was.
            self._begin_anew(is_reboot=stamp_s < self.stamps.newest_stamp_s - _SAME_CLOCK_S)
        return refusal

    def add_utc(self, unix_s: float, boot_s: float, utc_minus_service_s: float) -> None:
        """Add the UTC that a vehicle has from a healthy GPS, at its boot time.

        `utc_minus_service_s` is that of the host, whose UTC is known to be right. Only valid after `learn` has accepted the
        boot time. Source: SYSTEM_TIME (2).
        """
        behind_s = self.stamps.to_service(boot_s) + utc_minus_service_s - unix_s
        sigma_s = hypot(_UTC_SIGMA_S, CRYSTAL_DRIFT * boot_s)
        is_plausible = -3.0 * sigma_s <= behind_s - _UTC_BEHIND_S <= _MOST_BY_UTC_S
        self._by_utc = OneWay("UTC", max(behind_s - _UTC_BEHIND_S, 0.0), sigma_s) if is_plausible else None

    def one_way(self) -> OneWay:
        """Return the least delay of the link that is assumed where TIMESYNC is not answered."""
        if self.settings.min_delay_s > 0.0:
            return OneWay(ONE_WAY, self.settings.min_delay_s, self.settings.min_delay_sigma_s)
        if self._by_utc is not None:
            return self._by_utc
        least_s = self.settings.min_delay_sigma_s
        sigma_s = hypot(least_s, _WAITS * self.stamps.mean_wait_s()) if self.stamps.known else least_s
        return OneWay(ONE_WAY, 0.0, min(sigma_s, max(_MOST_UNKNOWN_S, least_s)))

    def synchronised(self, now_s: float) -> Synchronised | None:
        """Return the offset by TIMESYNC; None where it is not answered."""
        return self.round_trips.estimate(now_s)

    def quality(self, now_s: float) -> tuple[str, float] | None:
        """Return how the clock is known, in a word, and its 1-sigma in s; None before its first stamp."""
        sync = self.synchronised(now_s)
        if sync is not None:
            return "TIMESYNC", sync.sigma_at_s(now_s)
        if not self.stamps.known:
            return None
        one_way = self.one_way()
        return one_way.method, one_way.sigma_s

    def one_way_delay_s(self, now_s: float) -> float | None:
        """Return the least delay of the link in one direction, s; None where it is not known."""
        sync = self.synchronised(now_s)
        if sync is not None:
            return sync.one_way_delay_s
        return self._by_utc.delay_s if self._by_utc is not None else None

    def to_service(self, stamp_s: float, now_s: float) -> ServiceTime:
        """Return the service time of a stamp of this clock that `learn` has accepted."""
        sync = self.synchronised(now_s)
        if sync is not None:
            return ServiceTime(self.stamps.unwrapped(stamp_s) + sync.offset_at_s(now_s), sync.sigma_at_s(now_s))
        one_way = self.one_way()
        return ServiceTime(self.stamps.to_service(stamp_s) - one_way.delay_s, one_way.sigma_s)

    def from_service(self, at_s: float, now_s: float) -> float | None:
        """Return the inverse of `to_service` near the present, s; None before the first stamp."""
        if not self.stamps.known:
            return None
        newest_s = self.stamps.newest_stamp_s
        return newest_s + at_s - self.to_service(newest_s, now_s).at_s

    def device_to_service(self, device: SenderClock, stamp_s: float, now_s: float) -> ServiceTime:
        """Return the service time of a stamp from which a ranging device's own clock has learnt."""
        sync = self.synchronised(now_s)
        waits_more_s, held_s = 0.0, device.held_back_s()
        if self.stamps.known:
            waits_more_s = max(device.mean_wait_s() - self.stamps.mean_wait_s(), 0.0)
            held_s = max(held_s - self.stamps.held_back_s(), 0.0)
        # What waits longer than the autopilot's messages may have a longer least delay, too.
        unknown_s = hypot(min(_WAITS * waits_more_s, _MOST_UNKNOWN_S), 0.5 * held_s)
        heard_s = device.to_service(stamp_s) + 0.5 * held_s
        if sync is None or not self.stamps.known:
            one_way = self.one_way()
            return ServiceTime(heard_s - one_way.delay_s, hypot(one_way.sigma_s, unknown_s))
        if self.round_trips.wanders(now_s):
            # The least of a minute is out of date there.
            is_same = abs(device.last_difference_s - self.stamps.last_difference_s) < _SAME_UNEVEN_CLOCK_S
            min_delay_s = sync.one_way_delay_s
        else:
            is_alike = abs(device.least_difference_s() - self.stamps.least_difference_s()) < _SAME_CLOCK_S
            is_same = is_alike and held_s < _SAME_CLOCK_S
            min_delay_s = self.stamps.least_difference_s() - sync.offset_at_s(now_s)
        if is_same:
            return self.to_service(stamp_s, now_s)
        sigma_s = hypot(sync.sigma_at_s(now_s), _ONE_WAY_SIGMA_S, unknown_s)
        return ServiceTime(heard_s - min_delay_s, sigma_s)

    def _begin_anew(self, *, is_reboot: bool) -> None:
        self.stamps.begin_anew(is_reset=is_reboot)
        self.round_trips.forget()
        self._by_utc = None
