"""Frames to the records of a tlog: without signatures, and without the message that carries the key to them."""

from __future__ import annotations

import struct

from fastcrc.crc16 import mcrf4xx

from gcs_coloc.mavlink.dialect import CRC_EXTRA
from gcs_coloc.mavlink.framing import CHECKSUM_LENGTH, INCOMPAT_SIGNED, MAGIC_V1, MAGIC_V2, SIGNATURE_LENGTH

_TIME = struct.Struct(">Q")
_SETUP_SIGNING = 256
_INCOMPAT_AT = 2


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
    """The frame as it would be had it not been signed; None where its message is unknown and its checksum with it."""
    if frame[0] != MAGIC_V2 or not frame[_INCOMPAT_AT] & INCOMPAT_SIGNED:
        return frame
    crc_extra = CRC_EXTRA.get(message_id(frame))
    if crc_extra is None:
        return None
    body = bytearray(frame[: -SIGNATURE_LENGTH - CHECKSUM_LENGTH])
    body[_INCOMPAT_AT] &= ~INCOMPAT_SIGNED
    checksum = mcrf4xx(bytes(body[1:]) + bytes((crc_extra,)))
    return bytes(body) + checksum.to_bytes(2, "little")
