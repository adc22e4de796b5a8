"""The tlog, the recording format of ground stations.

A record is the time in microseconds since 1970 (8 bytes, big-endian) and then the frame.
"""

from __future__ import annotations

import mmap
import stat
import struct
from collections.abc import Iterator
from itertools import chain, pairwise
from pathlib import Path
from typing import NamedTuple

from fastcrc.crc16 import mcrf4xx

from gcs_coloc.core.errors import DataError
from gcs_coloc.mavlink.checks import UNIX_TIME_TO_US
from gcs_coloc.mavlink.framing import (
    ANY_MAGIC,
    CHECKSUM_LENGTH,
    CRC_EXTRA,
    INCOMPAT_SIGNED,
    MAGIC_V1,
    MAGIC_V2,
    SIGNATURE_LENGTH,
    RawFrame,
    read_frame,
)
from gcs_coloc.mavlink.refusals import Counts, Refusal
from gcs_coloc.runtime.files import reading

SEARCHED_BYTES = 1 << 16
"""A file without one good record in so many bytes is no tlog."""

_TIME = struct.Struct(">Q")
_BACK_S = 1.0  # chosen: records of several links are that much out of order; a clock that is set goes further
_SETUP_SIGNING = 256  # message id of SETUP_SIGNING
_INCOMPAT_AT = 2  # byte of a frame; source: MAVLink 2, packet format
_OTHERS = {
    b"\x1f\x8b": "is compressed; unpack it with gunzip first",
    b"PK\x03\x04": "is a zip archive; unpack it first",
    b"\x89MCAP": "is an MCAP file; the .tlog that was recorded beside it is wanted",
    b"\xa3\x95": "is an onboard log of ArduPilot; a log of the telemetry (.tlog) is wanted",
    b"ULog": "is an onboard log of PX4; a log of the telemetry (.tlog) is wanted",
}
"""Kinds of file by their first bytes, and the remedy."""


class TlogRecord(NamedTuple):
    """One frame and when it was recorded, in UNIX seconds. Of a recording these never go back."""

    unix_s: float
    frame: bytes


def message_id(frame: bytes) -> int:
    """The message id in the header of a whole frame of either version."""
    return frame[5] if frame[0] == MAGIC_V1 else int.from_bytes(frame[7:10], "little")


def tlog_record(at_s: float, frame: bytes) -> bytes:
    """One record: the time in microseconds since 1970 (8 bytes, big-endian), then the frame.

    Args:
        at_s: UNIX seconds.
        frame: a whole frame with a right checksum.

    Returns:
        The record; empty for SETUP_SIGNING, which holds the secret key, and for a signed frame whose message is unknown:
        without its signature it would need a checksum that nobody here can compute.
    """
    if message_id(frame) == _SETUP_SIGNING:
        return b""
    stripped = without_signature(frame)
    return _TIME.pack(round(at_s * 1e6)) + stripped if stripped is not None else b""


def without_signature(frame: bytes) -> bytes | None:
    """Return the frame without its signature, with a new checksum.

    None where the message, and so its checksum, is unknown.
    """
    if frame[0] != MAGIC_V2 or not frame[_INCOMPAT_AT] & INCOMPAT_SIGNED:
        return frame
    crc_extra = CRC_EXTRA.get(message_id(frame))
    if crc_extra is None:
        return None
    body = bytearray(frame[: -SIGNATURE_LENGTH - CHECKSUM_LENGTH])
    body[_INCOMPAT_AT] &= ~INCOMPAT_SIGNED
    checksum = mcrf4xx(bytes(body[1:]) + bytes((crc_extra,)))
    return bytes(body) + checksum.to_bytes(2, "little")


