"""Store of the pictures of a recording, which one pass computes for the page.

They are looked up by time. The pictures are on disk; events and samples are in memory.
"""

from __future__ import annotations

import errno
import os
import tempfile
import threading
import zlib
from array import array
from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.alarms.alarms import Alarm
from gcs_coloc.core.messages.outbound import ToOperator
from gcs_coloc.web.picture import (
    EVENTS_KEPT,
    SAMPLE_COLUMNS,
    Sample,
    columns,
    is_told_already,
    page_event,
    samples_per_vehicle,
)
from gcs_coloc.web.wire import Event, EventsFrame, VehicleHistory

PICTURE_PERIOD_S = 0.2
"""Recorded seconds between two pictures, as often as the page is sent one when it plays at real time."""
SAMPLE_PERIOD_S = 1.0  # as of the live page's tracks
MAX_PICTURES = 200_000
"""Eleven hours at 0.2 s; the index takes some 30 MB then. Beyond that every second picture is dropped."""
MAX_BYTES = 500_000_000
"""On disk; beyond that every second picture is dropped. Measured (`python -m bench seek`): 2.7 kB a picture of four
vehicles, 48 MB an hour."""
MAX_SAMPLES = 1_000_000
"""Of all vehicles together, 72 MB; beyond that every second sample is dropped."""
MAX_EVENTS = 50_000
"""Some 15 MB; the oldest go first."""

_WIDTH = 1 + len(SAMPLE_COLUMNS)
_COMPRESSION_LEVEL = 1


class _PictureFile:
    """A file without a name in the directory for temporary files.

    It is closed with the last reference to it.
    """

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(prefix="gcs-coloc-replay-", buffering=0)  # noqa: SIM115, it lives as long as this object
        self.size = 0

    def __del__(self) -> None:
        if hasattr(self, "_file"):
            self._file.close()

    def append(self, data: bytes) -> int:
        """Write at the end; returns the offset. OSError where the disk is full."""
        offset = self.size
        if self._file.write(data) != len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.size += len(data)
        return offset

    def read(self, offset: int, length: int) -> bytes:
        """Any part, from any thread."""
        return os.pread(self._file.fileno(), length, offset)


class StoredPicture(NamedTuple):
    """Where one picture is kept, and what goes with it.

    `newest_event` is the number of the newest event then. `utc_minus_service_s` is UTC minus the service's clock.
    """

    at_s: float
    newest_event: int
    utc_minus_service_s: float | None
    file: _PictureFile
    offset: int
    length: int

    def read(self) -> tuple[str, str]:
        """The page's `fleet` and `counts` messages as JSON."""
        fleet, counts = zlib.decompress(self.file.read(self.offset, self.length)).decode().split("\n")
        return fleet, counts


