"""A recorded flight through the same engine, on recorded time: deterministic, and as fast as it goes unless it is paced.

The service's clock is the recording's: UNIX seconds of arrival. Ranges that the recording's frames do not carry come from
a table beside it. Nothing is sent anywhere.
"""

from __future__ import annotations

import heapq
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from gcs_coloc.core.advance import CATCH_UP_S, HeldUp, advance
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.errors import DataError
from gcs_coloc.core.messages import Inbound, PeerRange, TimeBase
from gcs_coloc.core.outputs import Outbound
from gcs_coloc.core.words import ClockReference, OffAir, OperatorWord, RouteReport
from gcs_coloc.mavlink.decoder import Decoder
from gcs_coloc.mavlink.dialect import OWN_COMPID, OWN_SYSID
from gcs_coloc.mavlink.framing import RawFrame, sender_of
from gcs_coloc.mavlink.truth import HeardTruth, truth_of
from gcs_coloc.recorder.notes import GroundTool, ReadNote, read_note
from gcs_coloc.recorder.tables import read_table
from gcs_coloc.recorder.tlog import TlogReader


@dataclass(frozen=True, slots=True)
class TruthPoint:
    """Where a vehicle truly was, to score by and to show. Degrees, metres above mean sea level, UNIX seconds of the recorder."""

    unix_s: float
    sysid: int
    lat_deg: float
    lon_deg: float
    alt_msl_m: float


class TruthTable:
    """True positions, looked up by time."""

    def __init__(self, points: Sequence[TruthPoint]) -> None:
        """Take points in order of time."""
        self._by_vehicle: dict[int, list[TruthPoint]] = {}
        for point in points:
            self._by_vehicle.setdefault(point.sysid, []).append(point)

    def at(self, unix_s: float) -> dict[int, HeardTruth]:
        """Each vehicle's newest point not after a time (UNIX s), by system id."""
        found = {}
        for sysid, points in self._by_vehicle.items():
            i = bisect_right(points, unix_s, key=lambda point: point.unix_s)
            if i > 0:
                point = points[i - 1]
                found[sysid] = HeardTruth(sysid, point.unix_s, point.lat_deg, point.lon_deg)
        return found


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


def read_ranges(path: Path) -> list[PeerRange]:
    """The ranges of a table `unix_s,from_sysid,to_sysid,range_m,sigma_m` in order of time. `unix_s` is the measuring time.

    Raises:
        DataError: as `read_table`, or a value is impossible.
    """
    ranges = []
    for row in read_table(path, ("unix_s", "from_sysid", "to_sysid", "range_m"), ("sigma_m",)):
        measured_at_s = row.number("unix_s")
        message = PeerRange(
            sysid=row.integer("from_sysid", 1, 255),
            received_at_s=measured_at_s,
            peer_sysid=row.integer("to_sysid", 1, 255),
            range_m=row.positive("range_m"),
            sigma_m=None if row.is_empty("sigma_m") else row.positive("sigma_m"),
            measured_at_s=measured_at_s,
            time_base=TimeBase.SERVICE,
            sequence=None,
            line_of_sight=None,
            device_id=0,
        )
        if message.sysid == message.peer_sysid:
            raise row.error("to_sysid", "a vehicle has no range to itself")
        ranges.append(message)
    return sorted(ranges, key=lambda r: r.received_at_s)


def read_truth(path: Path) -> list[TruthPoint]:
    """The true positions of a table `unix_s,sysid,lat_deg,lon_deg,alt_msl_m` in order of time.

    Raises:
        DataError: as `read_table`, or the table is empty.
    """
    points = [
        TruthPoint(
            unix_s=row.number("unix_s"),
            sysid=row.integer("sysid", 1, 255),
            lat_deg=row.number("lat_deg"),
            lon_deg=row.number("lon_deg"),
            alt_msl_m=row.number("alt_msl_m"),
        )
        for row in read_table(path, ("unix_s", "sysid", "lat_deg", "lon_deg", "alt_msl_m"))
    ]
    if not points:
        raise DataError(f"{path}: holds no true position; a row for each time and vehicle is wanted")
    return sorted(points, key=lambda p: p.unix_s)


