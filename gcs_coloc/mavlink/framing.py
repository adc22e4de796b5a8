"""MAVLink framing: find and verify the frames in bytes, and read whom they address.

It also has the message definitions of our dialect, and the usual ids of ground stations and of this service.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from mmap import mmap
from types import MappingProxyType
from typing import Any, NamedTuple

from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import ardupilotmega

from gcs_coloc.mavlink._generated import gcs_coloc
from gcs_coloc.mavlink.refusals import Counts, Refusal

MESSAGE_CLASSES: Mapping[int, Any] = MappingProxyType({**ardupilotmega.mavlink_map, **gcs_coloc.mavlink_map})
"""pymavlink's message class (with `unpacker`, `crc_extra`, `ordered_fieldnames`) of each message id."""

CRC_EXTRA: Mapping[int, int] = MappingProxyType({number: cls.crc_extra for number, cls in MESSAGE_CLASSES.items()})
"""The last byte of each message's checksum (MAVLink's CRC_EXTRA): ends with different definitions refuse each other."""

GCS_SYSID = 255  # source: MAVLink, usual id of a ground station
GCS_COMPID = ardupilotmega.MAV_COMP_ID_MISSIONPLANNER
"""The ids of a ground station by custom."""

OWN_SYSID = 254  # chosen: beside that of a ground station
OWN_COMPID = ardupilotmega.MAV_COMP_ID_ONBOARD_COMPUTER
"""Our ids unless set otherwise: no vehicle and no ground station uses them by custom."""

# Source of these: MAVLink, packet serialisation.
MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
HEADER_LENGTH_V1 = 6
HEADER_LENGTH_V2 = 10
CHECKSUM_LENGTH = 2
SIGNATURE_LENGTH = 13
INCOMPAT_SIGNED = 0x01
INCOMPAT_32_BIT = 0x02 | 0x04
"""A sender's id or a target beyond one byte. Source: MAVLink RFC 20, https://github.com/mavlink/rfcs/pull/20, with 32 bits."""
_KNOWN_INCOMPAT = INCOMPAT_SIGNED | INCOMPAT_32_BIT
MAX_PAYLOAD_LENGTH = 255
"""Lengths in bytes, as in https://mavlink.io/en/guide/serialization.html."""
MAX_FRAME_LENGTH = HEADER_LENGTH_V2 + MAX_PAYLOAD_LENGTH + CHECKSUM_LENGTH + SIGNATURE_LENGTH

MAX_FALSE_STARTS = 512
"""Chosen: a datagram with more magic bytes that begin no frame is an attack; so many cost about a millisecond."""


ANY_MAGIC = re.compile(b"[\xfd\xfe]")
_new = tuple.__new__
_ONE_BYTE = tuple(bytes((value,)) for value in range(256))
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

    @property
    def is_signed(self) -> bool:
        """Whether the frame carries a signature, right or wrong."""
        return self.frame[0] == MAGIC_V2 and bool(self.frame[2] & INCOMPAT_SIGNED)


def read_frame(data: bytes | mmap, start: int) -> RawFrame | Refusal:
    """Read the frame that begins at `start`, or return why there is none.

    The reason is a Refusal from NO_MAGIC to UNKNOWN_INCOMPAT_FLAGS.
    """
    size = len(data)
    magic = data[start]
    if magic == MAGIC_V2:
        payload_start = start + HEADER_LENGTH_V2
        if payload_start > size:
            return Refusal.TRUNCATED
        length, incompat, _, sequence, sysid, compid, id_low, id_high = _HEADER_V2.unpack_from(data, start + 1)
        if incompat & ~INCOMPAT_SIGNED:
            # Random bytes have other flags as well.
            return Refusal.UNKNOWN_INCOMPAT_FLAGS if incompat & ~_KNOWN_INCOMPAT else Refusal.SYSTEM_ID_32_BIT
        message_id = id_low | id_high << 16
    elif magic == MAGIC_V1:
        payload_start = start + HEADER_LENGTH_V1
        if payload_start > size:
            return Refusal.TRUNCATED
        length, sequence, sysid, compid, message_id = _HEADER_V1.unpack_from(data, start + 1)
        incompat = 0
    else:
        return Refusal.NO_MAGIC
    payload_end = payload_start + length
    end = payload_end + CHECKSUM_LENGTH + (SIGNATURE_LENGTH if incompat else 0)
    if end > size:
        return Refusal.TRUNCATED
    checksum = data[payload_end] | data[payload_end + 1] << 8
    crc_extra = CRC_EXTRA.get(message_id)
    if crc_extra is not None and mcrf4xx(data[start + 1 : payload_end] + _ONE_BYTE[crc_extra]) != checksum:
        return Refusal.BAD_CRC
    payload = data[payload_start:payload_end]
    # As RawFrame(...), in half the time.
    return _new(RawFrame, (crc_extra is not None, message_id, sysid, compid, sequence, checksum, payload, data[start:end]))


