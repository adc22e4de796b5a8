"""How the engine's deadlines are run, live and in replay alike.

A deadline is answered with its own time, however late the caller comes, and after every message that arrived before it or
at the same time. What the engine does is then a function of the messages and their times alone: that the event loop woke
half a millisecond late leaves no trace, and a recording of the messages gives the same answers to the last bit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.outbound import AidingMessage, Outbound, RangingBeacon

CATCH_UP_S = 0.05
"""A service that was held up for longer answers what it missed once, in the present. Chosen: 1 m at 20 m/s."""


@dataclass(frozen=True, slots=True)
class Overrun:
    """A time for which the service was held up, so that it answered no deadline.

    It was held up from `received_at_s` until `until_s` (service time, s). What it missed it answered once, at `until_s`, when it
    had received all that arrived before. A replay must do the same.
    """

    received_at_s: float
    until_s: float


def find_overrun(engine: Engine, at_s: float, now_s: float) -> Overrun | None:
    """Return the overrun of an engine that has fallen behind; None where it keeps up.

    The engine is at service time `at_s` (s), while it is `now_s`.

    A recording must hold the overrun, before whatever the engine receives from then on.
    """
    return Overrun(at_s, now_s) if now_s - engine.next_deadline() > CATCH_UP_S else None


def advance(engine: Engine, to_s: float, held_up_until_s: float = float("-inf")) -> Iterator[tuple[float, list[Outbound]]]:
    """Poll the engine at each deadline before `to_s`: the time and what came of it, one by one.

    What vehicles wait for comes first: where the fleet is reviewed at the same time, that is a poll of its own after it.

    Args:
        engine: the engine; every message that arrived before `to_s` has been received.
        to_s: service time, seconds. A deadline at this very time waits for the next call.
        held_up_until_s: of the last overrun. Deadlines before it are answered once, at that time.
    """
    while to_s >= held_up_until_s and (due_s := engine.next_deadline()) < to_s:
        at_s = max(due_s, held_up_until_s)
        yield at_s, engine.serve(at_s) if engine.next_aid_s() <= at_s else engine.poll(at_s)


def without_superseded(outputs: list[Outbound]) -> list[Outbound]:
    """Return the outputs without the aiding messages that a later output replaces.

    A later one of the same kind to the same vehicle replaces a message, so that no old position is sent late. A range is replaced
    by one to the same peer alone.
    """
    last = {_topic(output): i for i, output in enumerate(outputs) if isinstance(output, AidingMessage)}
    return [output for i, output in enumerate(outputs) if not isinstance(output, AidingMessage) or last[_topic(output)] == i]


def _topic(message: AidingMessage) -> tuple[type[AidingMessage], int, int | None]:
    return type(message), message.sysid, message.beacon_id if isinstance(message, RangingBeacon) else None
