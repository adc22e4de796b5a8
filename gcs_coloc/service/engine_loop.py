"""The loop of one engine: what was received goes in by its time, and outputs come out at deadlines.

Where the host was held up, what waits is received in the order in which it came, in portions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter

from gcs_coloc.core.deadlines import advance, find_overrun
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import (
    HOST_LATE_S,
    ClockReference,
    ForeignGpsInput,
    HoldBack,
    OperatorCommand,
    SwitchedByOther,
)
from gcs_coloc.core.messages.inbound import PeerRange
from gcs_coloc.core.messages.outbound import Outbound
from gcs_coloc.links.base import Clock
from gcs_coloc.recorder.side_channel import SideChannelRecord
from gcs_coloc.runtime.clock import ServiceClock, Timer

_HELD_UP_S = 0.02
"""What is read so long after the engine's time may have waited. Chosen: less than the 0.05 s that 1 m at 20 m/s takes."""
_BEHIND_S = 0.5
"""Chosen: two and a half deadlines at 5 Hz. A position so late, or a sign of life, says what is no longer so."""
_AT_ONCE_S = 0.02
"""Chosen: page, log and the other service of a hot standby wait no longer than a person or a vehicle would notice."""

Control = ClockReference | OperatorCommand | PeerRange | ForeignGpsInput | HoldBack | SwitchedByOther
"""What the engine receives besides the vehicles' frames."""


@dataclass(frozen=True, slots=True)
class LoopHooks:
    """What the loop calls."""

    read_waiting: Callable[[], None]
    """Has the links deliver what waits in them."""
    emit: Callable[[list[Outbound]], None]
    """Takes outputs that are to be sent, or published, now."""
    record: Callable[[SideChannelRecord], None]
    """Takes what the engine received besides frames."""
    record_outputs: Callable[[float, list[Outbound]], None]
    """Takes the outputs of a deadline and its time; called after they were emitted."""
    on_idle: Callable[[], None]
    """Is called when the outputs of a deadline were emitted and the next one is as far off as it gets."""


