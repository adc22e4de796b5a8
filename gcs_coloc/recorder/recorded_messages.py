"""The messages of a recording for the core, in order of arrival: its frames, side-channel records, and ranges from a table."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from gcs_coloc.core.advance import Overrun
from gcs_coloc.core.messages.control import ClockReference, OperatorCommand, RouteReport, TransmitDisabled
from gcs_coloc.core.messages.inbound import Inbound, PeerRange
from gcs_coloc.mavlink.decoder import Decoder
from gcs_coloc.mavlink.framing import RawFrame, sender_of
from gcs_coloc.mavlink.truth import HeardTruth, truth_of
from gcs_coloc.recorder.side_channel import FlownWith, GroundTool, ReadRecord, read_note
from gcs_coloc.recorder.tlog import TlogReader, TlogRecord

_LONGEST_GAP_S = 600.0
"""What lies beyond so long a gap is another flight, or the recorder's clock was set: the deadlines between are left out."""


@dataclass(slots=True)
class ReplayCounts:
    """What a replay went through: times of the first and last record (UNIX s), frames in the file, messages for the core.

    `wire` counts what the decoder set aside, by reason.
    """

    first_s: float = 0.0
    last_s: float = 0.0
    records: int = 0
    messages: int = 0
    wire: Mapping[str, int] = field(default_factory=dict)


class RecordedMessages:
    """The messages of one recording. `truths` is where a simulation says that vehicles truly are, up to the last message.

    Args:
        log: the recording's frames, in order.
        ranges: ranges that the frames do not carry, in order of time.
        own: the system and component id of the service that recorded: what it sent itself is passed over.
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
        self._words: set[tuple[int, type]] = set()
        self._ground_tools: set[tuple[int, int]] = set()
        self._of_record: deque[Inbound | Overrun] = deque()
        self._truths_of_record: list[HeardTruth] = []
        self._ranges_taken = 0

    def next(self) -> Inbound | Overrun | None:
        """The next message; None at the end. One of the table comes after those of the recording that arrived with it.

        Raises:
            DataError: the recording cannot be read or is none.
        """
        while not self._of_record:
            self.truths.update((truth.sysid, truth) for truth in self._truths_of_record)
            self._truths_of_record.clear()
            record = next(self._records, None)
            if record is None:
                break
            self._take(record)
        if self._was_flown_otherwise and self._of_record:
            # Not before the first message of the flight, which sets the grid of the deadlines.
            self._was_flown_otherwise = False
            self._of_record.appendleft(TransmitDisabled(self._of_record[0].received_at_s))
        if self._ranges_taken < len(self._ranges):
            told = self._ranges[self._ranges_taken]
            if not self._of_record or told.received_at_s < self._of_record[0].received_at_s:
                self._ranges_taken += 1
                return told
        return self._of_record.popleft() if self._of_record else None

    def _take(self, record: TlogRecord) -> None:
        counts, found = self.counts, self._of_record
        gap_ends_s = self._latest_s + _LONGEST_GAP_S
        at_s = self._latest_s = max(self._latest_s, record.unix_s)
        noted = read_note(record.frame, at_s, self._own)
        if counts.records == 0:
            counts.first_s = at_s
            if noted is None:
                # Another program's recording: its clock is all that is known of UTC, and every vehicle is taken as reached.
                found += TransmitDisabled(at_s), ClockReference(at_s, 0.0)
        elif at_s > gap_ends_s:
            found.append(Overrun(at_s, gap_ends_s))
        counts.records += 1
        counts.last_s = at_s
        if noted is not None:
            self._take_note(noted)
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
        self._truths_of_record.extend(truth for raw in good if (truth := truth_of(raw, at_s)) is not None)

    def _take_note(self, noted: ReadRecord) -> None:
        note = noted.note
        if isinstance(note, RouteReport):
            # Told with the vehicle's next heartbeat, as in flight.
            self._routes[note.sysid] = note
        elif isinstance(note, OperatorCommand):
            is_news = (note.sysid, type(note.override)) not in self._words or not noted.repeated
            self._words.add((note.sysid, type(note.override)))
            if is_news:
                self._of_record.append(note)
        elif isinstance(note, FlownWith):
            self._was_flown_otherwise = self._flown_with not in (None, note.fingerprint)
        elif isinstance(note, GroundTool):
            self._ground_tools.add((note.sysid, note.compid))
        elif note is not None:
            self._of_record.append(note)
