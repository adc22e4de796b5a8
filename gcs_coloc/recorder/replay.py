"""A recorded flight through the same engine, on recorded time: deterministic, and as fast as it goes unless it is paced.

The service's clock is the recording's: UNIX seconds of arrival. Ranges that the recording's frames do not carry come from
a table beside it. Nothing is sent anywhere.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gcs_coloc.core.advance import advance
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.errors import DataError
from gcs_coloc.core.messages import ClockReference, Inbound, OperatorWord, Outbound, PeerRange, RouteReport, TimeBase
from gcs_coloc.mavlink.decoder import Decoder
from gcs_coloc.mavlink.dialect import OWN_COMPID, OWN_SYSID
from gcs_coloc.recorder.notes import ReadNote, read_note
from gcs_coloc.recorder.tables import read_table
from gcs_coloc.recorder.tlog import TlogReader


@dataclass(frozen=True, slots=True)
class TruthPoint:
    """Where a vehicle truly was, for scoring only. Degrees, metres above mean sea level, UNIX seconds of the recorder."""

    unix_s: float
    sysid: int
    lat_deg: float
    lon_deg: float
    alt_msl_m: float


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


def replay(
    engine: Engine,
    log: TlogReader,
    ranges: Iterable[PeerRange],
    observe: Iterable[float],
    on_poll: Callable[[float, list[Outbound]], None],
    on_observe: Callable[[float], None],
    pace: Callable[[float], None] = lambda _: None,
    own: tuple[int, int] = (OWN_SYSID, OWN_COMPID),
) -> ReplayCounts:
    """Drive the engine through a recording.

    Args:
        engine: a fresh engine.
        log: the recording's frames, in order.
        ranges: ranges that the frames do not carry, in order of time.
        observe: service times (UNIX s), in order, at which `on_observe` is called when all that arrived by then is taken.
        on_poll: takes the service time and the engine's outputs of each of its deadlines.
        on_observe: see `observe`.
        pace: called with the service time before it is reached; may wait.
        own: the system and component id of the service that recorded: what it sent itself is passed over.

    Returns:
        What was gone through. The frames' own counts are the log's.
    """
    counts = ReplayCounts()
    decoder = Decoder(own_sysid=own[0], own_compid=own[1])
    observations = iter(observe)
    due = next(observations, None)
    now_s = float("-inf")
    for message in heapq.merge(_messages(log, decoder, own, counts), ranges, key=lambda m: m.received_at_s):
        # A recorder's clock may be stepped back; the engine's time never is.
        arrived_s = max(message.received_at_s, now_s)
        while due is not None and due < arrived_s:
            _advance(engine, due, on_poll, pace)
            now_s = max(now_s, due)
            on_observe(due)
            due = next(observations, None)
        _advance(engine, arrived_s, on_poll, pace)
        now_s = arrived_s
        engine.receive(message)
        counts.messages += 1
    counts.wire = decoder.counts
    return counts


def _advance(
    engine: Engine, to_s: float, on_poll: Callable[[float, list[Outbound]], None], pace: Callable[[float], None]
) -> None:
    pace(to_s)
    for at_s, outputs in advance(engine, to_s):
        on_poll(at_s, outputs)


def _messages(log: TlogReader, decoder: Decoder, own: tuple[int, int], counts: ReplayCounts) -> Iterator[Inbound]:
    latest_s = float("-inf")
    routes: dict[int, str | None] = {}
    words: set[tuple[int, type]] = set()
    for record in log:
        latest_s = max(latest_s, record.unix_s)
        noted = read_note(record.frame, latest_s, own)
        if counts.records == 0:
            counts.first_s = latest_s
            if noted is None:
                # Another program's recording: its clock is all that is known of UTC, and every vehicle is taken as reached.
                yield ClockReference(latest_s, 0.0)
        counts.records += 1
        counts.last_s = latest_s
        if noted is not None:
            yield from _of_note(noted, routes, words)
            continue
        for frame in decoder.decode(record.frame, latest_s):
            if frame.message is not None:
                yield frame.message
            if frame.is_autopilot_heartbeat:
                yield RouteReport(frame.sysid, latest_s, routes.get(frame.sysid))


def _of_note(noted: ReadNote, routes: dict[int, str | None], words: set[tuple[int, type]]) -> Iterator[Inbound]:
    note = noted.note
    if isinstance(note, RouteReport):
        # Told with the vehicle's next heartbeat, as in flight.
        routes[note.sysid] = note.blocked
    elif isinstance(note, OperatorWord):
        is_news = (note.sysid, type(note.word)) not in words or not noted.repeated
        words.add((note.sysid, type(note.word)))
        if is_news:
            yield note
    elif note is not None:
        yield note