class TlogReader:
    """The records of a tlog in the order of the file; memory does not grow with its length.

    Where the file is damaged, reading goes on at the next record whose frame has a right checksum. A time that is not
    between those around it is replaced by that of the record before; where the clock of the recording computer went back,
    times go on from there. `counts` holds what of that was met, and truncated if the file ends within a record. Iterating
    raises DataError where the file cannot be read or is no tlog.
    """

    def __init__(self, path: Path) -> None:
        self.counts = Counts()
        self._path = path

    def span(self) -> tuple[float, float]:
        """The times (UNIX s) of the first and the last record, without reading what is between.

        Raises:
            DataError: the file cannot be read or is no tlog.
        """
        first_s = next(iter(TlogReader(self._path))).unix_s
        with reading(self._path), self._path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            return first_s, max(first_s, _last_time_s(data))

    def __iter__(self) -> Iterator[TlogRecord]:
        with reading(self._path):
            about = self._path.stat()
            if stat.S_ISDIR(about.st_mode):
                raise DataError(f"{self._path}: is a directory; a recording is a file, NAME.tlog")
            if not stat.S_ISREG(about.st_mode):
                raise DataError(f"{self._path}: is no file; a recording cannot be replayed from a pipe or device")
            if about.st_size == 0:
                raise DataError(f"{self._path}: is empty, no tlog")
            with self._path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                yield from self._in_order(self._records(data))

    def _in_order(self, records: Iterator[TlogRecord]) -> Iterator[TlogRecord]:
        """Yield records with times that never go back, and without those that are wrong."""
        before_s, latest_s, ahead_s = None, float("-inf"), 0.0
        for record, following in pairwise(chain(records, [None])):
            assert record is not None
            unix_s, frame = record
            if before_s is not None and following is not None:
                after_s = following.unix_s + _BACK_S
                if before_s <= after_s and not before_s - _BACK_S <= unix_s <= after_s:
                    self.counts.add(Refusal.WRONG_TIMES)
                    unix_s = before_s
            before_s = unix_s
            if unix_s + ahead_s < latest_s - _BACK_S:
                self.counts.add(Refusal.CLOCK_WENT_BACK)
                ahead_s = latest_s - unix_s
            latest_s = max(latest_s, unix_s + ahead_s)
            yield TlogRecord(latest_s, frame)

    def _records(self, data: mmap.mmap) -> Iterator[TlogRecord]:
        position, size = 0, len(data)
        found_any = False
        while position < size:
            found = _frame_of_record(data, position)
            if isinstance(found, RawFrame):
                (time_us,) = _TIME.unpack_from(data, position)
                found_any = True
                position += _TIME.size + len(found.frame)
                yield TlogRecord(time_us / 1e6, found.frame)
                continue
            if not found_any and (other := _other_kind(data)) is not None:
                raise DataError(f"{self._path}: {other}")
            resume = _next_record(data, position + 1, size if found_any else min(size, SEARCHED_BYTES))
            if resume is not None:
                self.counts.add(Refusal.DAMAGED_BYTES, resume - position)
                position = resume
                continue
            if not found_any:
                raise DataError(
                    f"{self._path}: is no tlog: no MAVLink frame follows a time at byte 0, nor up to byte {SEARCHED_BYTES}"
                )
            if found == Refusal.TRUNCATED:
                self.counts.add(Refusal.TRUNCATED)
            else:
                self.counts.add(Refusal.DAMAGED_BYTES, size - position)
            return


def _frame_of_record(data: mmap.mmap, position: int) -> RawFrame | Refusal:
    start = position + _TIME.size
    if start >= len(data):
        return Refusal.TRUNCATED
    if not _is_time(data, position):
        return Refusal.UNVERIFIABLE
    found = read_frame(data, start)
    if isinstance(found, RawFrame) and not found.is_known:
        # Its checksum cannot be verified; a record that follows at its end confirms its length.
        following = start + len(found.frame) + _TIME.size
        if following < len(data) and data[following] not in (MAGIC_V1, MAGIC_V2):
            return Refusal.UNVERIFIABLE
    return found


def _is_time(data: mmap.mmap, position: int) -> bool:
    """Whether eight bytes can be the time of a record: a time before the year 2100."""
    time_us: int = _TIME.unpack_from(data, position)[0]
    return time_us < UNIX_TIME_TO_US


def _other_kind(data: mmap.mmap) -> str | None:
    """Return what a file is that does not begin with a record, and the remedy.

    None where it may be a damaged tlog.
    """
    for beginning, words in _OTHERS.items():
        if data[: len(beginning)] == beginning:
            return words
    for magic in ANY_MAGIC.finditer(data, 0, min(len(data), SEARCHED_BYTES)):
        found = read_frame(data, magic.start())
        if isinstance(found, RawFrame) and found.is_known:
            end = magic.start() + len(found.frame)
            following = read_frame(data, end) if end < len(data) else None
            if isinstance(following, RawFrame) and following.is_known:
                return "holds MAVLink frames without times, as MAVProxy's .tlog.raw; the .tlog itself is wanted"
            return None
    return None


def _last_time_s(data: mmap.mmap) -> float:
    """The time of the last record with a right checksum, looked for from the end."""
    tail = SEARCHED_BYTES
    while True:
        at, last_s = _next_record(data, max(len(data) - tail, 0), len(data)), float("-inf")
        while at is not None:
            found = read_frame(data, at + _TIME.size)
            assert isinstance(found, RawFrame)
            last_s = _TIME.unpack_from(data, at)[0] / 1e6
            at = _next_record(data, at + _TIME.size + len(found.frame), len(data))
        if last_s != float("-inf") or tail >= len(data):
            return last_s
        tail *= 2


def _next_record(data: mmap.mmap, start: int, end: int) -> int | None:
    """The first offset in [start, end) of a record whose frame has a right checksum."""
    for magic in ANY_MAGIC.finditer(data, start + _TIME.size, end):
        found = read_frame(data, magic.start())
        if isinstance(found, RawFrame) and found.is_known and _is_time(data, magic.start() - _TIME.size):
            return magic.start() - _TIME.size
    return None
