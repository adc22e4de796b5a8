"""A replay: a recorded flight goes through the same engine on recorded time.

It is deterministic, and as fast as possible unless it is paced.

The service's clock is the recording's: UNIX seconds of arrival. Ranges that the recording's frames do not carry come from
a table beside it. Nothing is sent anywhere.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from gcs_coloc.core.deadlines import Overrun, advance
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import ClockReference, OperatorCommand, RouteReport, TransmitDisabled
from gcs_coloc.core.messages.inbound import Inbound, PeerRange
from gcs_coloc.core.messages.outbound import Outbound
from gcs_coloc.mavlink.decoder import Decoder, HeardTruth, truth_of
from gcs_coloc.mavlink.framing import OWN_COMPID, OWN_SYSID, RawFrame, sender_of
from gcs_coloc.recorder.side_channel import FlownWith, GroundTool, ReadRecord, read_side_channel
from gcs_coloc.recorder.tlog import TlogReader, TlogRecord

_LONGEST_GAP_S = 600.0
"""A longer gap separates flights, or the recorder's clock was set: the deadlines beyond are left out. Chosen: ten minutes."""


class Replay:
    """An engine driven through a recording, one message after the other; the caller decides how fast.

    `now_s` is the service time (UNIX s) that was reached; `messages` is what comes out of the recording.

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
        self.messages = RecordedMessages(log, ranges, own, flown_with)
        self.now_s = self._held_up_until_s = float("-inf")
        self._next = self.messages.next()

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
        self.advance(at_s)
        if isinstance(message, Overrun):
            self._held_up_until_s = message.until_s
        else:
            self.engine.receive(message)
            self.messages.counts.messages += 1
        self._next = self.messages.next()

    def advance(self, to_s: float) -> None:
        """Advance the engine to a service time (UNIX s) before the next message."""
        self.now_s = max(self.now_s, to_s)
        for at_s, outputs in advance(self.engine, to_s, self._held_up_until_s):
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
    return through.messages.counts


@dataclass(slots=True)
class ReplayCounts:
    """Counts of a replay.

    `first_s` and `last_s` are the times of the first and last record (UNIX s). `records` counts the records of the file,
    `messages` those that the engine received. `wire` counts what the decoder refused, by reason.
    """

    first_s: float = 0.0
    last_s: float = 0.0
    records: int = 0
    messages: int = 0
    wire: Mapping[str, int] = field(default_factory=dict)


class RecordedMessages:
    """The messages of one recording, and the true positions that a simulation sent.

    `truths` holds the true positions up to the last message, by system id.

    Args:
        log: the recording's frames, in order.
        ranges: ranges that the frames do not carry, in order of time.
        own: the system and component id of the service that recorded: what it sent itself is skipped.
        flown_with: as `Replay`.
    """

    def __init__(self, log: TlogReader, ranges: Sequence[PeerRange], own: tuple[int, int], flown_with: str | None) -> None:
        self.log = log
        self.decoder = Decoder(own_sysid=own[0], own_compid=own[1])
        self.counts = ReplayCounts(wire=self.decoder.counts)
        self.truths: dict[int, HeardTruth] = {}
        self._records: Iterator[TlogRecord] = iter(log)
        self._ranges = ranges
        self._own = own
        self._flown_with = flown_with
        self._was_flown_otherwise = False
        self._latest_s = float("-inf")
        self._routes: dict[int, RouteReport] = {}
        self._overridden: set[tuple[int, type]] = set()
        self._ground_tools: set[tuple[int, int]] = set()
        self._pending: deque[Inbound | Overrun] = deque()
        self._pending_truths: list[HeardTruth] = []
        self._next_range = 0

    def next(self) -> Inbound | Overrun | None:
        """Return the next message; None at the end.

        A range of the table comes after the messages that arrived at the same time.

        Raises:
            DataError: the recording cannot be read or is none.
        """
        while not self._pending:
            self.truths.update((truth.sysid, truth) for truth in self._pending_truths)
            self._pending_truths.clear()
            record = next(self._records, None)
            if record is None:
                break
            self._read(record)
        if self._was_flown_otherwise and self._pending:
            # Not before the first message of the flight, which sets the grid of the deadlines.
            self._was_flown_otherwise = False
            self._pending.appendleft(TransmitDisabled(self._pending[0].received_at_s))
        if self._next_range < len(self._ranges):
            table_range = self._ranges[self._next_range]
            if not self._pending or table_range.received_at_s < self._pending[0].received_at_s:
                self._next_range += 1
                return table_range
        return self._pending.popleft() if self._pending else None

    def _read(self, record: TlogRecord) -> None:
        counts, found = self.counts, self._pending
        gap_ends_s = self._latest_s + _LONGEST_GAP_S
        at_s = self._latest_s = record.unix_s
        read = read_side_channel(record.frame, at_s, self._own)
        if counts.records == 0:
            counts.first_s = at_s
            if read is None:
                # Another program's recording: its clock is taken for UTC, and no frame of ours reached a vehicle.
                found += TransmitDisabled(at_s), ClockReference(at_s, 0.0)
        elif at_s > gap_ends_s:
            found.append(Overrun(gap_ends_s, at_s))
        counts.records += 1
        counts.last_s = at_s
        if read is not None:
            self._add_side_channel(read)
            return
        if sender_of(record.frame) in self._ground_tools:
            return
        good: list[RawFrame] = []
        for frame in self.decoder.decode(record.frame, at_s, good=good):
            if frame.message is not None:
                found.append(frame.message)
            if frame.is_autopilot_heartbeat:
                route = self._routes.get(frame.sysid)
                found.append(RouteReport(frame.sysid, at_s, None) if route is None else replace(route, received_at_s=at_s))
        self._pending_truths.extend(truth for raw in good if (truth := truth_of(raw, at_s)) is not None)

    def _add_side_channel(self, read: ReadRecord) -> None:
        record = read.record
        if isinstance(record, RouteReport):
            # Reported with the vehicle's next heartbeat, as in flight.
            self._routes[record.sysid] = record
        elif isinstance(record, OperatorCommand):
            is_new = (record.sysid, type(record.override)) not in self._overridden or not read.repeated
            self._overridden.add((record.sysid, type(record.override)))
            if is_new:
                self._pending.append(record)
        elif isinstance(record, FlownWith):
            self._was_flown_otherwise = self._flown_with not in (None, record.fingerprint)
        elif isinstance(record, GroundTool):
            self._ground_tools.add((record.sysid, record.compid))
        elif record is not None:
            self._pending.append(record)