def sender_of(frame: bytes) -> tuple[int, int]:
    """The system and component id in the header of a whole frame of either version."""
    return (frame[3], frame[4]) if frame[0] == MAGIC_V1 else (frame[5], frame[6])


def split(data: bytes, counts: Counts, *, ended: bool) -> tuple[list[RawFrame], int]:
    """Find the valid frames in `data`, and the number of its bytes that are consumed.

    Garbage is skipped byte by byte, and of an invalid frame only the magic byte: a length within garbage must not hide a
    valid frame behind it. With `ended` (a datagram) all bytes are consumed; without (a stream) the bytes from the returned
    offset on, at most `MAX_FRAME_LENGTH`, may be the beginning of a frame.

    A frame whose message id is unknown cannot be verified. It counts as valid where another frame's magic byte or the end
    of the datagram follows, else as garbage. The rest of a datagram is dropped after `MAX_FALSE_STARTS`.
    """
    frames: list[RawFrame] = []
    position, size, false_starts = 0, len(data), 0
    while position < size:
        found = read_frame(data, position)
        if isinstance(found, Refusal):
            fault = found
        else:
            end = position + len(found.frame)
            if found.is_known or (data[end] in (MAGIC_V1, MAGIC_V2) if end < size else ended):
                frames.append(found)
                position = end
                continue
            fault = Refusal.UNVERIFIABLE if end < size else Refusal.TRUNCATED
        if fault == Refusal.TRUNCATED and not ended:
            break
        if fault != Refusal.NO_MAGIC:
            counts.add(fault)
            false_starts += 1
        if ended and false_starts > MAX_FALSE_STARTS:
            counts.add(Refusal.REST_DROPPED)
            counts.add(Refusal.GARBAGE_BYTES, size - position)
            return frames, size
        next_magic = ANY_MAGIC.search(data, position + 1)
        resume = next_magic.start() if next_magic else size
        counts.add(Refusal.GARBAGE_BYTES, resume - position)
        position = resume
    return frames, position


class StreamFramer:
    """Cuts a byte stream (TCP, serial) into whole frames. It keeps at most one unfinished frame."""

    def __init__(self, counts: Counts) -> None:
        self._counts = counts
        self._pending = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Add the next bytes of the stream and return the frames that they complete."""
        buffer = self._pending + data
        frames, consumed = split(buffer, self._counts, ended=False)
        self._pending = buffer[consumed:]
        return [raw.frame for raw in frames]


class Target(NamedTuple):
    """A system and a component of it; 0 is all of them."""

    sysid: int
    compid: int


EVERYBODY = Target(0, 0)

_SYSTEM_FIELDS = ("target_system", "target")  # MANUAL_CONTROL alone has the second
_COMPONENT_FIELD = "target_component"
_FIELD_FORMAT = re.compile(r"\d*[a-zA-Z]")


def _offsets(message_class: Any) -> tuple[int, int | None] | None:
    """Return the offsets of the target system and component in the payload, bytes.

    None where the message has no target, and for the component where it has a target system alone.
    """
    at, places = 0, {}
    formats = _FIELD_FORMAT.findall(message_class.unpacker.format.lstrip("<"))
    for name, field_format in zip(message_class.ordered_fieldnames, formats, strict=True):
        places[name] = at
        at += struct.calcsize(f"<{field_format}")
    for name in _SYSTEM_FIELDS:
        if name in places:
            return places[name], places.get(_COMPONENT_FIELD)
    return None


_OFFSETS: Mapping[int, tuple[int, int | None]] = MappingProxyType(
    {number: found for number, cls in MESSAGE_CLASSES.items() if (found := _offsets(cls)) is not None}
)


def target_of(raw: RawFrame) -> Target:
    """The target of a frame; everybody where its message has no target field, or is in no dialect of ours."""
    offsets = _OFFSETS.get(raw.message_id)
    if offsets is None:
        return EVERYBODY
    system_at, component_at = offsets
    return Target(_byte(raw.payload, system_at), _byte(raw.payload, component_at) if component_at is not None else 0)


def _byte(payload: bytes, at: int) -> int:
    # MAVLink 2 cuts off trailing zeros.
    return payload[at] if at < len(payload) else 0
