"""Hand-written MAVLink 2 frames of messages that pymavlink's ardupilotmega dialect lacks.

They are PEER_RANGE and RANGING_BEACON. Ranges can also be built as DEBUG_VECT and as NAMED_VALUE_FLOAT, for autopilots that
can send nothing else.

Written from the messages' definitions, not from the service's code, so that the wire is checked from two sides. Frame
layout: https://mavlink.io/en/guide/serialization.html.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.generator.mavcrc import x25crc

PEER_RANGE_ID = 181600  # source: the dialect of gcs-coloc
RANGING_BEACON_ID = 513  # source: MAVLink, development.xml

# Fields in wire order: the largest types first, definition order among equals.
_PEER_RANGE_FIELDS = (
    ("uint64_t", "time_usec"),
    ("float", "range"),
    ("float", "range_std"),
    ("uint16_t", "sequence"),
    ("uint8_t", "peer_system"),
    ("uint8_t", "quality"),
    ("uint8_t", "device_id"),
)
_RANGING_BEACON_FIELDS = (
    ("uint64_t", "time_usec"),
    ("uint32_t", "range"),
    ("int32_t", "lat"),
    ("int32_t", "lon"),
    ("float", "alt"),
    ("uint32_t", "hacc_est"),
    ("uint32_t", "vacc_est"),
    ("uint32_t", "range_accuracy"),
    ("uint16_t", "beacon_id"),
    ("uint16_t", "carrier_freq"),
    ("uint8_t", "target_system"),
    ("uint8_t", "target_component"),
    ("uint8_t", "alt_type"),
    ("uint8_t", "sequence"),
    ("uint8_t", "status"),
)
_UINT32_UNKNOWN = 0xFFFFFFFF  # MAVLink's unknown of the type
_INT32_UNKNOWN = 0x7FFFFFFF  # the same
_ALT_MSL = 1


def crc_extra(name: str, fields: Sequence[tuple[str, str]]) -> int:
    """CRC_EXTRA of a message without arrays: its name and its fields (type, name) in wire order."""
    crc = x25crc()
    crc.accumulate_str(name + " ")
    for type_name, field in fields:
        crc.accumulate_str(f"{type_name} {field} ")
    value: int = crc.crc
    return (value & 0xFF) ^ (value >> 8)


_PEER_RANGE_CRC_EXTRA = crc_extra("PEER_RANGE", _PEER_RANGE_FIELDS)
_RANGING_BEACON_CRC_EXTRA = crc_extra("RANGING_BEACON", _RANGING_BEACON_FIELDS)


def _frame(message_id: int, payload: bytes, extra: int, sysid: int, compid: int, sequence: int) -> bytes:
    payload = payload.rstrip(b"\0") or payload[:1]
    head = struct.pack("<BBBBBB", len(payload), 0, 0, sequence & 0xFF, sysid, compid) + message_id.to_bytes(3, "little")
    crc = x25crc(head + payload)
    crc.accumulate(bytes([extra]))
    return b"\xfd" + head + payload + struct.pack("<H", crc.crc)


def peer_range_frame(
    *,
    sysid: int,
    compid: int,
    frame_sequence: int,
    time_usec: int,
    peer_system: int,
    range_m: float,
    range_std_m: float,
    sequence: int,
    quality: int = 255,
    device_id: int = 0,
    station: int | None = None,
) -> bytes:
    """Pack PEER_RANGE (181600).

    `time_usec` is on the sender's clock. `range_std_m` is 0 where unknown, `quality` in % or 255.

    To a `station` (id) `peer_system` is 0, and the extension fields peer_type and peer_station name it.
    """
    fields = time_usec, range_m, range_std_m, sequence & 0xFFFF, peer_system, quality, device_id
    payload = struct.pack("<QffHBBBBH", *fields, int(station is not None), station or 0)
    return _frame(PEER_RANGE_ID, payload, _PEER_RANGE_CRC_EXTRA, sysid, compid, frame_sequence)


def ranging_beacon_frame(
    *,
    sysid: int,
    compid: int,
    frame_sequence: int,
    time_usec: int,
    peer_system: int,
    range_m: float,
    range_std_m: float,
    sequence: int,
    station: int | None = None,
    station_lla: tuple[float, float, float] | None = None,
) -> bytes:
    """Pack RANGING_BEACON (513).

    `station_lla` is the position of the `station` (degrees, m above mean sea level). Without one, `beacon_id` is the
    peer's system id, and the position is marked unknown.
    """
    lat_deg, lon_deg, alt_m = station_lla if station_lla is not None else (math.nan, math.nan, math.nan)
    accuracy = round(range_std_m * 1000.0) if range_std_m > 0.0 else _UINT32_UNKNOWN
    payload = struct.pack(
        "<QIiifIIIHHBBBBB",
        time_usec,
        round(range_m * 1000.0),
        _INT32_UNKNOWN if station_lla is None else round(lat_deg * 1e7),
        _INT32_UNKNOWN if station_lla is None else round(lon_deg * 1e7),
        alt_m,
        _UINT32_UNKNOWN,
        _UINT32_UNKNOWN,
        accuracy,
        peer_system if station is None else station,
        0,
        0,
        0,
        0 if station_lla is None else _ALT_MSL,
        sequence & 0xFF,
        0,
    )
    return _frame(RANGING_BEACON_ID, payload, _RANGING_BEACON_CRC_EXTRA, sysid, compid, frame_sequence)


def debug_range(time_usec: int, peer_system: int, range_m: float, range_std_m: float, station: int | None = None) -> Any:
    """Build a range as DEBUG_VECT, named as `named_range` does.

    x is the range, y its standard deviation (0 unknown).
    """
    return mavlink.MAVLink_debug_vect_message(_name(peer_system, station).encode(), time_usec, range_m, range_std_m, -1.0)


def named_range(boot_s: float, peer_system: int, range_m: float, station: int | None = None) -> Any:
    """Build a range as NAMED_VALUE_FLOAT.

    Its name is "RNG" and the peer's system id, or "STN" and the station's id.
    """
    time_boot_ms = int(boot_s * 1000.0) & 0xFFFFFFFF
    return mavlink.MAVLink_named_value_float_message(time_boot_ms, _name(peer_system, station).encode(), range_m)


def _name(peer_system: int, station: int | None) -> str:
    return f"RNG{peer_system}" if station is None else f"STN{station}"
