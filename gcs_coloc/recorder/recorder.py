"""The recorder: callers queue what is to be recorded, and a thread writes it.

A slow or full disk costs recording and never delays the flight.
"""

from __future__ import annotations

import contextlib
import errno
import os
import threading
import time
from collections import deque
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from gcs_coloc.core.errors import RecordError
from gcs_coloc.core.messages.control import HoldBack, OperatorCommand, RouteBlock, RouteReport
from gcs_coloc.mavlink.refusals import Counts, Refusal
from gcs_coloc.recorder.journal import Entry, StationEntry
from gcs_coloc.recorder.log_segment import LogSegment, delete_oldest
from gcs_coloc.recorder.side_channel import FlownWith, GroundTool, SideChannelRecord, SideChannelWriter
from gcs_coloc.recorder.tlog import tlog_record

_MAX_QUEUED = 20_000  # chosen: ten seconds of thirty vehicles at 60 messages a second, should the disk not answer
_BATCH_ITEMS = 200  # chosen: between two batches the thread looks whether it is to end
_WRITE_EVERY_S = 1.0
"""Chosen: what a killed process or a power cut loses at most; more often, and a memory card is worn for nothing.

Once instead of twice a second costs 0.8 times the CPU: the thread finds its caches cold at every turn.
"""
_RETRY_S = 5.0  # chosen: a full or missing disk is looked at anew without filling the log
_SILENT_S = 5.0  # chosen: beyond what a memory card takes to tidy up
_JOIN_S = 5.0  # chosen: a service that is to end does not wait longer for a disk
_NAMES = 3600  # an hour of names, one a second: as many recordings cannot begin at once

_Item = tuple[float, bytes] | SideChannelRecord | Entry