class PictureStore:
    """Pictures, events and track samples of a recording, looked up by time.

    `first_s` and `last_s` are the beginning and end of the recording (UNIX s).
    One thread adds, another reads. The disk file has no name and goes with the process.
    """

    def __init__(self, first_s: float, last_s: float, max_pictures: int = MAX_PICTURES, max_bytes: int = MAX_BYTES) -> None:
        """Make the file. OSError where the directory for temporary files cannot be written to."""
        self.first_s = first_s
        self.last_s = max(first_s, last_s)
        self.computed_s = first_s
        """Up to here (UNIX s) everything is there; `last_s` at the end of the pass."""
        self.picture_period_s = PICTURE_PERIOD_S
        self._max_pictures = max_pictures
        self._max_bytes = max_bytes
        self._lock = threading.Lock()
        self._file = _PictureFile()
        self._pictures: list[StoredPicture] = []
        self._events: list[Event] = []
        self._newest_event = 0
        self._samples: dict[int, array[float]] = {}
        self._sample_count = 0
        self._sample_period_s = SAMPLE_PERIOD_S
        self._sample_due_s = float("-inf")

    @property
    def size_bytes(self) -> int:
        """The bytes on disk."""
        return self._file.size

    def __len__(self) -> int:
        return len(self._pictures)

    def add_picture(self, at_s: float, fleet: bytes, counts: bytes, utc_minus_service_s: float | None) -> None:
        """Add the picture (JSON) of a later time than all before. OSError where the disk is full."""
        data = zlib.compress(fleet + b"\n" + counts, _COMPRESSION_LEVEL)
        offset = self._file.append(data)
        picture = StoredPicture(at_s, self._newest_event, utc_minus_service_s, self._file, offset, len(data))
        with self._lock:
            self._pictures.append(picture)
            self.computed_s = at_s
        if len(self._pictures) > self._max_pictures or self._file.size > self._max_bytes:
            self._thin_pictures()

    def add_event(self, message: ToOperator | Alarm) -> None:
        """Add a message to the operator, or the change of an alarm; it belongs to the pictures that follow."""
        if is_told_already(message):
            return
        with self._lock:
            self._newest_event += 1
            self._events.append(page_event(self._newest_event, message))
            if len(self._events) > MAX_EVENTS:
                del self._events[: MAX_EVENTS // 10]

    def add_samples(self, at_s: float, samples: Sequence[tuple[int, Sample]]) -> None:
        """Add a sample of each vehicle, by system id, where one is due."""
        if at_s < self._sample_due_s:
            return
        self._sample_due_s = at_s + self._sample_period_s
        with self._lock:
            for sysid, sample in samples:
                self._samples.setdefault(sysid, array("d")).extend(sample)
            self._sample_count += len(samples)
            if self._sample_count > MAX_SAMPLES:
                self._thin_samples()

    def finish(self, at_s: float) -> None:
        """State that the pass is at the end, and when that is.

        It is later than its last record says where the clock of the recording went back.
        """
        self.computed_s = self.last_s = at_s

    def picture_at(self, at_s: float) -> StoredPicture | None:
        """The newest picture not after a time, or the first; None before there is one."""
        with self._lock:
            i = bisect_right(self._pictures, at_s, key=lambda picture: picture.at_s)
            return self._pictures[max(i - 1, 0)] if self._pictures else None

    def events(self, after: int, until: int) -> EventsFrame:
        """Return the events with numbers above `after` up to `until`, the last 500 of them.

        The result also has how many are left out.
        """
        with self._lock:
            oldest = self._newest_event - len(self._events) + 1
            start = max(after + 1, until - EVENTS_KEPT + 1, oldest)
            events = tuple(self._events[start - oldest : max(until - oldest + 1, 0)])
        return EventsFrame(events=events, missed=max(until - after, 0) - len(events))

    def tracks(self, at_s: float) -> tuple[VehicleHistory, ...]:
        """The last minutes of each vehicle before a time."""
        count = samples_per_vehicle(len(self._samples))
        found = {}
        with self._lock:
            for sysid, samples in sorted(self._samples.items()):
                rows = np.frombuffer(samples).reshape(-1, _WIDTH)
                end = int(np.searchsorted(rows[:, 0], at_s, side="right"))
                found[sysid] = rows[max(end - count, 0) : end].tolist()
                del rows  # an array cannot grow while a view of it is alive
        return tuple(columns(sysid, rows) for sysid, rows in found.items() if rows)

    def _thin_pictures(self) -> None:
        """Keep every second picture, in a new file.

        A reader that still holds an old picture reads it from the old file.
        """
        file = _PictureFile()
        kept = [one._replace(file=file, offset=file.append(one.file.read(one.offset, one.length))) for one in self._pictures[::2]]
        with self._lock:
            self._pictures, self._file = kept, file
        self.picture_period_s *= 2.0

    def _thin_samples(self) -> None:
        for sysid, samples in self._samples.items():
            self._samples[sysid] = array("d", np.array(samples).reshape(-1, _WIDTH)[::2].ravel())
        self._sample_count = sum(len(samples) // _WIDTH for samples in self._samples.values())
        self._sample_period_s *= 2.0