class Replay:
    """An engine on its way through a recording, one message after the other; whoever holds it decides how fast.

    `now_s` is the service time (UNIX s) that was reached. `truths` is where a simulation says that vehicles truly are.

    However it is stepped and advanced, the engine does the same at the same recorded times.
    """

    def __init__(
        self,
        engine: Engine,
        log: TlogReader,
        ranges: Iterable[PeerRange],
        on_poll: Callable[[float, list[Outbound]], None],
        own: tuple[int, int] = (OWN_SYSID, OWN_COMPID),
        *,
        as_flown: bool = True,
    ) -> None:
        """Read up to the first message.

        Args:
            engine: a fresh engine.
            log: the recording's frames, in order.
            ranges: ranges that the frames do not carry, in order of time.
            on_poll: takes the service time (UNIX s) and the engine's outputs of each of its deadlines.
            own: the system and component id of the service that recorded: what it sent itself is passed over.
            as_flown: the engine is the one of the flight. Else, as with another program's recording, what it sends was never on
                the air, and how vehicles take it is not judged.

        Raises:
            DataError: the recording cannot be read or is none.
        """
        self.engine = engine
        self.counts = ReplayCounts()
        self.decoder = Decoder(own_sysid=own[0], own_compid=own[1])
        self.counts.wire = self.decoder.counts
        self.truths: dict[int, HeardTruth] = {}
        self._on_poll = on_poll
        self._messages = heapq.merge(
            _messages(log, self.decoder, own, self.counts, self.truths, as_flown=as_flown),
            ranges,
            key=lambda message: message.received_at_s,
        )
        self.now_s = float("-inf")
        self._next = next(self._messages, None)

    @property
    def next_s(self) -> float | None:
        """The service time (UNIX s) at which the next message arrives; None at the end."""
        # A recorder's clock may be stepped back; the engine's time never is.
        return max(self._next.received_at_s, self.now_s) if self._next is not None else None

    def step(self) -> None:
        """Bring the engine to the next message and give it to it."""
        message, at_s = self._next, self.next_s
        assert message is not None
        assert at_s is not None
        if isinstance(message, HeldUp):
            self._advance(message.since_s)
            self._advance(at_s, CATCH_UP_S)
        else:
            self._advance(at_s)
            self.engine.receive(message)
            self.counts.messages += 1
        self._next = next(self._messages, None)

    def advance(self, to_s: float) -> None:
        """Bring the engine to a service time (UNIX s) before which all messages were given to it, between two of them."""
        # While it was held up, the service did nothing.
        self._advance(min(to_s, self._next.since_s) if isinstance(self._next, HeldUp) else to_s)

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


def _messages(
    log: TlogReader,
    decoder: Decoder,
    own: tuple[int, int],
    counts: ReplayCounts,
    truths: dict[int, HeardTruth],
    *,
    as_flown: bool,
) -> Iterator[Inbound | HeldUp]:
    latest_s = float("-inf")
    routes: dict[int, str | None] = {}
    words: set[tuple[int, type]] = set()
    ground_tools: set[tuple[int, int]] = set()
    for record in log:
        latest_s = max(latest_s, record.unix_s)
        noted = read_note(record.frame, latest_s, own)
        if counts.records == 0:
            counts.first_s = latest_s
            if noted is None or not as_flown:
                yield OffAir(latest_s)
            if noted is None:
                # Another program's recording: its clock is all that is known of UTC, and every vehicle is taken as reached.
                yield ClockReference(latest_s, 0.0)
        counts.records += 1
        counts.last_s = latest_s
        if noted is not None:
            yield from _of_note(noted, routes, words, ground_tools)
            continue
        if sender_of(record.frame) in ground_tools:
            continue
        good: list[RawFrame] = []
        for frame in decoder.decode(record.frame, latest_s, good=good):
            if frame.message is not None:
                yield frame.message
            if frame.is_autopilot_heartbeat:
                yield RouteReport(frame.sysid, latest_s, routes.get(frame.sysid))
        truths.update((raw.sysid, truth) for raw in good if (truth := truth_of(raw, latest_s)) is not None)


def _of_note(
    noted: ReadNote, routes: dict[int, str | None], words: set[tuple[int, type]], ground_tools: set[tuple[int, int]]
) -> Iterator[Inbound | HeldUp]:
    note = noted.note
    if isinstance(note, RouteReport):
        # Told with the vehicle's next heartbeat, as in flight.
        routes[note.sysid] = note.blocked
    elif isinstance(note, OperatorWord):
        is_news = (note.sysid, type(note.word)) not in words or not noted.repeated
        words.add((note.sysid, type(note.word)))
        if is_news:
            yield note
    elif isinstance(note, GroundTool):
        ground_tools.add((note.sysid, note.compid))
    elif note is not None:
        yield note