class EngineLoop:
    """Runs one engine on the service's clock.

    `at_s` is the engine's time, in service time; it never runs back. `host` is the host's time at the start.
    """

    def __init__(self, engine: Engine, clock: ServiceClock, host: ClockReference, hooks: LoopHooks) -> None:
        self.at_s = clock()
        self._engine = engine
        self._clock = clock
        self._host = host
        self._hooks = hooks
        self._lag_s = 0.0  # the worst since the host's last report
        self._backlog = _Backlog()
        self._is_reading = self._is_catching_up = False
        self._held_up_until_s = float("-inf")
        self._unsent: list[Outbound] = []
        self._deadline = Timer(clock, self._poll)

    def add(self, at_s: float, receive: Callable[[], None], *, is_late: bool) -> None:
        """Have `receive` called in its turn for a datagram that arrived at service time `at_s` (s).

        That is mostly at once. `is_late`: the datagram may have waited before it was read.
        """
        has_waited = is_late or at_s - self.at_s > _HELD_UP_S
        if not (has_waited or self._is_reading or self._backlog):
            receive()
            return
        starts = not (self._is_reading or self._backlog)
        self._backlog.add(at_s, receive)
        if starts:
            self._read_waiting()
            self._receive_some()

    def apply(self, message: Control) -> None:
        """Pass a message that is in no frame to the engine, in its turn."""
        if not (self._backlog or self._is_catching_up):
            self._read_waiting()
            self._receive_some()
        if self._backlog or self._is_catching_up:
            self._backlog.add(message.received_at_s, partial(self._receive_control, message))
        else:
            self._receive_control(message)

    def set_host(self, host: ClockReference) -> None:
        """Pass the host's time to the engine, with the worst lag since the last call."""
        self._host, self._lag_s = replace(host, lag_s=round(self._lag_s, 3)), 0.0
        self.apply(self._host)

    def advance_for(self, at_s: float) -> None:
        """Run the deadlines before what arrived at `at_s`, which is the engine's time now."""
        # The timer fires no later than the engine's next deadline, and most datagrams come before that.
        if at_s > self._deadline.at_s or self._is_catching_up:
            self._advance(at_s)
        self.at_s = at_s

    def wake(self) -> None:
        """Set the timer for the rest of the backlog or, without one, for the engine's next deadline."""
        self._deadline.by(self._backlog.oldest_s if self._backlog else self._engine.next_deadline())

    def stop(self) -> None:
        """Run no deadline any more."""
        self._deadline.cancel()

    def behind_s(self) -> float:
        """Return how long the oldest of what waits, or the engine's deadline, has been due."""
        return self._clock() - (self._backlog.oldest_s if self._backlog else self._engine.next_deadline())

    def is_behind(self) -> bool:
        """Return whether what is received now is too old for its answer to be sent."""
        return bool(self._backlog) and self._clock() - self._backlog.oldest_s > _BEHIND_S

    def _poll(self) -> None:
        if not self._backlog:
            self._add_lag(self._clock() - self._engine.next_deadline())
            self._read_waiting()
        self._receive_some()
        if not self._backlog:
            self._advance(max(self._clock(), self.at_s))
            self._emit_unsent()
            self.wake()

    def _read_waiting(self) -> None:
        """Read what waits at all links into the backlog.

        It can then be received in the order in which it came, so that no link's datagrams are taken for late.
        """
        self._is_reading = True
        try:
            self._hooks.read_waiting()
        finally:
            self._is_reading = False

    def _receive_some(self) -> None:
        """Receive the backlog, or its oldest part.

        The timer goes on with the rest, so that the event loop runs before.
        """
        now_s = self._clock()
        if self._backlog:
            self._add_lag(now_s - self._backlog.oldest_s)
        overrun = find_overrun(self._engine, self.at_s, now_s)
        if overrun is not None and self.at_s >= self._held_up_until_s:
            self._held_up_until_s = overrun.until_s
            self._hooks.record(overrun)
        self._is_catching_up = True
        try:
            self._backlog.receive_some(self._clock)
        finally:
            self._is_catching_up = False
        self._emit_unsent()
        self.wake()

    def _receive_control(self, message: Control) -> None:
        message = replace(message, received_at_s=max(message.received_at_s, self.at_s))
        self._advance(message.received_at_s)
        if not self._is_catching_up:
            self._emit_unsent()
        self._engine.receive(message)
        self._hooks.record(message)
        self.wake()

    def _add_lag(self, lag_s: float) -> None:
        """Have the engine know of a lag before it gets what came meanwhile: no vehicle is to blame for it."""
        self._lag_s = max(self._lag_s, lag_s)
        if lag_s > HOST_LATE_S:
            late = replace(self._host, received_at_s=self.at_s, lag_s=round(lag_s, 3))
            self._engine.receive(late)
            self._hooks.record(late)

    def _advance(self, to_s: float) -> None:
        """Run the engine's deadlines before `to_s` and emit its outputs.

        This comes before the engine gets what arrived at `to_s`.
        """
        self.at_s = to_s
        if self._engine.next_deadline() >= to_s:
            return
        is_idle = False
        for at_s, outputs in advance(self._engine, to_s, self._held_up_until_s):
            self._unsent.extend(outputs)
            if self._engine.next_aid_s() >= to_s and not self._is_catching_up:
                # Before the fleet is reviewed and the journal written: that takes longer than estimating, and vehicles wait.
                self._emit_unsent()
                is_idle = self._engine.next_deadline() >= to_s
            self._hooks.record_outputs(at_s, outputs)
        if is_idle:
            self._hooks.on_idle()

    def _emit_unsent(self) -> None:
        if not self.is_behind():
            unsent, self._unsent = self._unsent, []
            self._hooks.emit(unsent)


class _Backlog:
    """What waits to be received, in the order in which it came.

    It is worked off in portions, so that a busy host lets everything else go on between.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[float, Callable[[], None]]] = []
        self._rest = 0  # of the last portion

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def oldest_s(self) -> float:
        """When the oldest arrived (service time, s). Only where something waits."""
        return min(at_s for at_s, _ in self._waiting)

    def add(self, at_s: float, receive: Callable[[], None]) -> None:
        """Have `receive` called in its turn for what arrived at service time `at_s` (s)."""
        self._waiting.append((at_s, receive))

    def receive_some(self, clock: Clock) -> None:
        """Receive the oldest of what waits, for `_AT_ONCE_S` at least.

        Where some were left the last time, as many are received as came since, so that the backlog does not grow.
        """
        waiting, self._waiting = sorted(self._waiting, key=itemgetter(0)), []
        least = len(waiting) - self._rest if self._rest else 0
        ends_s = clock() + _AT_ONCE_S
        received = 0
        try:
            for received, (_, receive) in enumerate(waiting, 1):
                receive()
                if received >= least and clock() > ends_s:
                    break
        finally:
            self._waiting = waiting[received:] + self._waiting
            self._rest = len(self._waiting)