class Recorder:
    """One recording in a directory. Adding never waits and never raises; `counts` holds what was lost.

    Everything added before `open` waits for it; without it no file is created.
    """

    def __init__(self, directory: Path, rotate_bytes: int, sysid: int, compid: int, keep_bytes: int | None = None) -> None:
        """Make the directory. With `keep_bytes` the oldest recordings in it are deleted beyond that.

        Raises:
            RecordError: it cannot be made or not be written to; the text says why.
        """
        self.counts = Counts()
        self._directory = directory
        self._rotate_bytes = rotate_bytes
        self._keep_bytes = keep_bytes
        self._side_channel = SideChannelWriter(sysid, compid)
        self._routes: dict[int, tuple[RouteBlock | None, tuple[int, ...]]] = {}
        self._items: deque[_Item] = deque()
        self._ending = threading.Event()
        self._turned_at_s = self._retry_at_s = time.monotonic()
        self._fault: str | None = None
        self._reported: tuple[str | None, int] = (None, 0)
        self._segment_count = 0
        self._state: dict[tuple[object, ...], SideChannelRecord | Entry] = {}  # what a new segment has to repeat
        self._name = ""
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except FileExistsError:
            raise self._not_writable("it is a file and no directory") from None
        except OSError as error:
            raise self._not_writable(error.strerror) from None
        if not os.access(directory, os.W_OK | os.X_OK):
            is_read_only = os.statvfs(directory).f_flag & os.ST_RDONLY
            raise self._not_writable(os.strerror(errno.EROFS if is_read_only else errno.EACCES))
        self._segment: LogSegment | None = None
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        """Begin the first segment.

        Raises:
            RecordError: it cannot be made; the text says why.
        """
        try:
            self._segment = self._open_first()
        except OSError as error:
            raise self._not_writable(error.strerror) from None
        self._turned_at_s = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def add_frame(self, at_s: float, frame: bytes) -> None:
        """Record one whole frame, received or sent, at service time `at_s` (UNIX seconds)."""
        self._put((at_s, frame))

    def add_record(self, record: SideChannelRecord) -> None:
        """Record what the engine received besides frames; of routes only changes."""
        if isinstance(record, RouteReport):
            route = (record.blocked, record.shared_with)
            if self._routes.get(record.sysid) == route:
                return
            self._routes[record.sysid] = route
        self._put(record)

    def add_entry(self, entry: Entry) -> None:
        """Record one entry of the journal."""
        self._put(entry)

    def pending_warning(self) -> tuple[str, str] | None:
        """Return level and text of a warning about the recording; None where there is nothing new.

        It warns if the recording has failed, recovered or lost frames since the last call.
        """
        lost, fault = self.counts.get(Refusal.NOT_RECORDED, 0), self._fault
        if self._thread is not None and time.monotonic() - self._turned_at_s > _SILENT_S:
            fault = f"{self._directory}: the disk has not answered for {_SILENT_S:g} s"
        before_fault, before_lost = self._reported
        self._reported = (fault, lost)
        if fault is not None and fault != before_fault:
            again = f", and it is tried again every {_RETRY_S:g} s" if fault == self._fault else ""
            return "error", f"nothing is being recorded: {fault}; the flight goes on{again}"
        if fault is None and before_fault is not None:
            return "info", f"recording again; {lost} frames and entries were lost"
        if fault is None and lost > before_lost:
            return "warning", f"the disk is too slow: {lost - before_lost} frames and entries were not recorded"
        return None

    def close(self) -> None:
        """Write the queue and end the files. A disk that does not answer within 5 s is abandoned."""
        if self._thread is None:
            return
        self._ending.set()
        self._thread.join(_JOIN_S)

    def _not_writable(self, why: str | None) -> RecordError:
        return RecordError(f"--record {self._directory}: cannot be written to: {why}")

    def _put(self, item: _Item) -> None:
        if len(self._items) < _MAX_QUEUED:
            self._items.append(item)
        else:
            self.counts.add(Refusal.NOT_RECORDED)

    def _run(self) -> None:
        ended = False
        while not ended:
            # Items do not wake this thread: at hundreds a second that would cost the flight more than the writing does.
            ended = self._ending.wait(_WRITE_EVERY_S)
            self._turned_at_s = time.monotonic()
            if self._segment is None and (ended or self._turned_at_s >= self._retry_at_s):
                self._try_to_open()
            self._write_waiting()
            self._sync()
        if self._segment is not None:
            self._end(self._segment)
        self.counts.add(Refusal.NOT_RECORDED, len(self._items))

    def _write_waiting(self) -> None:
        """Write the queue; while there is no segment to write to, it stays queued."""
        waiting = len(self._items)
        while waiting and (segment := self._segment_with_room()) is not None:
            # Only what is written leaves the queue: a batch that fails is tried again, in its place.
            items = [self._items[place] for place in range(min(waiting, _BATCH_ITEMS))]
            waiting -= len(items)
            if self._write(segment, items):
                for _ in items:
                    self._items.popleft()

    def _write(self, segment: LogSegment, items: list[_Item]) -> bool:
        """Write a batch. False where nothing of it was written, True also where a half of it is lost."""
        size_before, lost = segment.size, 0
        told: dict[tuple[object, ...], SideChannelRecord | Entry] = {}
        try:
            records, entries = self._head(items[0]) if segment.size == 0 else (bytearray(), [])
            for item in items:
                if isinstance(item, tuple):
                    records += tlog_record(*item)
                    continue
                if isinstance(item, SideChannelRecord):
                    try:
                        records += tlog_record(item.received_at_s, self._side_channel.pack(item))
                    except ValueError:
                        lost += 1  # too long for a frame
                        continue
                else:
                    entries.append(item)
                key = _lasting_key(item)
                if key is not None:
                    told[key] = item
            segment.write(bytes(records), entries)
        except OSError as error:
            self._fail(error)
            if segment.size == size_before:
                return False
            lost = len(items)  # one of its two files took them, and the other did not
        if lost:
            self.counts.add(Refusal.NOT_RECORDED, lost)
        self._state |= told  # not before: the next segment would begin with what only follows in it
        return True

    def _segment_with_room(self) -> LogSegment | None:
        if self._segment is not None and self._segment.size >= self._rotate_bytes:
            self._end(self._segment)
            self._segment = None
            self._try_to_open()
        return self._segment

    def _head(self, first: _Item) -> tuple[bytearray, list[Entry]]:
        """The beginning of a segment: the mark that it is ours, and the records and entries that still hold."""
        at_s = (
            first[0] if isinstance(first, tuple) else first.received_at_s if isinstance(first, SideChannelRecord) else first.at_s
        )
        head, entries = bytearray(tlog_record(at_s, self._side_channel.pack(None))), list[Entry]()
        for told in self._state.values():
            if isinstance(told, SideChannelRecord):
                head += tlog_record(at_s, self._side_channel.pack(told, repeated=True))
            else:
                entries.append(replace(told, at_s=at_s))
        return head, entries

    def _open_first(self) -> LogSegment:
        """Open the first segment under the name of this second, or of the next that is free.

        Another service may have begun in it, and a computer without a battery for its clock begins every day at the same time.
        """
        begun = datetime.now(UTC)
        for later_s in range(_NAMES):
            self._name = (begun + timedelta(seconds=later_s)).strftime("%Y%m%dT%H%M%SZ")
            with contextlib.suppress(FileExistsError):
                return self._new_segment(1)
        return self._new_segment(1)

    def _new_segment(self, number: int) -> LogSegment:
        self._segment_count = number
        segment = LogSegment(self._directory, f"gcs-coloc-{self._name}-{number:03d}")
        if self._keep_bytes is not None:
            with contextlib.suppress(OSError):  # a directory that cannot be read loses the limit, not the flight
                delete_oldest(self._directory, self._keep_bytes - self._rotate_bytes)
        return segment

    def _try_to_open(self) -> None:
        try:
            self._segment = self._new_segment(self._segment_count + 1)
        except OSError as error:
            self._fail(error)

    def _sync(self) -> None:
        if self._segment is None or self._segment.size == 0:
            return
        try:
            self._segment.sync()
            self._fault = None  # not before: a full disk still makes new files
        except OSError as error:
            self._fail(error)

    def _end(self, segment: LogSegment) -> None:
        try:
            segment.close()
        except OSError as error:
            self._fault = _fault_text(self._directory, error)

    def _fail(self, error: OSError) -> None:
        self._fault = _fault_text(self._directory, error)
        self._retry_at_s = time.monotonic() + _RETRY_S
        if self._segment is not None:
            if self._segment.size == 0:
                self._segment_count -= 1  # nothing is left of it, and its name is free
            self._segment.close(whole=False)
            self._segment = None


def _lasting_key(record: SideChannelRecord | Entry) -> tuple[object, ...] | None:
    """Return the key of a record or entry that every new segment repeats; None for any other.

    Such a record holds until another of its key replaces it. Any other concerns a moment.
    """
    match record:
        case OperatorCommand():
            return type(record.override), record.sysid
        case RouteReport():
            return RouteReport, record.sysid
        case GroundTool():
            return GroundTool, record.sysid, record.compid
        case StationEntry():
            return StationEntry, record.station.node
        case FlownWith() | HoldBack():
            return (type(record),)
        case _:
            return None


def _fault_text(directory: Path, error: OSError) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"{directory}: the disk is full"
    if error.errno == errno.ENOENT:
        return f"{directory}: the directory, or a file in it, was taken away; put the directory or its disk back"
    return f"{directory}: {error.strerror}"
