"""A replay: a recorded flight through the same engine on recorded time, deterministic, as fast as possible unless paced.

The service's clock is the recording's: UNIX seconds of arrival. Ranges that the recording's frames do not carry come from
a table beside it. Nothing is sent anywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.inbound import PeerRange
from gcs_coloc.core.messages.outbound import Outbound
from gcs_coloc.core.schedule import CATCH_UP_S, Overrun, advance
from gcs_coloc.mavlink.decoder import Decoder, HeardTruth
from gcs_coloc.mavlink.framing import OWN_COMPID, OWN_SYSID
from gcs_coloc.recorder.recorded_messages import RecordedMessages, ReplayCounts
from gcs_coloc.recorder.tlog import TlogReader


class Replay:
    """An engine driven through a recording, one message after the other; the caller decides how fast.

    `now_s` is the service time (UNIX s) that was reached.

    However it is stepped and advanced, the engine does the same at the same recorded times.
    """

    def __init__(
        self,
        engine: Engine,
        log: TlogReader,
        ranges: Sequence[PeerRange],
        on_poll: Callable[[float, list[Outbound]], None],
        own: tuple[int, int] = (OWN_SYSID, OWN_COMPID),
        flown_with: str | None = None,
    ) -> None:
        """Read up to the first message.

        Args:
            engine: a fresh engine.
            log: the recording's frames, in order.
            ranges: ranges that the frames do not carry, in order of time.
            on_poll: takes the service time (UNIX s) and the engine's outputs of each of its deadlines.
            own: the system and component id of the service that recorded: what it sent itself is skipped.
            flown_with: what the engine is set to, as `Settings.fingerprint`. Where the recording names something else, and in
                another program's, what the engine sends was never on the air, and how vehicles take it is not judged.

        Raises:
            DataError: the recording cannot be read or is none.
        """
        self.engine = engine
        self._on_poll = on_poll
        self._messages = RecordedMessages(log, ranges, own, flown_with)
        self.now_s = float("-inf")
        self._next = self._messages.next()

    @property
    def counts(self) -> ReplayCounts:
        """The counts so far."""
        return self._messages.counts

    @property
    def log(self) -> TlogReader:
        """The recording; its counts hold the damage found so far."""
        return self._messages.log

    @property
    def decoder(self) -> Decoder:
        """The decoder of the recording's frames."""
        return self._messages.decoder

    @property
    def truths(self) -> dict[int, HeardTruth]:
        """The true positions that a simulation sent, by system id."""
        return self._messages.truths

    @property
    def next_s(self) -> float | None:
        """The service time (UNIX s) at which the next message arrives; None at the end."""
        # A recorder's clock may be stepped back; the engine's time never is.
        return max(self._next.received_at_s, self.now_s) if self._next is not None else None

    def step(self) -> None:
        """Advance the engine to the next message, and have it receive that."""
        message, at_s = self._next, self.next_s
        assert message is not None
        assert at_s is not None
        if isinstance(message, Overrun):
            self._advance(message.since_s)
            self._advance(at_s, CATCH_UP_S)
        else:
            self._advance(at_s)
            self.engine.receive(message)
            self.counts.messages += 1
        self._next = self._messages.next()

    def advance(self, to_s: float) -> None:
        """Advance the engine to a service time (UNIX s) before the next message."""
        # During an overrun the service did nothing.
        self._advance(min(to_s, self._next.since_s) if isinstance(self._next, Overrun) else to_s)

    def _advance(self, to_s: float, catch_up_s: float = float("inf")) -> None:
        self.now_s = max(self.now_s, to_s)
        for at_s, outputs in advance(self.engine, to_s, catch_up_s=catch_up_s):
            self._on_poll(at_s, outputs)


def replay(
    through: Replay,
    observe: Iterable[float] = (),
    on_observe: Callable[[float], None] = lambda _: None,
    pace: Callable[[float], None] = lambda _: None,
) -> ReplayCounts:
    """Go through a recording to its end.

    Args:
        through: the replay at its beginning.
        observe: service times (UNIX s), in order, at which `on_observe` is called when all that arrived by then is taken.
        on_observe: see `observe`.
        pace: called with the service time before it is reached; may wait.

    Returns:
        What was gone through. The frames' own counts are the log's.
    """
    for due_s in observe:
        while (at_s := through.next_s) is not None and at_s <= due_s:
            pace(at_s)
            through.step()
        if through.next_s is None:
            break
        pace(due_s)
        through.advance(due_s)
        on_observe(due_s)
    while (at_s := through.next_s) is not None:
        pace(at_s)
        through.step()
    return through.counts
