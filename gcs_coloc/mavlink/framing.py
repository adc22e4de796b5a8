"""Finding MAVLink frames among bytes, and checking them: lengths, flags, checksum. No signature is verified here."""

from __future__ import annotations

import re
import struct
from typing import NamedTuple

from pymavlink.generator.mavcrc import x25crc

from gcs_coloc.mavlink.counts import Counts
from gcs_coloc.mavlink.dialect import CRC_EXTRA

MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
HEADER_LENGTH_V1 = 6
HEADER_LENGTH_V2 = 10
CHECKSUM_LENGTH = 2
SIGNATURE_LENGTH = 13
INCOMPAT_SIGNED = 0x01
MAX_FRAME_LENGTH = HEADER_LENGTH_V2 + 255 + CHECKSUM_LENGTH + SIGNATURE_LENGTH

GARBAGE_BYTES = "garbage_bytes"
TRUNCATED = "truncated"
BAD_CRC = "bad_crc"
UNKNOWN_INCOMPAT_FLAGS = "unknown_incompat_flags"
UNVERIFIABLE = "unverifiable"

_ANY_MAGIC = re.compile(b"[\xfd\xfe]")
_HEADER_V1 = struct.Struct("<5B")  # after the magic byte: length, sequence, system, component, message id
_HEADER_V2 = struct.Struct("<6BHB")  # length, incompat and compat flags, sequence, system, component, message id (24 bits)


class RawFrame(NamedTuple):
    """One frame: its header, its payload (trailing zeros may be cut off) and its whole bytes.

    Its checksum is right, except where the message id is in no dialect of ours (`is_known` False): it is unverifiable then.
    """

    is_known: bool
    message_id: int
    sysid: int
    compid: int
    sequence: int
    checksum: int
    payload: bytes
    frame: bytes


class _Extent(NamedTuple):
    """What a header says of its frame: where payload, checksum and frame end, and whose it is."""

    message_id: int
    sysid: int
    compid: int
    sequence: int
    payload_start: int
    payload_end: int
    end: int


def split(data: bytes, counts: Counts, *, ended: bool) -> tuple[list[RawFrame], int]:
    """Find the good frames in `data`, and how many of its bytes are dealt with.

    Garbage is skipped byte by byte, and a frame that turns out bad costs its magic byte only: no length that garbage
    happens to state hides a good frame behind it. With `ended` (a datagram) all bytes are dealt with; without (a
    stream) the bytes from the returned offset on, at most `MAX_FRAME_LENGTH`, may be the beginning of a frame.

    A frame whose message id is unknown cannot be verified. It is taken for one where another frame's magic byte or the
    end of the datagram follows, else for garbage.
    """
    frames: list[RawFrame] = []
    position, size = 0, len(data)
    while position < size:
        magic = data[position]
        if magic not in (MAGIC_V1, MAGIC_V2):
            found = _ANY_MAGIC.search(data, position)
            next_magic = found.start() if found else size
            counts.add(GARBAGE_BYTES, next_magic - position)
            position = next_magic
            continue
        extent = _extent(data, position, size)
        if extent is None:
            fault = UNKNOWN_INCOMPAT_FLAGS
        elif extent.end > size:
            if not ended:
                break
            fault = TRUNCATED
        elif (crc_extra := CRC_EXTRA.get(extent.message_id)) is not None:
            if x25crc(data[position + 1 : extent.payload_end] + bytes((crc_extra,))).crc == _checksum(data, extent):
                frames.append(_raw_frame(data, position, extent, is_known=True))
                position = extent.end
                continue
            fault = BAD_CRC
        elif extent.end == size and not ended:
            break
        elif extent.end == size or data[extent.end] in (MAGIC_V1, MAGIC_V2):
            frames.append(_raw_frame(data, position, extent, is_known=False))
            position = extent.end
            continue
        else:
            fault = UNVERIFIABLE
        counts.add(fault)
        counts.add(GARBAGE_BYTES)
        position += 1
    return frames, position


def _extent(data: bytes, start: int, size: int) -> _Extent | None:
    """Read the header at `start`; None where it asks for a feature that we do not know. `end` is beyond `size` if cut off."""
    if data[start] == MAGIC_V2:
        payload_start = start + HEADER_LENGTH_V2
        if payload_start > size:
            return _Extent(0, 0, 0, 0, payload_start, payload_start, payload_start)
        length, incompat, _, sequence, sysid, compid, id_low, id_high = _HEADER_V2.unpack_from(data, start + 1)
        if incompat & ~INCOMPAT_SIGNED:
            return None
        message_id = id_low | id_high << 16
        signature_length = SIGNATURE_LENGTH if incompat else 0
    else:
        payload_start = start + HEADER_LENGTH_V1
        if payload_start > size:
            return _Extent(0, 0, 0, 0, payload_start, payload_start, payload_start)
        length, sequence, sysid, compid, message_id = _HEADER_V1.unpack_from(data, start + 1)
        signature_length = 0
    payload_end = payload_start + length
    return _Extent(
        message_id, sysid, compid, sequence, payload_start, payload_end, payload_end + CHECKSUM_LENGTH + signature_length
    )


def _checksum(data: bytes, extent: _Extent) -> int:
    return data[extent.payload_end] | data[extent.payload_end + 1] << 8


def _raw_frame(data: bytes, start: int, extent: _Extent, *, is_known: bool) -> RawFrame:
    return RawFrame(
        is_known,
        extent.message_id,
        extent.sysid,
        extent.compid,
        extent.sequence,
        _checksum(data, extent),
        data[extent.payload_start : extent.payload_end],
        data[start : extent.end],
    )


class StreamFramer:
    """Cuts a byte stream (TCP, serial) into whole frames. It holds back at most one unfinished frame."""

    def __init__(self, counts: Counts) -> None:
        self._counts = counts
        self._pending = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Take the next bytes of the stream and return the frames that they complete."""
        buffer = self._pending + data
        frames, dealt_with = split(buffer, self._counts, ended=False)
        self._pending = buffer[dealt_with:]
        return [raw.frame for raw in frames]
